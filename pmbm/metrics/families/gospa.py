"""GOSPA with alpha = 2, decomposed into localisation, missed and false objects.

Rahmathullah, Garcia-Fernandez, Svensson, "Generalized optimal sub-pattern assignment metric",
FUSION 2017:

    d = [ min over partial assignments of  sum d_ij^p + c^p/2 (missed + false) ]^(1/p)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pmbm.arrays import FloatArray, IntArray
from pmbm.geometry import centre_distance
from pmbm.metrics.core.family import Family, Tally, Work, per_frame
from pmbm.metrics.core.formulas import Means
from pmbm.metrics.core.matching import best_matching
from pmbm.metrics.core.points import check_cutoff_and_order, point_sets
from pmbm.metrics.core.scene import NearPairs, ScoredScene


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
    pairs: NearPairs


def gospa_series(scene: ScoredScene, cutoff: float = 4.0, order: float = 2.0) -> GospaSeries:
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


def _count(work: Work) -> Tally:
    p = work.parameters
    result = gospa_series(work.scene, p.gospa_cutoff, p.gospa_order)
    series = {key: value for key, value in vars(result).items() if key != "pairs"}
    return Tally.of_frames(
        series, cutoff=p.gospa_cutoff, order=p.gospa_order, alpha=2.0, distance="xy"
    )


FAMILY: Final = Family(
    name="gospa",
    rule="GOSPA and its parts, mean over frames",
    count=_count,
    metrics=(
        per_frame(
            name="gospa",
            unit="m",
            series="distance",
            question="How far is the picture from the truth, all errors in one number?",
            parts=Means(
                ("localisation", "missed", "false", "missed_count", "false_count"), "frames"
            ),
        ),
        per_frame(
            name="gospa_localisation",
            unit="m^p",
            series="localisation",
            question="How much of GOSPA^p is misplacement?",
        ),
        per_frame(
            name="gospa_missed",
            unit="m^p",
            series="missed",
            question="How much of GOSPA^p is missed objects?",
        ),
        per_frame(
            name="gospa_false",
            unit="m^p",
            series="false",
            question="How much of GOSPA^p is false tracks?",
        ),
    ),
)
