"""The KITTI tracking rules (the devkit's evaluator in three dimensions, as AB3DMOT ships it).

Every frame is matched anew; ignored truth, small boxes, neighbouring classes and DontCare regions
count neither way; averages over recall are those of Weng, Wang, Held, Kitani, "3D multi-object
tracking: a baseline and new evaluation metrics", IROS 2020.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from typing import Final

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.metrics.benchmarks.rules import (
    ERRORS,
    TRUTHS,
    ComparedSequence,
    ScoringRule,
    benchmark_evaluation,
    benchmark_metrics,
    or_undefined,
)
from pmbm.metrics.benchmarks.trackeval import BEV, IOU3D, similarity_rule
from pmbm.metrics.core.formulas import NO_TRUTH, Total
from pmbm.metrics.core.matching import most_then_nearest
from pmbm.metrics.core.result import Counts, Evaluation, Joined, Undefined
from pmbm.metrics.core.scene import ScoredScene, make_scene, pair_overlap


@dataclass(frozen=True, eq=False, kw_only=True)
class KittiScene:
    """One sequence and class, with what the benchmark ignores.

    scene : truth (DontCare left out) and tracks.
    overlap (Q,) : of the scene's pairs, in [0, 1].
    ignored_truth (N,) : too occluded, truncated, or of a neighbouring class.
    ignored_tracks (K,) : where unmatched, not false: too small, of a neighbouring class, or inside
        a DontCare region.
    """

    scene: ScoredScene
    overlap: FloatArray
    ignored_truth: BoolArray
    ignored_tracks: BoolArray

    @classmethod
    def plain(cls, scene: ScoredScene, overlap: FloatArray) -> KittiScene:
        """The scene with nothing ignored."""
        return cls(
            scene=scene,
            overlap=overlap,
            ignored_truth=np.zeros(len(scene.truth), np.bool_),
            ignored_tracks=np.zeros(len(scene.tracks), np.bool_),
        )

    def with_tracks(self, rows: BoolArray) -> KittiScene:
        """The scene with these track rows only."""
        return KittiScene(
            scene=self.scene.with_rows(np.ones(len(self.scene.truth), np.bool_), rows),
            overlap=self.overlap[rows[self.scene.pairs.track]],
            ignored_truth=self.ignored_truth,
            ignored_tracks=self.ignored_tracks[rows],
        )


@dataclass(frozen=True, kw_only=True)
class KittiCounts:
    """The devkit's counts over sequences.

    truths : truth rows that are not ignored.
    matches : matched pairs, those of ignored truth included.  misses, false_positives : rows.
    switches, fragmentations : events.
    overlap_sum : over matches.
    precision_sum : over frames, the mean overlap of matches with truth that is not ignored (1 in a
        frame without any).
    frames : all of them.
    objects, mostly_tracked, partly_tracked, mostly_lost : objects not ignored throughout.
    """

    frames: int = 0
    truths: int = 0
    matches: int = 0
    misses: int = 0
    false_positives: int = 0
    switches: int = 0
    fragmentations: int = 0
    overlap_sum: float = 0.0
    precision_sum: float = 0.0
    objects: int = 0
    mostly_tracked: int = 0
    partly_tracked: int = 0
    mostly_lost: int = 0

    def __add__(self, other: KittiCounts) -> KittiCounts:
        return KittiCounts(
            **{key: value + getattr(other, key) for key, value in vars(self).items()}
        )


def kitti_matches(sequence: KittiScene, least_overlap: float) -> IntArray:
    """The matched pairs (rows of the scene's pairs): in every frame the most pairs of at least
    this overlap, and among those the most overlap."""
    # Compared as costs, so that an overlap rounded to just below the bound decides as there.
    near = np.flatnonzero(1 - sequence.overlap <= 1 - least_overlap)
    pairs = sequence.scene.pairs
    return near[most_then_nearest(pairs.truth[near], pairs.track[near], 1 - sequence.overlap[near])]


def kitti_counts(sequence: KittiScene, least_overlap: float) -> KittiCounts:
    """Score one sequence of one class."""
    scene, frames = sequence.scene, len(sequence.scene)
    chosen = kitti_matches(sequence, least_overlap)
    truth, track = scene.pairs.truth[chosen], scene.pairs.track[chosen]
    overlap = sequence.overlap[chosen]
    ignored_truth = int(sequence.ignored_truth.sum())
    missed = np.ones(len(scene.truth), np.bool_)
    missed[truth] = False
    spare = np.ones(len(scene.tracks), np.bool_)
    spare[track] = False

    counted = ~sequence.ignored_truth[truth]
    frame_of = scene.truth.frame[truth[counted]]
    hits = np.bincount(frame_of, minlength=frames)
    total = np.bincount(frame_of, overlap[counted], minlength=frames)
    counts = KittiCounts(
        frames=frames,
        truths=len(scene.truth) - ignored_truth,
        matches=len(chosen),
        misses=int((missed & ~sequence.ignored_truth).sum()),
        false_positives=int((spare & ~sequence.ignored_tracks).sum()),
        overlap_sum=float(overlap.sum()),
        precision_sum=float(np.where(hits > 0, total / np.maximum(hits, 1), 1.0).sum()),
    )
    track_of = np.full(len(scene.truth), -1)
    track_of[truth] = scene.tracks.index[track]
    order = scene.truth.by_object
    for rows in np.split(order, np.flatnonzero(np.diff(scene.truth.index[order])) + 1):
        if len(rows) and not sequence.ignored_truth[rows].all():
            counts += _object_counts(track_of[rows].tolist(), sequence.ignored_truth[rows].tolist())
    return counts


def _object_counts(tracks: list[int], ignored: list[bool]) -> KittiCounts:
    """One object's events, from its track (-1 none) in each of its frames.

    Quirks kept: a switch needs a match in the frame before as well; a change of the track id, and
    a new start after a gap, is a fragmentation only where the next frame is matched too; in the
    last frame any match is one that the frame before has not, the object's first one included (the
    program looks there after it has taken note of the match); a match in an ignored first frame
    counts as tracked.
    """
    if all(track == -1 for track in tracks):
        return KittiCounts(objects=1, mostly_lost=1)
    last = tracks[0]
    tracked = int(last >= 0)
    switches = fragmentations = 0
    final = len(tracks) - 1
    for k in range(1, len(tracks)):
        if ignored[k]:
            last = -1
            continue
        here, before = tracks[k], tracks[k - 1]
        if last not in (here, -1) and here != -1 and before != -1:
            switches += 1
        changed = before != here and here != -1
        if changed and (k == final or (last != -1 and tracks[k + 1] != -1)):
            fragmentations += 1
        if here != -1:
            tracked, last = tracked + 1, here
    share = tracked / (len(tracks) - sum(ignored))
    return KittiCounts(
        objects=1,
        switches=switches,
        fragmentations=fragmentations,
        mostly_tracked=int(share > 0.8),
        mostly_lost=int(share < 0.2),
        partly_tracked=int(0.2 <= share <= 0.8),
    )


def kitti_scores(counts: KittiCounts, recall: float = 1.0) -> dict[str, float | None]:
    """Ratios by the devkit's names; those without truth are None.

    recall : the recall level that sMOTA is scaled by.
    Quirks kept: precision, recall and F1 without any box are 0, MOTP without a match is 0.
    """
    tp, fn, fp, ids = counts.matches, counts.misses, counts.false_positives, counts.switches
    both = (tp + fp) > 0 and (tp + fn) > 0
    found, right = (tp / (tp + fn), tp / (tp + fp)) if both else (0.0, 0.0)
    n = counts.truths
    log_ids = math.log10(ids) if ids else 0.0
    objects = max(counts.objects, 1)
    return {
        "MOTA": 1 - (fn + fp + ids) / n if n else None,
        "MODA": 1 - (fn + fp) / n if n else None,
        "MOTAL": 1 - (fn + fp + log_ids) / n if n else None,
        "sMOTA": (
            min(1.0, max(0.0, 1 - (fn + fp + ids - (1 - recall) * n) / (recall * n))) if n else None
        ),
        "MOTP": counts.overlap_sum / tp if tp else 0.0,
        "MODP": counts.precision_sum / counts.frames if counts.frames else None,
        "recall": found,
        "precision": right,
        "F1": 2 * found * right / (found + right) if found + right else 0.0,
        "MT": counts.mostly_tracked / objects,
        "PT": counts.partly_tracked / objects,
        "ML": counts.mostly_lost / objects,
    }


@dataclass(frozen=True, kw_only=True)
class KittiAverages:
    """Means over recall levels 1/40 to 1; levels that are not reached count as 0.

    samota, amota, amotp : means of sMOTA, MOTA and MOTP.
    best_threshold : of the confidence, where MOTA is highest and above 0; None where it never is.
    best : the counts there, or without a threshold.
    """

    samota: float
    amota: float
    amotp: float
    best_threshold: float | None
    best: KittiCounts


def kitti_averages(
    sequences: Sequence[KittiScene], least_overlap: float, levels: int = 40
) -> KittiAverages | None:
    """sAMOTA, AMOTA and AMOTP over all sequences of a class, or None without truth.

    A track's confidence is its mean score over the sequence (`scene.tracks.score` per row).
    """
    confidence = [track_mean_scores(one.scene) for one in sequences]
    everything = sum_counts(kitti_counts(one, least_overlap) for one in sequences)
    if everything.truths == 0:
        return None
    scores = np.concatenate(
        [
            own[one.scene.pairs.track[kitti_matches(one, least_overlap)]]
            for one, own in zip(sequences, confidence, strict=True)
        ]
    )
    sums = np.zeros(3)
    best, best_threshold, best_mota = everything, None, 0.0
    steps = _recall_steps(scores, everything.matches + everything.misses, levels)
    for threshold, recall in steps:
        counts = sum_counts(
            kitti_counts(one.with_tracks(own >= threshold), least_overlap)
            for one, own in zip(sequences, confidence, strict=True)
        )
        ratios = kitti_scores(counts, recall)
        mota = ratios["MOTA"] or 0.0
        sums += (ratios["sMOTA"] or 0.0, mota, ratios["MOTP"] or 0.0)
        if mota > best_mota:
            best, best_threshold, best_mota = counts, threshold, mota
    samota, amota, amotp = (sums / levels).tolist()
    return KittiAverages(
        samota=samota, amota=amota, amotp=amotp, best_threshold=best_threshold, best=best
    )


def track_mean_scores(scene: ScoredScene) -> FloatArray:
    """The mean score of each track row's track, (K,)."""
    ids = len(scene.tracks.ids)
    rows = np.bincount(scene.tracks.index, minlength=ids)
    total = np.bincount(scene.tracks.index, scene.tracks.score, minlength=ids)
    return (total / np.maximum(rows, 1))[scene.tracks.index]


