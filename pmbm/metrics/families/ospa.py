"""OSPA: the miss-distance of two sets, per object.

Schuhmacher, Vo, Vo, "A consistent metric for performance evaluation of multi-object filters",
IEEE TSP 56(8), 2008.  With N the larger of the two sizes M and K,

    d = [ ( min over assignments of  sum min(d_ij, c)^p + c^p |M - K| ) / N ]^(1/p)

The assignment minimises the p-th powers of the cut distances.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from pmbm.arrays import FloatArray
from pmbm.geometry import centre_distance
from pmbm.intervals import Scale
from pmbm.metrics.core.family import Family, Tally, Work, per_frame
from pmbm.metrics.core.formulas import Means
from pmbm.metrics.core.matching import best_matching
from pmbm.metrics.core.parameters import MetricParameters
from pmbm.metrics.core.points import check_cutoff_and_order, point_sets
from pmbm.metrics.core.scene import ScoredScene


@dataclass(frozen=True, eq=False, kw_only=True)
class OspaSeries:
    """OSPA of F frames, m: distance^order = localisation^order + cardinality^order.

    distance, localisation, cardinality (F,).
    """

    distance: FloatArray
    localisation: FloatArray
    cardinality: FloatArray


def ospa_series(scene: ScoredScene, cutoff: float = 10.0, order: float = 2.0) -> OspaSeries:
    """OSPA of every frame of a scene, distances of centres in (x, y).

    cutoff : c > 0, m.  order : p >= 1, finite.
    """
    check_cutoff_and_order(cutoff, order)
    pairs = scene.near(cutoff)
    power = pairs.distance**order
    # Full assignments of distances cut at c, and partial ones of pairs nearer than c, have the
    # same optimum: whoever is left over pairs up at c.
    chosen = best_matching(pairs.truth, pairs.track, cutoff**order - power)
    frames = len(scene)
    matched = np.bincount(pairs.frame[chosen], minlength=frames)
    near = np.bincount(pairs.frame[chosen], power[chosen], minlength=frames)
    m, n = scene.truth.count(frames), scene.tracks.count(frames)
    size = np.maximum(np.maximum(m, n), 1)
    localisation = (near + cutoff**order * (np.minimum(m, n) - matched)) / size
    cardinality = cutoff**order * np.abs(m - n) / size
    return OspaSeries(
        distance=(localisation + cardinality) ** (1 / order),
        localisation=localisation ** (1 / order),
        cardinality=cardinality ** (1 / order),
    )


@dataclass(frozen=True, kw_only=True)
class Ospa:
    """OSPA of one pair of sets, m: distance^order = localisation^order + cardinality^order."""

    distance: float
    localisation: float
    cardinality: float


def ospa(
    truth: ArrayLike, estimates: ArrayLike, *, cutoff: float = 10.0, order: float = 2.0
) -> Ospa:
    """OSPA between two sets of points, truth (M,D) and estimates (N,D), in metres.

    cutoff : c > 0, m.  order : p >= 1; infinity is the bottleneck distance, where localisation is
    the whole for sets of equal size and cardinality the whole otherwise.  Raises InputError for
    other values, for coordinates that are not finite, and for points of different dimension.
    """
    bottleneck = order == np.inf
    check_cutoff_and_order(cutoff, 1.0 if bottleneck else order)
    x, y = point_sets(truth, estimates)
    m, n = len(x), len(y)
    cut = np.minimum(centre_distance(x, y), cutoff)
    if bottleneck:
        localisation = _bottleneck(cut) if m == n else 0.0
        cardinality = cutoff if m != n else 0.0
        return Ospa(
            distance=max(localisation, cardinality),
            localisation=localisation,
            cardinality=cardinality,
        )
    size = max(m, n, 1)
    i, j = np.nonzero(cut < cutoff)
    benefit = cutoff**order - cut[i, j] ** order
    chosen = best_matching(i, j, benefit)
    near = float((cut[i, j][chosen] ** order).sum())
    localisation = (near + cutoff**order * (min(m, n) - len(chosen))) / size
    cardinality = cutoff**order * abs(m - n) / size
    return Ospa(
        distance=(localisation + cardinality) ** (1 / order),
        localisation=localisation ** (1 / order),
        cardinality=cardinality ** (1 / order),
    )


def _bottleneck(cost: FloatArray) -> float:
    """The smallest possible largest cost of a perfect matching, cost (N,N)."""
    if cost.size == 0:
        return 0.0
    levels = np.unique(cost)
    low, high = 0, len(levels) - 1
    while low < high:
        middle = (low + high) // 2
        graph = csr_array((cost <= levels[middle]).astype(np.int8))
        if (maximum_bipartite_matching(graph) >= 0).all():
            high = middle
        else:
            low = middle + 1
    return float(levels[low])


def _count(work: Work) -> Tally:
    p = work.parameters
    result = ospa_series(work.scene, p.ospa_cutoff, p.ospa_order)
    return Tally.of_frames(vars(result), cutoff=p.ospa_cutoff, order=p.ospa_order, distance="xy")


OSPA_BOUNDS: Final = Scale(0.0, MetricParameters().ospa_cutoff)

FAMILY: Final = Family(
    name="ospa",
    rule="OSPA and its parts, mean over frames",
    count=_count,
    metrics=(
        per_frame(
            name="ospa",
            unit="m",
            series="distance",
            bounds=OSPA_BOUNDS,
            question="How far off is the picture, per object?",
            parts=Means(("localisation", "cardinality"), "frames"),
        ),
        per_frame(
            name="ospa_localisation",
            unit="m",
            series="localisation",
            bounds=OSPA_BOUNDS,
            question="How much of OSPA is misplacement?",
        ),
        per_frame(
            name="ospa_cardinality",
            unit="m",
            series="cardinality",
            bounds=OSPA_BOUNDS,
            question="How much of OSPA is a wrong number of objects?",
        ),
    ),
)
