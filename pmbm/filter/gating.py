"""Which measurements lie in the gate of which Gaussian."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pmbm.filter.density import Index
from pmbm.filter.gaussian import Innovation
from pmbm.types import FloatArray

_DENSE_BELOW = 20_000
"""Gaussians times measurements; below it, looking at every pair costs less than a tree."""
_NEIGHBOURS = 4
"""Measurements fetched per Gaussian in the first, vectorised look-up."""


def gate(
    innovation: Innovation, z: FloatArray, threshold: float
) -> tuple[Index, Index, FloatArray]:
    """All pairs with squared Mahalanobis distance of the innovation below `threshold`.

    z (M,2).  Gives rows (n,) of the Gaussians, ascending, rows (n,) of the measurements, and the
    whitened innovations (n,2), whose squared length is that distance.
    """
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

    Most gates are about equally wide and hold few measurements: these are looked up together.
    Wide and crowded ones are looked up one by one.
    """
    tree = cKDTree(z)
    usual = radius <= 4 * np.median(radius)
    rows = np.flatnonzero(usual)
    k = min(_NEIGHBOURS, len(z))
    distance, found = tree.query(
        centre[rows], k=np.arange(1, k + 1), distance_upper_bound=radius[rows].max()
    )
    crowded = np.isfinite(distance[:, -1]) if k == _NEIGHBOURS else np.zeros(len(rows), bool)
    in_reach = (distance <= radius[rows][:, None]) & ~crowded[:, None]
    i, j = np.nonzero(in_reach)
    row, column = [rows[i]], [found[i, j]]
    others = np.concatenate([rows[crowded], np.flatnonzero(~usual)])
    for one, neighbours in zip(
        others.tolist(), tree.query_ball_point(centre[others], radius[others]), strict=True
    ):
        row.append(np.full(len(neighbours), one))
        column.append(np.array(neighbours, dtype=np.intp))
    all_rows, all_columns = np.concatenate(row), np.concatenate(column)
    order = np.lexsort((all_columns, all_rows))
    return all_rows[order], all_columns[order]
