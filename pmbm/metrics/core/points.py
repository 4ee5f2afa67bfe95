"""Checked arguments of distances between sets of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmbm.arrays import FloatArray
from pmbm.errors import InputError


def check_cutoff_and_order(cutoff: float, order: float) -> None:
    """Raise InputError unless cutoff > 0 and order >= 1 (both finite)."""
    if not 0 < cutoff < np.inf:
        raise InputError("bad cutoff", field="cutoff", expected="above 0 m", got=cutoff)
    if not 1 <= order < np.inf:
        raise InputError("bad order", field="order", expected="a finite number >= 1", got=order)


def point_sets(truth: ArrayLike, estimates: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Two checked sets of points, (M,D) and (N,D); an empty list is a set of no points."""
    sets = []
    for name, given in (("truth", truth), ("estimates", estimates)):
        points = np.asarray(given, dtype=np.float64)
        if points.size == 0:
            points = points.reshape(0, points.shape[-1])
        if points.ndim != 2:
            raise InputError(
                "bad points", field=name, expected="shape (N, D)", got=f"shape {points.shape}"
            )
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        if len(bad):
            raise InputError(
                "bad points", field=name, rows=bad, expected="finite numbers", got=points[bad[0]]
            )
        sets.append(points)
    x, y = sets
    if x.size and y.size and x.shape[1] != y.shape[1]:
        raise InputError(
            "points of different dimension", field="estimates", expected=x.shape[1], got=y.shape[1]
        )
    width = max(x.shape[1], y.shape[1])
    return x.reshape(len(x), width), y.reshape(len(y), width)
