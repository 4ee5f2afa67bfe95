"""Arrays of class, size, place, identity and velocity from the cells of boxes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.errors import nearest_hint
from pmbm.geometry import wrap_angle
from pmbm.labels import Label
from pmbm.tables.cells import Cells, arrow_package
from pmbm.tables.clock import Placed

WHOLE: Final = r"0|-?[1-9][0-9]{0,17}"
"""Ids that stand for themselves."""


def labels_of(cells: Cells, classes: Mapping[str, Label | None]) -> tuple[IntArray, BoolArray]:
    """(R,) the label of each row, and whether the row is kept: a class may be left out.

    classes : the table's own names -> labels, None for those left out; beside them the names of
        the labels themselves.
    Raises InputError for an unknown class, with the nearest.
    """
    known: dict[str, Label | None] = {label.name.lower(): label for label in Label}
    known |= classes
    index, names = cells.texts("class")
    number = np.full(len(names) + 1, int(Label.OTHER))
    kept = np.ones(len(names) + 1, bool)
    # An empty cell, whose index is -1, is of the class "other".
    for place, name in enumerate([*names, "other"]):
        if name not in known:
            raise cells.error(
                "an unknown class",
                "class",
                int(np.argmax(index == place)),
                expected="a label's name or one of [classes]",
                got=name,
                hint=nearest_hint(name, known, "class"),
            )
        label = known[name]
        kept[place] = label is not None
        number[place] = int(Label.OTHER if label is None else label)
    return number[index], kept[index]


def boxes(cells: Cells, label: IntArray) -> dict[str, FloatArray]:
    """Position (R,3), size (R,3) and yaw (R,) of each row, with their defaults."""
    usual = np.array([other.default_size for other in Label])
    sides = [
        cells.numbers(name, usual[label, side] if not _full(cells, name) else None)
        for side, name in enumerate(("length", "width", "height"))
    ]
    size = np.column_stack(sides)
    z = cells.numbers("z", None if _full(cells, "z") else size[:, 2] / 2)
    position = np.column_stack([cells.numbers("x"), cells.numbers("y"), z])
    return {"position": position, "size": size, "yaw": wrap_angle(cells.numbers("yaw", 0.0))}


def _full(cells: Cells, name: str) -> bool:
    """Whether the column has no empty cell, so that nobody asks for its default."""
    return cells.has(name) and cells.table.column(name).null_count == 0


def identities(cells: Cells) -> tuple[IntArray, dict[str, int] | None]:
    """(R,) the number of each row's id, and what ids the numbers stand for; None where ids that are
    whole numbers stand for themselves.  Others are numbered as they appear."""
    column = cells.table.column("id")
    if arrow_package().types.is_integer(column.type) and not column.null_count:
        return cells.integers("id")[0], None
    index, names = cells.texts("id")
    if all(re.fullmatch(WHOLE, name) for name in names):
        return np.array([*map(int, names), 0], np.int64)[index], None
    return index, {name: number for number, name in enumerate(names)}


def each_once(cells: Cells, identity: IntArray, placed: Placed) -> None:
    """Raise InputError where an id stands twice in a frame.  identity (R,) : in order of frame."""
    if len(identity) == 0:
        return
    low, high = int(identity.min()), int(identity.max())
    frame = placed.frame
    if (high - low + 1) * len(placed.count) < 2**62:
        joint = frame * (high - low + 1) + (identity - low)
        if (joint[1:] > joint[:-1]).all():
            return
        joint.sort()
        if not (joint[1:] == joint[:-1]).any():
            return
    order = np.lexsort((identity, frame))
    same = (np.diff(identity[order]) == 0) & (np.diff(frame[order]) == 0)
    if same.any():
        rows = order[int(np.argmax(same)) :][:2]
        first, second = sorted(rows.tolist() if placed.order is None else placed.order[rows])
        raise cells.error(
            "the same id twice in a frame",
            "id",
            int(first),
            int(second),
            expected="each id once",
            got=int(identity[rows[0]]),
        )


def differences(
    identity: IntArray, position: FloatArray, placed: Placed, time: FloatArray
) -> FloatArray:
    """(R,2) velocities from positions, rows in order of frame: central where the object is in both
    neighbouring frames, one-sided where it is in one, zero where it is in none."""
    frame = placed.frame
    order = np.lexsort((frame, identity))
    who, when, where = identity[order], frame[order], position[order, :2]
    joined = (np.diff(who) == 0) & (np.diff(when) == 1)
    rows = np.arange(len(who))
    first = rows - np.concatenate([[False], joined])[: len(rows)]
    last = rows + np.concatenate([joined, [False]])[: len(rows)]
    apart = time[when[last]] - time[when[first]]
    speed = np.zeros((len(who), 2))
    moved = where[last] - where[first]
    np.divide(moved, apart[:, None], out=speed, where=(last > first)[:, None])
    result = np.empty_like(speed)
    result[order] = speed
    return result
