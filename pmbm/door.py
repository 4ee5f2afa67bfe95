"""The checks made where a value is made, so that nothing behind the door checks again."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.geometry import wrap_angle
from pmbm.labels import Label

FloatArray = NDArray[np.float64]
_LAST_LABEL = int(max(Label))
"""Labels are numbered from 0 on without a gap."""


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only, C-ordered array that shares no memory with one that others may write."""
    if array.flags.writeable or not array.flags.c_contiguous or array.base is not None:
        array = np.array(array, order="C")
    array.flags.writeable = False
    return array


class Door:
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

    def ids(self, n: int) -> None:
        array = self._shaped("id", np.int64, (n,))
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

    def not_negative(self, name: str, *, hint: str) -> None:
        array = getattr(self.value, name)
        rows = np.flatnonzero(array < 0)
        if len(rows):
            raise self._fail(
                name,
                rows=rows,
                expected="numbers of at least 0",
                got=int(array[rows[0]]),
                hint=hint,
            )

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
