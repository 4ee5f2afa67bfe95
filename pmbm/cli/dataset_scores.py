"""The datasets' own scoring rules, by name: a sequence scored, and several together."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from pmbm.cli.track import tracked
from pmbm.datasets import Dataset, with_origins
from pmbm.datasets.frames import Comparison
from pmbm.errors import InputError, nearest_hint
from pmbm.metrics import Evaluation, MetricValue, combine
from pmbm.metrics.benchmarks import (
    evaluate_argoverse1,
    evaluate_kitti,
    evaluate_nuscenes,
    evaluate_trackeval,
    evaluate_waymo,
)
from pmbm.metrics.hota import distance_similarity
from pmbm.metrics.kitti import KittiScene
from pmbm.metrics.scene import Scene, make_scene, pair_overlap
from pmbm.metrics.trackeval import SimilarScene
from pmbm.metrics.waymo import WaymoScene, waymo_overlap
from pmbm.seeding import tracker_seed
from pmbm.study import ConfiguredTracker, follow
from pmbm.tracking import SHIPPED_BOUNDS, joined_tracks
from pmbm.types import FloatArray, Label, Recording, TrackSequence

Scores = dict[str, float | None]


@dataclass(frozen=True)
class Rule:
    """score : one sequence of a class (by name).  says : what the rule compares, in a few words.
    shown : the benchmark's name of a figure -> its name among the metrics.
    in_image : whether it compares image boxes alone."""

    score: Callable[[Comparison, str], Evaluation]
    says: str
    shown: Mapping[str, str]
    in_image: bool = False

    def scores(self, sequences: Sequence[Evaluation]) -> Scores:
        """The figures of several sequences together, counted as one."""
        whole = combine(sequences)
        return {short: _figure(whole[name]) for short, name in self.shown.items()}

    def reasons(self, sequences: Sequence[Evaluation]) -> dict[str, str]:
        """Of the same figures, why those are undefined that are."""
        whole = combine(sequences)
        found = {short: whole[name].reason for short, name in self.shown.items()}
        return {short: reason for short, reason in found.items() if reason is not None}


def _figure(value: MetricValue) -> float | None:
    whole = value.unit in ("boxes", "events")
    return int(value.value) if whole and value.value is not None else value.value


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


def score_sequence(
    dataset_name: str, dataset: Dataset, sequence: str, kind: str, results: Path, rule: str | None
) -> Evaluation:
    """One sequence of one class, by a rule.

    Raises InputError for results of image boxes alone, by a rule that compares more."""
    by = rule_of(dataset_name, rule)
    comparison = dataset.compared(sequence, kind, results)
    if comparison.image_only is not None and not by.in_image:
        flat = [name for name, other in RULES[dataset_name].items() if other.in_image]
        raise comparison.image_only.error(
            "a result without a 3D box",
            field="height",
            expected="above 0",
            hint=f"image boxes alone are what --rule {' or '.join(flat)} compares",
        )
    return by.score(comparison, kind)


def score_run(
    dataset_name: str,
    dataset: Dataset,
    sequence: str,
    trackers: Mapping[Label, ConfiguredTracker],
    rule: str | None,
    mode: str = "online",
    recording: Recording | None = None,
) -> dict[str, Evaluation]:
    """One sequence tracked, written in the dataset's format and scored: class -> its scores.

    recording : the sequence without its truth, where it has been read before.
    A bound sees the truth, with the detections' origins by overlap.
    """
    if any(one.factory in SHIPPED_BOUNDS for one in trackers.values()):
        tracks = _bounded(sequence, with_origins(dataset.recording(sequence)), trackers)
    else:
        recording = recording or dataset.recording(sequence, truth=False)
        tracks = tracked(sequence, recording, trackers, mode)
    with tempfile.TemporaryDirectory() as folder:
        dataset.write(sequence, tracks, Path(folder))
        return {
            kind: score_sequence(dataset_name, dataset, sequence, kind, Path(folder), rule)
            for kind in dataset.classes
        }


def _bounded(
    sequence: str, recording: Recording, bounds: Mapping[Label, ConfiguredTracker]
) -> TrackSequence:
    """Every label's objects by that label's bound, under their true ids."""
    seed = tracker_seed(0, sequence)
    found = {label: follow(bound, recording, seed) for label, bound in bounds.items()}
    steps = []
    for reports in zip(*(each.steps for each in found.values()), strict=True):
        own = [r.take(r.label == label) for label, r in zip(found, reports, strict=True)]
        ids = [i for tracks in own for i in tracks.id.tolist()]
        steps.append(joined_tracks(reports[0].time, own, ids))
    return replace(next(iter(found.values())), steps=tuple(steps))


def _similar(
    measure: Callable[[Scene, Comparison], FloatArray],
    least: float,
    says: str,
    farthest: float = np.inf,
    *,
    in_image: bool = False,
) -> Rule:
    """CLEAR, identity and HOTA over a similarity, the benchmark's ignored boxes left out, and those
    farther from the sensor, seen from above, in whose frame the boxes then are."""

    def score(comparison: Comparison, _kind: str) -> Evaluation:
        scene = make_scene(comparison.truth, comparison.tracks)
        truth, tracks = (
            np.hypot(side.position[:, 0], side.position[:, 1]) <= farthest
            for side in (scene.truth, scene.tracks)
        )
        scene = scene.with_rows(truth, tracks)
        similar = SimilarScene(scene=scene, similarity=measure(scene, comparison))
        counted = similar.counted(least, comparison.excused[tracks])
        return evaluate_trackeval([counted], threshold=least, similarity=says)

    return Rule(score, says, _SIMILAR, in_image)


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


def _argoverse1(comparison: Comparison, _kind: str) -> Evaluation:
    return evaluate_argoverse1([make_scene(comparison.truth, comparison.tracks)])


def _waymo(level: int) -> Rule:
    def score(comparison: Comparison, kind: str) -> Evaluation:
        scene = make_scene(comparison.truth, comparison.tracks)
        assert comparison.hard is not None
        sequence = WaymoScene(
            scene=scene,
            overlap=waymo_overlap(scene),
            level=np.where(comparison.hard, 2, 1),
            in_no_label_zone=comparison.excused,
        )
        return evaluate_waymo([sequence], 0.7 if kind == "VEHICLE" else 0.5, level=level)

    return Rule(score, f"3D IoU of at least .7 (vehicles) or .5, LEVEL_{level}", _WAYMO)


def _nuscenes(gaps: str, says: str) -> Rule:
    def score(comparison: Comparison, _kind: str) -> Evaluation:
        return evaluate_nuscenes([make_scene(comparison.truth, comparison.tracks)], gaps=gaps)

    return Rule(score, f"centres within 2 m seen from above, {says}", _NUSCENES)


def _kitti_devkit(comparison: Comparison, _kind: str) -> Evaluation:
    scene = make_scene(comparison.truth, comparison.tracks)
    if comparison.confidence is not None:
        scene = replace(scene, tracks=replace(scene.tracks, score=comparison.confidence))
    sequence = KittiScene(
        scene=scene,
        overlap=pair_overlap(scene),
        ignored_truth=~scene.truth.observable,
        ignored_tracks=comparison.excused,
    )
    return evaluate_kitti([sequence], 0.25)


_ERRORS: Final = {
    "FP": "false_positives",
    "FN": "misses",
    "IDS": "id_switches",
    "FRAG": "fragmentations",
}
_SIMILAR: Final = {
    "MOTA": "mota",
    "MOTP": "motp",
    **_ERRORS,
    "IDF1": "idf1",
    "HOTA": "hota",
    "DetA": "deta",
    "AssA": "assa",
    "GT": "truths",
}
_ARGOVERSE1: Final = {
    "MOTA": "mota",
    "MOTP-C": "motp_c",
    "MOTP-O": "motp_o",
    "MOTP-I": "motp_i",
    **_ERRORS,
    "IDF1": "idf1",
    "MT": "mostly_tracked",
    "ML": "mostly_lost",
    "GT": "truths",
}
_WAYMO: Final = {
    "MOTA": "mota",
    "MOTP": "motp",
    "FP": "false_positives",
    "misses": "misses",
    "mismatches": "mismatches",
    "cutoff": "score_cutoff",
    "GT": "truths",
}
_KITTI: Final = {
    "sAMOTA": "samota",
    "AMOTA": "amota",
    "AMOTP": "amotp",
    "MOTA": "mota",
    "MOTP": "motp",
    **_ERRORS,
    "MT": "mostly_tracked",
    "ML": "mostly_lost",
    "GT": "truths",
}
_NUSCENES: Final = {
    "AMOTA": "amota",
    "AMOTP": "amotp",
    "MOTAR": "motar",
    "MOTA": "mota",
    "MOTP": "motp",
    "recall": "recall",
    **_ERRORS,
    "FAF": "faf",
    "TID": "tid",
    "LGD": "lgd",
    "GT": "truths",
}

_BARELY_NEARER: Final = 0.5 + 1e-12
"""Strictly within half of 4 m, beyond the rounding that matching forgives."""

RULES: Final[Mapping[str, Mapping[str, Rule]]] = {
    "argoverse1": {
        "argoverse1": Rule(_argoverse1, "centres within 2 m, boxes within 100 m", _ARGOVERSE1),
    },
    "argoverse2": {
        "argoverse2": _similar(
            _near_in_argoverse2, 0.5, "centres within 1 m seen from above, boxes within 50 m", 50.0
        ),
    },
    "kitti": {
        "iou3d": _similar(_iou3d, 0.25, "3D IoU of at least .25"),
        "bev": _similar(_near_from_above, _BARELY_NEARER, "centres within 2 m seen from above"),
        "iou2d": _similar(_iou2d, 0.5, "IoU of at least .5 in the image", in_image=True),
        "devkit": Rule(_kitti_devkit, "3D IoU of at least .25, by the devkit's counting", _KITTI),
    },
    "nuscenes": {
        "nuscenes": _nuscenes("filled", "gaps filled in"),
        "devkit": _nuscenes("devkit", "gaps filled in with the devkit's reversed weights"),
    },
    "waymo": {"level2": _waymo(2), "level1": _waymo(1)},
}
