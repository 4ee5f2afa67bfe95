"""GOSPA with alpha = 2, decomposed into localisation, missed and false objects.

Rahmathullah, Garcia-Fernandez, Svensson, "Generalized optimal sub-pattern assignment metric",
FUSION 2017:

    d = [ min over partial assignments of  sum d_ij^p + c^p/2 (missed + false) ]^(1/p)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.errors import InputError
from pmbm.geometry import centre_distance
from pmbm.metrics.matching import best_matching
from pmbm.metrics.scene import Pairs, Scene

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class GospaSeries:
    """GOSPA of F frames.

    distance (F,) : m.
    localisation, missed, false (F,) : parts of distance^order, m^order.
    missed_count, false_count (F,) : objects without a track nearer than the cutoff, and tracks
        without an object.
    pairs : the assigned pairs.
    """

    distance: FloatArray
    localisation: FloatArray
    missed: FloatArray
    false: FloatArray
    missed_count: IntArray
    false_count: IntArray
    pairs: Pairs


def gospa_series(scene: Scene, cutoff: float = 4.0, order: float = 2.0) -> GospaSeries:
    """GOSPA of every frame of a scene, distances of centres in (x, y).

    cutoff : c > 0, m: an object and a track at least this far apart are one missed and one false.
    order : p >= 1.
    """
    check_cutoff_and_order(cutoff, order)
    pairs = scene.near(cutoff)
    power = pairs.distance**order
    chosen = best_matching(pairs.truth, pairs.track, cutoff**order - power)
    frames = len(scene)
    matched = np.bincount(pairs.frame[chosen], minlength=frames)
    missed_count = scene.truth.count(frames) - matched
    false_count = scene.tracks.count(frames) - matched
    localisation: FloatArray = np.bincount(
        pairs.frame[chosen], power[chosen], minlength=frames
    ).astype(np.float64)
    missed = cutoff**order / 2 * missed_count
    false = cutoff**order / 2 * false_count
    return GospaSeries(
        distance=(localisation + missed + false) ** (1 / order),
        localisation=localisation,
        missed=missed,
        false=false,
        missed_count=missed_count,
        false_count=false_count,
        pairs=pairs.take(chosen),
    )


@dataclass(frozen=True, kw_only=True)
class Gospa:
    """GOSPA of one pair of sets: distance^order = localisation + missed + false.

    distance : m.  localisation, missed, false : m^order.  missed_count, false_count : objects.
    """

    distance: float
    localisation: float
    missed: float
    false: float
    missed_count: int
    false_count: int


def gospa(
    truth: ArrayLike, estimates: ArrayLike, *, cutoff: float = 4.0, order: float = 2.0
) -> Gospa:
    """GOSPA between two sets of points, truth (M,D) and estimates (N,D), in metres.

    cutoff : c > 0, m.  order : p >= 1.  Raises InputError for other values, for coordinates that
    are not finite, and for points of different dimension.
    """
    check_cutoff_and_order(cutoff, order)
    x, y = point_sets(truth, estimates)
    distance = centre_distance(x, y)
    i, j = np.nonzero(distance < cutoff)
    power = distance[i, j] ** order
    chosen = best_matching(i, j, cutoff**order - power)
    missed_count, false_count = len(x) - len(chosen), len(y) - len(chosen)
    localisation = float(power[chosen].sum())
    missed = cutoff**order / 2 * missed_count
    false = cutoff**order / 2 * false_count
    return Gospa(
        distance=(localisation + missed + false) ** (1 / order),
        localisation=localisation,
        missed=missed,
        false=false,
        missed_count=missed_count,
        false_count=false_count,
    )


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