def sum_counts(counts: Iterable[KittiCounts]) -> KittiCounts:
    """The counts of several sequences together."""
    return sum(counts, start=KittiCounts())


def _recall_steps(scores: FloatArray, truths: int, levels: int) -> list[tuple[float, float]]:
    """(threshold, recall) pairs: for each recall level the score of the true positive at which it
    is first met, to the nearer side; the level of zero recall is left out."""
    ordered = np.sort(scores)[::-1]
    steps: list[tuple[float, float]] = []
    recall = 0.0
    for place, score in enumerate(ordered):
        here = (place + 1) / truths
        final = place == len(ordered) - 1
        following = here if final else (place + 2) / truths
        if not final and following - recall < recall - here:
            continue
        steps.append((float(score), recall))
        recall += 1 / levels
    return steps[1:]


@dataclass(frozen=True)
class KittiFigure:
    """A figure of `kitti_scores`."""

    name: str

    def __call__(self, counts: Counts) -> float | Undefined:
        own = KittiCounts(**{f.name: counts[f.name] for f in fields(KittiCounts)})
        return or_undefined(kitti_scores(own)[self.name], NO_TRUTH)


@dataclass(frozen=True)
class KittiAverage:
    """A figure of `kitti_averages`."""

    name: str

    def __call__(self, counts: Counts) -> float | Undefined:
        averages = _averages(counts["sequences"], counts["least_overlap"])
        return Undefined(NO_TRUTH) if averages is None else float(getattr(averages, self.name))


