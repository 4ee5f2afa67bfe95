"""SIAP attributes: completeness, ambiguity, spuriousness, accuracy, continuity.

Votruba, Nisley, Rothrock, Zombro, "Single integrated air picture (SIAP) metrics implementation",
2001; which track follows which object is decided as in the Stone Soup library: every track follows
the nearest object inside the gate, so one object may have several tracks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from pmbm.arrays import FloatArray, IntArray
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import NO_MATCH, NO_TRACKS, NO_TRUTH, Ratio
from pmbm.metrics.core.result import Metric
from pmbm.metrics.core.scene import ScoredScene


@dataclass(frozen=True, kw_only=True)
class SiapAssociation:
    """A track id follows an object id from the first to the last frame, both included."""

    truth: int
    track: int
    first: int
    last: int


@dataclass(frozen=True, kw_only=True)
class SiapCounts:
    """The counts whose ratios are the attributes.

    truths, tracks : rows.  tracked : truth rows with an associated track.
    associated : track rows with an associated object.
    position_error, velocity_error : sums over associated rows, m and m/s.
    track_changes : over objects, the sum of tracks needed to cover them, less one each.
    time_tracked, lifetime : sums over objects, s.
    longest_segment : sum over objects of the longest time of one track with it, s.
    """

    truths: int
    tracks: int
    tracked: int
    associated: int
    position_error: float
    velocity_error: float
    track_changes: int
    time_tracked: float
    longest_segment: float
    lifetime: float


def siap_associations(
    scene: ScoredScene, *, gate: float = 2.0, confirm: int = 1, end: int = 1
) -> tuple[SiapAssociation, ...]:
    """The object that each track follows in each frame.

    gate : only objects strictly nearer than this in (x, y), m, are followed.
    confirm : consecutive reports with the same nearest object that begin an association.
    end : consecutive reports with another or no nearest object that end it; it then lasts to the
        last report that agreed.
    """
    nearest = _nearest_truth(scene, gate)
    tracks = scene.tracks
    found: list[SiapAssociation] = []
    for rows in np.split(
        tracks.by_object, np.flatnonzero(np.diff(tracks.index[tracks.by_object])) + 1
    ):
        if len(rows):
            spells = _spells(nearest[rows].tolist(), confirm, end)
            found.extend(
                SiapAssociation(
                    truth=int(scene.truth.ids[followed]),
                    track=int(tracks.id[rows[0]]),
                    first=int(tracks.frame[rows[first]]),
                    last=int(tracks.frame[rows[last]]),
                )
                for followed, first, last in spells
            )
    return tuple(sorted(found, key=lambda a: (a.truth, a.track, a.first)))


def siap_counts(scene: ScoredScene, associations: Sequence[SiapAssociation]) -> SiapCounts:
    """Count under these associations; a frame in which either side is absent holds no pair."""
    truth_row = _row_table(scene.truth.frame, scene.truth.index, len(scene.truth.ids), len(scene))
    track_row = _row_table(
        scene.tracks.frame, scene.tracks.index, len(scene.tracks.ids), len(scene)
    )
    tracked = np.zeros(len(scene.truth), np.bool_)
    associated = np.zeros(len(scene.tracks), np.bool_)
    by_truth: dict[int, list[SiapAssociation]] = {}
    position_error = velocity_error = 0.0
    for association in associations:
        i = int(np.searchsorted(scene.truth.ids, association.truth))
        j = int(np.searchsorted(scene.tracks.ids, association.track))
        by_truth.setdefault(i, []).append(association)
        spell = slice(association.first, association.last + 1)
        a, b = truth_row[i, spell], track_row[j, spell]
        tracked[a[a >= 0]] = True
        associated[b[b >= 0]] = True
        both = (a >= 0) & (b >= 0)
        a, b = a[both], b[both]
        offset = scene.tracks.position[b, :2] - scene.truth.position[a, :2]
        position_error += float(np.hypot(offset[:, 0], offset[:, 1]).sum())
        drift = scene.tracks.velocity[b] - scene.truth.velocity[a]
        velocity_error += float(np.hypot(drift[:, 0], drift[:, 1]).sum())

    changes = 0
    time_tracked = longest = lifetime = 0.0
    for i in range(len(scene.truth.ids)):
        there = np.flatnonzero(truth_row[i] >= 0)
        own = by_truth.get(i, [])
        changes += max(_tracks_needed(there, own) - 1, 0)
        time_tracked += _time_tracked(scene.time, there, own)
        longest += _longest_segment(scene.time, own)
        lifetime += float(scene.time[there[-1]] - scene.time[there[0]])
    return SiapCounts(
        truths=len(scene.truth),
        tracks=len(scene.tracks),
        tracked=int(tracked.sum()),
        associated=int(associated.sum()),
        position_error=position_error,
        velocity_error=velocity_error,
        track_changes=changes,
        time_tracked=time_tracked,
        longest_segment=longest,
        lifetime=lifetime,
    )


def _nearest_truth(scene: ScoredScene, gate: float) -> IntArray:
    """The place of the nearest object's id for each track row, or -1; the lower id of equals."""
    pairs = scene.near(gate)
    order = np.lexsort((pairs.truth, pairs.distance, pairs.track))
    first = order[np.unique(pairs.track[order], return_index=True)[1]]
    nearest = np.full(len(scene.tracks), -1)
    nearest[pairs.track[first]] = scene.truth.index[pairs.truth[first]]
    return nearest


