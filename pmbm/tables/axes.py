"""Turns between the frame that boxes are given in and the world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmbm.arrays import FloatArray, IntArray
from pmbm.geometry import wrap_angle
from pmbm.tables.cells import Cells


@dataclass(frozen=True, eq=False)
class Axes:
    """Rigid motions from the frame that boxes are given in to the world.

    rotation (M,3,3), translation (M,3) : m.
    """

    rotation: FloatArray
    translation: FloatArray

    def take(self, rows: IntArray) -> Axes:
        """The axes of these rows."""
        return Axes(self.rotation[rows], self.translation[rows])

    def to_world(self, table: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Boxes, a motion each, in the world; what is no box's place or direction is kept."""
        turn = self.rotation
        place = np.einsum("rij,rj->ri", turn, table["position"]) + self.translation
        return self._turned(table, place, turn[:, :2, :2])

    def to_sensor(self, table: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The inverse of `to_world`."""
        place = np.einsum("rji,rj->ri", self.rotation, table["position"] - self.translation)
        return self._turned(
            table, place, np.asarray(np.linalg.inv(self.rotation[:, :2, :2]), np.float64)
        )

    def _turned(
        self, table: Mapping[str, NDArray[Any]], place: FloatArray, turn: FloatArray
    ) -> dict[str, NDArray[Any]]:
        heading = np.stack([np.cos(table["yaw"]), np.sin(table["yaw"])], axis=1)
        x, y = np.einsum("rij,rj->ri", turn, heading).T
        moved = {**table, "position": place, "yaw": wrap_angle(np.arctan2(y, x))}
        if "velocity" in table:
            moved["velocity"] = np.einsum("rij,rj->ri", turn, table["velocity"])
        return moved


def axes(poses: Cells) -> Axes:
    """The motion of each row of the poses; where empty, none.  Turned by yaw, then pitch about the
    new y axis, then roll about the new x axis."""
    yaw, pitch, roll = (poses.numbers(name, 0.0) for name in ("yaw", "pitch", "roll"))
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(a), np.sin(a)) for a in (yaw, pitch, roll))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    place = np.column_stack([poses.numbers(name, 0.0) for name in ("x", "y", "z")])
    return Axes(np.moveaxis(np.array(rows), 2, 0), place)
