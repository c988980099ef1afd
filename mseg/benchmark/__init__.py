"""Running methods on benchmarks and folders of clips: in parallel, resumable, reproducible."""

from mseg.benchmark.results import BenchmarkResult, Configuration
from mseg.benchmark.runner import find_clips, predict, run

__all__ = ["BenchmarkResult", "Configuration", "find_clips", "predict", "run"]