def _spells(nearest: list[int], confirm: int, end: int) -> list[tuple[int, int, int]]:
    """(object, first, last) of one track's associations, from its nearest object (-1 none) at
    each report.

    Quirks of Stone Soup's associator kept: agreement with the current object in between does not
    restart the count of a rival, so the rival's association may begin before the current one
    ends; and an object that takes over at once inherits the count of failures, so its own first
    failure ends it.
    """
    spells = []
    current = rival = -1
    agreed = failed = 0
    start = last = rival_start = 0
    for report, seen in enumerate(nearest):
        if current >= 0 and seen == current:
            failed, last = 0, report
            continue
        if seen >= 0 and seen == rival:
            agreed += 1
        else:
            rival, rival_start, agreed = seen, report, int(seen >= 0)
        if current >= 0:
            failed += 1
            if failed < end:
                continue
            spells.append((current, start, last))
            current = -1
            if agreed >= confirm:
                current, start, last = rival, rival_start, report
        elif agreed >= confirm:
            current, start, last = rival, rival_start, report
            rival, agreed = -1, 0
    if current >= 0:
        spells.append((current, start, last))
    return spells


def _row_table(frame: IntArray, index: IntArray, ids: int, frames: int) -> IntArray:
    """The row of each id in each frame (I,F), -1 where absent."""
    table = np.full((ids, frames), -1)
    table[index, frame] = np.arange(len(frame))
    return table


def _tracks_needed(there: IntArray, own: Sequence[SiapAssociation]) -> int:
    """The fewest associations that cover the object wherever any does: from each uncovered frame
    on, the one that lasts longest."""
    needed, done = 0, -1
    for frame in there:
        if frame > done:
            reach = [a.last for a in own if a.first <= frame <= a.last]
            if reach:
                needed, done = needed + 1, max(reach)
    return needed


def _longest_segment(time: FloatArray, own: Sequence[SiapAssociation]) -> float:
    """The longest time, all its spells together, that one track follows the object, s."""
    by_track: dict[int, float] = {}
    for association in own:
        spell = float(time[association.last] - time[association.first])
        by_track[association.track] = by_track.get(association.track, 0.0) + spell
    return max(by_track.values(), default=0.0)


def _time_tracked(time: FloatArray, there: IntArray, own: Sequence[SiapAssociation]) -> float:
    """Time between consecutive frames of an object that one association covers both, s."""
    begin, end = there[:-1], there[1:]
    covered = np.zeros(len(begin), np.bool_)
    for association in own:
        covered |= (begin >= association.first) & (end <= association.last)
    return float((time[end] - time[begin])[covered].sum())


def _count(work: Work) -> Tally:
    gate = work.parameters.gate
    counts = siap_counts(work.scene, siap_associations(work.scene, gate=gate))
    return Tally.of(
        {**asdict(counts), "spurious": counts.tracks - counts.associated},
        gate=gate,
        distance="xy",
        confirm=1,
        end=1,
    )


FAMILY: Final = Family(
    name="siap",
    rule="SIAP attributes; a track follows the nearest object inside the gate",
    count=_count,
    metrics=(
        share(
            name="siap_completeness",
            default=False,
            question="What share of objects has a track?",
            formula=Ratio("tracked", "truths", NO_TRUTH),
        ),
        Metric(
            name="siap_ambiguity",
            unit="1",
            direction="lower",
            default=False,
            question="How many tracks has a tracked object (1 is best)?",
            formula=Ratio("associated", "tracked", NO_MATCH),
        ),
        share(
            name="siap_spuriousness",
            direction="lower",
            default=False,
            question="What share of tracks follows nothing?",
            formula=Ratio("spurious", "tracks", NO_TRACKS),
        ),
        Metric(
            name="siap_position_accuracy",
            unit="m",
            direction="lower",
            default=False,
            question="How far is a track from its object?",
            formula=Ratio("position_error", "associated", NO_MATCH),
        ),
        Metric(
            name="siap_velocity_accuracy",
            unit="m/s",
            direction="lower",
            default=False,
            question="How wrong is a track's velocity?",
            formula=Ratio("velocity_error", "associated", NO_MATCH),
        ),
        Metric(
            name="siap_track_changes",
            unit="1/s",
            direction="lower",
            default=False,
            question="How often does an object change its track, per time tracked?",
            formula=Ratio("track_changes", "time_tracked", NO_MATCH),
        ),
        share(
            name="siap_longest_segment",
            default=False,
            question="What share of its life is an object's longest track?",
            formula=Ratio("longest_segment", "lifetime", "no object lives for two frames"),
        ),
    ),
)
