"""Kinds of knobs of the detector model: a bounded number, or a curve over range or visibility.

Bounds stand once, in the annotation of the field; they are checked where a value is made and they
show in the JSON Schema.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, Final

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.labels import Label
from pmbm.types import FloatArray, IntArray
from pmbm.validation import POSITIVE, SHARE, Bounds

Size = Annotated[tuple[float, float, float], POSITIVE]
"""Length, width, height, m."""
Spread = Annotated[tuple[float, float, float], Bounds(0.0, 0.5)]
"""Relative standard deviations of length, width, height."""
SizeCorrelation = Annotated[float | tuple[float, float, float], Bounds(-0.999, 0.999)]
"""One for every two of length, width, height; or that of length with width, of length with height
and of width with height."""
Row = tuple[float, float, float]
SizeResponse = Annotated[tuple[Row, Row, Row], Bounds(-2.0, 2.0)]
"""Rows for the box's length, width, height; columns for the object's."""


@dataclass(frozen=True)
class Curve:
    """A quantity that changes piecewise linearly with another, and is constant beyond the ends.

    at : where it is known, strictly increasing (metres for range, shares for visibility).
    value : what it is there.  A file may give one number instead: the same everywhere.
    """

    at: tuple[float, ...]
    value: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", tuple(float(x) for x in self.at))
        object.__setattr__(self, "value", tuple(float(x) for x in self.value))
        if not self.at or len(self.at) != len(self.value):
            raise InputError(
                "a curve needs as many values as places",
                field="value",
                expected=f"{len(self.at) or 'one or more'} numbers",
                got=len(self.value),
            )
        if not np.isfinite([*self.at, *self.value]).all() or np.any(np.diff(self.at) <= 0):
            raise InputError(
                "a curve's places must increase",
                field="at",
                expected="strictly increasing finite numbers",
                got=list(self.at),
            )

    def __call__(self, x: FloatArray) -> FloatArray:
        """The values at x, of the same shape."""
        return np.interp(x, self.at, self.value)

    def numbers(self) -> tuple[float, ...]:
        """The values, for the bounds of a field."""
        return self.value

    @classmethod
    def constant(cls, value: float) -> Curve:
        """The same everywhere."""
        return cls(at=(0.0,), value=(value,))

    def plain(self) -> float | dict[str, list[float]]:
        """The value as a file says it."""
        if len(self.value) == 1:
            return self.value[0]
        return {"at": list(self.at), "value": list(self.value)}


NO_UNKNOWN_KEYS: Final = {"extra": "forbid"}
"""How files are read into these dataclasses."""
Curve.__pydantic_config__ = NO_UNKNOWN_KEYS  # type: ignore[attr-defined]


class _AlsoNumber:
    """Lets a file give a curve as one number."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_wrap_validator_function(_number_or_table, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: Any, handler: Callable[[Any], dict[str, Any]]
    ) -> dict[str, Any]:
        return {"anyOf": [{"type": "number"}, handler(schema)]}


NumberOrCurve = Annotated[Curve, _AlsoNumber()]
"""A curve that files may also give as one number."""


def label_named(name: object) -> Label:
    """The label of a lower-case name, as files write it.

    Raises InputError with the nearest valid name.
    """
    for label in Label:
        if name == label.name.lower():
            return label
    names = [label.name.lower() for label in Label]
    raise InputError("unknown label", got=name, hint=nearest_hint(name, names, "label"))


class _ByName:
    """Reads a label from its name in a file."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(label_named)

    def __get_pydantic_json_schema__(
        self, schema: Any, handler: Callable[[Any], dict[str, Any]]
    ) -> dict[str, Any]:
        return {"type": "string", "enum": [label.name.lower() for label in Label]}


NamedLabel = Annotated[Label, _ByName()]
"""A label that files give by its name."""


Shares = Annotated[Mapping[NamedLabel, float], SHARE]
"""A probability for each of some labels."""


def check_correlation(field: str, correlation: float | tuple[float, float, float]) -> None:
    """Refuse what no three quantities can have for correlations.

    Raises InputError with the field's name.
    """
    if isinstance(correlation, tuple):
        a, b, c = correlation
        possible, expected = 1 + 2 * a * b * c > a * a + b * b + c * c, "a positive definite matrix"
    else:
        possible, expected = correlation >= 0, "at least 0, or three numbers"
    if not possible:
        raise InputError(f"impossible {field}", field=field, expected=expected, got=correlation)


def by_label(field: str, shares: Mapping[Label, float]) -> Mapping[Label, float]:
    """Shares of labels, in order of the labels and read-only.

    Raises InputError with the field's name where they add up to more than 1.
    """
    ordered = {Label(label): float(shares[label]) for label in sorted(shares)}
    if sum(ordered.values()) > 1.0:
        raise InputError(
            f"impossible {field}",
            field=field,
            expected="probabilities that add up to at most 1",
            got=list(ordered.values()),
        )
    return MappingProxyType(ordered)


def without_proxies(knobs: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """What `__reduce__` of a dataclass of knobs gives: its read-only mappings do not pickle."""
    values = {k: dict(v) if isinstance(v, Mapping) else v for k, v in vars(knobs).items()}
    return _made_again, (type(knobs), values)


def _made_again(kind: type, values: dict[str, Any]) -> Any:
    return kind(**values)


def drawn_label(shares: Mapping[Label, float], draw: FloatArray) -> IntArray:
    """The label (R,) that uniforms (R,) choose with these probabilities, -1 where none."""
    names = np.array([*map(int, shares), -1])
    chosen: IntArray = names[np.searchsorted(np.cumsum(list(shares.values())), draw, side="right")]
    return chosen


def _number_or_table(given: Any, read_table: Callable[[Any], Curve]) -> Curve:
    if isinstance(given, int | float) and not isinstance(given, bool):
        return Curve.constant(given)
    if isinstance(given, dict):
        # Strict reading, once it went through Python, takes a list for no tuple.
        given = {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()}
    return read_table(given)
