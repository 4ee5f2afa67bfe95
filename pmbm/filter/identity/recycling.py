"""Identity through recycling: an object that was given up and is seen again resumes its id.

A Bernoulli that hardly exists is moved into the PPP, and its component remembers whose it was
(`RecycledFrom`).  Where a first detection is explained, more than half, by what one track left
behind, it is that track's object again: an identity for the output, which changes no probability.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.association import Association
from pmbm.filter.density import Density, Index, RecycledFrom
from pmbm.filter.hypotheses.gating import FirstDetectionDensity
from pmbm.filter.hypotheses.gaussian import Innovation
from pmbm.filter.hypotheses.radar_pairs import UpdatedPairs
from pmbm.filter.scan import Scan
from pmbm.kernels import twin
from pmbm.types import ABSENT, FloatArray

MOST_OF_ONE = 0.5
"""Share of a first detection's intensity from which on it is the object of the one track that the
share was recycled from."""


def ids_of_new(
    density: Density, scan: Scan, association: Association, new: Index
) -> NDArray[np.int64]:
    """(M,) the ids of the tracks that the measurements would start: their running numbers, or, of
    those that start one (`new`), the id of the track whose object they show again.

    An id that is still in the filter's mind is not resumed, and each goes to one measurement: the
    one that it explains most probably.
    """
    ids = density.detections_seen + np.arange(len(scan))
    recycled = density.undetected.recycled_from
    if recycled is not None and len(new):
        resumed = _resumed(density, scan, association, recycled, new)
        ids[new] = np.where(resumed == ABSENT, ids[new], resumed)
    return ids


def _resumed(
    density: Density, scan: Scan, association: Association, recycled: RecycledFrom, new: Index
) -> NDArray[np.int64]:
    """Of each of the measurements `new` (n,), the id that it resumes, or ABSENT."""
    first = association.undetected
    if isinstance(first, UpdatedPairs):
        return _resumed_by_radar(density, association, first, recycled, new)
    r = np.exp(association.log_birth_evidence - association.log_new)[new]
    return _resume(
        *first.innovation.columns(),
        first.log_height,
        recycled.track,
        recycled.share,
        scan.position[new],
        association.log_e[new],
        first.gate,
        MOST_OF_ONE,
        r,
        density.track_id,
    )


def _resumed_by_radar(
    density: Density,
    association: Association,
    first: UpdatedPairs,
    recycled: RecycledFrom,
    new: Index,
) -> NDArray[np.int64]:
    """`_resumed` where the pairs of undetected objects and measurements are worked out already."""
    place = np.full(len(association.log_e), -1, np.intp)
    place[new] = np.arange(len(new))
    pairs = first.take(
        np.flatnonzero((place[first.measurement] >= 0) & (recycled.track[first.row] != ABSENT))
    )
    track, share = _explained(
        recycled.track[pairs.row],
        place[pairs.measurement],
        pairs.log_weight - association.log_e[pairs.measurement],
        recycled.share[pairs.row],
        len(new),
    )
    r = np.exp(association.log_birth_evidence - association.log_new)[new]
    return _claimed(track, share, r, density.track_id, MOST_OF_ONE)


@twin("resumed")
def _resume(
    expected: FloatArray,
    l11: FloatArray,
    l21: FloatArray,
    l22: FloatArray,
    log_height: FloatArray,
    recycled_track: NDArray[np.int64],
    recycled_share: FloatArray,
    z: FloatArray,
    log_e: FloatArray,
    threshold: float,
    most: float,
    r: FloatArray,
    known: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Of first detections z (n,2) with existence r (n,), the ids that they resume, or ABSENT; those
    in `known` (T,) are not resumed."""
    density = FirstDetectionDensity(Innovation(expected, l11, l21, l22), log_height, threshold)
    rows = np.flatnonzero(recycled_track != ABSENT)
    left_behind = FirstDetectionDensity(
        density.innovation.take(rows), density.log_height[rows], density.gate
    )
    pairs = left_behind.pairs(z)
    track, share = _explained(
        recycled_track[rows[pairs.row]],
        pairs.measurement,
        pairs.log_weight - log_e[pairs.measurement],
        recycled_share[rows[pairs.row]],
        len(z),
    )
    return _claimed(track, share, r, known, most)


def _claimed(
    track: NDArray[np.int64],
    share: FloatArray,
    r: FloatArray,
    known: NDArray[np.int64],
    most: float,
) -> NDArray[np.int64]:
    """The ids (n,) that first detections resume, or ABSENT, of the recycled tracks that explain
    most of each and their shares in it."""
    claims = np.flatnonzero((share > most) & ~np.isin(track, known))
    # The least probable first: of those that claim one id, the last stays.
    order = claims[np.argsort(r[claims] * share[claims], kind="stable")]
    last = len(order) - 1 - np.unique(track[order[::-1]], return_index=True)[1]
    resumed = np.full(len(track), ABSENT, np.int64)
    resumed[order[last]] = track[order[last]]
    return resumed


def _explained(
    recycled: NDArray[np.int64],
    measurement_of: Index,
    log_share: FloatArray,
    part_of: FloatArray,
    measurements: int,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Of each of these first detections (n,), the recycled track that explains most of it, and
    the share of e, the intensity of first detections there, that comes from it.

    Of pairs of a recycled component and a first detection: recycled (p,), part_of (p,) : track and
    share of `RecycledFrom`; measurement_of (p,); log_share (p,) : log of the pair's share of e.
    """
    track, share = np.full(measurements, ABSENT, np.int64), np.zeros(measurements)
    if not len(recycled):
        return track, share
    part = np.exp(log_share) * part_of
    by_track = np.lexsort((recycled, measurement_of))
    measurement, of_track = measurement_of[by_track], recycled[by_track]
    begin = np.flatnonzero(
        (np.diff(measurement, prepend=-1) != 0) | (np.diff(of_track, prepend=ABSENT) != 0)
    )
    part = np.add.reduceat(part[by_track], begin)
    # The largest part of each measurement comes last, and so is what stays written.
    order = np.lexsort((part, measurement[begin]))
    where = measurement[begin[order]]
    track[where], share[where] = of_track[begin[order]], part[order]
    return track, share
