"""CLEAR MOT, identity and HOTA as the TrackEval program computes them, conventions included.

Luiten, Hoffhues, "TrackEval", 2020.  Scores are over a similarity in [0, 1] of every pair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.metrics.benchmarks.rules import (
    ERRORS,
    TRUTHS,
    ComparedSequence,
    ScoringRule,
    benchmark_evaluation,
    benchmark_metrics,
)
from pmbm.metrics.core.clear_matching import Matches, matches_of
from pmbm.metrics.core.formulas import F1, NO_MATCH, Ratio, Total
from pmbm.metrics.core.matching import best_matching
from pmbm.metrics.core.result import Counts, Evaluation, Formula, Undefined
from pmbm.metrics.core.scene import ScoredScene, make_scene, pair_overlap
from pmbm.metrics.families.clear import MOTA
from pmbm.metrics.families.hota import (
    HotaCounts,
    OverThresholds,
    distance_similarity,
    hota_counts,
)
from pmbm.metrics.families.identity import IdentityCounts, identity_counts

_EPS: Final = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False, kw_only=True)
class SimilarScene:
    """One sequence and class, with the similarity (Q,) of the scene's pairs, in [0, 1]."""

    scene: ScoredScene
    similarity: FloatArray

    def with_tracks(self, rows: BoolArray) -> SimilarScene:
        """The same with only these rows (K,) of its tracks."""
        scene = self.scene.with_rows(np.ones(len(self.scene.truth), bool), rows)
        return SimilarScene(scene=scene, similarity=self.similarity[rows[self.scene.pairs.track]])

    def counted(self, least: float, excused: BoolArray) -> SimilarScene:
        """What is left where some boxes count neither way, as TrackEval takes them out for KITTI.

        In every frame truth and tracks of at least this similarity, less one rounding as in
        `trackeval_matches`, are matched for the largest total.  Tracks matched to truth that is not
        observable are left out, and so are unmatched tracks that are `excused` (K,); of the truth,
        what is not observable.
        """
        scene, pairs = self.scene, self.scene.pairs
        near = np.flatnonzero(_similar_enough(self.similarity, least))
        chosen = near[best_matching(pairs.truth[near], pairs.track[near], self.similarity[near])]
        truth, track = pairs.truth[chosen], pairs.track[chosen]
        seen = scene.truth.observable
        dropped = excused.copy()
        dropped[track] = False
        dropped[track[~seen[truth]]] = True
        left = seen[pairs.truth] & ~dropped[pairs.track]
        return SimilarScene(scene=scene.with_rows(seen, ~dropped), similarity=self.similarity[left])


@dataclass(frozen=True, kw_only=True)
class TrackEvalCounts:
    """TrackEval's counts, which add up over sequences.

    one_sided : truth or tracks are empty, where the program returns early.
    frames : 0 where one-sided.
    matches, misses, false_positives, switches, fragmentations, similarity_sum : CLEAR.
    mostly_tracked, partly_tracked, mostly_lost : objects.
    identity, hota : of the other two families.
    """

    one_sided: bool
    frames: int
    matches: int
    misses: int
    false_positives: int
    switches: int
    fragmentations: int
    similarity_sum: float
    mostly_tracked: int
    partly_tracked: int
    mostly_lost: int
    identity: IdentityCounts
    hota: HotaCounts


def trackeval_counts(
    scene: ScoredScene, similarity: FloatArray, threshold: float = 0.5
) -> TrackEvalCounts:
    """Count one sequence, similarity (Q,) of the scene's pairs."""
    one_sided = len(scene.truth) == 0 or len(scene.tracks) == 0
    matches = trackeval_matches(scene, similarity, threshold)
    objects = len(scene.truth.ids)
    share = np.bincount(scene.truth.index[matches.truth], minlength=objects) / np.bincount(
        scene.truth.index, minlength=objects
    )
    mostly_tracked = int((share > 0.8).sum())
    partly_tracked = int((share >= 0.2).sum()) - mostly_tracked
    return TrackEvalCounts(
        one_sided=one_sided,
        frames=0 if one_sided else len(scene),
        matches=len(matches),
        misses=len(scene.truth) - len(matches),
        false_positives=len(scene.tracks) - len(matches),
        switches=int(matches.switch.sum()),
        fragmentations=_restarts(scene, matches),
        similarity_sum=float(matches.distance.sum()),
        mostly_tracked=mostly_tracked,
        partly_tracked=partly_tracked,
        mostly_lost=objects - mostly_tracked - partly_tracked,
        identity=identity_counts(scene, scene.pairs.take(similarity >= threshold)),
        hota=hota_counts(scene, scene.pairs, similarity),
    )


