"""Identity through recycling: an object that was given up and is seen again resumes its id.

A Bernoulli that hardly exists is moved into the PPP, and its component remembers whose it was
(`Origin`).  Where a first detection is explained, more than half, by what one track left behind,
it is that track's object again: an identity for the output, which changes no probability.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.association import Association, Priced
from pmbm.filter.density import Density, Index
from pmbm.filter.scan import Scan
from pmbm.types import ABSENT, FloatArray

_MOST = 0.5
"""Of a first detection's intensity, that is of one origin: more is that track's object again."""


def ids_of_new(
    density: Density, scan: Scan, association: Association, new: Index
) -> NDArray[np.int64]:
    """(M,) the ids of the tracks that the measurements would start: their running numbers, or, of
    those that start one (`new`), the id of the track whose object they show again.

    An id that is still in the filter's mind is not resumed, and each goes to one measurement: the
    one that it explains most probably.
    """
    ids = density.detections_seen + np.arange(len(scan))
    track, explained = _explained(density, scan, association, new)
    resumes = np.flatnonzero((explained > _MOST) & ~np.isin(track, density.track_id))
    if len(resumes):
        r = np.exp(association.log_first - association.log_new)[new[resumes]]
        # The least probable first: of those that claim one id, the last stays.
        order = resumes[np.argsort(r * explained[resumes], kind="stable")]
        last = len(order) - 1 - np.unique(track[order[::-1]], return_index=True)[1]
        ids[new[order[last]]] = track[order[last]]
    return ids


def _explained(
    density: Density, scan: Scan, association: Association, new: Index
) -> tuple[NDArray[np.int64], FloatArray]:
    """Of each of the measurements `new` (n,), the recycled track that explains most of it, and the
    share of e, the intensity of first detections there, that comes from it."""
    track, share = np.full(len(new), ABSENT, np.int64), np.zeros(len(new))
    origin = density.undetected.origin
    if origin is None or not len(new):
        return track, share
    rows = np.flatnonzero(origin.track != ABSENT)
    z = scan.position[new]
    priced = association.undetected
    recycled = Priced(priced.innovation.take(rows), priced.log_height[rows], priced.gate)
    pairs = recycled.pairs(z)
    if not len(pairs.row):
        return track, share
    log_e = priced.log_density(z)[pairs.measurement]
    part = np.exp(pairs.log_weight - log_e) * origin.share[rows[pairs.row]]
    by_track = np.lexsort((origin.track[rows[pairs.row]], pairs.measurement))
    measurement = pairs.measurement[by_track]
    of_track = origin.track[rows[pairs.row[by_track]]]
    begin = np.flatnonzero(
        (np.diff(measurement, prepend=-1) != 0) | (np.diff(of_track, prepend=ABSENT) != 0)
    )
    part = np.add.reduceat(part[by_track], begin)
    # The largest part of each measurement comes last, and so is what stays written.
    order = np.lexsort((part, measurement[begin]))
    where = measurement[begin[order]]
    track[where], share[where] = of_track[begin[order]], part[order]
    return track, share
