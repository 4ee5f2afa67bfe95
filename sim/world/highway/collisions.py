"""The broad phase before the stock collision routine: pairs on a road that could collide in a
step."""

from __future__ import annotations

import numpy as np

from pmbm.kernels import twin
from pmbm.types import FloatArray, IntArray

_MARGIN = 1e-6
"""m by which pairs are kept whose rounding cannot be judged here."""


@twin("near_pairs")
def near_pairs(
    position: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    half_length: FloatArray,
    half_width: FloatArray,
    vehicles: int,
    dt: float,
) -> tuple[IntArray, IntArray]:
    """Pairs of a vehicle (P,) and a thing (P,) of N things, the first `vehicles` of them vehicles,
    in the order in which a stock road looks at them.

    Left out are only pairs that the stock routine leaves as they are: too far apart for its
    pre-check, or with a box's edge whose normal separates the boxes now and over the step.
    """
    none = np.zeros(0, np.int64)
    if len(position) < 2:
        return none, none
    radius = np.hypot(half_length, half_width)
    reach = 2 * radius.max() + max(float(speed.max()) * dt, 0.0) + _MARGIN
    first, second = _candidates(position, reach)
    offset = position[second] - position[first]
    limit = np.maximum(radius[first] + radius[second] + speed[first] * dt + _MARGIN, 0.0)
    keep = (first < vehicles) & ((offset**2).sum(axis=1) <= limit**2)
    first, second, offset = first[keep], second[keep], offset[keep]
    if len(first) == 0:
        return none, none
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    aside = np.stack([-along[:, 1], along[:, 0]], axis=1)
    moved = speed[:, None] * along * dt
    drift = moved[first] - moved[second]
    apart = np.zeros(len(first), bool)
    for axis in (along[first], aside[first], along[second], aside[second]):
        between = (offset * axis).sum(axis=1)
        extent = np.zeros(len(first))
        for box in (first, second):
            extent += half_length[box] * abs((along[box] * axis).sum(axis=1))
            extent += half_width[box] * abs((aside[box] * axis).sum(axis=1))
        toward = (drift * axis).sum(axis=1) * np.where(between >= 0, 1.0, -1.0)
        apart |= abs(between) - extent - np.maximum(toward, 0.0) > _MARGIN
    first, second = first[~apart], second[~apart]
    order = np.lexsort((second, first))
    return first[order], second[order]


def _candidates(position: FloatArray, reach: float) -> tuple[IntArray, IntArray]:
    """Index pairs i < j whose places are within `reach` along x, by sorting."""
    order = np.argsort(position[:, 0], kind="stable")
    x = position[order, 0]
    counts = np.searchsorted(x, x + reach, side="right") - np.arange(len(x)) - 1
    one = np.repeat(np.arange(len(x)), counts)
    other = np.arange(len(one)) - np.repeat(np.cumsum(counts) - counts, counts) + one + 1
    a, b = order[one], order[other]
    return np.minimum(a, b), np.maximum(a, b)
