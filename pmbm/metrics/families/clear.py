"""CLEAR MOT: what the standard matching of objects and tracks counts.

Bernardin, Stiefelhagen, "Evaluating multiple object tracking performance: the CLEAR MOT metrics",
EURASIP JIVP 2008.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from pmbm.arrays import BoolArray
from pmbm.metrics.core.clear_matching import Matches
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import NO_MATCH, NO_TRACKS, NO_TRUTH, OneMinusRatio, Ratio, Total
from pmbm.metrics.core.result import Metric
from pmbm.metrics.core.scene import ScoredScene


@dataclass(frozen=True, kw_only=True)
class ClearCounts:
    """The counts of CLEAR MOT over a run.

    frames, truths, tracks : frames, and rows of either side.
    matches : matched pairs, those that are identity switches included.
    misses, false_positives, switches, fragmentations : events.
    transfers : new matches of a track that was last newly matched to another object.
    objects, mostly_tracked, mostly_lost : truth ids; tracked in at least 80 %, in less than 20 %
        of their frames.
    distance_sum : of matched pairs, m.
    """

    frames: int
    truths: int
    tracks: int
    matches: int
    misses: int
    false_positives: int
    switches: int
    fragmentations: int
    transfers: int
    objects: int
    mostly_tracked: int
    mostly_lost: int
    distance_sum: float


def clear_counts(scene: ScoredScene, matches: Matches) -> ClearCounts:
    """Count the events of a matching.

    A fragmentation is a change from tracked to missed of an object between its first and its last
    tracked frame; a change of identity is none.
    """
    tracked = np.zeros(len(scene.truth), np.bool_)
    tracked[matches.truth] = True
    objects = len(scene.truth.ids)
    share = np.bincount(scene.truth.index, tracked, minlength=objects) / np.maximum(
        np.bincount(scene.truth.index, minlength=objects), 1
    )
    return ClearCounts(
        frames=len(scene),
        truths=len(scene.truth),
        tracks=len(scene.tracks),
        matches=len(matches),
        misses=len(scene.truth) - len(matches),
        false_positives=len(scene.tracks) - len(matches),
        switches=int(matches.switch.sum()),
        fragmentations=fragmentations(scene, tracked),
        transfers=_transfers(scene, matches),
        objects=objects,
        mostly_tracked=int((share >= 0.8).sum()),
        mostly_lost=int((share < 0.2).sum()),
        distance_sum=float(matches.distance.sum()),
    )


def fragmentations(scene: ScoredScene, tracked: BoolArray) -> int:
    """Interruptions of tracked objects that are taken up again, tracked (N,) per truth row."""
    order = scene.truth.by_object
    # An interruption taken up again is a restart: between consecutive tracked rows of one object
    # there is at least one row of it that is not tracked.
    object_place = np.arange(len(order))[tracked[order]]
    object_id = scene.truth.index[order][tracked[order]]
    same = object_id[1:] == object_id[:-1]
    return int((same & (np.diff(object_place) > 1)).sum())


def _transfers(scene: ScoredScene, matches: Matches) -> int:
    """New matches whose track was last newly matched to another object."""
    truth_id, track_id = scene.truth.index[matches.truth], scene.tracks.index[matches.track]
    order = np.lexsort((matches.frame, truth_id))
    kept = np.zeros(len(matches), np.bool_)
    same_truth = truth_id[order][1:] == truth_id[order][:-1]
    kept[order[1:]] = same_truth & ~matches.switch[order[1:]]
    new = np.flatnonzero(~kept)
    new = new[np.lexsort((matches.frame[new], track_id[new]))]
    same_track = track_id[new][1:] == track_id[new][:-1]
    return int((same_track & (truth_id[new][1:] != truth_id[new][:-1])).sum())


def _count(work: Work) -> Tally:
    counts = clear_counts(work.scene, work.matches)
    return Tally.of(asdict(counts), gate=work.parameters.gate, distance="xyz")


MOTA: Final = OneMinusRatio(("misses", "false_positives", "switches"), "truths", NO_TRUTH)

FAMILY: Final = Family(
    name="clear",
    rule="CLEAR MOT; an object keeps its last known match across any gap",
    count=_count,
    metrics=(
        Metric(
            name="mota",
            variant="clear",
            unit="1",
            direction="higher",
            question="What share of objects is found, less false boxes and identity switches?",
            formula=MOTA,
        ),
        Metric(
            name="motp",
            variant="clear",
            unit="m",
            direction="lower",
            question="How far is a matched box from its object?",
            formula=Ratio("distance_sum", "matches", NO_MATCH),
        ),
        Metric(
            name="id_switches",
            variant="clear",
            unit="events",
            direction="lower",
            question="How often does an object change its track id?",
            formula=Total("switches"),
        ),
        Metric(
            name="false_positives",
            variant="clear",
            unit="boxes",
            direction="lower",
            question="How many reported boxes are nothing?",
            formula=Total("false_positives"),
        ),
        Metric(
            name="misses",
            variant="clear",
            unit="boxes",
            direction="lower",
            question="How many true boxes are not reported?",
            formula=Total("misses"),
        ),
        Metric(
            name="fragmentations",
            variant="clear",
            unit="events",
            direction="lower",
            question="How often is a track interrupted?",
            formula=Total("fragmentations"),
        ),
        share(
            name="precision",
            variant="clear",
            question="What share of reported boxes is real?",
            formula=Ratio("matches", "tracks", NO_TRACKS),
        ),
        share(
            name="recall",
            variant="clear",
            question="What share of true boxes is reported?",
            formula=Ratio("matches", "truths", NO_TRUTH),
        ),
        share(
            name="mostly_tracked",
            variant="clear",
            question="What share of objects is tracked for at least 80 % of its life?",
            formula=Ratio("mostly_tracked", "objects", NO_TRUTH),
        ),
        share(
            name="mostly_lost",
            variant="clear",
            direction="lower",
            question="What share of objects is tracked for less than 20 % of its life?",
            formula=Ratio("mostly_lost", "objects", NO_TRUTH),
        ),
    ),
)
