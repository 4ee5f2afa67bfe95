"""Metrics and their values: a value has its rule, its parts and what is needed to combine it.

A value is always a formula of counts (sums over frames and objects) or of samples.  Recordings are
combined by adding the counts and applying the same formula, never by averaging ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pmbm.arrays import FloatArray
from pmbm.errors import InputError, nearest_hint
from pmbm.intervals import COUNT, MEASURED, Scale
from pmbm.labels import Label
from pmbm.wording import counted

if TYPE_CHECKING:
    import pandas as pd

Counts = Mapping[str, Any]
"""Numbers or arrays that add up over recordings, and `Samples` and `Joined`, which join."""
Scope = Literal["all", "observable"]
Direction = Literal["higher", "lower", "none"]

OBSERVABLE = "_observable"
_READ_ONLY = ("parameters", "components", "counts")
_HEADLINE = ("gospa", "mota", "id_switches")
"""What the repr of an evaluation shows."""
_COUNTED = ("boxes", "events", "tracks")
"""Units of metrics that are counts."""


@dataclass(frozen=True)
class Undefined:
    """Why a formula has no value for these counts."""

    reason: str


Formula = Callable[[Counts], float | Undefined]
Parts = Callable[[Counts], Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Samples:
    """One number per object or event; over recordings they are joined."""

    values: FloatArray

    def __add__(self, other: Samples | int) -> Samples:
        if isinstance(other, int):
            return self
        return Samples(np.concatenate([self.values, other.values]))

    __radd__ = __add__


@dataclass(frozen=True, eq=False)
class Joined:
    """Whole runs, for scores whose thresholds depend on all of them; over recordings joined."""

    items: tuple[Any, ...]

    def __add__(self, other: Joined | int) -> Joined:
        return self if isinstance(other, int) else Joined(self.items + other.items)

    __radd__ = __add__


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric's name, its meaning, and its formula.

    name, variant : of the metric, and whose rule it follows.
    unit, direction : of the value; whether "higher" or "lower" is better, or "none".
    question : what it answers, in a few words.
    formula : counts (and the parameters, by name) -> value.
    parts : the same -> further numbers worth showing beside the value, defined or not.
    series : name of its family's per-frame series, or None.
    default : whether `evaluate` gives it unasked.
    bounds : the values that it can take in a trial where it is no count, at the parameters'
        defaults.
    """

    name: str
    unit: str
    direction: Direction
    question: str
    formula: Formula
    variant: str = "standard"
    parts: Parts | None = None
    series: str | None = None
    default: bool = True
    bounds: Scale = MEASURED

    @property
    def scale(self) -> Scale:
        """The values that the metric can take in a trial."""
        return COUNT if self.unit in _COUNTED else self.bounds

    def value(
        self,
        counts: Counts,
        *,
        scope: Scope = "all",
        parameters: Mapping[str, Any],
        series: FloatArray | None = None,
    ) -> MetricValue:
        """The metric's value for these counts."""
        known = {**parameters, **counts}
        outcome = self.formula(known)
        undefined = isinstance(outcome, Undefined)
        return MetricValue(
            name=self.name + (OBSERVABLE if scope == "observable" else ""),
            variant=self.variant,
            value=None if undefined else float(outcome),  # type: ignore[arg-type]
            reason=outcome.reason if isinstance(outcome, Undefined) else None,
            unit=self.unit.replace("^p", f"^{parameters['order']:g}")
            if "^p" in self.unit
            else self.unit,
            direction=self.direction,
            scope=scope,
            parameters=parameters,
            components={} if self.parts is None else self.parts(known),
            series=series,
            counts=counts,
            definition=self,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class MetricValue:
    """One metric of one run, or of several combined.

    name : as in the table; "_observable" at its end where only observable objects are scored.
    variant : whose rule it follows.
    value : None where undefined, with the `reason`.
    unit, direction : "higher" or "lower" is better, or "none".
    scope : "all" objects, or "observable" ones.
    parameters : thresholds and orders it was computed with.
    components : parts of the value, by name.
    series (F,) or None : the value of each frame.
    counts : what adds up over recordings.
    """

    name: str
    variant: str
    value: float | None
    reason: str | None
    unit: str
    direction: Direction
    scope: Scope
    parameters: Mapping[str, Any]
    components: Mapping[str, float]
    series: FloatArray | None
    counts: Counts
    definition: Metric = field(repr=False)

    def __post_init__(self) -> None:
        for name in _READ_ONLY:
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        if self.series is not None:
            self.series.flags.writeable = False

    @property
    def rule(self) -> str:
        """The rule and its parameters in one line."""
        given = settings(self.parameters)
        return f"{self.variant}: {given}" if given else self.variant

    def __repr__(self) -> str:
        shown = f"{_text(self)} {self.unit}" if self.reason is None else f"undefined, {self.reason}"
        return f"MetricValue({self.name}: {shown}; {self.rule})"

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only views of dictionaries do not pickle.
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        values |= {name: dict(values[name]) for name in _READ_ONLY}
        return partial(MetricValue, **values), ()


def settings(parameters: Mapping[str, Any]) -> str:
    """Parameters in one line."""
    return ", ".join(
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in parameters.items()
    )


@dataclass(frozen=True, eq=False)
class Evaluation(Mapping[str, MetricValue]):
    """The metrics of one run, or of several combined, by name.

    metrics : the metrics, in order.
    recordings : how many runs are in it.
    per_class : the same of each class alone (truth and tracks of that label), where asked for.
    """

    metrics: tuple[MetricValue, ...]
    recordings: int = 1
    per_class: Mapping[Label, Evaluation] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_by_name", {value.name: value for value in self.metrics})

    def __getitem__(self, name: str) -> MetricValue:
        by_name: dict[str, MetricValue] = self.__dict__["_by_name"]
        if name not in by_name:
            raise InputError(f"no metric '{name}'", hint=nearest_hint(name, by_name, "metric"))
        return by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in self.__dict__["_by_name"]

    def get(self, name: object, default: Any = None) -> Any:
        """The metric of this name, or `default` where it was not evaluated."""
        return self.__dict__["_by_name"].get(name, default)

    def __iter__(self) -> Iterator[str]:
        return iter(self.__dict__["_by_name"])

    def __len__(self) -> int:
        return len(self.metrics)

    def scalars(self) -> dict[str, float | None]:
        """Values alone, by name: for tables and JSON."""
        return {value.name: value.value for value in self.metrics}

    def to_frame(self) -> pd.DataFrame:
        """The table as data: a row a metric, in order."""
        import pandas as pd

        columns = ("value", "unit", "direction", "scope", "variant", "reason")
        return pd.DataFrame(
            [[getattr(value, column) for column in columns] for value in self.metrics],
            index=pd.Index([*self], name="metric"),
            columns=[*columns],
        )

    def __repr__(self) -> str:
        shown = [f"{name} {_text(self[name])}" for name in _HEADLINE if name in self]
        return (
            f"Evaluation({', '.join(shown) or counted(len(self), 'metric')}"
            f"{', ...' if shown and len(self) > len(shown) else ''}; "
            f"{counted(self.recordings, 'recording')})"
        )

    def _repr_html_(self) -> str:
        head, *rows = self._rows()
        lines = [f"<tr>{''.join(f'<th>{escape(cell)}</th>' for cell in head)}</tr>"]
        lines += [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows]
        return f"<table>{''.join(lines)}</table>{''.join(map(_paragraph, self._reasons()))}"

    def __str__(self) -> str:
        rows = self._rows()
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        lines = [
            "  ".join(
                cell.rjust(width) if column in (1, 2) else cell.ljust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
        return "\n".join(lines + self._reasons())

    def _rows(self) -> list[tuple[str, ...]]:
        """The table's head, and a row a metric."""
        rows: list[tuple[str, ...]] = [("metric", "all", "observable", "unit", "better", "rule")]
        bases = dict.fromkeys(name.removesuffix(OBSERVABLE) for name in self)
        for base in bases:
            all_, observable = self.get(base), self.get(base + OBSERVABLE)
            shown = all_ or observable
            assert shown is not None
            rows.append(
                (
                    base,
                    _text(all_),
                    _text(observable),
                    shown.unit,
                    "" if shown.direction == "none" else shown.direction,
                    shown.rule,
                )
            )
        return rows

    def _reasons(self) -> list[str]:
        """Lines that say why some metrics are undefined."""
        undefined: dict[str, list[str]] = {}
        for value in self.metrics:
            if value.reason is not None:
                undefined.setdefault(value.reason, []).append(value.name)
        return [f"undefined, {reason}: {', '.join(which)}" for reason, which in undefined.items()]


def combine(evaluations: Sequence[Evaluation]) -> Evaluation:
    """Several runs as one: counts are added and every formula applied to the sums.

    Raises InputError where there is nothing to combine, or where the evaluations differ in their
    metrics or parameters.
    """
    if not evaluations:
        raise InputError("no evaluations to combine", field="evaluations", expected="at least one")
    first = evaluations[0]
    for other in evaluations[1:]:
        if list(other) != list(first):
            raise InputError(
                "evaluations of different metrics cannot be combined",
                got=", ".join(sorted(set(first) ^ set(other))),
            )
    labels = dict.fromkeys(label for one in evaluations for label in one.per_class)
    return Evaluation(
        tuple(_combined([one[name] for one in evaluations]) for name in first),
        recordings=sum(one.recordings for one in evaluations),
        per_class={
            label: combine([one.per_class[label] for one in evaluations if label in one.per_class])
            for label in sorted(labels)
        },
    )


def _combined(values: Sequence[MetricValue]) -> MetricValue:
    first = values[0]
    for other in values[1:]:
        if dict(other.parameters) != dict(first.parameters) or other.variant != first.variant:
            raise InputError(
                f"values of '{first.name}' by different rules cannot be combined",
                expected=f"{first.variant} {dict(first.parameters)}",
                got=f"{other.variant} {dict(other.parameters)}",
            )
    counts = {key: sum(value.counts[key] for value in values) for key in first.counts}
    return first.definition.value(counts, scope=first.scope, parameters=first.parameters)


def _paragraph(text: str) -> str:
    return f"<p>{escape(text)}</p>"


def _text(value: MetricValue | None) -> str:
    if value is None:
        return ""
    return "undefined" if value.value is None else f"{value.value:.4g}"
