"""Angles, frames, boxes and their overlap, on arrays.

Boxes are given as position (N,3) of the centre, size (N,3) as length, width, height, and yaw (N,),
all in one frame; lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.arrays import FloatArray

_CORNER_SIGNS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
"""Front left, rear left, rear right, front right, as shares of length and width:

        y
        |   1 ---------- 0
        |   |   x_local->|
        |   2 ---------- 3
        +--------------------- x
"""

_NARROWEST = 1e-3
"""m."""

_PAIRS_AT_ONCE = 200_000
"""Objects times outlines looked at together: some tens of MB."""


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """The same angles in [-pi, pi), rad; those already there keep their bits."""
    angle = np.asarray(angle, dtype=np.float64)
    inside = (angle >= -np.pi) & (angle < np.pi)
    if inside.all():
        return angle
    result = np.array(angle)
    wrapped = np.mod(angle[~inside] + np.pi, 2 * np.pi) - np.pi
    # np.mod of a tiny negative number rounds up to the divisor itself.
    result[~inside] = np.where(wrapped >= np.pi, -np.pi, wrapped)
    return result


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
    `vertical=False` of bird's-eye areas."""
    a = [np.asarray(value, np.float64) for value in (position_a, size_a, yaw_a)]
    b = [np.asarray(value, np.float64) for value in (position_b, size_b, yaw_b)]
    n, m = len(a[0]), len(b[0])
    i, j = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
    overlap = paired_iou(*(v[i] for v in a), *(v[j] for v in b), vertical=vertical)
    return overlap.reshape(n, m)


def paired_iou(
    position_a: FloatArray,
    size_a: FloatArray,
    yaw_a: FloatArray,
    position_b: FloatArray,
    size_b: FloatArray,
    yaw_b: FloatArray,
    *,
    vertical: bool = True,
) -> FloatArray:
    """Intersection over union (N,) of N pairs of upright rotated boxes, row by row.

    Only pairs whose circumscribed circles meet are intersected (shapely, all pairs in one call).
    """
    import shapely

    result = np.zeros(len(position_a))
    reach = (np.hypot(size_a[:, 0], size_a[:, 1]) + np.hypot(size_b[:, 0], size_b[:, 1])) / 2
    offset = position_a[:, :2] - position_b[:, :2]
    near = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) < reach)
    if len(near) == 0:
        return result
    position_a, size_a, yaw_a = position_a[near], size_a[near], yaw_a[near]
    position_b, size_b, yaw_b = position_b[near], size_b[near], yaw_b[near]
    polygon_a = shapely.polygons(corners(position_a, size_a, yaw_a))
    polygon_b = shapely.polygons(corners(position_b, size_b, yaw_b))
    overlap = shapely.area(shapely.intersection(polygon_a, polygon_b))
    measure_a, measure_b = size_a[:, 0] * size_a[:, 1], size_b[:, 0] * size_b[:, 1]
    if vertical:
        top = np.minimum(position_a[:, 2] + size_a[:, 2] / 2, position_b[:, 2] + size_b[:, 2] / 2)
        bottom = np.maximum(
            position_a[:, 2] - size_a[:, 2] / 2, position_b[:, 2] - size_b[:, 2] / 2
        )
        overlap = overlap * np.clip(top - bottom, 0.0, None)
        measure_a, measure_b = measure_a * size_a[:, 2], measure_b * size_b[:, 2]
    result[near] = overlap / (measure_a + measure_b - overlap)
    return result


def visible_fraction(
    corners: ArrayLike, sensor_xy: ArrayLike, occluders: Sequence[ArrayLike] = ()
) -> FloatArray:
    """Unoccluded share (N,) of each object's angular extent as seen from the sensor, in [0, 1].

    corners : (N,4,2) bird's-eye corners of the objects, in order around each box.
    sensor_xy : (2,) where the sensor stands.
    occluders : convex polygons (V,2) that stand still and cast shadows but are not judged.

    Every object is shadowed by the nearer of the others and by the occluders, all as tall as
    need be.  Exact: two convex outlines keep their order along the rays that hit both, except
    where they cross, and each shadow is cut there.  A polygon that contains the sensor hides
    nothing and is seen whole.
    """
    objects = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 2)
    sensor = np.asarray(sensor_xy, dtype=np.float64)[None]
    return visible_fractions(objects, [len(objects)], sensor, occluders)


