"""The Waymo Open Dataset's tracking rules (its `metrics` library: mot.cc, tracking_metrics.cc).

CLEAR MOT per object type over 3D IoU, at score cutoffs 0, 0.01, ..., 1; the cutoff with the highest
MOTA is reported, at two levels of difficulty and by range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.errors import InputError
from pmbm.metrics.benchmarks.rules import (
    ComparedSequence,
    ScoringRule,
    benchmark_evaluation,
    benchmark_metrics,
    or_undefined,
)
from pmbm.metrics.core.formulas import NO_TRUTH
from pmbm.metrics.core.matching import best_matching
from pmbm.metrics.core.result import Counts, Evaluation, Undefined
from pmbm.metrics.core.scene import BoxRows, ScoredScene, make_scene, pair_overlap

CUTOFFS: Final[FloatArray] = np.append(np.arange(100) * 0.01, 1.0)
"""Scores are compared with them in single precision, as they are stored."""
LEVELS: Final = (1, 2)
_SMALLEST_SIDE: Final = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class WaymoScene:
    """One sequence and object type.

    scene : truth and tracks; positions in the vehicle's frame where ranges are asked for.
    overlap (Q,) : 3D IoU of the scene's pairs.
    level (N,) : difficulty of each truth row; anything but 2 is level 1.
    in_no_label_zone (K,) : track rows that overlap a no-label zone, not false where unmatched.
    """

    scene: ScoredScene
    overlap: FloatArray
    level: IntArray
    in_no_label_zone: BoolArray

    def within(self, low: float, high: float) -> WaymoScene:
        """The scene with boxes of low <= distance < high only, m, of either side on its own."""
        truth = _between(self.scene.truth, low, high)
        tracks = _between(self.scene.tracks, low, high)
        pairs = self.scene.pairs
        both = np.flatnonzero(truth[pairs.truth] & tracks[pairs.track])
        return WaymoScene(
            scene=self.scene.with_rows(truth, tracks),
            overlap=self.overlap[both],
            level=self.level[truth],
            in_no_label_zone=self.in_no_label_zone[tracks],
        )


def _between(boxes: BoxRows, low: float, high: float) -> BoolArray:
    away: FloatArray = np.sqrt((boxes.position**2).sum(axis=1))
    inside: BoolArray = (low <= away) & (away < high)
    return inside


def waymo_overlap(scene: ScoredScene) -> FloatArray:
    """3D IoU of the scene's pairs (Q,), or 0 where a box has a side of at most 0.01 m."""
    overlap = pair_overlap(scene)
    flat_truth = scene.truth.size.min(axis=1, initial=np.inf) <= _SMALLEST_SIDE
    flat_track = scene.tracks.size.min(axis=1, initial=np.inf) <= _SMALLEST_SIDE
    overlap[flat_truth[scene.pairs.truth] | flat_track[scene.pairs.track]] = 0.0
    return overlap


@dataclass(frozen=True, eq=False, kw_only=True)
class WaymoCounts:
    """The counts at each of the C score cutoffs, which add up over sequences.

    misses, false_positives, mismatches, matches, truths (C,) : events and rows.
    cost (C,) : over matches, the sum of 1 - IoU.
    """

    misses: IntArray
    false_positives: IntArray
    mismatches: IntArray
    cost: FloatArray
    matches: IntArray
    truths: IntArray

    def __add__(self, other: WaymoCounts) -> WaymoCounts:
        return WaymoCounts(
            **{key: value + getattr(other, key) for key, value in vars(self).items()}
        )


def waymo_counts(
    sequence: WaymoScene, least_overlap: float, cutoffs: FloatArray = CUTOFFS
) -> dict[int, WaymoCounts]:
    """Counts of one sequence by level of difficulty.

    At level 1 truth of level 2 takes part in the matching: matched it counts as match and as
    truth, missed it is no miss and no truth.  At level 2 everything counts.
    """
    score = sequence.scene.tracks.score.astype(np.float32)
    hard = sequence.level == 2
    columns: dict[int, list[tuple[float, ...]]] = {level: [] for level in LEVELS}
    seen: dict[int, tuple[IntArray, int, float]] = {}
    for cutoff in cutoffs.astype(np.float32):
        kept = score >= cutoff
        # The kept sets are nested, so their size tells them apart.
        size = int(kept.sum())
        if size not in seen:
            seen[size] = _run(sequence, kept, least_overlap)
        matched, mismatches, cost = seen[size]
        pairs = sequence.scene.pairs
        missed = np.ones(len(hard), np.bool_)
        missed[pairs.truth[matched]] = False
        spare = kept & ~sequence.in_no_label_zone
        spare[pairs.track[matched]] = False
        for level in LEVELS:
            ignored = int((missed & hard).sum()) if level == 1 else 0
            columns[level].append(
                (
                    int(missed.sum()) - ignored,
                    int(spare.sum()),
                    mismatches,
                    cost,
                    len(matched),
                    len(hard) - ignored,
                )
            )
    return {level: _counts_of(rows) for level, rows in columns.items()}


