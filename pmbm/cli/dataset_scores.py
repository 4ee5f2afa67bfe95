"""The datasets' own scoring rules, by name: what is counted of a sequence, and the scores of the
counts of several."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from pmbm.datasets import Dataset
from pmbm.datasets.frames import Comparison
from pmbm.errors import InputError, nearest_hint
from pmbm.metrics.benchmark import benchmark_scores, kept_rows
from pmbm.metrics.hota import distance_similarity
from pmbm.metrics.scene import Scene, make_scene, pair_overlap
from pmbm.metrics.trackeval import trackeval_counts
from pmbm.types import FloatArray

Scores = dict[str, float | None]


@dataclass(frozen=True)
class Rule:
    """count : what one sequence of a class adds.  scores : of several sequences together.
    says : what the rule compares, in a few words."""

    count: Callable[[Comparison], Any]
    scores: Callable[[Sequence[Any]], Scores]
    says: str


def rule_of(dataset: str, name: str | None) -> Rule:
    """A dataset's rule; its first where none is named.

    Raises InputError, with the nearest valid name, where there is none.
    """
    rules = RULES[dataset]
    if name is None:
        return next(iter(rules.values()))
    if name not in rules:
        raise InputError(
            f"{dataset} has no rule '{name}'",
            field="--rule",
            hint=nearest_hint(name, rules, "rule"),
        )
    return rules[name]


def count_sequence(
    dataset_name: str, dataset: Dataset, sequence: str, kind: str, results: Path, rule: str | None
) -> Any:
    """What one sequence of one class adds, by a rule."""
    return rule_of(dataset_name, rule).count(dataset.compared(sequence, kind, results))


def _similar(measure: Callable[[Scene, Comparison], FloatArray], least: float, says: str) -> Rule:
    """CLEAR, identity and HOTA over a similarity, the benchmark's ignored boxes left out."""

    def count(comparison: Comparison) -> Any:
        scene = make_scene(comparison.truth, comparison.tracks)
        similarity = measure(scene, comparison)
        truth, tracks = kept_rows(scene, similarity, least, comparison.excused)
        pairs = truth[scene.pairs.truth] & tracks[scene.pairs.track]
        return trackeval_counts(scene.with_rows(truth, tracks), similarity[pairs], least)

    return Rule(count, benchmark_scores, says)


def _iou3d(scene: Scene, _: Comparison) -> FloatArray:
    return pair_overlap(scene)


def _near_from_above(scene: Scene, _: Comparison) -> FloatArray:
    return distance_similarity(scene.pairs.distance)


def _iou2d(scene: Scene, comparison: Comparison) -> FloatArray:
    assert comparison.truth_image is not None
    assert comparison.tracks_image is not None
    a = comparison.truth_image[scene.pairs.truth]
    b = comparison.tracks_image[scene.pairs.track]
    sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    shared = np.clip(sides, 0, None).prod(axis=1)
    both = (a[:, 2:] - a[:, :2]).prod(axis=1) + (b[:, 2:] - b[:, :2]).prod(axis=1) - shared
    return np.divide(shared, both, out=np.zeros_like(shared), where=both > 0)


_BARELY_NEARER: Final = 0.5 + 1e-12
"""Strictly within half of 4 m, beyond the rounding that matching forgives."""

RULES: Final[Mapping[str, Mapping[str, Rule]]] = {
    "kitti": {
        "iou3d": _similar(_iou3d, 0.25, "3D IoU of at least .25"),
        "bev": _similar(_near_from_above, _BARELY_NEARER, "centres within 2 m seen from above"),
        "iou2d": _similar(_iou2d, 0.5, "IoU of at least .5 in the image"),
    },
}
