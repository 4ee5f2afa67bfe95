"""Estimates as the words and bars of a table."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pmbm.errors import InputError
from pmbm.intervals import LEVEL
from pmbm.metrics.catalogue import definition

if TYPE_CHECKING:
    from pmbm.study import Estimate, Summary

MAIN_METRICS = (
    "gospa",
    "gospa_localisation",
    "gospa_missed",
    "gospa_false",
    "ospa",
    "mota",
    "idf1",
    "hota",
    "id_switches",
    "false_positives",
    "misses",
)
"""The rows shown first; the others are one click away."""

Verdict = Literal["better", "worse", "tie"]

_ACRONYMS = {"gospa", "ospa", "mota", "motp", "idf1", "hota", "deta", "assa", "loca", "nees", "id"}
_ACRONYMS |= {"anees", "tgospa"}
_SPELT = {"ospa2": "OSPA(2)", "deta": "DetA", "assa": "AssA", "loca": "LocA"}
_ARROWS = {"lower": "↓", "higher": "↑", "none": ""}
_MIDDLE, _REACH = 75.0, 68.0
"""Of the bar's picture: where zero is, and how far bars reach to either side."""


@dataclass(frozen=True)
class ShownMetric:
    """A metric as it is shown: name for people, unit, direction, and the question it answers."""

    key: str
    name: str
    unit: str
    arrow: str
    answers: str

    @property
    def sign(self) -> int:
        """+1 where higher is better, -1 where lower is, 0 where neither."""
        return {"↑": 1, "↓": -1}.get(self.arrow, 0)


@dataclass(frozen=True)
class Text:
    """An estimate in words: mean; its interval, which is one of half-width or ends, or neither;
    standard error and count."""

    mean: str
    half: str
    detail: str
    ends: str = ""

    @property
    def spread(self) -> str:
        """The spread to write behind the mean."""
        return f"± {self.half}" if self.half else self.ends

    def __str__(self) -> str:
        return f"{self.mean} {self.spread}".strip()


@dataclass(frozen=True)
class Bar:
    """A paired difference's interval about zero, in the picture's units."""

    at: float
    low: float
    high: float
    span: bool
    verdict: Verdict
    label: str


@dataclass(frozen=True)
class ShownDifference:
    text: Text
    bar: Bar


@dataclass(frozen=True)
class Row:
    """A table's line: an estimate per tracker, a difference per tracker that is compared."""

    name: str
    unit: str
    arrow: str
    answers: str
    cells: tuple[Text | None, ...]
    differences: tuple[ShownDifference | None, ...]


@dataclass(frozen=True)
class Table:
    trackers: tuple[str, ...]
    compared: tuple[str, ...]
    reference: str
    rows: tuple[Row, ...]


def shown_metric(key: str) -> ShownMetric:
    """How a metric is shown; one that the catalogue does not know is shown by its key."""
    try:
        entry = definition(key)
    except InputError:
        return ShownMetric(key, key, "", "", "")
    base = key.removesuffix("_observable")
    words = [
        _SPELT.get(word, word.upper() if word in _ACRONYMS else word) for word in base.split("_")
    ]
    name = " ".join(words) + (", observable" if base != key else "")
    unit = {"1": "", "m^p": "m²"}.get(entry.unit, entry.unit)
    return ShownMetric(key, name, unit, _ARROWS[entry.direction], entry.question)


def metric_tables(summary: Summary) -> tuple[Table, Table | None]:
    """The main rows, and the rest (None where there are none)."""
    main = [key for key in MAIN_METRICS if key in summary.metrics]
    if not main:
        return _table(summary, summary.metrics), None
    rest = [key for key in summary.metrics if key not in main]
    return _table(summary, main), _table(summary, rest) if rest else None


def _table(summary: Summary, metrics: Iterable[str]) -> Table:
    compared = tuple(summary.differences)
    return Table(
        trackers=summary.trackers,
        compared=compared,
        reference=summary.reference,
        rows=tuple(metric_row(summary, key) for key in metrics),
    )


def metric_rows(summaries: Sequence[tuple[str, Summary]], key: str) -> tuple[Row, ...]:
    """One metric over several (name, summary), the bars to one scale."""
    ends = [
        abs(end)
        for _, summary in summaries
        for differences in summary.differences.values()
        if (value := differences.get(key))
        for end in (value.mean, value.low, value.high)
        if end is not None
    ]
    reach = max(ends, default=0.0)
    return tuple(metric_row(summary, key, name, reach) for name, summary in summaries)