@dataclass(frozen=True, kw_only=True)
class WaymoScores:
    """The reported numbers: those of the score cutoff with the highest MOTA.

    mota ; motp : mean of 1 - IoU over matches; misses, mismatches, false_positives : per truth.
    truths : of the last cutoff that has any.  cutoff : None where no MOTA is above 0.
    """

    mota: float
    motp: float
    misses: float
    mismatches: float
    false_positives: float
    truths: int
    cutoff: float | None


def waymo_scores(counts: WaymoCounts, cutoffs: FloatArray = CUTOFFS) -> WaymoScores:
    """Choose the cutoff and take the ratios.

    Quirks kept: the search starts at 0, so a MOTA of 0 or less is reported as 0 with all errors 0;
    the number of truths is not that of the chosen cutoff but of the last one with truth; equally
    good cutoffs are told apart by rounding.
    """
    some = np.flatnonzero(counts.truths)
    truths = int(counts.truths[some[-1]]) if len(some) else 0
    # In single precision and in this order, as there: rounding picks among equal cutoffs.
    n = np.maximum(counts.truths, 1).astype(np.float32)
    ratios = [
        events.astype(np.float32) / n
        for events in (counts.misses, counts.false_positives, counts.mismatches)
    ]
    mota = (1.0 - (ratios[0] + ratios[1] + ratios[2]).astype(np.float64)).astype(np.float32)
    mota[counts.truths == 0] = 0.0
    best = int(np.argmax(mota))
    if mota[best] <= 0:
        return WaymoScores(
            mota=0.0,
            motp=0.0,
            misses=0.0,
            mismatches=0.0,
            false_positives=0.0,
            truths=truths,
            cutoff=None,
        )
    truths_there, matches = counts.truths[best], counts.matches[best]
    return WaymoScores(
        mota=float(mota[best]),
        motp=float(counts.cost[best] / matches) if matches else 0.0,
        misses=float(counts.misses[best] / truths_there),
        mismatches=float(counts.mismatches[best] / truths_there),
        false_positives=float(counts.false_positives[best] / truths_there),
        truths=truths,
        cutoff=float(cutoffs[best]),
    )


def _run(
    sequence: WaymoScene, kept: BoolArray, least_overlap: float
) -> tuple[IntArray, int, float]:
    """Match one sequence at one cutoff: matched pairs, mismatches, the sum of 1 - IoU.

    An object keeps the track of its last match, however long ago, while they overlap enough; the
    memory is one to one.  The rest is assigned by the largest sum of overlaps.

    Quirk kept: beside a change of an object's track, a track that takes up an object while its
    last one has left the scene counts as a mismatch ("eviction").
    """
    scene, pairs = sequence.scene, sequence.scene.pairs
    gated = np.flatnonzero((sequence.overlap >= least_overlap) & kept[pairs.track])
    truth_id = scene.truth.index[pairs.truth[gated]].tolist()
    track_id = scene.tracks.index[pairs.track[gated]].tolist()
    overlap = sequence.overlap[gated]
    cuts = np.searchsorted(pairs.frame[gated], np.arange(len(scene) + 1)).tolist()
    present = [set(ids.tolist()) for ids in _ids_by_frame(scene)]
    track_of: dict[int, int] = {}
    truth_of: dict[int, int] = {}
    chosen: list[int] = []
    mismatches = 0
    for frame, there in enumerate(present):
        rows = range(cuts[frame], cuts[frame + 1])
        taken = [row for row in rows if track_of.get(truth_id[row]) == track_id[row]]
        busy_truth = {truth_id[row] for row in taken}
        busy_track = {track_id[row] for row in taken}
        rest = np.array(
            [
                row
                for row in rows
                if truth_id[row] not in busy_truth and track_id[row] not in busy_track
            ],
            dtype=np.int64,
        )
        if len(rest):
            own_pairs = gated[rest]
            new = best_matching(pairs.truth[own_pairs], pairs.track[own_pairs], overlap[rest])
            taken += rest[new].tolist()
        if not taken:
            continue
        chosen += taken
        matched_now = {truth_id[row] for row in taken}
        evicted = []
        for row in taken:
            i, j = truth_id[row], track_id[row]
            mismatches += track_of.get(i, j) != j
            former = truth_of.get(j, i)
            mismatches += former not in there
            if former not in matched_now:
                evicted.append(former)
        track_of.update({truth_id[row]: track_id[row] for row in taken})
        for former in evicted:
            del track_of[former]
        truth_of = {j: i for i, j in track_of.items()}
    matched = gated[np.array(sorted(chosen), dtype=np.int64)]
    return matched, mismatches, float(np.maximum(1 - sequence.overlap[matched], 0).sum())


