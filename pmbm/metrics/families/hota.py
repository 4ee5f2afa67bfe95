"""HOTA: detection and association quality in equal parts, averaged over localisation thresholds.

Luiten, Osep, Dendorfer, Torr, Geiger, Leal-Taixe, Leibe, "HOTA: a higher order metric for
evaluating multi-object tracking", IJCV 2020.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Final, Literal

import numpy as np

from pmbm.arrays import FloatArray, IntArray
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import NOTHING
from pmbm.metrics.core.matching import best_matching
from pmbm.metrics.core.result import Counts, Undefined
from pmbm.metrics.core.scene import NearPairs, ScoredScene
from pmbm.metrics.families.identity import id_pairs

ALPHAS: Final = np.arange(0.05, 0.99, 0.05)
"""The thresholds on similarity."""
_EPS: Final = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False, kw_only=True)
class HotaCounts:
    """The counts of HOTA at each of the A thresholds `ALPHAS`.

    true_positives, misses, false_positives (A,) : rows.
    association, association_recall, association_precision (A,) : over true positives, the sum of
        the share of its identities' rows that agree (of both, of the object's, of the track's).
    similarity (A,) : sum over true positives.
    """

    true_positives: IntArray
    misses: IntArray
    false_positives: IntArray
    association: FloatArray
    association_recall: FloatArray
    association_precision: FloatArray
    similarity: FloatArray


def distance_similarity(distance: FloatArray, zero_at: float = 4.0) -> FloatArray:
    """max(0, 1 - d / zero_at), distances and `zero_at` in m."""
    return np.maximum(0.0, 1.0 - distance / zero_at)


def hota_counts(scene: ScoredScene, pairs: NearPairs, similarity: FloatArray) -> HotaCounts:
    """Match every frame by global alignment times similarity, and count at each threshold.

    pairs : all pairs of the scene that are alike at all.
    similarity (Q,) : of these, in [0, 1].
    """
    pairs, s = pairs.take(similarity > 0), similarity[similarity > 0]
    truth, track = pairs.truth, pairs.track
    of_truth = np.bincount(truth, s, minlength=len(scene.truth))[truth]
    of_track = np.bincount(track, s, minlength=len(scene.tracks))[track]
    truth_id, track_id, place, _ = id_pairs(scene, pairs)
    truth_rows = np.bincount(scene.truth.index, minlength=1)[truth_id]
    track_rows = np.bincount(scene.tracks.index, minlength=1)[track_id]
    overlap = np.bincount(place, s / (of_truth + of_track - s), minlength=len(truth_id))
    alignment = overlap / (truth_rows + track_rows - overlap)
    chosen = best_matching(truth, track, alignment[place] * s)
    s, place = s[chosen], place[chosen]

    passes = s[:, None] >= ALPHAS - _EPS
    together = np.zeros((len(truth_id), len(ALPHAS)))
    np.add.at(together, place, passes)
    true_positives = passes.sum(axis=0)
    rows = truth_rows[:, None] + track_rows[:, None]
    return HotaCounts(
        true_positives=true_positives,
        misses=len(scene.truth) - true_positives,
        false_positives=len(scene.tracks) - true_positives,
        association=(together**2 / np.maximum(1, rows - together)).sum(axis=0),
        association_recall=(together**2 / np.maximum(1, truth_rows[:, None])).sum(axis=0),
        association_precision=(together**2 / np.maximum(1, track_rows[:, None])).sum(axis=0),
        similarity=(passes * s[:, None]).sum(axis=0),
    )


@dataclass(frozen=True)
class OverThresholds:
    """The mean of a curve over the thresholds `ALPHAS`."""

    curve: Literal["HOTA", "DetA", "AssA", "LocA"]

    def __call__(self, counts: Counts) -> float | Undefined:
        rows = counts["true_positives"] + counts["misses"] + counts["false_positives"]
        return float(_CURVES[self.curve](counts).mean()) if rows.any() else Undefined(NOTHING)


def _deta(counts: Counts) -> FloatArray:
    rows = counts["true_positives"] + counts["misses"] + counts["false_positives"]
    return counts["true_positives"] / np.maximum(1, rows)


def _assa(counts: Counts) -> FloatArray:
    """0 where nothing matches."""
    return counts["association"] / np.maximum(1, counts["true_positives"])


def _loca(counts: Counts) -> FloatArray:
    """1 where nothing matches."""
    hits = counts["true_positives"]
    return np.where(hits > 0, counts["similarity"] / np.maximum(1, hits), 1.0)


def _hota(counts: Counts) -> FloatArray:
    return np.sqrt(_deta(counts) * _assa(counts))


_CURVES: Final = {"HOTA": _hota, "DetA": _deta, "AssA": _assa, "LocA": _loca}
"""The value at each threshold (A,)."""


def _count(work: Work) -> Tally:
    zero_at = work.parameters.similarity_zero
    pairs = work.scene.near(zero_at)
    similarity = distance_similarity(pairs.distance_xyz, zero_at)
    return Tally.of(
        asdict(hota_counts(work.scene, pairs, similarity)), similarity_zero=zero_at, distance="xyz"
    )


FAMILY: Final = Family(
    name="hota",
    rule="HOTA over the similarity max(0, 1 - d / similarity_zero)",
    count=_count,
    metrics=(
        share(
            name="hota",
            question="How good are detection and association together, in equal parts?",
            formula=OverThresholds("HOTA"),
        ),
        share(
            name="deta",
            question="How good is detection alone?",
            formula=OverThresholds("DetA"),
        ),
        share(
            name="assa",
            question="How good is association alone?",
            formula=OverThresholds("AssA"),
        ),
        share(
            name="loca",
            question="How well placed are matched boxes?",
            formula=OverThresholds("LocA"),
        ),
    ),
)