def metric_row(
    summary: Summary, key: str, name: str | None = None, reach: float | None = None
) -> Row:
    """One metric's line; `name` stands in its first column instead of the metric's own, and
    `reach` is the difference at the end of the bar's picture, by default the row's largest."""
    metric = shown_metric(key)
    estimates = [summary.estimates[tracker].get(key) for tracker in summary.trackers]
    differences = [summary.differences[tracker].get(key) for tracker in summary.differences]
    return Row(
        name=name or metric.name,
        unit=metric.unit,
        arrow=metric.arrow,
        answers=metric.answers,
        cells=tuple(words(estimate, summary.trials) for estimate in estimates),
        differences=tuple(
            difference(value, metric, summary.trials, reach) for value in differences
        ),
    )


def words(estimate: Estimate | None, trials: int, *, signed: bool = False) -> Text | None:
    """Mean and interval, both to the second digit of half its width, or None where undefined.

    An interval that is as wide to either side by its kind is told by half of it, another one by
    its ends.
    """
    if estimate is None or estimate.mean is None:
        return None
    mean = estimate.mean
    counted = "" if estimate.n == trials else f"n {estimate.n}"
    if estimate.uncertainty is None:
        text = _signed(f"{mean:z.4g}", signed)
        return Text(text, "", "" if trials == 1 else f"n {estimate.n}")
    if estimate.low is None or estimate.high is None:
        return Text(_signed(f"{mean:z.4g}", signed), "", counted, f"in all {estimate.n}")
    reach = (estimate.high - estimate.low) / 2
    digits = max(0, 1 - math.floor(math.log10(reach)))
    shown = _signed(f"{mean:z.{digits}f}", signed)
    if estimate.half is None:
        low, high = (_signed(f"{end:z.{digits}f}", signed) for end in (estimate.low, estimate.high))
        return Text(shown, "", counted, f"[{low}, {high}]")
    detail = " · ".join(part for part in (f"sem {estimate.sem:.2g}", counted) if part)
    return Text(shown, f"{estimate.half:.{digits}f}", detail)


def difference(
    value: Estimate | None, metric: ShownMetric, trials: int, reach: float | None = None
) -> ShownDifference | None:
    """A paired difference in words and as a bar about zero."""
    text = words(value, trials, signed=True)
    if value is None or text is None or value.mean is None:
        return None
    low = value.mean if value.low is None else value.low
    high = value.mean if value.high is None else value.high
    reach = max(abs(low), abs(high), reach or 0.0, 1e-300)
    verdict = judge(value, metric.sign)
    at, left, right = (round(_MIDDLE + _REACH * v / reach, 1) for v in (value.mean, low, high))
    label = f"{metric.name}: difference {text.mean}"
    if text.spread:
        label += f" {text.spread} ({verdict if verdict != 'tie' else 'no clear difference'})"
    return ShownDifference(text, Bar(at, left, right, value.low is not None, verdict, label))


def judge(value: Estimate, sign: int) -> Verdict:
    """The verdict of a paired difference: better or worse only where its interval excludes 0."""
    if sign == 0 or value.mean is None or value.uncertainty is None:
        return "tie"
    if value.low is None or value.high is None:
        clear = value.uncertainty.p_value() < 1 - LEVEL
    else:
        clear = not value.low <= 0 <= value.high
    if not clear:
        return "tie"
    return "better" if sign * value.mean > 0 else "worse"


def _signed(text: str, signed: bool) -> str:
    if signed and not text.startswith("-") and float(text) != 0:
        text = f"+{text}"
    return text.replace("-", "−")


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """A Markdown table; the first `words` columns are text, the others numbers."""
    lines = [header, ["---" if k < words else "--:" for k in range(len(header))], *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def plain_markdown(text: str) -> str:
    """Text that Markdown shows as it is."""
    text = re.sub(r"([\\`*\[\]|#]|(?<![0-9A-Za-z])_|_(?![0-9A-Za-z]))", r"\\\1", text)
    return " ".join(html.escape(text, quote=False).split())


def code_block(text: str) -> str:
    """Text as a block of code; every line of it is indented, so that none gets out of the block."""
    return "\n".join(f"    {line}" for line in re.split(r"\r\n|\r|\n", text))


def _cell(text: str) -> str:
    for character, escaped in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ("|", "\\|")):
        text = text.replace(character, escaped)
    return " ".join(text.split())
