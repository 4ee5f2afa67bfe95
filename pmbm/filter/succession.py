"""Identity through second thoughts: a track that proves to be what another was reported for goes on
under that one's id.

A detection may continue an old track or begin a new one.  Both explanations are kept, as two
Bernoullis that follow the same detections from then on, and the one believed first is reported.
Where the other wins later, nothing was ever reported but one object, and its id must not change:
the two tracks exchange their ids, which changes no probability.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pmbm.filter.density import MISSED, Density, Index
from pmbm.filter.estimation import Marginals
from pmbm.types import FloatArray, IntArray

_TWO = 0.1
"""Tracks that both exist with at least this probability are two objects."""
_SURE = 0.5
"""A track that is there more probably than not and is reported beside its elder is one of its own.
"""


@dataclass(frozen=True, eq=False, slots=True)
class Succession:
    """Which tracks may take over whose id.

    told (N,) : ids of the tracks that have been reported, rising.
    elder : of tracks in doubt, by id, the id of the track that was reported for the first time
        while both followed one detection.
    """

    told: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    elder: Mapping[int, int] = field(default_factory=dict)

    def after(
        self, density: Density, marginal: Marginals, exists: FloatArray, reported: Index
    ) -> tuple[Succession, Density]:
        """With the tracks in these rows reported, and the density with the ids that they go by.

        exists (T,) : probability that each track is an object.  The density keeps at least one
        step of association history.
        """
        density = self._named(density, marginal.existence, reported)
        ids = density.track_id
        elder = {**self.elder, **_elders(density, marginal, reported, self.told)}
        recycled = density.undetected.origin
        known = ids if recycled is None else np.concatenate([ids, recycled.track])
        if elder:
            doubtful = set(known.tolist()) - set(ids[reported[exists[reported] > _SURE]].tolist())
            elder = {one: other for one, other in elder.items() if one in doubtful}
        told = np.union1d(self.told, ids[reported])
        told = told[np.isin(told, known) | np.isin(told, list(elder.values()))]
        return Succession(told, elder), density

    def _named(self, density: Density, existence: FloatArray, reported: Index) -> Density:
        """With the ids of reported tracks exchanged for those of their elders that are reported no
        more, unless both are there."""
        ids = density.track_id
        for row in reported[np.isin(ids[reported], list(self.elder))].tolist():
            heir = int(ids[row])
            elder = self.elder[heir]
            at_least_both = existence[row] + existence[ids == elder].sum() - 1
            if at_least_both < _TWO and elder not in density.track_id[reported]:
                density = _exchanged(density, heir, elder)
        return density


def _elders(
    density: Density, marginal: Marginals, reported: Index, told: IntArray
) -> dict[int, int]:
    """Of tracks never reported, by id, the id of the one that is reported for the first time and
    follows the same detection."""
    ids, taken = density.track_id, density.local.history[marginal.best, -1]
    first = reported[~np.isin(ids[reported], told) & (taken[reported] > MISSED)]
    elder = dict(zip(taken[first].tolist(), ids[first].tolist(), strict=True))
    silent = np.isin(taken, taken[first]) & ~np.isin(ids, told)
    silent[reported] = False
    rows = np.flatnonzero(silent)
    return {int(ids[row]): elder[int(taken[row])] for row in rows.tolist()}


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
