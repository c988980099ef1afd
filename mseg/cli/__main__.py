"""Run as ``python -m mseg.cli``."""

from mseg.cli import main

raise SystemExit(main())
