"""The datasets' own scoring rules, by name: what is counted of a sequence, and the scores of the
counts of several."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from pmbm.datasets import Dataset
from pmbm.datasets.frames import Comparison
from pmbm.errors import InputError, nearest_hint
from pmbm.metrics.argoverse1 import Argoverse1Counts, argoverse1_counts
from pmbm.metrics.benchmark import benchmark_scores, kept_rows
from pmbm.metrics.hota import distance_similarity
from pmbm.metrics.nuscenes import nuscenes_scores
from pmbm.metrics.scene import Scene, make_scene, pair_overlap
from pmbm.metrics.trackeval import trackeval_counts
from pmbm.metrics.waymo import (
    WaymoCounts,
    WaymoScene,
    waymo_counts,
    waymo_overlap,
    waymo_scores,
)
from pmbm.types import FloatArray

Scores = dict[str, float | None]


@dataclass(frozen=True)
class Rule:
    """count : what one sequence of a class (by name) adds.  scores : of several sequences together.
    says : what the rule compares, in a few words."""

    count: Callable[[Comparison, str], Any]
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
    return rule_of(dataset_name, rule).count(dataset.compared(sequence, kind, results), kind)


def _similar(
    measure: Callable[[Scene, Comparison], FloatArray],
    least: float,
    says: str,
    farthest: float = np.inf,
) -> Rule:
    """CLEAR, identity and HOTA over a similarity, the benchmark's ignored boxes left out, and those
    farther from the sensor, seen from above, in whose frame the boxes then are."""

    def count(comparison: Comparison, _kind: str) -> Any:
        scene = make_scene(comparison.truth, comparison.tracks)
        truth, tracks = (
            np.hypot(side.position[:, 0], side.position[:, 1]) <= farthest
            for side in (scene.truth, scene.tracks)
        )
        scene = scene.with_rows(truth, tracks)
        excused = comparison.excused[tracks]
        similarity = measure(scene, comparison)
        truth, tracks = kept_rows(scene, similarity, least, excused)
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


def _near_in_argoverse2(scene: Scene, _: Comparison) -> FloatArray:
    return distance_similarity(scene.pairs.distance, 2.0)


def _argoverse1(comparison: Comparison, _kind: str) -> Argoverse1Counts:
    return argoverse1_counts(make_scene(comparison.truth, comparison.tracks))


def _argoverse1_scores(counts: Sequence[Argoverse1Counts]) -> Scores:
    def total(name: str) -> Any:
        return sum(getattr(one.clear, name) for one in counts)

    truths, matches, objects = total("truths"), total("matches"), total("objects")
    wrong = total("misses") + total("false_positives") + total("switches")
    identified = sum(one.identity.true_positives for one in counts)
    rows = truths + total("tracks")
    orientation = sum(one.orientation_sum for one in counts)
    size = sum(one.size_sum for one in counts)
    return {
        "MOTA": 1 - wrong / truths if truths else None,
        "MOTP-C": total("distance_sum") / matches if matches else None,
        "MOTP-O": orientation / matches if matches else None,
        "MOTP-I": size / matches if matches else None,
        "FP": total("false_positives"),
        "FN": total("misses"),
        "IDS": total("switches"),
        "FRAG": total("fragmentations"),
        "IDF1": 2 * identified / rows if rows else None,
        "MT": total("mostly_tracked") / objects if objects else None,
        "ML": total("mostly_lost") / objects if objects else None,
        "GT": truths,
    }


def _waymo(comparison: Comparison, kind: str) -> Mapping[int, WaymoCounts]:
    scene = make_scene(comparison.truth, comparison.tracks)
    assert comparison.hard is not None
    sequence = WaymoScene(
        scene=scene,
        overlap=waymo_overlap(scene),
        level=np.where(comparison.hard, 2, 1),
        in_no_label_zone=comparison.excused,
    )
    return waymo_counts(sequence, 0.7 if kind == "VEHICLE" else 0.5)


def _waymo_level(level: int) -> Rule:
    def scores(counts: Sequence[Mapping[int, WaymoCounts]]) -> Scores:
        joined = functools.reduce(operator.add, (one[level] for one in counts))
        values = waymo_scores(joined)
        return {
            "MOTA": values.mota,
            "MOTP": values.motp,
            "FP": values.false_positives,
            "misses": values.misses,
            "mismatches": values.mismatches,
            "cutoff": values.cutoff,
            "GT": values.truths,
        }

    return Rule(_waymo, scores, f"3D IoU of at least .7 (vehicles) or .5, LEVEL_{level}")


def _nuscenes(comparison: Comparison, _kind: str) -> Scene:
    return make_scene(comparison.truth, comparison.tracks)


def _nuscenes_scores(scenes: Sequence[Scene]) -> Scores:
    values = nuscenes_scores(scenes)
    if values is None:
        return dict.fromkeys(("AMOTA", "AMOTP"))
    return {"AMOTA": values.amota, "AMOTP": values.amotp, **values.at_best}


_BARELY_NEARER: Final = 0.5 + 1e-12
"""Strictly within half of 4 m, beyond the rounding that matching forgives."""

RULES: Final[Mapping[str, Mapping[str, Rule]]] = {
    "argoverse1": {
        "argoverse1": Rule(
            _argoverse1, _argoverse1_scores, "centres within 2 m, boxes within 100 m"
        ),
    },
    "argoverse2": {
        "argoverse2": _similar(
            _near_in_argoverse2, 0.5, "centres within 1 m seen from above, boxes within 50 m", 50.0
        ),
    },
    "kitti": {
        "iou3d": _similar(_iou3d, 0.25, "3D IoU of at least .25"),
        "bev": _similar(_near_from_above, _BARELY_NEARER, "centres within 2 m seen from above"),
        "iou2d": _similar(_iou2d, 0.5, "IoU of at least .5 in the image"),
    },
    "nuscenes": {
        "nuscenes": Rule(_nuscenes, _nuscenes_scores, "centres within 2 m seen from above"),
    },
    "waymo": {"level2": _waymo_level(2), "level1": _waymo_level(1)},
}
