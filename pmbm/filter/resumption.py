"""Identity through recycling: an object that was given up and is seen again resumes its id.

A Bernoulli that hardly exists is moved into the PPP, and its component remembers whose it was
(`Origin`).  Where a first detection is explained, more than half, by what one track left behind,
it is that track's object again: an identity for the output, which changes no probability.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmbm import compiled
from pmbm.filter.association import Association, Priced
from pmbm.filter.density import Density, Index, Origin
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
    origin = density.undetected.origin
    if origin is not None and len(new):
        resumed = _resumed(density, scan, association, origin, new)
        ids[new] = np.where(resumed == ABSENT, ids[new], resumed)
    return ids


def _resumed(
    density: Density, scan: Scan, association: Association, origin: Origin, new: Index
) -> NDArray[np.int64]:
    """Of each of the measurements `new` (n,), the id that it resumes, or ABSENT."""
    z, log_e = scan.position[new], association.log_e[new]
    r = np.exp(association.log_first - association.log_new)[new]
    if compiled.native is not None:
        priced = association.undetected
        components = *priced.innovation.columns(), priced.log_height, origin.track, origin.share
        return compiled.native.resumed(
            *components, z, log_e, priced.gate, _MOST, r, density.track_id
        )
    track, share = _explained(origin, association.undetected, z, log_e)
    claims = np.flatnonzero((share > _MOST) & ~np.isin(track, density.track_id))
    # The least probable first: of those that claim one id, the last stays.
    order = claims[np.argsort(r[claims] * share[claims], kind="stable")]
    last = len(order) - 1 - np.unique(track[order[::-1]], return_index=True)[1]
    resumed = np.full(len(new), ABSENT, np.int64)
    resumed[order[last]] = track[order[last]]
    return resumed


def _explained(
    origin: Origin, priced: Priced, z: FloatArray, log_e: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Of each of these first detections z (n,2), the recycled track that explains most of it, and
    the share of e, the intensity of first detections there, that comes from it.

    log_e (n,) : of e.
    """
    track, share = np.full(len(z), ABSENT, np.int64), np.zeros(len(z))
    rows = np.flatnonzero(origin.track != ABSENT)
    recycled = Priced(priced.innovation.take(rows), priced.log_height[rows], priced.gate)
    pairs = recycled.pairs(z)
    if not len(pairs.row):
        return track, share
    part = np.exp(pairs.log_weight - log_e[pairs.measurement]) * origin.share[rows[pairs.row]]
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
