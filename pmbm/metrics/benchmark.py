"""CLEAR, identity and HOTA of a whole benchmark, with what it does not want counted taken out.

Matching and taking out are TrackEval's (Luiten, Hoffhues 2020), as for KITTI; unlike there, the
counts of all sequences are added with no exception for those in which one side is empty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pmbm.metrics.hota import HotaCounts
from pmbm.metrics.matching import best_matching
from pmbm.metrics.scene import Scene
from pmbm.metrics.trackeval import TrackEvalCounts

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def kept_rows(
    scene: Scene, similarity: FloatArray, least: float, excused: BoolArray
) -> tuple[BoolArray, BoolArray]:
    """What of truth (N,) and tracks (K,) counts.

    In every frame truth and tracks of at least this similarity are matched for the largest total.
    Tracks matched to truth that is not observable are left out, and so are unmatched tracks that
    are `excused` (K,); of the truth, what is not observable.

    similarity (Q,) : of the scene's pairs.
    """
    near = np.flatnonzero(similarity >= least)
    truth, track = scene.pairs.truth[near], scene.pairs.track[near]
    chosen = best_matching(truth, track, similarity[near])
    truth, track = truth[chosen], track[chosen]
    unmatched = np.ones(len(scene.tracks), np.bool_)
    unmatched[track] = False
    dropped = unmatched & excused
    dropped[track[~scene.truth.observable[truth]]] = True
    return scene.truth.observable, ~dropped


def benchmark_scores(sequences: Sequence[TrackEvalCounts]) -> dict[str, float | None]:
    """Several sequences together: counts are added, then ratios taken; a ratio without a
    denominator is None.

    Keys: MOTA, MOTP (mean similarity of matches), FP, FN, IDS, FRAG, IDF1, HOTA, DetA, AssA, GT.
    """
    matches = sum(one.matches for one in sequences)
    truths = matches + sum(one.misses for one in sequences)
    events: dict[str, float | None] = {
        "FP": sum(one.false_positives for one in sequences),
        "FN": sum(one.misses for one in sequences),
        "IDS": sum(one.switches for one in sequences),
    }
    wrong = sum(one.false_positives + one.misses + one.switches for one in sequences)
    identified = sum(one.identity.true_positives for one in sequences)
    rows = 2 * identified + sum(
        one.identity.misses + one.identity.false_positives for one in sequences
    )
    similarity = sum(one.similarity_sum for one in sequences)
    return {
        "MOTA": 1 - wrong / truths if truths else None,
        "MOTP": similarity / matches if matches else None,
        **events,
        "FRAG": sum(one.fragmentations for one in sequences),
        "IDF1": 2 * identified / rows if rows else None,
        **_hota([one.hota for one in sequences]),
        "GT": truths,
    }


def _hota(counts: Sequence[HotaCounts]) -> dict[str, float | None]:
    """Means over the thresholds."""
    found = sum((one.true_positives for one in counts), start=np.zeros(1))
    wrong = sum((one.misses + one.false_positives for one in counts), start=np.zeros(1))
    agreed = sum((one.association for one in counts), start=np.zeros(1))
    if not (found + wrong).any():
        return dict.fromkeys(("HOTA", "DetA", "AssA"))
    detection = found / (found + wrong)
    association = agreed / np.maximum(found, 1)
    return {
        "HOTA": float(np.sqrt(detection * association).mean()),
        "DetA": float(detection.mean()),
        "AssA": float(association.mean()),
    }