@lru_cache(maxsize=1)
def _averages(sequences: Joined, least_overlap: float) -> KittiAverages | None:
    return kitti_averages(sequences.items, least_overlap)


METRICS: Final = benchmark_metrics(
    "kitti",
    ("mota", "1", "higher", "CLEAR MOT accuracy", KittiFigure("MOTA")),
    ("motp", "1", "higher", "mean overlap of matches", KittiFigure("MOTP")),
    ("moda", "1", "higher", "accuracy without identities", KittiFigure("MODA")),
    ("motal", "1", "higher", "accuracy with log of switches", KittiFigure("MOTAL")),
    ("id_switches", "events", "lower", "changes of identity", Total("switches")),
    ("fragmentations", "events", "lower", "interruptions", Total("fragmentations")),
    ("false_positives", "boxes", "lower", "boxes of nothing", Total("false_positives")),
    ("misses", "boxes", "lower", "objects not found", Total("misses")),
    ("recall", "1", "higher", "share of objects found", KittiFigure("recall")),
    ("precision", "1", "higher", "share of boxes that are real", KittiFigure("precision")),
    ("mostly_tracked", "1", "higher", "objects tracked in more than 80 %", KittiFigure("MT")),
    ("mostly_lost", "1", "lower", "objects tracked in less than 20 %", KittiFigure("ML")),
    ("samota", "1", "higher", "scaled accuracy over recall", KittiAverage("samota")),
    ("amota", "1", "higher", "accuracy over recall", KittiAverage("amota")),
    ("amotp", "1", "higher", "overlap over recall", KittiAverage("amotp")),
    TRUTHS,
)