def trackeval_matches(
    scene: ScoredScene, similarity: FloatArray, threshold: float = 0.5
) -> Matches:
    """Match frame by frame; `distance` of the result holds the similarity.

    Quirks kept: only pairs of the single previous frame in which both sides have boxes are
    continued (a bonus of 1000 each, so all that are inside the gate), and the rest maximises the
    total similarity, not the number of pairs.
    """
    gated = np.flatnonzero(_similar_enough(similarity, threshold))
    pairs, value = scene.pairs.take(gated), similarity[gated]
    truth_id = scene.truth.index[pairs.truth]
    track_id = scene.tracks.index[pairs.track]
    cuts = np.searchsorted(pairs.frame, np.arange(len(scene) + 1))
    previous: dict[int, int] = {}
    chosen: list[IntArray] = []
    for frame in _two_sided_frames(scene):
        rows = np.arange(cuts[frame], cuts[frame + 1])
        kept = np.array(
            [previous.get(i) == j for i, j in zip(truth_id[rows], track_id[rows], strict=True)],
            np.bool_,
        )
        free = ~np.isin(truth_id[rows], truth_id[rows[kept]])
        free &= ~np.isin(track_id[rows], track_id[rows[kept]])
        rest = rows[free]
        new = rest[best_matching(truth_id[rest], track_id[rest], value[rest])]
        taken = np.sort(np.concatenate([rows[kept], new]))
        previous = dict(zip(truth_id[taken].tolist(), track_id[taken].tolist(), strict=True))
        chosen.append(taken)
    taken = np.concatenate(chosen) if chosen else np.zeros(0, np.int64)
    return matches_of(scene, pairs.take(taken), value[taken])


def _similar_enough(similarity: FloatArray, threshold: float) -> BoolArray:
    """Whether similarities reach the threshold, less one rounding, and are above 0."""
    return (similarity >= threshold - _EPS) & (similarity > _EPS)


def trackeval_scores(counts: TrackEvalCounts) -> dict[str, Any]:
    """All fields by TrackEval's own names; those over thresholds are arrays (19,).

    Quirks kept: ratios without a denominator are 0, LocA without matches is 1, and where one side
    is empty the program returns zeros (so MOTA is 0 whatever the number of false boxes) and an
    MLR of 1.
    """
    tp, fn, fp, idsw = counts.matches, counts.misses, counts.false_positives, counts.switches
    truths, objects = tp + fn, counts.mostly_tracked + counts.partly_tracked + counts.mostly_lost
    log_idsw = np.log10(idsw) if idsw > 0 else 0.0
    clear = {
        "MOTA": (tp - fp - idsw) / max(1, truths),
        "MOTP": counts.similarity_sum / max(1, tp),
        "MODA": (tp - fp) / max(1, truths),
        "CLR_Re": tp / max(1, truths),
        "CLR_Pr": tp / max(1, tp + fp),
        "MTR": counts.mostly_tracked / max(1, objects),
        "PTR": counts.partly_tracked / max(1, objects),
        "MLR": counts.mostly_lost / max(1, objects),
        "sMOTA": (counts.similarity_sum - fp - idsw) / max(1, truths),
        "CLR_F1": tp / max(1, tp + 0.5 * fn + 0.5 * fp),
        "FP_per_frame": fp / max(1, counts.frames),
        "MOTAL": (tp - fp - log_idsw) / max(1, truths),
    }
    if counts.one_sided:
        clear = {**dict.fromkeys(clear, 0.0), "MLR": 1.0}
    return {
        **clear,
        "MOTP_sum": counts.similarity_sum,
        "CLR_TP": tp,
        "CLR_FN": fn,
        "CLR_FP": fp,
        "IDSW": idsw,
        "MT": counts.mostly_tracked,
        "PT": counts.partly_tracked,
        "ML": counts.mostly_lost,
        "Frag": counts.fragmentations,
        "CLR_Frames": counts.frames,
        **_identity_scores(counts.identity),
        **_hota_scores(counts.hota),
    }


