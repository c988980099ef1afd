"""Run as ``python -m mseg``."""

from mseg.cli import main

raise SystemExit(main())
