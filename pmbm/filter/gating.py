"""Which measurements lie in the gate of which Gaussian."""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from pmbm import compiled
from pmbm.filter.density import Index
from pmbm.filter.gaussian import Innovation
from pmbm.types import FloatArray

_DENSE_BELOW = 20_000
"""Gaussians times measurements; below it, looking at every pair costs less than a tree."""
_NEIGHBOURS = 4
"""Measurements fetched per Gaussian in the first, vectorised look-up."""
_USUAL_WIDTH = 4.0
"""Reaches up to this many times the median are looked up together."""


def gate(
    innovation: Innovation, z: FloatArray, threshold: float
) -> tuple[Index, Index, FloatArray]:
    """All pairs with squared Mahalanobis distance of the innovation below `threshold`.

    z (M,2).  Gives rows (n,) of the Gaussians, ascending, rows (n,) of the measurements, and the
    whitened innovations (n,2), whose squared length is that distance.
    """
    if compiled.native is not None:
        row, column, y = compiled.native.gate(
            *innovation.columns(), np.ascontiguousarray(z), threshold
        )
        return row, column, y.reshape(-1, 2)
    if len(innovation.expected) * len(z) <= _DENSE_BELOW:
        y0, y1 = innovation.whiten_all(z)
        row, column = np.nonzero(y0 * y0 + y1 * y1 < threshold)
        return row, column, np.stack([y0[row, column], y1[row, column]], axis=1)
    row, column = near(innovation.expected, innovation.reach(threshold), z)
    y = innovation.whiten(row, z[column])
    inside = np.flatnonzero(y[:, 0] * y[:, 0] + y[:, 1] * y[:, 1] < threshold)
    return row[inside], column[inside], y[inside]


def near(centre: FloatArray, radius: FloatArray, z: FloatArray) -> tuple[Index, Index]:
    """Pairs of a centre (N,2) and a point (M,2) no further apart than `radius` (N,) of the centre,
    and perhaps some that are, sorted by centre, then point."""
    if len(centre) * len(z) <= _DENSE_BELOW:
        close = np.abs(centre[:, None, 0] - z[:, 0]) <= radius[:, None]
        close &= np.abs(centre[:, None, 1] - z[:, 1]) <= radius[:, None]
        row, column = np.nonzero(close)
        return row, column
    return _near_by_tree(centre, radius, z)


def _near_by_tree(centre: FloatArray, radius: FloatArray, z: FloatArray) -> tuple[Index, Index]:
    """`near` where there are too many pairs to look at each.

    Most reaches are about equally wide and hold few points: these are looked up together.  The
    crowded ones among them are looked up again, and the wide ones compared with every point.
    """
    tree = cKDTree(z)
    usual = radius <= _USUAL_WIDTH * np.median(radius)
    rows = np.flatnonzero(usual)
    k = min(_NEIGHBOURS, len(z))
    distance, found = tree.query(
        centre[rows], k=np.arange(1, k + 1), distance_upper_bound=radius[rows].max()
    )
    within = distance <= radius[rows][:, None]
    crowded = within[:, -1].copy() if k < len(z) else np.zeros(len(rows), bool)
    within[crowded] = False
    i, j = np.nonzero(within)
    again = rows[crowded]
    lists = tree.query_ball_point(centre[again], radius[again])
    length = np.fromiter(map(len, lists), np.intp, len(lists))
    wide = np.flatnonzero(~usual)
    close = np.hypot(*(centre[wide, :, None] - z.T).transpose(1, 0, 2)) <= radius[wide, None]
    wide_row, wide_column = np.nonzero(close)
    row = np.concatenate([rows[i], np.repeat(again, length), wide[wide_row]])
    column = np.concatenate(
        [found[i, j], np.fromiter(chain.from_iterable(lists), np.intp), wide_column]
    )
    order = np.lexsort((column, row))
    return row[order], column[order]