def _identity_scores(counts: IdentityCounts) -> dict[str, Any]:
    tp, fn, fp = counts.true_positives, counts.misses, counts.false_positives
    return {
        "IDF1": tp / max(1, tp + 0.5 * fp + 0.5 * fn),
        "IDR": tp / max(1, tp + fn),
        "IDP": tp / max(1, tp + fp),
        "IDTP": tp,
        "IDFN": fn,
        "IDFP": fp,
    }


def _hota_scores(counts: HotaCounts) -> dict[str, Any]:
    tp, fn, fp = counts.true_positives, counts.misses, counts.false_positives
    hits = np.maximum(1, tp)
    scores: dict[str, Any] = {
        "DetRe": tp / np.maximum(1, tp + fn),
        "DetPr": tp / np.maximum(1, tp + fp),
        "DetA": tp / np.maximum(1, tp + fn + fp),
        "AssA": counts.association / hits,
        "AssRe": counts.association_recall / hits,
        "AssPr": counts.association_precision / hits,
        "LocA": np.maximum(1e-10, counts.similarity) / np.maximum(1e-10, tp),
        "HOTA_TP": tp,
        "HOTA_FN": fn,
        "HOTA_FP": fp,
    }
    scores["HOTA"] = np.sqrt(scores["DetA"] * scores["AssA"])
    scores["OWTA"] = np.sqrt(scores["DetRe"] * scores["AssA"])
    scores["HOTA(0)"] = scores["HOTA"][0]
    scores["LocA(0)"] = scores["LocA"][0]
    scores["HOTALocA(0)"] = scores["HOTA(0)"] * scores["LocA(0)"]
    for name in ("HOTA", "DetA", "AssA", "LocA"):
        scores[f"{name}_mean"] = scores[name].mean()
    return scores


def _two_sided_frames(scene: ScoredScene) -> IntArray:
    """Frames in which both sides have boxes."""
    frames = len(scene)
    return np.flatnonzero((scene.truth.count(frames) > 0) & (scene.tracks.count(frames) > 0))


def _restarts(scene: ScoredScene, matches: Matches) -> int:
    """Tracking restarts beyond the first of each object.

    Quirk kept: the absence of an object counts as not tracked, and frames in which either side is
    empty are not looked at.
    """
    place = np.searchsorted(_two_sided_frames(scene), matches.frame)
    truth_id = scene.truth.index[matches.truth]
    order = np.lexsort((matches.frame, truth_id))
    same = np.diff(truth_id[order]) == 0
    return int((same & (np.diff(place[order]) > 1)).sum())


@dataclass(frozen=True)
class Under:
    """A formula over the counts whose names begin with a prefix."""

    prefix: str
    formula: Formula

    def __call__(self, counts: Counts) -> float | Undefined:
        own = {
            k.removeprefix(self.prefix): v for k, v in counts.items() if k.startswith(self.prefix)
        }
        return self.formula(own)


METRICS: Final = benchmark_metrics(
    "trackeval",
    ("hota", "1", "higher", "detection and association", Under("hota.", OverThresholds("HOTA"))),
    ("deta", "1", "higher", "detection", Under("hota.", OverThresholds("DetA"))),
    ("assa", "1", "higher", "association", Under("hota.", OverThresholds("AssA"))),
    ("loca", "1", "higher", "similarity of matches", Under("hota.", OverThresholds("LocA"))),
    ("mota", "1", "higher", "CLEAR MOT accuracy", MOTA),
    (
        "motp",
        "1",
        "higher",
        "similarity of matches",
        Ratio("similarity_sum", "matches", NO_MATCH),
    ),
    ("id_switches", "events", "lower", "changes of identity", Total("switches")),
    ("fragmentations", "events", "lower", "restarts", Total("fragmentations")),
    ("false_positives", "boxes", "lower", "boxes of nothing", Total("false_positives")),
    ("misses", "boxes", "lower", "objects not found", Total("misses")),
    (
        "idf1",
        "1",
        "higher",
        "agreement of identities",
        Under("identity.", F1("true_positives", "misses", "false_positives")),
    ),
    TRUTHS,
)


