"""Bars of the report: every clip beside the prevalence baseline, the mean beside published ones."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from mseg.evaluation.results import ScoreTable
from mseg.evaluation.tables import published_for

_MAX_DOTS = 30


def bars_per_clip(scores: ScoreTable, order: Sequence[str], *, linked: bool) -> str:
    """Draw the error of each clip: bar = mean over seeds, dots = seeds, line = prevalence baseline."""
    matrix = scores.matrix()
    place = {name: i for i, name in enumerate(scores.names)}
    top = max(0.05, float(matrix.max()), *(scores.of(name).prevalence for name in order))
    rows = []
    for name in order:
        runs = matrix[place[name]]
        base = scores.of(name).prevalence
        seeds = "".join(_mark("seed", v / top) for v in runs[:_MAX_DOTS]) if len(runs) > 1 else ""
        drawn = _bar(runs.mean() / top) + _mark("base", base / top) + seeds
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
        "<div class='key'><span><i></i>error, %</span>"
        f"<span><i class='base'></i>prevalence baseline: all in the largest motion</span>{dots}"
        f"<span>full width = {100 * top:.0f} %</span></div>"
        "<div class='scroll'><table class='bars clips'><thead><tr><th scope='col'>clip</th>"
        "<th scope='col'>error</th><th scope='col' class='wide'>prevalence</th><th></th></tr></thead>"
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
    top = max(0.01, *(v for v, _, _ in values))
    rows = "".join(
        f"<tr class='{kind}'><th scope='row'>{escape(method)}</th><td>{100 * v:.2f}</td>"
        f"<td class='track'><div>{_bar(v / top)}</div></td></tr>"
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
        f"<div class='scroll'><table class='bars'><tbody>{rows}</tbody></table></div>"
    )


_TABLE = "Table 1 of Xu, Cheong and Li, CVPR 2018"


def _bar(share: float) -> str:
    return f"<i class='bar' style='width:{100 * min(1.0, share):.2f}%'></i>"


def _mark(kind: str, share: float) -> str:
    return f"<i class='{kind}' style='left:{100 * min(1.0, share):.2f}%'></i>"
