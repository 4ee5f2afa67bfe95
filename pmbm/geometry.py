"""Angles, frames, boxes and their overlap, on arrays.

Boxes are given as position (N,3) of the centre, size (N,3) as length, width, height, and yaw (N,),
all in one frame; lengths in metres, angles in radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_CORNER_SIGNS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
"""Front left, rear left, rear right, front right, as shares of length and width:

        y
        |   1 ---------- 0
        |   |   x_local->|
        |   2 ---------- 3
        +--------------------- x
"""


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """The same angles in [-pi, pi), rad; those already there keep their bits."""
    angle = np.asarray(angle, dtype=np.float64)
    inside = (angle >= -np.pi) & (angle < np.pi)
    wrapped = np.mod(angle + np.pi, 2 * np.pi) - np.pi
    # np.mod of a tiny negative number rounds up to the divisor itself.
    wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)
    return np.where(inside, angle, wrapped)


def to_world(points: ArrayLike, pose: ArrayLike) -> FloatArray:
    """Points (..., 2) from the frame of `pose` = (x, y, yaw) in the world, into the world."""
    pose = np.asarray(pose, dtype=np.float64)
    return np.asarray(points, dtype=np.float64) @ _rotation(pose[2]).T + pose[:2]


def to_local(points: ArrayLike, pose: ArrayLike) -> FloatArray:
    """Points (..., 2) from the world into the frame of `pose` = (x, y, yaw) in the world."""
    pose = np.asarray(pose, dtype=np.float64)
    return (np.asarray(points, dtype=np.float64) - pose[:2]) @ _rotation(pose[2])


def corners(position: ArrayLike, size: ArrayLike, yaw: ArrayLike) -> FloatArray:
    """Bird's-eye corners (N,4,2) of boxes, counter-clockwise from the front left."""
    position, size, yaw = (np.asarray(v, dtype=np.float64) for v in (position, size, yaw))
    local = _CORNER_SIGNS * size[:, None, :2]
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x = local[..., 0] * cos - local[..., 1] * sin
    y = local[..., 0] * sin + local[..., 1] * cos
    return np.stack([x, y], axis=-1) + position[:, None, :2]


def centre_distance(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Euclidean distances (N,M) between points a (N,D) and b (M,D), m."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    difference = a[:, None, :] - b[None, :, :]
    return np.sqrt(np.einsum("nmd,nmd->nm", difference, difference))


def iou(
    position_a: ArrayLike,
    size_a: ArrayLike,
    yaw_a: ArrayLike,
    position_b: ArrayLike,
    size_b: ArrayLike,
    yaw_b: ArrayLike,
    *,
    vertical: bool = True,
) -> FloatArray:
    """Intersection over union (N,M) of upright rotated boxes: of volumes, or with
    `vertical=False` of bird's-eye areas.

    Only pairs whose circumscribed circles meet are intersected (shapely, all pairs in one call).
    """
    import shapely

    position_a, size_a, yaw_a = (np.asarray(v, np.float64) for v in (position_a, size_a, yaw_a))
    position_b, size_b, yaw_b = (np.asarray(v, np.float64) for v in (position_b, size_b, yaw_b))
    result = np.zeros((len(position_a), len(position_b)))
    if result.size == 0:
        return result
    radius_a = np.hypot(size_a[:, 0], size_a[:, 1]) / 2
    radius_b = np.hypot(size_b[:, 0], size_b[:, 1]) / 2
    near = centre_distance(position_a[:, :2], position_b[:, :2]) < radius_a[:, None] + radius_b
    i, j = np.nonzero(near)
    if len(i) == 0:
        return result
    polygon_a = shapely.polygons(corners(position_a, size_a, yaw_a))
    polygon_b = shapely.polygons(corners(position_b, size_b, yaw_b))
    overlap = shapely.area(shapely.intersection(polygon_a[i], polygon_b[j]))
    measure_a, measure_b = size_a[:, 0] * size_a[:, 1], size_b[:, 0] * size_b[:, 1]
    if vertical:
        top = np.minimum(
            (position_a[:, 2] + size_a[:, 2] / 2)[i], (position_b[:, 2] + size_b[:, 2] / 2)[j]
        )
        bottom = np.maximum(
            (position_a[:, 2] - size_a[:, 2] / 2)[i], (position_b[:, 2] - size_b[:, 2] / 2)[j]
        )
        overlap = overlap * np.clip(top - bottom, 0.0, None)
        measure_a, measure_b = measure_a * size_a[:, 2], measure_b * size_b[:, 2]
    result[i, j] = overlap / (measure_a[i] + measure_b[j] - overlap)
    return result


def _rotation(yaw: float) -> FloatArray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin], [sin, cos]])
