"""Bars of the report: every clip beside the prevalence baseline, the mean beside published ones."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from mseg.evaluation.results import ScoreTable
from mseg.evaluation.tables import published_for

_MAX_DOTS = 30
_STEPS = (0.01, 0.02, 0.05, 0.10, 0.15, 0.20, 0.25)
_TABLE = "Table 1 of Xu, Cheong and Li, CVPR 2018"


def bars_per_clip(scores: ScoreTable, order: Sequence[str], *, linked: bool) -> str:
    """Draw the error of each clip: bar = mean over seeds, dots = seeds, line = prevalence baseline."""
    matrix = scores.matrix()
    place = {name: i for i, name in enumerate(scores.names)}
    step = _step(float(matrix.max()), *(scores.of(name).prevalence for name in order))
    rows = []
    for name in order:
        runs = matrix[place[name]]
        base = scores.of(name).prevalence
        seeds = "".join(_mark("seed", v / step) for v in runs[:_MAX_DOTS]) if len(runs) > 1 else ""
        drawn = _bar(runs.mean() / step) + _mark("base", base / step) + seeds
        failed = any(scores.of(name, seed).reason for seed in scores.seeds)
        title = f"<a href='#clip-{escape(name)}'>{escape(name)}</a>" if linked else escape(name)
        rows.append(
            f"<tr class='{'failed' if failed else ''}'><th scope='row'>{title}"
            f"{' <span class=bad>failed</span>' if failed else ''}</th>"
            f"<td>{100 * runs.mean():.2f}</td><td class='wide'>{100 * base:.2f}</td>"
            f"<td class='track'><div>{drawn}</div></td></tr>"
        )
    dots = "<span><i class='seed'></i>single seeds</span>" if len(scores.seeds) > 1 else ""
    return (
        "<div class='key'><span><i></i>classification error, %</span>"
        f"<span><i class='base'></i>prevalence baseline: all in the largest motion</span>{dots}</div>"
        "<div class='scroll'><table class='bars clips'><thead><tr><th scope='col'>clip</th>"
        f"<th scope='col'>error</th><th scope='col' class='wide'>prevalence</th>{_axis(step)}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def bars_published(scores: ScoreTable) -> str:
    """Draw the mean error per group beside the published means."""
    return "".join(
        _published_group(scores, group.title, names, {m: v["mean"] / 100 for m, v in known.items()})
        for group, names in scores.groups()
        if names and (known := published_for(scores, group))
    )


def _published_group(scores: ScoreTable, title: str, names: list[str], known: dict[str, float]) -> str:
    summary = scores.summary("error", names)
    own = f"{scores.meta.method} (this submission)"
    values = sorted([(v, m, "") for m, v in known.items()] + [(summary.mean, own, "own")])
    step = _step(*(v for v, _, _ in values))
    rows = "".join(
        f"<tr class='{kind}'><th scope='row'>{escape(method)}</th><td>{100 * v:.2f}</td>"
        f"<td class='track'><div>{_bar(v / step)}</div></td></tr>"
        for v, method, kind in values
    )
    protocol = scores.benchmark
    part = (
        f" Published means are over all {protocol.n_clips} clips, this submission's over "
        f"{protocol.coverage(scores.names)}."
    )
    return (
        f"<h2>Beside published results: {escape(title)}</h2>"
        f"<p class='quiet'>Mean classification error, %. Published: {escape(_TABLE)}.{escape(part)}</p>"
        "<div class='scroll'><table class='bars'><thead><tr><th scope='col'>method</th>"
        f"<th scope='col'>mean</th>{_axis(step)}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _step(*values: float) -> float:
    """Round distance of the axis' lines, four of which hold all values."""
    return next((step for step in _STEPS if 4 * step >= max(values)), _STEPS[-1])


def _axis(step: float) -> str:
    """Head of the bars' column: the numbers of the axis' lines."""
    numbers = "".join(f"<span style='left:{25 * k}%'>{100 * k * step:.0f}</span>" for k in range(5))
    return f"<th scope='col' class='track'><div class='axis' aria-hidden='true'>{numbers}</div></th>"


def _bar(steps: float) -> str:
    return f"<i class='bar' style='width:{25 * min(4.0, steps):.2f}%'></i>"


def _mark(kind: str, steps: float) -> str:
    return f"<i class='{kind}' style='left:{25 * min(4.0, steps):.2f}%'></i>"
