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
from pmbm.filter.scan import Scan
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
    if recycled is None:
        return ids
    resumed = _resumed(density, association, recycled, new)
    return np.where(resumed == ABSENT, ids, resumed)


def _resumed(
    density: Density, association: Association, recycled: RecycledFrom, new: Index
) -> NDArray[np.int64]:
    """(M,) the id that each measurement resumes, or ABSENT; only those of `new` (n,) do."""
    pairs = association.undetected
    pairs = pairs.take(
        np.flatnonzero(np.isin(pairs.measurement, new) & (recycled.track[pairs.row] != ABSENT))
    )
    track, share = _explained(
        recycled.track[pairs.row],
        pairs.measurement,
        pairs.log_weight - association.log_e[pairs.measurement],
        recycled.share[pairs.row],
        len(association.log_e),
    )
    r = np.exp(association.log_birth_evidence - association.log_new)
    claims = np.flatnonzero((share > MOST_OF_ONE) & ~np.isin(track, density.track_id))
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
