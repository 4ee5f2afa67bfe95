"""The frames of a recording, and which rows of its tables belong to each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from pmbm.arrays import FloatArray, IntArray
from pmbm.errors import InputError
from pmbm.tables.cells import Cells

_CLOSE: Final = 0.1
"""Times nearer than this share of the usual step are one frame written down twice."""


@dataclass(frozen=True, eq=False)
class Placed:
    """The rows of a table in order of frame, the file's order within each.

    count (F,) : rows of each frame.  order (R,) or None : where rows were moved to get there.
    """

    count: IntArray
    order: IntArray | None

    @property
    def frame(self) -> IntArray:
        """(R,) of the rows in this order."""
        return np.repeat(np.arange(len(self.count)), self.count)

    def sorted(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of rows in this order."""
        return values if self.order is None else values[self.order]


@dataclass(frozen=True, eq=False)
class Clock:
    """The frames of a recording.

    key (F,) : what the tables call them, by number or by time, increasing.
    time (F,) : s.  by : the column that joins the tables.
    """

    key: NDArray[Any]
    time: FloatArray
    by: Literal["frame", "time"]

    def place(self, cells: Cells) -> Placed:
        """Where a table's rows belong.  Raises InputError for a row of no frame."""
        key = keys(cells, self.by)
        order = None
        if len(key) and (key[1:] < key[:-1]).any():
            order = np.argsort(key, kind="stable")
            key = key[order]
        starts = _starts(key)
        frame = np.searchsorted(self.key, key[starts])
        known = frame < len(self.key)
        known[known] = self.key[frame[known]] == key[starts[known]]
        if not known.all():
            row = int(starts[np.argmin(known)])
            raise cells.error(
                f"a {self.by} that is no frame's",
                self.by,
                row if order is None else int(order[row]),
                expected=f"one of {len(self.key)} in the poses",
                got=key[row].item(),
            )
        count = np.zeros(len(self.key), np.int64)
        count[frame] = np.diff(np.append(starts, len(key)))
        return Placed(count, order)


def clock(tables: Mapping[str, Cells], rate: float) -> Clock:
    """The frames of a recording: those of the poses; without poses, of truth and detections.

    rate : frames a second where no table has times.
    Raises InputError where tables cannot be joined, or times do not increase with the frames.
    """
    given = [cells for cells in tables.values() if len(cells)]
    numbered = [cells.has("frame") for cells in given]
    by: Literal["frame", "time"] = "frame" if all(numbered) and given else "time"
    for cells in given:
        if not cells.has(by):
            raise cells.error(
                "tables that cannot be joined", by, hint="give all of them frame, or all time"
            )
    poses = tables.get("poses")
    sources = given if poses is None else [poses]
    found = [_different(keys(cells, by)) for cells in sources]
    key = np.unique(np.concatenate([np.zeros(0, found[0].dtype), *found])) if found else np.zeros(0)
    if by == "time":
        steps = np.diff(key)
        close = np.flatnonzero(steps < _CLOSE * np.median(steps)) if len(steps) else steps
        if poses is None and len(close):
            at = key[int(close[0]) : int(close[0]) + 2].tolist()
            raise InputError(
                "times that nearly agree, and may be one frame",
                field="time",
                got=at,
                hint="give the tables a column frame, or poses with the times of the frames",
            )
        return Clock(key, key, by)
    time = np.full(len(key), np.nan)
    for what in ("poses", "truth", "detections", "tracks"):
        if what in tables and tables[what].has("time") and np.isnan(time).any():
            _tell_time(tables[what], key, time)
    if np.isnan(time).all():
        time = key / rate
    untold = np.flatnonzero(np.isnan(time))
    if len(untold):
        raise InputError(
            "a frame without a time",
            frame=int(key[untold[0]]),
            field="time",
            hint="give every frame a time, or none",
        )
    late = np.flatnonzero(np.diff(time) <= 0)
    if len(late):
        frame = int(late[0]) + 1
        raise InputError(
            "times must increase with the frames",
            frame=int(key[frame]),
            field="time",
            expected=f"above {float(time[frame - 1])!r}",
            got=float(time[frame]),
        )
    return Clock(key, time, by)


def _tell_time(cells: Cells, key: NDArray[Any], time: FloatArray) -> None:
    """Put down the times that a table gives to frames which have none yet.

    Raises InputError where it gives one frame two.
    """
    at, own = cells.numbers("time"), keys(cells, "frame")
    rows = np.flatnonzero(~np.isnan(at))
    frame = np.searchsorted(key, own[rows])
    known = frame < len(key)
    known[known] = key[frame[known]] == own[rows[known]]
    # A row of a frame that is none is refused where rows are placed.
    rows, frame, at = rows[known], frame[known], at[rows[known]]
    told = time.copy()
    np.copyto(told, np.nan)
    told[frame[::-1]] = at[::-1]
    differ = told[frame] != at
    if differ.any():
        row = int(np.argmax(differ))
        raise cells.error(
            "two times of one frame", "time", int(rows[row]), expected=told[frame[row]], got=at[row]
        )
    np.copyto(time, told, where=np.isnan(time))


def keys(cells: Cells, by: str) -> NDArray[Any]:
    """(R,) the number or time of each row's frame.  Raises InputError for an empty cell."""
    if by == "time":
        key: NDArray[Any] = cells.numbers("time")
        given = ~np.isnan(key)
    else:
        key, given = cells.integers("frame")
    if not given.all():
        raise cells.error("an empty cell", by, int(np.argmin(given)), expected="every row's frame")
    return key


def _different(key: NDArray[Any]) -> NDArray[Any]:
    """The different keys, increasing."""
    return np.unique(key[_starts(key)])


def _starts(key: NDArray[Any]) -> IntArray:
    """The places where runs of equal keys begin."""
    return np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])[: len(key)])
