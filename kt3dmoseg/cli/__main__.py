"""Run as ``python -m kt3dmoseg.cli``."""

from kt3dmoseg.cli import main

raise SystemExit(main())