def evaluate_trackeval(
    sequences: Sequence[SimilarScene], *, threshold: float = 0.5, similarity: str = "given"
) -> Evaluation:
    """CLEAR MOT, identity and HOTA by TrackEval's matching, over sequences of one class.

    threshold : least similarity of CLEAR MOT and IDF1.  similarity : what it is, in words.
    Counts of all sequences are added, without TrackEval's exception for those in which one side
    is empty, and what has no denominator is undefined; `trackeval_scores` gives its own zeros.
    """
    sums: dict[str, Any] = {}
    for sequence in sequences:
        counts = trackeval_counts(sequence.scene, sequence.similarity, threshold)
        own = {
            "truths": counts.matches + counts.misses,
            **{key: value for key, value in vars(counts).items() if key in _CLEAR},
            **{f"identity.{key}": value for key, value in vars(counts.identity).items()},
            **{f"hota.{key}": value for key, value in vars(counts.hota).items()},
        }
        sums = {key: sums.get(key, 0) + value for key, value in own.items()}
    parameters = {"similarity": similarity, "threshold": threshold}
    return benchmark_evaluation(METRICS, sums, parameters, len(sequences))


_CLEAR: Final = (
    "matches",
    "misses",
    "false_positives",
    "switches",
    "fragmentations",
    "similarity_sum",
)


@dataclass(frozen=True)
class SimilarityScore:
    """CLEAR, identity and HOTA over a similarity, the benchmark's ignored boxes left out.

    measure : the similarity (Q,) of the scene's pairs, in [0, 1].
    least, says : similarity from which a pair may match, and that in words.
    farthest : boxes farther from the sensor, seen from above, in whose frame the boxes then are,
        are left out, m.
    """

    measure: Callable[[ScoredScene, ComparedSequence], FloatArray]
    least: float
    says: str
    farthest: float = np.inf

    def __call__(self, sequence: ComparedSequence, kind: str) -> Evaluation:
        counted = self.counted(sequence)
        return evaluate_trackeval([counted], threshold=self.least, similarity=self.says)

    def counted(self, sequence: ComparedSequence) -> SimilarScene:
        """What counts of a sequence."""
        similar, excused = self.similar(sequence)
        return similar.counted(self.least, excused)

    def similar(self, sequence: ComparedSequence) -> tuple[SimilarScene, BoolArray]:
        """A sequence before it is said what counts, its scores as they were written, and which of
        its tracks (K,) are excused."""
        scene = make_scene(sequence.truth, sequence.tracks)
        if sequence.confidence is not None:
            scene = replace(scene, tracks=replace(scene.tracks, score=sequence.confidence))
        truth, tracks = (
            np.hypot(side.position[:, 0], side.position[:, 1]) <= self.farthest
            for side in (scene.truth, scene.tracks)
        )
        scene = scene.with_rows(truth, tracks)
        similarity = self.measure(scene, sequence)
        return SimilarScene(scene=scene, similarity=similarity), sequence.excused[tracks]


def similarity_rule(
    measure: Callable[[ScoredScene, ComparedSequence], FloatArray],
    least: float,
    says: str,
    farthest: float = np.inf,
    *,
    in_image: bool = False,
) -> ScoringRule:
    """The rule that scores by `SimilarityScore`."""
    return ScoringRule(SimilarityScore(measure, least, says, farthest), says, _SHOWN, in_image)


_SHOWN: Final = {
    "MOTA": "mota",
    "MOTP": "motp",
    **ERRORS,
    "IDF1": "idf1",
    "HOTA": "hota",
    "DetA": "deta",
    "AssA": "assa",
    "GT": "truths",
}


def _overlap(scene: ScoredScene, _: ComparedSequence) -> FloatArray:
    return pair_overlap(scene)


def _near_from_above(scene: ScoredScene, _: ComparedSequence) -> FloatArray:
    return distance_similarity(scene.pairs.distance)


_BARELY_NEARER: Final = 0.5 + 1e-12
"""Strictly within half of 4 m, beyond the rounding that matching forgives."""

IOU3D: Final = similarity_rule(_overlap, 0.25, "3D IoU of at least .25")
BEV: Final = similarity_rule(_near_from_above, _BARELY_NEARER, "centres within 2 m seen from above")
"""Rules of more than one dataset."""
