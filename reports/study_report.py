"""A study as a page and as Markdown: verdicts first, then what they rest on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmbm.reports.curves import MetricCurve, curve_figure, svg_image
from pmbm.reports.page import render_page
from pmbm.reports.render import LAYERS, ReplayView, facts, replay_view
from pmbm.reports.tables import (
    MAIN_METRICS,
    Row,
    Table,
    Verdict,
    code_block,
    judge,
    markdown_table,
    metric_row,
    metric_rows,
    metric_tables,
    plain_markdown,
    shown_metric,
    words,
)
from pmbm.reports.values import CellResults, StudyReport
from pmbm.study import Estimate, Summary, TrialResult, estimate, metric_scale

CURVE_METRICS = (
    "gospa",
    "id_switches",
    "misses",
    "false_positives",
    "mota",
    "hota",
)
COMPONENTS = ("gospa_localisation", "gospa_missed", "gospa_false")
ALPHA = 0.05
SETTINGS_IN_FULL = 3
"""With more settings, Markdown shows their leading metric alone."""


@dataclass(frozen=True)
class StudyFinding:
    """The comparison of one tracker with the reference in one scenario.

    verdict : better or worse where any cell says so after Holm's adjustment over all cells and
        trackers, and none says the opposite.
    headline, detail : for people.
    """

    verdict: Verdict
    headline: str
    detail: str


@dataclass(frozen=True)
class _CellView:
    label: str
    main: Table
    rest: Table | None
    trials: int


@dataclass(frozen=True)
class _Picture:
    light: str
    dark: str
    alt: str


@dataclass(frozen=True)
class _Curves:
    parameter: str
    pictures: tuple[_Picture, ...]


@dataclass(frozen=True)
class _Stack:
    """One bar of the decomposed GOSPA: shares in percent of the longest bar."""

    label: str
    tracker: int
    parts: tuple[tuple[str, float, float], ...]
    total: str


@dataclass(frozen=True)
class _ScenarioView:
    name: str
    stresses: str
    cells: tuple[_CellView, ...]
    overview: tuple[Row, ...]
    curves: tuple[_Curves, ...]
    stacks: tuple[_Stack, ...]


@dataclass(frozen=True)
class _WorstView:
    why: str
    command: str
    replay: ReplayView | None


def study_page(study: StudyReport) -> str:
    """The study as one HTML file that opens from disk."""
    summaries = [summary for summary in study.summaries if summary]
    metric = leading_metric(summaries)
    return render_page(
        "study.html.j2",
        title=f"Study: {study.name}",
        lede=_lede(study, summaries),
        commands=tuple(study.commands.items()),
        findings=findings(study),
        metric=shown_metric(metric),
        trackers=summaries[0].trackers if summaries else (),
        compared=tuple(summaries[0].differences) if summaries else (),
        reference=summaries[0].reference if summaries else "",
        scenarios=tuple(_scenarios(study, metric)),
        timings=_timings(study),
        worst=tuple(
            _WorstView(w.why, w.command, replay_view(w.replay) if w.replay else None)
            for w in study.worst
        ),
        failures=study.failures,
        facts=facts(study.provenance),
        layers=LAYERS,
    )


def study_markdown(study: StudyReport) -> str:
    """The verdicts, the leading metrics and the failures, for a pull request."""
    summaries = [summary for summary in study.summaries if summary]
    lines = [f"### {plain_markdown(study.name)}", "", plain_markdown(_lede(study, summaries)), ""]
    lines += [
        f"- **{plain_markdown(f.headline)}** {plain_markdown(f.detail)}" for f in findings(study)
    ]
    if summaries:
        lines += ["", *_markdown_tables(study, summaries)]
    if study.failures:
        rows = [(f.trial, f.what, f.command) for f in study.failures]
        lines += ["", markdown_table(["trial without result", "what happened", "replay"], rows, 3)]
    for what, command in study.commands.items():
        lines += ["", f"{what}:", "", code_block(command)]
    return "\n".join(lines) + "\n"


def findings(study: StudyReport) -> tuple[StudyFinding, ...]:
    """One finding per scenario and compared tracker, on the leading metric.

    A cell counts where the p-value of its paired difference, adjusted by Holm (Scand. J. Statist.
    6, 1979) over all cells and trackers of the study, is below 5 %.
    """
    metric = leading_metric([summary for summary in study.summaries if summary])
    shown = shown_metric(metric)
    paired = [
        (name, cell, tracker, difference)
        for name, cells in study.scenarios.items()
        for cell, summary in cells
        for tracker, values in summary.differences.items()
        if (difference := values.get(metric)) and difference.mean is not None
    ]
    clear = holm([p_value(difference) for *_, difference in paired])
    found = []
    keys = dict.fromkeys((name, tracker) for name, _, tracker, _ in paired)
    for name, tracker in keys:
        mine = [
            (cell, difference, judge(difference, shown.sign) if sure else "tie")
            for (scenario, cell, other, difference), sure in zip(paired, clear, strict=True)
            if (scenario, other) == (name, tracker)
        ]
        reference = study.scenarios[name][0][1].reference
        found.append(_finding(name, tracker, reference, shown.name, shown.unit, mine))
    return tuple(found)


def leading_metric(summaries: Sequence[Summary]) -> str:
    """GOSPA where it was measured, else the first metric of the study."""
    measured = list(dict.fromkeys(m for summary in summaries for m in summary.metrics))
    return next((m for m in MAIN_METRICS if m in measured), measured[0] if measured else "gospa")


def p_value(difference: Estimate) -> float:
    """The two-sided p-value against no difference, or 1 where there is no interval at any level."""
    return 1.0 if difference.uncertainty is None else difference.uncertainty.p_value()


def holm(p_values: Sequence[float], alpha: float = ALPHA) -> list[bool]:
    """The hypotheses that Holm's step-down procedure rejects."""
    rejected = [False] * len(p_values)
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    for rank, index in enumerate(order):
        if p_values[index] > alpha / (len(p_values) - rank):
            break
        rejected[index] = True
    return rejected


