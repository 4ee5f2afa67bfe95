"""Rigid motions between a sensor's frame (x forward, y left, z up) and the world, for points and
upright boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pmbm.datasets.files import LARGEST_LENGTH, Place
from pmbm.geometry import wrap_angle
from pmbm.types import FloatArray

_NEARLY: Final = 1e-2
"""How far a rotation as printed may be from one."""
_STEEPEST: Final = 0.1
"""Least cosine between a sensor's z and up: beyond, a box's heading in the world means nothing."""


@dataclass(frozen=True, eq=False)
class Pose:
    """World from sensor: p_world = rotation @ p_sensor + translation.

    rotation (3,3) : orthonormal, z of the sensor pointing up.
    translation (3,) : m.
    """

    rotation: FloatArray
    translation: FloatArray

    @cached_property
    def planar(self) -> FloatArray:
        """x, y, yaw of the sensor in the world (3,)."""
        forward = self.rotation[:, 0]
        return np.array([*self.translation[:2], np.arctan2(forward[1], forward[0])])

    def to_world(self, points: FloatArray) -> FloatArray:
        """Points (N,3) of the sensor's frame, in the world."""
        return points @ self.rotation.T + self.translation

    def to_sensor(self, points: FloatArray) -> FloatArray:
        """Points (N,3) of the world, in the sensor's frame."""
        return (points - self.translation) @ self.rotation

    def yaw_to_world(self, yaw: FloatArray) -> FloatArray:
        """Headings (N,) of boxes upright in the sensor's frame: the direction of their length,
        seen from above in the world, rad."""
        return _turned(yaw, self.rotation[:2, :2])

    def yaw_to_sensor(self, yaw: FloatArray) -> FloatArray:
        """The exact inverse of `yaw_to_world`."""
        return _turned(yaw, np.asarray(np.linalg.inv(self.rotation[:2, :2]), np.float64))


def _turned(yaw: FloatArray, matrix: FloatArray) -> FloatArray:
    x, y = matrix @ np.array([np.cos(yaw), np.sin(yaw)])
    return wrap_angle(np.arctan2(y, x))


STANDING: Final = Pose(np.eye(3), np.zeros(3))
"""The world is the sensor's own frame."""


def pose(rotation: ArrayLike, translation: ArrayLike, place: Place) -> Pose:
    """The pose with the nearest true rotation; InputError where the matrix is far from one, or
    turns the sensor over."""
    matrix = np.asarray(rotation, dtype=np.float64)
    vector = np.asarray(translation, dtype=np.float64)
    if not np.isfinite(vector).all() or np.abs(vector).max() > LARGEST_LENGTH:
        raise place.error("a pose without a place", field="translation", got=vector.tolist())
    close = np.isfinite(matrix).all() and np.abs(matrix).max() <= 1 + _NEARLY
    if not close or np.abs(matrix @ matrix.T - np.eye(3)).max() > _NEARLY:
        raise place.error(
            "not a rotation", field="rotation", expected="an orthonormal matrix", got=matrix
        )
    left, _, right = np.linalg.svd(matrix)
    nearest = left @ right
    if np.linalg.det(nearest) < 0:
        raise place.error(
            "not a rotation", field="rotation", expected="a right-handed matrix", got=matrix
        )
    if nearest[2, 2] < _STEEPEST:
        raise place.error(
            "the sensor's z axis does not point up in the world", field="rotation", got=matrix
        )
    return Pose(nearest, vector)


def quaternion_matrix(quaternion: Sequence[float], place: Place) -> FloatArray:
    """The rotation (3,3) of a quaternion w, x, y, z; InputError where its norm is not near 1."""
    norm = math.hypot(*quaternion)
    if not abs(norm - 1) <= _NEARLY:
        raise place.error(
            "not a unit quaternion", field="rotation", expected="norm 1", got=list(quaternion)
        )
    w, x, y, z = (part / norm for part in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def matrix_yaw(rotation: FloatArray) -> float:
    """The heading of a rotated x axis, seen from above, rad."""
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def yaw_quaternion(yaw: float) -> list[float]:
    """The quaternion [w, 0, 0, z] of a heading."""
    return [float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))]
