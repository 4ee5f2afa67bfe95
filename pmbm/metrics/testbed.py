"""Measures of a testbed beside the distances: delays, ghosts, track life, identity through an
occlusion, cardinality, velocity, yaw.

Objects and tracks are matched by the standard CLEAR rule.  Times are in seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmbm.geometry import wrap_angle
from pmbm.metrics.clear import Matches
from pmbm.metrics.scene import Scene

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectMeasures:
    """One number per object, and the objects for which it never happened.

    initiation_delay : first match minus first observable frame, s; of objects ever observable and
        ever matched.  never_initiated : ever observable, never matched.
    ghost_time : last report of the track id that last matched the object minus the object's last
        frame, 0 if negative, s; of objects ever matched.  never_matched : the others.
    track_life : share of the object's observable frames in which it is matched; of objects ever
        observable.  never_observable : the others.
    false_track_life : last minus first report of each track id that is never matched, s.
    """

    initiation_delay: FloatArray
    never_initiated: int
    ghost_time: FloatArray
    never_matched: int
    track_life: FloatArray
    never_observable: int
    false_track_life: FloatArray


def object_measures(scene: Scene, matches: Matches) -> ObjectMeasures:
    """Delays, ghosts and life of every object's tracks."""
    truth, tracks = scene.truth, scene.tracks
    objects, track_ids = len(truth.ids), len(tracks.ids)
    time = scene.time
    first_seen = _extreme(
        np.minimum, truth.index[truth.observable], time[truth.frame[truth.observable]], objects
    )
    last_there = _extreme(np.maximum, truth.index, time[truth.frame], objects)
    matched_object = truth.index[matches.truth]
    first_match = _extreme(np.minimum, matched_object, time[matches.frame], objects)
    last_report = _extreme(np.maximum, tracks.index, time[tracks.frame], track_ids)
    first_report = _extreme(np.minimum, tracks.index, time[tracks.frame], track_ids)

    last_track = np.full(objects, -1)
    last_track[matched_object] = tracks.index[matches.track]
    ever_matched = last_track >= 0
    ever_seen = np.isfinite(first_seen)
    initiated = ever_seen & ever_matched

    hit = np.zeros(len(truth), np.bool_)
    hit[matches.truth] = True
    observable_rows = np.bincount(truth.index, truth.observable, minlength=objects)
    hit_rows = np.bincount(truth.index, truth.observable & hit, minlength=objects)

    never_matched_track = np.ones(track_ids, np.bool_)
    never_matched_track[tracks.index[matches.track]] = False
    return ObjectMeasures(
        initiation_delay=first_match[initiated] - first_seen[initiated],
        never_initiated=int((ever_seen & ~ever_matched).sum()),
        ghost_time=np.maximum(
            last_report[last_track[ever_matched]] - last_there[ever_matched], 0.0
        ),
        never_matched=int((~ever_matched).sum()),
        track_life=hit_rows[ever_seen] / observable_rows[ever_seen],
        never_observable=int((~ever_seen).sum()),
        false_track_life=(last_report - first_report)[never_matched_track],
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class OcclusionMeasures:
    """What became of tracks while their objects were hidden.

    kept, lost : occlusions after which the object's first match had, or had not (or never came),
        the id of its last match before.
    untracked : occlusions of objects never matched before: there was no id to keep.
    coasting_error : distance of the reported track of that id to the hidden object in (x, y), m,
        one per hidden frame in which it is reported.
    hidden : hidden frames of objects that had an id to keep.
    """

    kept: int
    lost: int
    untracked: int
    coasting_error: FloatArray
    hidden: int


@dataclass(frozen=True, slots=True)
class Occlusion:
    """One object out of sight for a while.

    rows : of the scene's truth, one per hidden frame.
    begin, end : time of its last row in sight before, and of its first one after, s.
    before, after : index of the track that last matched it before, and first after; None: none did.
    """

    rows: IntArray
    begin: float
    end: float
    before: int | None
    after: int | None

    @property
    def kept(self) -> bool:
        """Whether it came back under its old id."""
        return self.before is not None and self.after == self.before


def occlusions(scene: Scene, matches: Matches, frames: int = 5) -> Iterator[Occlusion]:
    """Every object's spells of at least `frames` consecutive unobservable rows between two
    observable ones, object by object."""
    truth = scene.truth
    track_of_row = np.full(len(truth), -1)
    track_of_row[matches.truth] = scene.tracks.index[matches.track]
    order = truth.by_object
    for rows in np.split(order, np.flatnonzero(np.diff(truth.index[order])) + 1):
        for begin, end in _hidden_spells(truth.observable[rows], frames):
            before, after = track_of_row[rows[:begin]], track_of_row[rows[end:]]
            before, after = before[before >= 0], after[after >= 0]
            yield Occlusion(
                rows=rows[begin:end],
                begin=float(scene.time[truth.frame[rows[begin - 1]]]),
                end=float(scene.time[truth.frame[rows[end]]]),
                before=int(before[-1]) if len(before) else None,
                after=int(after[0]) if len(after) else None,
            )


def occlusion_measures(scene: Scene, matches: Matches, frames: int = 5) -> OcclusionMeasures:
    """Follow every object through each of its `occlusions`."""
    truth, tracks = scene.truth, scene.tracks
    row_of_report = {
        (int(frame), int(index)): row
        for row, (frame, index) in enumerate(zip(tracks.frame, tracks.index, strict=True))
    }
    kept = lost = untracked = hidden = 0
    errors: list[float] = []
    for spell in occlusions(scene, matches, frames):
        if spell.before is None:
            untracked += 1
            continue
        kept, lost = kept + spell.kept, lost + (not spell.kept)
        hidden += len(spell.rows)
        for row in spell.rows:
            report = row_of_report.get((int(truth.frame[row]), spell.before))
            if report is not None:
                offset = tracks.position[report, :2] - truth.position[row, :2]
                errors.append(float(np.hypot(*offset)))
    return OcclusionMeasures(
        kept=kept,
        lost=lost,
        untracked=untracked,
        coasting_error=np.array(errors),
        hidden=hidden,
    )


def velocity_error(scene: Scene, matches: Matches) -> FloatArray:
    """Length of the difference of velocities of each matched pair (A,), m/s."""
    difference = scene.tracks.velocity[matches.track] - scene.truth.velocity[matches.truth]
    return np.hypot(difference[:, 0], difference[:, 1])


def yaw_error(scene: Scene, matches: Matches) -> FloatArray:
    """Absolute difference of yaws of each matched pair (A,), in [0, pi] rad."""
    return np.abs(wrap_angle(scene.tracks.yaw[matches.track] - scene.truth.yaw[matches.truth]))


def _extreme(better: np.ufunc, index: IntArray, value: FloatArray, size: int) -> FloatArray:
    """The least or greatest value of each index; infinite where there is none."""
    result = np.full(size, np.inf if better is np.minimum else -np.inf)
    better.at(result, index, value)
    return result


def _hidden_spells(observable: NDArray[np.bool_], frames: int) -> list[tuple[int, int]]:
    """[begin, end) of runs of at least `frames` False between True values."""
    seen = np.flatnonzero(observable)
    gaps = np.flatnonzero(np.diff(seen) > frames)
    return [(int(seen[gap]) + 1, int(seen[gap + 1])) for gap in gaps]