def _finding(
    scenario: str,
    tracker: str,
    reference: str,
    metric: str,
    unit: str,
    cells: Sequence[tuple[CellResults, Estimate, Verdict]],
) -> StudyFinding:
    verdicts = [verdict for *_, verdict in cells]
    better, worse = verdicts.count("better"), verdicts.count("worse")
    overall: Verdict = "tie"
    if better and not worse:
        overall = "better"
    elif worse and not better:
        overall = "worse"
    settings = "" if len(cells) == 1 else f" of {len(cells)} settings"
    if better and worse:
        what = f"{tracker} beats {reference} in {better} and loses in {worse}{settings}"
    elif overall == "tie":
        what = f"no clear difference between {tracker} and {reference}"
    else:
        what = f"{tracker} is {overall} than {reference}"
        what += f" in {max(better, worse)}{settings}" if settings else ""
    pairs = sorted({difference.n for _, difference, _ in cells})
    if len(cells) == 1:
        detail = f"{_interval(cells[0][1], unit)}, {pairs[0]} paired trials"
    else:
        extremes = sorted(cells, key=lambda entry: entry[1].mean or 0.0)
        ends = [
            f"{_interval(e, unit)} at {cell.label}" for cell, e, _ in (extremes[0], extremes[-1])
        ]
        detail = f"from {ends[0]} to {ends[1]}"
    return StudyFinding(overall, f"{scenario}: {what}", f"{metric} difference {detail}")


def _interval(difference: Estimate, unit: str) -> str:
    text = words(difference, difference.n, signed=True)
    assert text is not None
    return f"{text} {unit}".strip()


def _lede(study: StudyReport, summaries: Sequence[Summary]) -> str:
    trackers = list(dict.fromkeys(name for s in summaries for name in s.trackers))
    parts = [f"{study.done} of {study.planned} trials"]
    if len(study.cells) > 1:
        parts.append(f"{len(study.cells)} settings")
    parts.append(f"trackers {', '.join(trackers)}" if trackers else "no results yet")
    if study.failures:
        parts.append(f"{len(study.failures)} without result")
    return "; ".join(parts) + "."


def _scenarios(study: StudyReport, metric: str) -> Iterable[_ScenarioView]:
    for name, filled in study.scenarios.items():
        yield _ScenarioView(
            name=name,
            stresses=filled[0][0].stresses,
            cells=tuple(
                _CellView(cell.label, *metric_tables(summary), summary.trials)
                for cell, summary in filled
            ),
            overview=metric_rows([(cell.label, summary) for cell, summary in filled], metric),
            curves=tuple(_curves([cell for cell, _ in filled])),
            stacks=_stacks(filled),
        )


def _curves(cells: Sequence[CellResults]) -> Iterable[_Curves]:
    for parameter in cells[0].point:
        pictures = []
        for curve in robustness(cells, parameter):
            light, dark = (
                svg_image(curve_figure(curve, parameter, dark=dark)) for dark in (False, True)
            )
            pictures.append(_Picture(light, dark, f"{curve.metric.name} against {parameter}"))
        if pictures:
            yield _Curves(parameter, tuple(pictures))


