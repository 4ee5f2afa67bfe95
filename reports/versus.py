"""One tracker of a study against each of the others, a row a setting: who is better where."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from pmbm.errors import InputError, nearest_hint
from pmbm.reports.study_report import ALPHA, holm, p_value
from pmbm.reports.tables import Verdict, code_block, markdown_table, plain_markdown, shown_metric
from pmbm.study import Estimate, StudyResults, Summary

_SHOWN: dict[Verdict, str] = {"better": "worse", "worse": "**better**", "tie": "no different"}
"""The verdict on the reference -> what a cell says of its own tracker."""


@dataclass(frozen=True)
class Comparison:
    """A setting, a tracker, and how the reference does there against it.

    difference : tracker - reference, over paired trials, its interval that of the level at which
        Holm's procedure judged it.
    verdict : of the reference.
    """

    cell: int
    tracker: str
    difference: Estimate
    verdict: Verdict


def compare(
    summaries: Sequence[Summary | None], metric: str, *, leave_out: Collection[str] = ()
) -> list[Comparison]:
    """Every setting's paired differences, judged together by Holm's procedure (Scand. J. Statist.
    6, 1979) at 5 %.

    summaries : of each setting; None where it has no results yet.
    leave_out : trackers that are not judged (bounds, that know the truth).

    The p-th of m differences in order of their p-values, from 0, has the interval of level
    1 - .05 / (m - p), which excludes zero where the verdict is clear; from the first that is not
    clear on, all have that one's.  Together these intervals are not simultaneous: those that are
    compatible with Holm's procedure say nothing beyond the verdicts.
    """
    pairs = [
        (cell, tracker, difference)
        for cell, summary in enumerate(summaries)
        if summary is not None
        for tracker, values in summary.differences.items()
        if tracker not in leave_out
        and (difference := values.get(metric)) is not None
        and difference.mean is not None
    ]
    values = [p_value(difference) for *_, difference in pairs]
    clear = holm(values)
    order = sorted(range(len(pairs)), key=values.__getitem__)
    rank = {index: min(place, sum(clear)) for place, index in enumerate(order)}
    sign = shown_metric(metric).sign or -1
    found = []
    for index, (cell, tracker, difference) in enumerate(pairs):
        assert difference.mean is not None
        verdict: Verdict = "tie"
        if clear[index]:
            verdict = "better" if difference.mean * sign < 0 else "worse"
        judged = difference.at(1 - ALPHA / (len(pairs) - rank[index]))
        found.append(Comparison(cell, tracker, judged, verdict))
    return found


def versus_markdown(
    results: StudyResults,
    metric: str,
    *,
    reference: str | None = None,
    bounds: Collection[str] = (),
    commands: Sequence[str] = (),
) -> str:
    """The comparison as a page of Markdown: how often the reference is better and worse, then every
    setting, with the verdict on the tracker that the column is of.

    reference : the tracker that is compared with the others; by default the study's first.
    bounds : trackers that know the truth: shown with the reference's regret, not judged.
    commands : that made it.
    Raises InputError for a metric that the study did not keep, and where nothing is stored yet.
    """
    reference = reference or results.trackers[0]
    summaries = [results.summary(cell, reference) for cell in range(len(results.cells))]
    first = next((summary for summary in summaries if summary), None)
    if first is None:
        raise InputError("no trial of this study has a result yet")
    if metric not in first.metrics:
        raise InputError(
            "the study did not keep this metric",
            field="--metric",
            got=metric,
            hint=nearest_hint(metric, first.metrics, "metric"),
        )
    shown = shown_metric(metric)
    unit = f" ({shown.unit})" if shown.unit else ""
    compared = compare(summaries, metric, leave_out=bounds)
    rivals = [name for name in first.differences if name not in bounds]
    shown_reference = plain_markdown(reference)
    lines = [
        f"# {plain_markdown(results.name)}: {shown_reference} against each, {shown.name}{unit}",
        "",
        f"{results.done} of {results.total} trials, seed {results.seed}; "
        f"{len(results.failures)} without result; pmbm {_version(results)}; "
        f"digest {(results.digest or 'none: rows are damaged')[:16]}. A cell is the mean of that "
        f"tracker, then its paired difference from {shown_reference} with its interval, then the "
        f"verdict on that tracker by Holm's procedure over all {len(compared)} comparisons "
        "(5 %). An interval has the level at which its difference was judged and excludes zero "
        "where the verdict is clear; the intervals are not simultaneous: 5 % bounds the chance of "
        "a wrong verdict, not of an interval that misses.",
    ]
    if bounds:
        names = ", ".join(map(plain_markdown, bounds))
        lines[-1] += f" {names} knows the truth: the difference is the regret."
    lines += ["", *_made_by(commands), *_counts(compared, rivals, reference), ""]
    header = ["setting", "trials", reference, *rivals, *bounds]
    by_place = {(one.cell, one.tracker): one for one in compared}
    rows = []
    for cell, summary in enumerate(summaries):
        if summary is None:
            rows.append([results.cells["label"][cell], "0", *["–"] * (len(header) - 2)])
            continue
        row = [results.cells["label"][cell], str(summary.trials)]
        row.append(_mean(summary, reference, metric))
        row += [_cell(summary, name, metric, by_place.get((cell, name))) for name in rivals]
        row += [_regret(summary, name, metric) for name in bounds]
        rows.append(row)
    return "\n".join([*lines, markdown_table(header, rows, 1)]) + "\n"


def _counts(compared: Sequence[Comparison], rivals: Sequence[str], reference: str) -> list[str]:
    rows = []
    for name in rivals:
        mine = [one.verdict for one in compared if one.tracker == name]
        rows.append([name, *(str(mine.count(kind)) for kind in ("better", "tie", "worse"))])
    header = [f"{reference} against", f"{reference} better", "no different", f"{reference} worse"]
    return [markdown_table(header, rows, 1)]


def _made_by(commands: Sequence[str]) -> list[str]:
    return ["Made by:", "", *map(code_block, commands), ""] if commands else []


def _mean(summary: Summary, tracker: str, metric: str) -> str:
    value = summary.estimates[tracker][metric].mean
    return "–" if value is None else f"{value:z.3f}"


def _cell(summary: Summary, tracker: str, metric: str, one: Comparison | None) -> str:
    text = _mean(summary, tracker, metric)
    if one is None:
        return text
    return f"{text} ({_interval(one.difference)}) {_SHOWN[one.verdict]}"


def _interval(difference: Estimate) -> str:
    mean = f"{difference.mean:+z.3f}"
    if difference.half is not None:
        # Never told as a width of zero.
        half = f"{difference.half:.3f}" if difference.half >= 0.0005 else f"{difference.half:.1g}"
        return f"{mean} ± {half}"
    if difference.low is not None and difference.high is not None:
        return f"{mean} [{difference.low:+z.3f}, {difference.high:+z.3f}]"
    return mean if difference.uncertainty is None else f"{mean} in all {difference.n}"


def _regret(summary: Summary, bound: str, metric: str) -> str:
    difference = summary.differences[bound][metric].mean
    text = _mean(summary, bound, metric)
    return text if difference is None else f"{text} ({-difference:+z.3f})"


def _version(results: StudyResults) -> str:
    return str(results.provenance.get("versions", {}).get("pmbm", "of unknown version"))