def _ids_by_frame(scene: ScoredScene) -> list[IntArray]:
    """The places of the objects' ids in each frame."""
    cuts = np.searchsorted(scene.truth.frame, np.arange(1, len(scene)))
    return np.split(scene.truth.index, cuts) if len(scene) else []


def _counts_of(rows: Sequence[tuple[float, ...]]) -> WaymoCounts:
    misses, false_positives, mismatches, cost, matches, truths = np.array(rows, np.float64).T
    whole = [column.astype(np.int64) for column in (misses, false_positives, mismatches)]
    return WaymoCounts(
        misses=whole[0],
        false_positives=whole[1],
        mismatches=whole[2],
        cost=cost,
        matches=matches.astype(np.int64),
        truths=truths.astype(np.int64),
    )


@dataclass(frozen=True)
class WaymoFigure:
    """A figure of `waymo_scores`."""

    name: str

    def __call__(self, counts: Counts) -> float | Undefined:
        if not counts["truths"].any():
            return Undefined(NO_TRUTH)
        scores = waymo_scores(WaymoCounts(**{f.name: counts[f.name] for f in fields(WaymoCounts)}))
        return or_undefined(getattr(scores, self.name), "no score cutoff has a MOTA above 0")


METRICS: Final = benchmark_metrics(
    "waymo",
    ("mota", "1", "higher", "CLEAR MOT accuracy at the best score cutoff", WaymoFigure("mota")),
    ("motp", "1", "lower", "mean 1 - IoU of matches", WaymoFigure("motp")),
    ("misses", "1", "lower", "objects not found, per object", WaymoFigure("misses")),
    ("mismatches", "1", "lower", "changes of identity, per object", WaymoFigure("mismatches")),
    ("false_positives", "1", "lower", "false boxes, per object", WaymoFigure("false_positives")),
    ("score_cutoff", "1", "none", "the best score cutoff", WaymoFigure("cutoff")),
    ("truths", "boxes", "none", "boxes of truth", WaymoFigure("truths")),
)


def evaluate_waymo(
    sequences: Sequence[WaymoScene], least_overlap: float, *, level: int = 2
) -> Evaluation:
    """Waymo over sequences of one object type (and range) at one level of difficulty.

    least_overlap : 3D IoU, 0.7 for vehicles, 0.5 for the others.  level : 1 or 2.
    """
    if level not in (1, 2):
        raise InputError("bad level of difficulty", field="level", expected="1 or 2", got=level)
    sums: dict[str, Any] = {}
    for sequence in sequences:
        own = vars(waymo_counts(sequence, least_overlap)[level])
        sums = {key: sums.get(key, 0) + value for key, value in own.items()}
    return benchmark_evaluation(
        METRICS, sums, {"least_overlap": least_overlap, "level": level}, len(sequences)
    )


@dataclass(frozen=True)
class WaymoScore:
    """The score of one sequence at a level of difficulty."""

    level: int

    def __call__(self, sequence: ComparedSequence, kind: str) -> Evaluation:
        scene = make_scene(sequence.truth, sequence.tracks)
        assert sequence.hard is not None
        compared = WaymoScene(
            scene=scene,
            overlap=waymo_overlap(scene),
            level=np.where(sequence.hard, 2, 1),
            in_no_label_zone=sequence.excused,
        )
        least_overlap = 0.7 if kind == "VEHICLE" else 0.5
        return evaluate_waymo([compared], least_overlap, level=self.level)


def _rule(level: int) -> ScoringRule:
    says = f"3D IoU of at least .7 (vehicles) or .5, LEVEL_{level}"
    return ScoringRule(WaymoScore(level), says, _SHOWN)


_SHOWN: Final = {
    "MOTA": "mota",
    "MOTP": "motp",
    "FP": "false_positives",
    "misses": "misses",
    "mismatches": "mismatches",
    "cutoff": "score_cutoff",
    "GT": "truths",
}

RULES: Final = {"level2": _rule(2), "level1": _rule(1)}
