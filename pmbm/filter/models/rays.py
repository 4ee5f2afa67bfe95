"""Lines of sight: the surroundings of a sensor cut into narrow bearings, and what they meet.

Bearings are counted from the sensor's yaw, so that a turn of the whole world changes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmbm.filter.density import Index, ragged, starts
from pmbm.geometry import to_local
from pmbm.kernels import twin
from pmbm.types import FloatArray

BEARINGS = 720
STEP = 2 * np.pi / BEARINGS
FAR = 1e5
"""m; no ray reaches further."""
COS, SIN = np.cos((np.arange(BEARINGS) + 0.5) * STEP), np.sin((np.arange(BEARINGS) + 0.5) * STEP)
_HALVES = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
_PARALLEL = 1e-12
ON_EDGE = 1e-6
"""Of a bearing: what lies nearer below its edge is on the edge, so that rounding decides nothing of
what lies straight ahead or abeam."""


@dataclass(frozen=True, eq=False, slots=True)
class Rays:
    """The bearings that B convex outlines cover: n rays, grouped by outline.

    first (B+1,) : rays of outline b are first[b] .. first[b + 1] - 1, at consecutive bearings.
    bearing (n,) : index of the bearing.  distance (n,) : where the ray first meets the outline, m.
    margin (B,), cores (B,) : how many rays before the outline itself, in the margin around it, and
        how many that the outline itself covers.
    """

    first: Index
    bearing: Index
    distance: FloatArray
    margin: Index
    cores: Index

    @property
    def outline(self) -> Index:
        """(n,) the outline that each ray belongs to."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))

    def bare(self, rows: Index) -> Rays:
        """These outlines without the margins around them."""
        cores = self.cores[rows]
        at = ragged(self.first[rows] + self.margin[rows], cores)
        none = np.zeros(len(rows), np.intp)
        return Rays(starts(cores), self.bearing[at], self.distance[at], none, cores)

    @staticmethod
    def joined(a: Rays, b: Rays) -> Rays:
        return Rays(
            np.concatenate([a.first, a.first[-1] + b.first[1:]]),
            np.concatenate([a.bearing, b.bearing]),
            np.concatenate([a.distance, b.distance]),
            np.concatenate([a.margin, b.margin]),
            np.concatenate([a.cores, b.cores]),
        )


def bearing_of(angle: FloatArray) -> Index:
    """The bearings in which angles from the sensor's yaw lie."""
    return np.mod(np.floor(angle / STEP + ON_EDGE).astype(np.intp), BEARINGS)


def box_rays(
    pose: FloatArray, centre: FloatArray, box: FloatArray, widen: FloatArray | None = None
) -> Rays:
    """Rays from pose (3,) of upright boxes: centre (B,2), box (B,5) as z, length, width, height,
    yaw, in the world.

    widen (B,) : margin on either side, across the line of sight, m; where the ray then misses the
        box it meets it at the distance of the centre.  A box around the sensor has no rays.
    """
    offset = to_local(centre, pose)
    widen = np.zeros(len(box)) if widen is None else widen
    return Rays(*_box_rays(offset, box, widen, float(pose[2]), COS, SIN))


