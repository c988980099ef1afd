"""Run as ``python -m kt3dmoseg``."""

from kt3dmoseg.cli import main

raise SystemExit(main())
