"""Running methods on benchmarks and folders of clips: in parallel, resumable, reproducible."""

from __future__ import annotations

from mseg.benchmark.predictions import predict
from mseg.benchmark.results import BenchmarkResult
from mseg.benchmark.runner import find_clips, run
from mseg.benchmark.tasks import Configuration

__all__ = ["BenchmarkResult", "Configuration", "find_clips", "predict", "run"]
