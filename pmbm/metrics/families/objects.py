"""Objects: how soon each is tracked, for how much of its life, and how long its track outlives it.

Objects and tracks are matched by the standard CLEAR rule.  Times are in seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from pmbm.arrays import FloatArray, IntArray
from pmbm.metrics.core.clear_matching import Matches
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import Described, Mean, Median, Number
from pmbm.metrics.core.result import Counts, Metric, Samples
from pmbm.metrics.core.scene import ScoredScene


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


def object_measures(scene: ScoredScene, matches: Matches) -> ObjectMeasures:
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


def _extreme(better: np.ufunc, index: IntArray, value: FloatArray, size: int) -> FloatArray:
    """The least or greatest value of each index; infinite where there is none."""
    result = np.full(size, np.inf if better is np.minimum else -np.inf)
    better.at(result, index, value)
    return result


@dataclass(frozen=True)
class FalseTrackLife:
    """Parts: the life of all false tracks together, s."""

    def __call__(self, counts: Counts) -> Mapping[str, float]:
        return {"life": float(counts["false_track_life"].values.sum())}


def _count(work: Work) -> Tally:
    result = object_measures(work.scene, work.matches)
    counts = {
        key: Samples(value) if isinstance(value, np.ndarray) else value
        for key, value in vars(result).items()
    }
    return Tally.of(counts, gate=work.parameters.gate)


FAMILY: Final = Family(
    name="objects",
    rule="each object in and out of sight, by the pairs that CLEAR MOT matches",
    count=_count,
    follows_objects=True,
    metrics=(
        Metric(
            name="initiation_delay",
            unit="s",
            direction="lower",
            question="How long until a visible object is first tracked (median)?",
            formula=Median("initiation_delay", "no visible object is ever matched"),
            parts=Described("initiation_delay", ("never_initiated",)),
        ),
        Metric(
            name="ghost_time",
            unit="s",
            direction="lower",
            question="How long does a track outlive its object (mean)?",
            formula=Mean("ghost_time", "no object is matched"),
            parts=Described("ghost_time", ("never_matched",)),
        ),
        share(
            name="track_life",
            question="For what share of its visible life is an object tracked (mean)?",
            formula=Mean("track_life", "no object is ever observable"),
            parts=Described("track_life", ("never_observable",)),
        ),
        Metric(
            name="false_tracks",
            unit="tracks",
            direction="lower",
            question="How many track ids never match any object?",
            formula=Number("false_track_life"),
            parts=FalseTrackLife(),
        ),
    ),
)
