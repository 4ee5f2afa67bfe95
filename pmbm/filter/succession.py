"""Identity through second thoughts: a track that proves to be what another was reported for goes on
under that one's id.

A detection may continue an old track or begin a new one.  Both explanations are kept, as two
Bernoullis that follow the same detections from then on, and the one believed first is reported.
Where the other wins later, nothing was ever reported but one object, and its id must not change:
the two tracks exchange their ids, which changes no probability.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pmbm.filter.density import MISSED, Density, Index
from pmbm.filter.estimation import Marginals
from pmbm.types import ABSENT, BoolArray, FloatArray, IntArray

_TWO = 0.1
"""Tracks that both exist with at least this probability are two objects."""
_SURE = 0.5
"""A track reported beside its elder, and there more probably than not, is an object of its own."""
_FORGOTTEN = 64
"""Ids of tracks that are no more, beyond as many as there are tracks, that are kept for a while."""


@dataclass(frozen=True, eq=False, slots=True)
class Succession:
    """Which tracks may take over whose id.

    told (N,) : ids of the tracks that have been reported, rising.
    heir (D,) : ids of tracks in doubt, rising.  elder (D,) : of each, the id of the track that was
        reported for the first time while both followed one detection.
    """

    told: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    heir: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    elder: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))

    def after(
        self, density: Density, marginal: Marginals, exists: FloatArray, reported: Index
    ) -> tuple[Succession, Density]:
        """With the tracks in these rows reported, and the density with the ids that they go by.

        exists (T,) : probability that each track is an object.  The density keeps at least one
        step of association history.
        """
        told, heir, elder = self.told, self.heir, self.elder
        ids = density.track_id[reported]
        if len(heir) and _among(ids, heir).any():
            density = self._named(density, marginal.existence, reported)
            ids = density.track_id[reported]
            doubtful = ~np.isin(heir, ids[exists[reported] > _SURE])
            heir, elder = heir[doubtful], elder[doubtful]
        first = ~_among(ids, told)
        if not first.any():
            return (self if heir is self.heir else Succession(told, heir, elder)), density
        also, theirs = _heirs(density, marginal, reported, first, told)
        if len(also):
            # Of two elders the later one counts.
            heir, row = np.unique(np.concatenate([also, heir]), return_index=True)
            elder = np.concatenate([theirs, elder])[row]
        told = np.sort(np.concatenate([told, ids[first]]))
        if len(told) + len(heir) > _FORGOTTEN + 2 * len(density.track_id):
            known = _known(density)
            heir, elder = heir[np.isin(heir, known)], elder[np.isin(heir, known)]
            told = told[np.isin(told, known) | np.isin(told, elder)]
        return Succession(told, heir, elder), density

    def _named(self, density: Density, existence: FloatArray, reported: Index) -> Density:
        """With the ids of reported tracks exchanged for those of their elders that are reported no
        more, unless both are there."""
        for row in reported[_among(density.track_id[reported], self.heir)].tolist():
            ids = density.track_id
            elder = self.elder[np.searchsorted(self.heir, ids[row])]
            at_least_both = existence[row] + existence[ids == elder].sum() - 1
            if at_least_both < _TWO and elder not in ids[reported]:
                density = _exchanged(density, int(ids[row]), int(elder))
        return density


def _among(ids: IntArray, rising: IntArray) -> BoolArray:
    """(n,) whether each id is one of these, which rise."""
    if not len(rising):
        return np.zeros(len(ids), bool)
    found: BoolArray = rising.take(rising.searchsorted(ids), mode="clip") == ids
    return found


def _heirs(
    density: Density, marginal: Marginals, reported: Index, first: BoolArray, told: IntArray
) -> tuple[IntArray, IntArray]:
    """Ids of tracks never reported, and of the reported one, `first` so, that follows the same
    detection."""
    ids, taken = density.track_id, density.local.history[marginal.best, -1]
    new = reported[first]
    new = new[taken[new] > MISSED]
    follows = np.full(int(taken.max(initial=0)) + 1, ABSENT, np.int64)
    follows[taken[new]] = ids[new]
    silent = (taken > MISSED) & ~_among(ids, told)
    silent[reported] = False
    row = np.flatnonzero(silent)
    row = row[follows[taken[row]] != ABSENT]
    return ids[row], follows[taken[row]]


def _known(density: Density) -> IntArray:
    """Ids of the tracks that are followed, and of those that were given up and may be resumed."""
    recycled = density.undetected.origin
    if recycled is None:
        return density.track_id
    return np.concatenate([density.track_id, recycled.track])


def _exchanged(density: Density, one: int, other: int) -> Density:
    """With the ids of two tracks exchanged, also where one was recycled."""

    def exchanged(ids: IntArray) -> IntArray:
        swapped: IntArray = np.select([ids == one, ids == other], [other, one], ids)
        return swapped

    undetected = density.undetected
    if undetected.origin is not None:
        origin = replace(undetected.origin, track=exchanged(undetected.origin.track))
        undetected = replace(undetected, origin=origin)
    return replace(density, undetected=undetected, track_id=exchanged(density.track_id))