def visible_fractions(
    corners: FloatArray,
    count: ArrayLike,
    sensor_xy: FloatArray,
    occluders: Sequence[ArrayLike] = (),
) -> FloatArray:
    """`visible_fraction` (R,) of the objects of many frames, to the bit as frame by frame.

    corners (R,4,2) : of all frames' objects, frame after frame, count (F,) of them in each.
    sensor_xy (F,2) : where the sensor stands in each frame.
    """
    count = np.asarray(count, dtype=np.int64)
    outline = _stacked(corners, occluders)
    parts = [np.zeros(0)]
    end = np.cumsum(count)
    for frames in _chunks(count, len(occluders)):
        rows = slice(int(end[frames.start] - count[frames.start]), int(end[frames.stop - 1]))
        parts.append(
            _visible(outline[rows], outline[len(corners) :], count[frames], sensor_xy[frames])
        )
    return np.concatenate(parts)


def _chunks(count: NDArray[np.int64], occluders: int) -> Iterator[slice]:
    """Runs of frames of which the pairs of objects and outlines fit into little memory."""
    start = 0
    while start < len(count):
        most = np.maximum.accumulate(count[start:])
        pairs = most * (most + occluders) * np.arange(1, len(most) + 1)
        stop = start + max(1, int(np.searchsorted(pairs, _PAIRS_AT_ONCE, side="right")))
        yield slice(start, stop)
        start = stop


def _visible(
    objects: FloatArray, occluders: FloatArray, count: NDArray[np.int64], sensor: FloatArray
) -> FloatArray:
    """Visible shares (R,) of the outlines `objects` (R,V,2) of frames; all counter-clockwise."""
    rows, frames, still = len(objects), len(count), len(occluders)
    frame = np.repeat(np.arange(frames), count)
    shape = (frames * still, *occluders.shape[1:])
    outline = np.concatenate(
        [objects, np.broadcast_to(occluders, (frames, *occluders.shape)).reshape(shape)]
    )
    outline -= sensor[np.append(frame, np.repeat(np.arange(frames), still))][:, None]
    # Where each outline stands in a table with a row a frame: its objects, then the occluders.
    most = int(count.max(initial=0))
    place = np.full((frames, most + still), -1)
    place[frame, np.arange(rows) - np.repeat(np.cumsum(count) - count, count)] = np.arange(rows)
    place[:, most:] = rows + np.arange(frames * still).reshape(frames, still)
    middle, half = _angular_extent(outline)
    target, other, low, high = _common_arcs(middle, half, place, most)
    low, high = low[:, None], high[:, None]
    edge = np.roll(outline, -1, axis=1) - outline
    plain = ~_bounds_meet(outline, target, other)
    shadow_target, shadow = [], []
    for pairs, cuts in (
        (plain, np.empty((np.count_nonzero(plain), 0))),
        (~plain, _crossing_angles(outline, edge, middle, target[~plain], other[~plain])),
    ):
        edges = np.concatenate(
            [low[pairs], np.sort(np.clip(cuts, low[pairs], high[pairs])), high[pairs]], axis=1
        )
        ray = (edges[:, :-1] + edges[:, 1:]) / 2 + middle[target[pairs], None]
        cos, sin = np.cos(ray), np.sin(ray)
        nearer = _entry_distance(outline, edge, other[pairs], cos, sin) < _entry_distance(
            outline, edge, target[pairs], cos, sin
        ) * (1 - 1e-12)
        shadow_target.append(np.broadcast_to(target[pairs, None], nearer.shape)[nearer])
        shadow.append(np.stack([edges[:, :-1][nearer], edges[:, 1:][nearer]], axis=-1))
    hidden = _union_length(np.concatenate(shadow_target), np.concatenate(shadow), frame)
    extent = 2 * half[:rows]
    seen_whole = extent <= 0
    share = hidden / np.where(seen_whole, 1.0, extent)
    return np.where(seen_whole, 1.0, np.clip(1.0 - share, 0.0, 1.0))


