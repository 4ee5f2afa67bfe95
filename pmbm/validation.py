"""The checks made where a value is made, so that nothing behind it checks again.

Bounds of numbers stand once, in the annotations of a dataclass's fields (`check_fields`); arrays
are checked, and frozen, by a `Checker`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from pmbm.arrays import FloatArray
from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import wrap_angle
from pmbm.labels import Label

_LAST_LABEL = int(max(Label))
"""Labels are numbered from 0 on without a gap."""


@dataclass(frozen=True)
class Bounds:
    """Closed bounds of a number, or of every value of a curve; `above` and `below` are open."""

    least: float = -np.inf
    most: float = np.inf
    above: float = -np.inf
    below: float = np.inf

    def holds(self, number: float) -> bool:
        return (
            self.least <= number <= self.most
            and self.above < number < self.below
            and bool(np.isfinite(number))
        )

    def __str__(self) -> str:
        low = (
            f"above {self.above:g}"
            if np.isfinite(self.above)
            else f"at least {self.least:g}"
            if np.isfinite(self.least)
            else ""
        )
        high = (
            f"below {self.below:g}"
            if np.isfinite(self.below)
            else f"at most {self.most:g}"
            if np.isfinite(self.most)
            else ""
        )
        return " and ".join(part for part in (low, high) if part) or "finite"

    def __get_pydantic_json_schema__(
        self, schema: Any, handler: Callable[[Any], dict[str, Any]]
    ) -> dict[str, Any]:
        described = handler(schema)
        if described.get("type") in ("number", "integer"):
            for keyword, limit in (
                ("minimum", self.least),
                ("maximum", self.most),
                ("exclusiveMinimum", self.above),
                ("exclusiveMaximum", self.below),
            ):
                if np.isfinite(limit):
                    described[keyword] = limit
        return described


SHARE = Bounds(0.0, 1.0)
NOT_NEGATIVE = Bounds(0.0)
POSITIVE = Bounds(above=0.0)
COUNT = Bounds(1)

_NUMBERS: Mapping[Any, tuple[tuple[type, ...], str]] = {
    float: ((int, float, np.integer, np.floating), "a number"),
    int: ((int, np.integer), "a whole number"),
    bool: ((bool, np.bool_), "true or false"),
}


def check_fields(value: Any, what: str) -> None:
    """Refuse a dataclass a field of which has another type than its annotation, or a number outside
    its bounds.

    Looked at are numbers, bools, choices (`Literal`), dataclasses and protocols; a whole number may
    stand for a float.  what : name of the value in messages.

    Raises InputError with the field's name.
    """
    for name, (kinds, bounds) in _rules(value.__class__).items():
        given = getattr(value, name)
        if given is None and (not kinds or type(None) in kinds):
            continue
        problem = _problem(given, kinds)
        if problem is not None:
            expected, hint = problem
            raise InputError(what, field=name, expected=expected, got=given, hint=hint)
        if bounds is None:
            continue
        for number in _numbers(given):
            if not bounds.holds(number):
                raise InputError(what, field=name, expected=f"a number {bounds}", got=number)


def _numbers(value: Any) -> Iterator[float]:
    """The numbers in a number, in nested tuples or in a mapping, or those that a value names."""
    if isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, Mapping):
        yield from value.values()
    elif hasattr(value, "numbers"):
        yield from value.numbers()
    else:
        yield value


def _problem(given: Any, kinds: tuple[Any, ...]) -> tuple[str | None, str | None] | None:
    """The expectation and hint that a value fails, or None where it fails none."""
    for kind in kinds:
        if kind in _NUMBERS:
            allowed, words = _NUMBERS[kind]
            is_bool = isinstance(given, bool | np.bool_)
            if not isinstance(given, allowed) or is_bool != (kind is bool) or given != given:
                return words, None
        elif get_origin(kind) is Literal:
            choices = get_args(kind)
            if given not in choices:
                return None, nearest_hint(given, choices, "choice")
    classes = tuple(kind for kind in kinds if isinstance(kind, type) and kind not in _NUMBERS)
    solid = tuple(kind for kind in classes if kind is not type(None))
    # A class has what a protocol asks for, and is no member all the same.
    if solid and (isinstance(given, type) or not isinstance(given, classes)):
        return "a " + " or ".join(kind.__name__ for kind in solid), None
    return None


@cache
def _rules(kind: Any) -> dict[str, tuple[tuple[Any, ...], Bounds | None]]:
    """Field -> the types that it may be of, where these can be checked, and its bounds."""
    hints = get_type_hints(kind, include_extras=True)
    rules = {}
    for field in fields(kind):
        form = hints[field.name]
        kinds: tuple[Any, ...] = _alternatives(form)
        bounds = next((b for part in (form, *kinds) if (b := _bounds_in(part))), None)
        kinds = tuple(get_args(k)[0] if get_origin(k) is Annotated else k for k in kinds)
        if not all(map(_checkable, kinds)):
            kinds = ()
        if kinds or bounds is not None:
            rules[field.name] = (kinds, bounds)
    return rules


def _alternatives(form: Any) -> tuple[Any, ...]:
    if get_origin(form) is Annotated:
        form = get_args(form)[0]
    return get_args(form) if get_origin(form) in (Union, UnionType) else (form,)


def _bounds_in(form: Any) -> Bounds | None:
    extras = getattr(form, "__metadata__", ())
    return next((extra for extra in extras if isinstance(extra, Bounds)), None)


def _checkable(kind: Any) -> bool:
    return (
        kind in _NUMBERS
        or kind is type(None)
        or get_origin(kind) is Literal
        or is_dataclass(kind)
        or getattr(kind, "_is_runtime_protocol", False)
    )


def equal_fields(one: Any, other: Any) -> bool:
    """Whether two dataclasses are of one class and equal field by field, arrays included."""
    if type(one) is not type(other):
        return False
    pairs = ((getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return all(
        np.array_equal(a, b) if isinstance(a, np.ndarray) or isinstance(b, np.ndarray) else a == b
        for a, b in pairs
    )


def hash_of_fields(one: Any) -> int:
    """A hash that goes with `equal_fields`."""
    return hash((type(one).__name__, *(_hashable(getattr(one, f.name)) for f in fields(one))))


def _hashable(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        # Equal arrays may differ in the sign of a zero.
        return (value + 0.0).tobytes()
    return frozenset(value.items()) if isinstance(value, Mapping) else value


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only, C-ordered array that shares no memory with one that others may write."""
    if array.flags.writeable or not array.flags.c_contiguous or array.base is not None:
        array = np.array(array, order="C")
    array.flags.writeable = False
    return array