def robustness(cells: Sequence[CellResults], parameter: str) -> list[MetricCurve]:
    """The study's metrics against one swept parameter, or none where it has fewer than two levels.

    Where other parameters are swept too, a trial's value at a level is its mean over their
    settings: trials stay independent, so the intervals hold.  A trial that lacks a setting there
    is left out.
    """
    levels = list(dict.fromkeys(cell.point[parameter] for cell in cells))
    if len(levels) < 2:
        return []
    trackers = list(cells[0].results[0].scores)
    measured = dict.fromkeys(
        name for result in cells[0].results for scores in result.scores.values() for name in scores
    )
    chosen = [m for m in CURVE_METRICS if m in measured] or list(measured)[:6]
    at_level = {
        level: [cell.results for cell in cells if cell.point[parameter] == level]
        for level in levels
    }
    return [
        MetricCurve(
            metric=shown_metric(metric),
            levels=tuple(levels),
            lines={
                tracker: tuple(_trial_means(at_level[level], tracker, metric) for level in levels)
                for tracker in trackers
            },
            connected=len(levels) <= 12,
        )
        for metric in chosen
    ]


def _trial_means(cells: Sequence[Sequence[TrialResult]], tracker: str, metric: str) -> Estimate:
    values: dict[int, list[float | None]] = {}
    for results in cells:
        for result in results:
            score = result.scores[tracker].get(metric)
            values.setdefault(result.trial, []).append(score)
    scale = metric_scale(metric, (value for row in values.values() for value in row))
    means = [
        None if None in row else float(np.mean(np.array(row, dtype=np.float64)))
        for row in values.values()
        if len(row) == len(cells)
    ]
    return estimate(means, scale.mean_of(len(cells)))


def _stacks(filled: Sequence[tuple[CellResults, Summary]]) -> tuple[_Stack, ...]:
    """Decomposed GOSPA, a bar per setting and tracker."""
    rows = []
    for cell, summary in filled:
        for index, tracker in enumerate(summary.trackers):
            estimates = summary.estimates[tracker]
            means = [estimates[c].mean for c in COMPONENTS if c in estimates]
            defined = [mean for mean in means if mean is not None]
            if len(defined) == len(COMPONENTS):
                rows.append((f"{cell.label} · {tracker}", index, defined))
    longest = max((sum(means) for *_, means in rows), default=0.0) or 1.0
    return tuple(_stack(label, index, means, longest) for label, index, means in rows)


def _stack(label: str, tracker: int, means: Sequence[float], longest: float) -> _Stack:
    names = [name.removeprefix("gospa_") for name in COMPONENTS]
    shares = [100 * mean / longest for mean in means]
    starts = [round(sum(shares[:k]), 2) for k in range(len(shares))]
    parts = tuple(zip(names, starts, (round(share, 2) for share in shares), strict=True))
    total = ", ".join(f"{name} {mean:.3g}" for name, mean in zip(names, means, strict=True))
    return _Stack(label, tracker, parts, total)


def _timings(study: StudyReport) -> tuple[tuple[str, str, str, str, str], ...]:
    """Per scenario and tracker: mean, median and 99th percentile of a step's CPU time, ms."""
    rows = []
    for name, cells in study.scenarios.items():
        results = [result for cell, _ in cells for result in cell.results]
        for tracker in dict.fromkeys(t for result in results for t in result.time):
            times = [result.time[tracker] for result in results if tracker in result.time]
            figures = (
                np.mean([t.mean for t in times]),
                np.median([t.median for t in times]),
                np.max([t.p99 for t in times]),
            )
            rows.append((name, tracker, *(f"{1000 * float(value):.3g}" for value in figures)))
    return tuple(rows)  # type: ignore[arg-type]


def _markdown_tables(study: StudyReport, summaries: Sequence[Summary]) -> list[str]:
    first = summaries[0]
    measured = [m for m in MAIN_METRICS if m in first.metrics] or list(first.metrics)
    if len(summaries) > SETTINGS_IN_FULL:
        measured = measured[:1]
    header = ["setting", "metric", *first.trackers]
    header += [f"{tracker} − {first.reference}" for tracker in first.differences]
    rows = []
    for cells in study.scenarios.values():
        for cell, summary in cells:
            for metric in measured:
                row = metric_row(summary, metric)
                setting = cell.scenario if not cell.point else f"{cell.scenario}: {cell.label}"
                numbers = [_cell_text(text) for text in row.cells]
                numbers += [_cell_text(d.text if d else None) for d in row.differences]
                rows.append([setting, f"{row.name} {row.arrow}".strip(), *numbers])
    return [markdown_table(header, rows, 2)]


def _cell_text(text: Any) -> str:
    if text is None:
        return "–"
    return str(text)


__all__ = [
    "StudyFinding",
    "findings",
    "holm",
    "p_value",
    "robustness",
    "study_markdown",
    "study_page",
]