def normal_density(points: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> FloatArray:
    """Densities (M,P), per m^2, of normals with mean (P,2) and covariance (P,2,2) at points (M,2).

    A normal narrower than a millimetre is taken to be that wide.
    """
    points = np.asarray(points, dtype=np.float64)
    whitened, area = _whitened(points[:, None], mean, cov)
    return np.exp(-0.5 * np.einsum("mpi,mpi->mp", whitened, whitened)) / (2 * np.pi * area)


def normal_in_polygon(polygon: ArrayLike, mean: ArrayLike, cov: ArrayLike) -> FloatArray:
    """(P,) probability that points drawn from normals, mean (P,2) and covariance (P,2,2), lie in a
    simple polygon (V,2), convex or not, to about 1e-14.

    Where the normal is made round and central the polygon is a signed sum of triangles around the
    origin, and of a triangle Owen's T function gives the probability in closed form (Owen 1956).
    A normal narrower than a millimetre is taken to be that wide.
    """
    from scipy.special import owens_t

    corner = _whitened(np.asarray(polygon, dtype=np.float64)[:, None], mean, cov)[0]
    after = np.roll(corner, -1, axis=0)
    edge = after - corner
    length = np.hypot(edge[..., 0], edge[..., 1])
    unit = edge / np.maximum(length, 1e-300)[..., None]
    # Of each edge's line: the signed distance from the origin, and where along it the ends lie.
    distance = _cross(corner, unit)
    begin = np.einsum("vpi,vpi->vp", corner, unit)
    angle = np.arctan2(_cross(corner, after), np.einsum("vpi,vpi->vp", corner, after))
    near = np.maximum(np.abs(distance), 1e-15)
    beyond = owens_t(near, (begin + length) / near) - owens_t(near, begin / near)
    return np.abs((angle / (2 * np.pi) - np.copysign(1.0, angle) * beyond).sum(axis=0)).clip(
        max=1.0
    )


def points_in_polygon(points: ArrayLike, polygon: ArrayLike) -> NDArray[np.bool_]:
    """(M,) whether points (M,2) lie in a simple polygon (V,2), convex or not."""
    x, y = np.asarray(points, dtype=np.float64).T[:, :, None]
    x0, y0 = np.asarray(polygon, dtype=np.float64).T
    x1, y1 = np.roll(x0, -1), np.roll(y0, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return crossing.sum(axis=1) % 2 == 1


def _whitened(points: FloatArray, mean: ArrayLike, cov: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """L^-1 (points - mean) of normals with covariance L L', and the determinant (P,) of L."""
    mean, cov = np.asarray(mean, dtype=np.float64), np.asarray(cov, dtype=np.float64)
    l11 = np.sqrt(np.maximum(cov[:, 0, 0], _NARROWEST**2))
    l21 = cov[:, 1, 0] / l11
    l22 = np.sqrt(np.maximum(cov[:, 1, 1] - l21**2, _NARROWEST**2))
    offset = points - mean
    first = offset[..., 0] / l11
    return np.stack([first, (offset[..., 1] - l21 * first) / l22], axis=-1), l11 * l22


def _stacked(objects: FloatArray, occluders: Sequence[ArrayLike]) -> FloatArray:
    """All outlines (M,V,2), counter-clockwise; short ones repeat their last corner."""
    outlines = [np.asarray(polygon, dtype=np.float64) for polygon in occluders]
    longest = max([4, *map(len, outlines)])
    stacked = np.empty((len(objects) + len(outlines), longest, 2))
    stacked[: len(objects), :4] = objects
    stacked[: len(objects), 4:] = objects[:, -1:]
    for row, polygon in enumerate(outlines, start=len(objects)):
        stacked[row, : len(polygon)] = polygon
        stacked[row, len(polygon) :] = polygon[-1]
    about = stacked - stacked[:, :1]
    clockwise = _cross(about, np.roll(about, -1, axis=1)).sum(axis=1) < 0
    stacked[clockwise] = stacked[clockwise, ::-1]
    return stacked


def _angular_extent(outline: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Middle angle and half-angle (M,) of outlines around the origin; half 0 around itself."""
    contains = (_cross(outline, np.roll(outline, -1, axis=1)) >= 0).all(axis=1)
    angle = np.arctan2(outline[..., 1], outline[..., 0])
    offset = wrap_angle(angle - angle[:, :1])
    low, high = offset.min(axis=1), offset.max(axis=1)
    middle = wrap_angle(angle[:, 0] + (low + high) / 2)
    return middle, np.where(contains, 0.0, (high - low) / 2)


def _common_arcs(
    middle: FloatArray, half: FloatArray, place: NDArray[np.intp], most: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray]:
    """Pairs (object, other outline) that share rays, and the shared arc about the object's middle.

    place : which outlines stand in each frame, -1 none; the first `most` columns are objects.
    Both half-angles are below pi / 2, so the shared arc is in one piece and does not wrap.
    """
    # What is not there shares no ray with anything.
    at, width = np.append(middle, 0.0)[place], np.append(half, -1.0)[place]
    own, own_width = at[:, :most, None], width[:, :most, None]
    offset = wrap_angle(at[:, None] - own)
    low = np.maximum(-own_width, offset - width[:, None])
    high = np.minimum(own_width, offset + width[:, None])
    shared = low < high
    each = np.arange(most)
    shared[:, each, each] = False
    frame, target, other = np.nonzero(shared)
    return (
        place[frame, target],
        place[frame, other],
        low[frame, target, other],
        high[frame, target, other],
    )


def _bounds_meet(
    outline: FloatArray, first: NDArray[np.intp], second: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Whether the axis-parallel bounds of two outlines meet, pair by pair."""
    (x, y), (far_x, far_y) = outline.min(axis=1).T, outline.max(axis=1).T
    return (
        (x[first] <= far_x[second])
        & (x[second] <= far_x[first])
        & (y[first] <= far_y[second])
        & (y[second] <= far_y[first])
    )


def _crossing_angles(
    outline: FloatArray,
    edges: FloatArray,
    middle: FloatArray,
    first: NDArray[np.intp],
    second: NDArray[np.intp],
) -> FloatArray:
    """Angles (P,V*V), about the middle of `first`, where the outlines of each pair cross."""
    start, other_start = outline[first][:, :, None], outline[second][:, None]
    edge, other_edge = edges[first][:, :, None], edges[second][:, None]
    between = other_start - start
    turn = _cross(edge, other_edge)
    parallel = turn == 0
    turn = np.where(parallel, 1.0, turn)
    along, other_along = _cross(between, other_edge) / turn, _cross(between, edge) / turn
    crossing = ~parallel & (along >= 0) & (along <= 1) & (other_along >= 0) & (other_along <= 1)
    angle = np.zeros(crossing.shape)
    pair, corner, _ = np.nonzero(crossing)
    point = outline[first[pair], corner] + along[crossing][:, None] * edges[first[pair], corner]
    angle[crossing] = wrap_angle(np.arctan2(point[:, 1], point[:, 0]) - middle[first[pair]])
    return angle.reshape(len(first), outline.shape[1] ** 2)


def _entry_distance(
    outline: FloatArray, edge: FloatArray, row: NDArray[np.intp], cos: FloatArray, sin: FloatArray
) -> FloatArray:
    """Distance (P,A) at which rays (P,A) from the origin, at angles of this cosine and sine, enter
    the outlines of these rows (P,) that they hit: the farthest of the edges that face the origin.
    """
    across = _cross(outline, edge)
    distance = np.full(cos.shape, -np.inf)
    for corner in range(outline.shape[1]):
        x, y = edge[row, corner].T[:, :, None]
        facing = cos * y - sin * x
        reach = across[row, corner, None] / np.where(facing < 0, facing, -1.0)
        np.maximum(distance, reach, out=distance, where=facing < 0)
    return distance


def _union_length(
    row: NDArray[np.intp], interval: FloatArray, frame: NDArray[np.intp]
) -> FloatArray:
    """Length (R,) of the union of the intervals (I,2) that belong to each row (I,) of R, which
    stand in frames (R,)."""
    count = len(frame)
    order = np.lexsort((interval[:, 0], row))
    row, interval = row[order], interval[order]
    per_row = np.bincount(row, minlength=count)
    column = np.arange(len(row)) - np.repeat(np.cumsum(per_row) - per_row, per_row)
    table = np.full((count, per_row.max(initial=0) + 1, 2), -np.inf)
    table[row, column + 1] = interval
    reached = np.maximum.accumulate(table[..., 1], axis=1)
    begin = np.maximum(table[:, 1:, 0], reached[:, :-1])
    length = np.zeros(begin.shape)
    np.subtract(table[:, 1:, 1], begin, out=length, where=table[:, 1:, 1] > begin)
    total = np.zeros(count)
    most = np.zeros(int(frame.max(initial=0)) + 1, np.int64)
    np.maximum.at(most, frame, per_row)
    # numpy's order of summation depends on the width: each frame has that of its own rows.
    for width in np.unique(most).tolist():
        rows = most[frame] == width
        total[rows] = np.ascontiguousarray(length[rows, :width]).sum(axis=1)
    return total


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _rotation(yaw: float) -> FloatArray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin], [sin, cos]])