def evaluate_kitti(sequences: Sequence[KittiScene], least_overlap: float) -> Evaluation:
    """KITTI over sequences of one class.

    least_overlap : of the overlap each `KittiScene` carries.
    """
    counts = asdict(sum_counts(kitti_counts(one, least_overlap) for one in sequences))
    counts["sequences"] = Joined(tuple(sequences))
    return benchmark_evaluation(METRICS, counts, {"least_overlap": least_overlap}, len(sequences))


def _devkit(sequence: ComparedSequence, _kind: str) -> Evaluation:
    scene = make_scene(sequence.truth, sequence.tracks)
    if sequence.confidence is not None:
        scene = replace(scene, tracks=replace(scene.tracks, score=sequence.confidence))
    compared = KittiScene(
        scene=scene,
        overlap=pair_overlap(scene),
        ignored_truth=~scene.truth.observable,
        ignored_tracks=sequence.excused,
    )
    return evaluate_kitti([compared], 0.25)


def _iou2d(scene: ScoredScene, sequence: ComparedSequence) -> FloatArray:
    assert sequence.truth_image is not None
    assert sequence.tracks_image is not None
    a = sequence.truth_image[scene.pairs.truth]
    b = sequence.tracks_image[scene.pairs.track]
    sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    shared = np.clip(sides, 0, None).prod(axis=1)
    both = (a[:, 2:] - a[:, :2]).prod(axis=1) + (b[:, 2:] - b[:, :2]).prod(axis=1) - shared
    return np.divide(shared, both, out=np.zeros_like(shared), where=both > 0)


RULES: Final = {
    "iou3d": IOU3D,
    "bev": BEV,
    "iou2d": similarity_rule(_iou2d, 0.5, "IoU of at least .5 in the image", in_image=True),
    "devkit": ScoringRule(
        _devkit,
        "3D IoU of at least .25, by the devkit's counting",
        {
            "sAMOTA": "samota",
            "AMOTA": "amota",
            "AMOTP": "amotp",
            "MOTA": "mota",
            "MOTP": "motp",
            **ERRORS,
            "MT": "mostly_tracked",
            "ML": "mostly_lost",
            "GT": "truths",
        },
    ),
}
