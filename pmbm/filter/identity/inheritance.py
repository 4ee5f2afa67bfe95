"""Inheritance of ids: the track that proves to explain what was reported takes over its id.

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
from pmbm.kernels import twin
from pmbm.types import ABSENT, BoolArray, FloatArray, IntArray

_TWO = 0.1
"""Tracks that both exist with at least this probability are two objects."""
_SURE = 0.5
"""A candidate reported beside the track whose id it might inherit, and there more probably than
not, is an object of its own."""
_FORGOTTEN = 64
"""Ids of tracks that are no more, beyond as many as there are tracks, that are kept for a while."""


@dataclass(frozen=True, eq=False, slots=True)
class IdInheritance:
    """The ids that tracks may take over from reported ones.

    reported_ids (N,) : ids of the tracks that have been reported, rising.
    candidate (D,) : ids of tracks that may inherit one, rising.
    reported_as (D,) : of each candidate, the id of the track that was reported for the first time
        while both followed one detection.
    """

    reported_ids: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    candidate: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    reported_as: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))

    def after(
        self, density: Density, marginal: Marginals, exists: FloatArray, reported: Index
    ) -> tuple[IdInheritance, Density]:
        """With the tracks in these rows reported, and the density with the ids that they go by.

        exists (T,) : probability that each track is an object.  The density keeps at least one
        step of association history.
        """
        reported_ids, candidate, reported_as = self.reported_ids, self.candidate, self.reported_as
        ids = density.track_id[reported]
        if _known_as_they_are(ids, reported_ids, candidate):
            return self, density
        if len(candidate) and _among(ids, candidate).any():
            density = self._named(density, marginal.existence, reported)
            ids = density.track_id[reported]
            doubtful = ~np.isin(candidate, ids[exists[reported] > _SURE])
            candidate, reported_as = candidate[doubtful], reported_as[doubtful]
        first = ~_among(ids, reported_ids)
        if not first.any():
            return (
                self
                if candidate is self.candidate
                else IdInheritance(reported_ids, candidate, reported_as)
            ), density
        also, theirs = _candidates(density, marginal, reported, first, reported_ids)
        if len(also):
            # Of two reported tracks the later one counts.
            candidate, row = np.unique(np.concatenate([also, candidate]), return_index=True)
            reported_as = np.concatenate([theirs, reported_as])[row]
        reported_ids = np.sort(np.concatenate([reported_ids, ids[first]]))
        if len(reported_ids) + len(candidate) > _FORGOTTEN + 2 * len(density.track_id):
            known = _known(density)
            candidate, reported_as = (
                candidate[np.isin(candidate, known)],
                reported_as[np.isin(candidate, known)],
            )
            reported_ids = reported_ids[
                np.isin(reported_ids, known) | np.isin(reported_ids, reported_as)
            ]
        return IdInheritance(reported_ids, candidate, reported_as), density

    def _named(self, density: Density, existence: FloatArray, reported: Index) -> Density:
        """Let candidates that are reported inherit the ids of tracks that are reported no more,
        unless both are there."""
        ids = density.track_id
        asking = reported[_among(ids[reported], self.candidate)]
        own_ids = ids[asking]
        wanted = self.reported_as[self.candidate.searchsorted(own_ids)]
        # Of all tracks, those that may exchange their ids.
        theirs = np.flatnonzero(_among(ids, np.sort(wanted)))
        names = dict(zip(asking.tolist(), own_ids.tolist(), strict=True))
        row_of = dict(zip(ids[theirs].tolist(), theirs.tolist(), strict=True))
        shown = {*own_ids.tolist(), *wanted[_among(wanted, np.sort(ids[reported]))].tolist()}
        heirs = dict(zip(own_ids.tolist(), wanted.tolist(), strict=True))
        renamed = _Exchanges()
        for row in asking.tolist():
            own = names[row]
            reported_as = heirs.get(own)
            if reported_as is None or reported_as in shown:
                continue
            other = row_of.get(reported_as)
            at_least_both = existence[row] + (0.0 if other is None else existence[other]) - 1
            if at_least_both >= _TWO:
                continue
            names[row], row_of[reported_as] = reported_as, row
            if other is not None:
                names[other], row_of[own] = own, other
            shown.symmetric_difference_update((own, reported_as))
            renamed.exchange(own, reported_as)
        return renamed.of(density)


@twin("known_as_they_are")
def _known_as_they_are(ids: IntArray, reported_ids: IntArray, candidate: IntArray) -> bool:
    """Whether tracks of these ids (n,) have all been reported, and none may inherit another."""
    return bool(_among(ids, reported_ids).all()) and not _among(ids, candidate).any()


def _among(ids: IntArray, rising: IntArray) -> BoolArray:
    """(n,) whether each id is one of these, which rise."""
    if not len(rising):
        return np.zeros(len(ids), bool)
    found: BoolArray = rising.take(rising.searchsorted(ids), mode="clip") == ids
    return found


def _candidates(
    density: Density, marginal: Marginals, reported: Index, first: BoolArray, reported_ids: IntArray
) -> tuple[IntArray, IntArray]:
    """Ids of tracks never reported, and of the reported one, `first` so, that follows the same
    detection."""
    ids, taken = density.track_id, density.local.history[marginal.best, -1]
    new = reported[first]
    new = new[taken[new] > MISSED]
    follows = np.full(int(taken.max(initial=0)) + 1, ABSENT, np.int64)
    follows[taken[new]] = ids[new]
    silent = (taken > MISSED) & ~_among(ids, reported_ids)
    silent[reported] = False
    row = np.flatnonzero(silent)
    row = row[follows[taken[row]] != ABSENT]
    return ids[row], follows[taken[row]]


def _known(density: Density) -> IntArray:
    """Ids of the tracks that are followed, and of those that were given up and may be resumed."""
    recycled = density.undetected.recycled_from
    if recycled is None:
        return density.track_id
    return np.concatenate([density.track_id, recycled.track])


class _Exchanges:
    """Ids that are exchanged two by two, one exchange after the other."""

    def __init__(self) -> None:
        self.after: dict[int, int] = {}
        self.before: dict[int, int] = {}

    def exchange(self, one: int, other: int) -> None:
        first, second = self.before.get(one, one), self.before.get(other, other)
        self.after |= {first: other, second: one}
        self.before |= {other: first, one: second}

    def of(self, density: Density) -> Density:
        """With the ids of its tracks exchanged, also where one was recycled."""
        if not self.after:
            return density
        undetected = density.undetected
        if undetected.recycled_from is not None:
            recycled_from = replace(
                undetected.recycled_from, track=self._ids(undetected.recycled_from.track)
            )
            undetected = replace(undetected, recycled_from=recycled_from)
        return replace(density, undetected=undetected, track_id=self._ids(density.track_id))

    def _ids(self, ids: IntArray) -> IntArray:
        old = np.array(sorted(self.after))
        new = np.array([self.after[one] for one in old.tolist()])
        at = np.searchsorted(old, ids).clip(max=len(old) - 1)
        exchanged: IntArray = np.where(old[at] == ids, new[at], ids)
        return exchanged