class Checker:
    """The checks made where a value is made; each also freezes what it has checked."""

    def __init__(self, value: Any, what: str) -> None:
        self.value = value
        self.what = what

    def _fail(self, field_name: str, **details: Any) -> InputError:
        time = getattr(self.value, "time", None)
        when = f" at t = {time:g} s" if isinstance(time, float) else ""
        return InputError(f"{self.what}{when}: bad {field_name}", field=field_name, **details)

    def _array(self, name: str, dtype: Any) -> NDArray[Any]:
        given = getattr(self.value, name)
        try:
            array = np.asarray(given)
            if array.dtype == dtype:
                return array
            if array.dtype == object or array.dtype.kind in "USMmc":
                raise TypeError
            with np.errstate(invalid="ignore"):
                converted = array.astype(dtype, copy=False)
            if np.dtype(dtype).kind in "iu" and not np.array_equal(converted, array):
                raise TypeError
        except (TypeError, ValueError, OverflowError):
            raise self._fail(
                name, expected=f"an array of {np.dtype(dtype).name}", got=given
            ) from None
        return converted

    def _store(self, name: str, array: NDArray[Any]) -> None:
        object.__setattr__(self.value, name, frozen(array))

    def _shaped(self, name: str, dtype: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        array = self._array(name, dtype)
        if array.shape != shape:
            raise self._fail(name, expected=f"shape {shape}", got=f"shape {array.shape}")
        return array

    def time(self) -> None:
        self.number("time")

    def number(
        self,
        name: str,
        *,
        above: float = -np.inf,
        at_least: float = -np.inf,
        at_most: float = np.finfo(float).max,
    ) -> None:
        given = getattr(self.value, name)
        try:
            number = float(given)
        except (TypeError, ValueError):
            raise self._fail(name, expected="a number", got=given) from None
        if not (above < number <= at_most and number >= at_least):
            bounds = "a finite number"
            if np.isfinite(above):
                bounds += f" above {above:g}"
            if np.isfinite(at_least):
                bounds += f" of at least {at_least:g}"
            if at_most < np.finfo(float).max:
                bounds += f" and at most {at_most:g}"
            raise self._fail(name, expected=bounds, got=given)
        object.__setattr__(self.value, name, number)

    def count(self, name: str, *, at_least: int = 0) -> None:
        given = getattr(self.value, name)
        whole = isinstance(given, int | np.integer) and not isinstance(given, bool)
        if not whole or given < at_least:
            raise self._fail(name, expected=f"a whole number of at least {at_least}", got=given)
        object.__setattr__(self.value, name, int(given))

    def rows(self, name: str, width: int) -> int:
        array = self._array(name, np.float64)
        if array.ndim != 2 or array.shape[1] != width:
            raise self._fail(name, expected=f"shape (N, {width})", got=f"shape {array.shape}")
        self.floats(name, array.shape)
        return len(array)

    def floats(self, name: str, shape: tuple[int, ...], *, allow_minus_inf: bool = False) -> None:
        array = self._shaped(name, np.float64, shape)
        good = np.isfinite(array)
        if allow_minus_inf:
            good |= array == -np.inf
        if not good.all():
            rows = np.unique(np.nonzero(~good)[0])
            raise self._fail(name, rows=rows, expected="finite numbers", got=array[rows[0]])
        self._store(name, array)

    def boxes(self, n: int) -> None:
        self.floats("size", (n, 3))
        size = self.value.size
        flat = np.flatnonzero((size <= 0).any(axis=1))
        if len(flat):
            raise self._fail(
                "size", rows=flat, expected="length, width, height > 0", got=size[flat[0]]
            )
        self.floats("yaw", (n,))
        self._store("yaw", wrap_angle(self.value.yaw))

    def unit_interval(self, name: str, n: int) -> None:
        self.floats(name, (n,))
        array = getattr(self.value, name)
        outside = np.flatnonzero((array < 0) | (array > 1))
        if len(outside):
            raise self._fail(
                name, rows=outside, expected="numbers in [0, 1]", got=array[outside[0]]
            )

    def labels(self, n: int) -> None:
        given = np.asarray(self.value.label)
        if given.dtype.kind in "USO" and any(isinstance(one, str) for one in given.flat):
            raise self._fail(
                "label",
                expected="Label values",
                got=given.flat[0],
                hint=f"pmbm.Label.CAR and so on: {', '.join(label.name for label in Label)}",
            )
        array = self._shaped("label", np.int64, (n,))
        unknown = np.flatnonzero((array < 0) | (array > _LAST_LABEL))
        if len(unknown):
            raise self._fail(
                "label",
                rows=unknown,
                expected=f"a Label, 0 to {_LAST_LABEL}",
                got=array[unknown[0]],
            )
        self._store("label", array.astype(np.int8))

    def ids(self, n: int, *, negative: str | None = None) -> None:
        """Each id once; `negative` is the hint where none may be below 0."""
        array = self._shaped("id", np.int64, (n,))
        below = np.flatnonzero(array < 0)
        if negative is not None and len(below):
            raise self._fail(
                "id",
                rows=below,
                expected="numbers of at least 0",
                got=int(array[below[0]]),
                hint=negative,
            )
        ordered = np.sort(array)
        repeated = ordered[1:] == ordered[:-1]
        if repeated.any():
            twice = ordered[1:][repeated][0]
            raise self._fail(
                "id",
                rows=np.flatnonzero(array == twice),
                expected="each id once in a frame",
                got=int(twice),
            )
        self._store("id", array)

    def ints(self, name: str, shape: tuple[int, ...]) -> None:
        self._store(name, self._shaped(name, np.int64, shape))

    def flags(self, name: str, n: int) -> None:
        array = self._array(name, np.float64)
        if array.shape != (n,) or not np.isin(array, (0, 1)).all():
            raise self._fail(name, expected=f"{n} flags", got=getattr(self.value, name))
        self._store(name, array.astype(np.bool_))

    def polygons(self, name: str, polygons: Any) -> tuple[FloatArray, ...]:
        checked = []
        for index, polygon in enumerate(polygons):
            array = np.asarray(polygon, dtype=np.float64)
            if array.ndim != 2 or array.shape[1] != 2 or len(array) < 3:
                raise self._fail(
                    name, rows=[index], expected="shape (V >= 3, 2)", got=f"shape {array.shape}"
                )
            if not np.isfinite(array).all():
                raise self._fail(name, rows=[index], expected="finite numbers", got=array)
            checked.append(frozen(array))
        return tuple(checked)
