"""Matching of objects and tracks frame by frame, by the standard CLEAR rule.

Bernardin, Stiefelhagen, "Evaluating multiple object tracking performance: the CLEAR MOT metrics",
EURASIP JIVP 2008.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.errors import InputError
from pmbm.metrics.core.matching import most_then_nearest
from pmbm.metrics.core.scene import NearPairs, ScoredScene


@dataclass(frozen=True, eq=False, kw_only=True)
class Matches:
    """The matched pairs of a run, sorted by frame, then truth row.

    frame, truth, track (A,) : the frame, and rows of the scene's truth and tracks.
    distance (A,) : between centres, m.
    switch (A,) : the track's id differs from that of the object's last match.
    """

    frame: IntArray
    truth: IntArray
    track: IntArray
    distance: FloatArray
    switch: BoolArray

    def __len__(self) -> int:
        return len(self.frame)


def clear_matches(scene: ScoredScene, gate: float = 2.0) -> Matches:
    """Match objects and tracks by the standard CLEAR rule.

    In each frame an object keeps the track of its last match, however long ago, while that track
    is inside the gate; where two objects remember one track the lower object id keeps it.  The
    rest is assigned anew: the largest number of pairs, then the least total distance.

    gate : pairs strictly nearer than this, between centres in (x, y, z), m, may match.
    """
    if not 0 < gate < np.inf:
        raise InputError("bad gate", field="gate", expected="above 0 m", got=gate)
    return continuing_matches(scene, gated_pairs(scene, gate))


def gated_pairs(scene: ScoredScene, gate: float) -> NearPairs:
    """The pairs strictly nearer than `gate` between centres in (x, y, z), m."""
    near = scene.near(gate)
    return near.take(near.distance_xyz < gate)


def continuing_matches(
    scene: ScoredScene, gated: NearPairs, distance: FloatArray | None = None
) -> Matches:
    """`clear_matches` with any gate and any distance.

    gated : the pairs that may match.
    distance (G,) : of these; between centres in (x, y, z) unless given.
    """
    cost = gated.distance_xyz if distance is None else distance
    chosen = _continue_tracks(scene, gated, cost)
    return matches_of(scene, gated.take(chosen), cost[chosen])


def matches_of(scene: ScoredScene, pairs: NearPairs, distance: FloatArray) -> Matches:
    """These pairs as matches, with the identity switches among them."""
    truth_id, track_id = scene.truth.index[pairs.truth], scene.tracks.index[pairs.track]
    order = np.lexsort((pairs.frame, truth_id))
    again = truth_id[order][1:] == truth_id[order][:-1]
    other = track_id[order][1:] != track_id[order][:-1]
    switch = np.zeros(len(pairs), np.bool_)
    switch[order[1:]] = again & other
    return Matches(
        frame=pairs.frame,
        truth=pairs.truth,
        track=pairs.track,
        distance=distance,
        switch=switch,
    )


def _continue_tracks(scene: ScoredScene, gated: NearPairs, cost: FloatArray) -> IntArray:
    """The chosen rows of `gated`: last matches first, the rest by the best assignment."""
    truth_id = scene.truth.index[gated.truth].tolist()
    track_id = scene.tracks.index[gated.track].tolist()
    cuts = np.searchsorted(gated.frame, np.arange(len(scene) + 1)).tolist()
    last: dict[int, int] = {}
    chosen: list[int] = []
    for begin, end in itertools.pairwise(cuts):
        taken_truth: set[int] = set()
        taken_track: set[int] = set()
        for pair in range(begin, end):
            i, j = truth_id[pair], track_id[pair]
            if last.get(i) == j and j not in taken_track:
                taken_truth.add(i)
                taken_track.add(j)
                chosen.append(pair)
        rest = [
            pair
            for pair in range(begin, end)
            if truth_id[pair] not in taken_truth and track_id[pair] not in taken_track
        ]
        if not rest:
            continue
        new = rest
        if len(rest) > 1:
            rows = np.array(rest)
            new = rows[most_then_nearest(gated.truth[rows], gated.track[rows], cost[rows])].tolist()
        for pair in new:
            last[truth_id[pair]] = track_id[pair]
        chosen.extend(new)
    return np.sort(np.array(chosen, dtype=np.int64))