@twin("box_rays")
def _box_rays(
    offset: FloatArray,
    box: FloatArray,
    widen: FloatArray,
    yaw: float,
    cos_of: FloatArray,
    sin_of: FloatArray,
) -> tuple[Index, Index, FloatArray, Index, Index]:
    """The columns of `Rays`: offset (B,2) in the sensor's frame, whose yaw this is; cosine and sine
    of each bearing."""
    turned = box[:, 4] - yaw
    cos, sin = np.cos(turned), np.sin(turned)
    half_length, half_width = 0.5 * box[:, 1], 0.5 * box[:, 2]
    # The sensor in each box's own frame.
    x = -(offset[:, 0] * cos + offset[:, 1] * sin)
    y = offset[:, 0] * sin - offset[:, 1] * cos
    range_ = np.hypot(offset[:, 0], offset[:, 1])
    middle = np.arctan2(offset[:, 1], offset[:, 0])
    local = _HALVES * box[:, None, 1:3]
    corner_x = offset[:, :1] + local[..., 0] * cos[:, None] - local[..., 1] * sin[:, None]
    corner_y = offset[:, 1:] + local[..., 0] * sin[:, None] + local[..., 1] * cos[:, None]
    turn = np.arctan2(corner_y, corner_x) - middle[:, None]
    turn = np.mod(turn + np.pi, 2 * np.pi) - np.pi
    low, high = turn.min(axis=1), turn.max(axis=1)

    # Bearings whose centre lies within the extent; at least the one that the middle lies in.
    begin = np.ceil((middle + low) / STEP - 0.5).astype(np.intp)
    end = np.floor((middle + high) / STEP - 0.5).astype(np.intp)
    thin = end < begin
    if thin.any():
        begin[thin] = end[thin] = np.floor(middle[thin] / STEP + ON_EDGE).astype(np.intp)
    margin = np.arctan2(widen, np.maximum(range_, 1e-9))
    low, high = np.maximum(low - margin, -3.0), np.minimum(high + margin, 3.0)
    core_begin, core_end = begin, end
    begin = np.minimum(begin, np.ceil((middle + low) / STEP - 0.5).astype(np.intp))
    end = np.maximum(end, np.floor((middle + high) / STEP - 0.5).astype(np.intp))
    around = (np.abs(x) <= half_length) & (np.abs(y) <= half_width)
    count = np.where(around, 0, end - begin + 1)
    bearing = ragged(begin, count)
    bearing = np.mod(bearing, BEARINGS)

    # Where each ray enters and leaves the box's two pairs of sides.
    of_box = np.repeat(np.stack([cos, sin, x, y, half_length, half_width, range_]), count, axis=1)
    cos, sin, x, y, half_length, half_width, range_ = of_box
    towards_x, towards_y = cos_of[bearing], sin_of[bearing]
    per_x = 1 / _not_zero(towards_x * cos + towards_y * sin)
    per_y = 1 / _not_zero(towards_y * cos - towards_x * sin)
    at_x, at_y = -x * per_x, -y * per_y
    within_x, within_y = half_length * np.abs(per_x), half_width * np.abs(per_y)
    enter = np.maximum(at_x - within_x, at_y - within_y)
    leave = np.minimum(at_x + within_x, at_y + within_y)
    distance = np.where((enter <= leave) & (enter > 0), enter, range_)
    cores = np.where(around, 0, core_end - core_begin + 1)
    return starts(count), bearing, distance, core_begin - begin, cores


def _not_zero(value: FloatArray) -> FloatArray:
    return np.copysign(np.maximum(np.abs(value), _PARALLEL), value)


def outline_rays(pose: FloatArray, outlines: Sequence[FloatArray]) -> Rays:
    """Rays of convex polygons (V,2) in the world; one around the sensor has none."""
    count, bearings, distances = [0], [np.zeros(0, np.intp)], [np.zeros(0)]
    for outline in outlines:
        corner = to_local(outline, pose)
        middle = np.arctan2(*corner.mean(axis=0)[::-1])
        turn = np.mod(np.arctan2(corner[:, 1], corner[:, 0]) - middle + np.pi, 2 * np.pi) - np.pi
        begin = int(np.ceil((middle + turn.min()) / STEP - 0.5))
        end = int(np.floor((middle + turn.max()) / STEP - 0.5))
        bearing = np.arange(begin, end + 1)
        angle = (bearing[:, None] + 0.5) * STEP
        ray = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        edge = np.roll(corner, -1, axis=0) - corner
        # t ray = corner + s edge, by Cramer's rule.
        with np.errstate(divide="ignore", invalid="ignore"):
            area = ray[..., 0] * edge[:, 1] - ray[..., 1] * edge[:, 0]
            t = (corner[:, 0] * edge[:, 1] - corner[:, 1] * edge[:, 0]) / area
            s = (corner[:, 0] * ray[..., 1] - corner[:, 1] * ray[..., 0]) / area
            t = np.where((s >= 0) & (s <= 1) & (t > 0), t, FAR)
        surrounds = turn.max() - turn.min() > np.pi
        nearest = t.min(axis=1)
        keep = (nearest < FAR) & (not surrounds)
        count.append(int(keep.sum()))
        bearings.append(np.mod(bearing[keep], BEARINGS))
        distances.append(nearest[keep])
    return Rays(
        np.cumsum(count),
        np.concatenate(bearings),
        np.concatenate(distances),
        np.zeros(len(outlines), np.intp),
        np.array(count[1:], np.intp),
    )


def ray_key(bearing: Index, distance: FloatArray) -> FloatArray:
    """Sorts by bearing, then by distance."""
    return bearing + np.minimum(distance, 0.999 * FAR) / FAR
