"""A benchmark's result made of figures."""

import numpy as np

from mseg.benchmark import BenchmarkResult
from mseg.evaluation import ClipScore, ScoreTable, SubmissionMeta, load_protocol
from mseg.evaluation.scoring import Provenance


def benchmark_result(
    benchmark, configurations, motions, errors, *, scored=(), found=(), failed=(), seeds=(0, 1)
):
    """Errors and found are (methods, clips, seeds); failed: reasons by method, clip and seed."""
    sizes, tables = scored or [100] * len(motions), []
    for m, made in enumerate(configurations):
        clips = []
        for i, (name, n_motions) in enumerate(motions.items()):
            for s, seed in enumerate(seeds):
                n_found = int(found[m][i][s]) if len(found) else n_motions
                reason = dict(failed).get((made.title, name, seed), "")
                values = {"error": float(errors[m][i][s])}
                clips.append(ClipScore(name, seed, n_motions, sizes[i], n_found, 0.5, reason, values))
        meta, source = SubmissionMeta(made.title), Provenance("2018", "a" * 64, "", "0.1.0")
        tables.append(ScoreTable(tuple(clips), meta, load_protocol(benchmark), source))
    return BenchmarkResult(tuple(configurations), tuple(tables), np.full(np.shape(errors), 0.125))
