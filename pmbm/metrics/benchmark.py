"""Scores over a similarity of boxes, with what a benchmark does not want counted taken out first.

The taking out is TrackEval's (Luiten, Hoffhues 2020) and the KITTI devkit's; the counts are the
standard CLEAR, identity and HOTA ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmbm.metrics.clear import ClearCounts, clear_counts, continuing_matches
from pmbm.metrics.hota import HotaCounts, hota_counts
from pmbm.metrics.identity import IdentityCounts, identity_counts
from pmbm.metrics.matching import best_matching
from pmbm.metrics.scene import Scene

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class BenchmarkCounts:
    """One sequence of one class."""

    clear: ClearCounts
    identity: IdentityCounts
    hota: HotaCounts


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


def benchmark_counts(scene: Scene, similarity: FloatArray, least: float) -> BenchmarkCounts:
    """Count one sequence: CLEAR and identity with a gate of `least` similarity, HOTA over all.

    similarity (Q,) : of the scene's pairs, in [0, 1].
    """
    near = np.flatnonzero(similarity >= least)
    return BenchmarkCounts(
        clear=clear_counts(scene, continuing_matches(scene, near, 1.0 - similarity)),
        identity=identity_counts(scene, near),
        hota=hota_counts(scene, similarity),
    )


def benchmark_scores(sequences: Iterable[BenchmarkCounts]) -> dict[str, float | None]:
    """Several sequences together: counts are added, then ratios taken; a ratio without a
    denominator is None.

    Keys: MOTA, MOTP (mean similarity of matches), FP, FN, IDS, FRAG, IDF1, HOTA, DetA, AssA, GT.
    """
    counts = list(sequences)
    clear = [one.clear for one in counts]
    truths = sum(one.truths for one in clear)
    matches = sum(one.matches for one in clear)
    events = {
        "FP": sum(one.false_positives for one in clear),
        "FN": sum(one.misses for one in clear),
        "IDS": sum(one.switches for one in clear),
    }
    identity = sum(one.identity.true_positives for one in counts)
    rows = 2 * identity + sum(o.identity.misses + o.identity.false_positives for o in counts)
    distance = sum(one.distance_sum for one in clear)
    return {
        "MOTA": 1 - sum(events.values()) / truths if truths else None,
        "MOTP": 1 - distance / matches if matches else None,
        **events,
        "FRAG": sum(one.fragmentations for one in clear),
        "IDF1": 2 * identity / rows if rows else None,
        **_hota([one.hota for one in counts]),
        "GT": truths,
    }


def _hota(counts: list[HotaCounts]) -> dict[str, float | None]:
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
