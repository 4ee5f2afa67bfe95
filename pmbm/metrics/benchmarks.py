"""The benchmarks' own scores as `Evaluation`s: Argoverse 1, Waymo, KITTI, nuScenes, TrackEval.

Each function takes the runs of one class and gives the benchmark's numbers by its own rule, quirks
included, under its variant's name; evaluations of several parts of a dataset are combined like any
others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.metrics import catalogue, formulas
from pmbm.metrics.argoverse1 import argoverse1_counts
from pmbm.metrics.formulas import NO_MATCH, NO_TRUTH, ratio, total
from pmbm.metrics.gaps import fill_gaps
from pmbm.metrics.kitti import (
    KittiAverages,
    KittiCounts,
    KittiScene,
    kitti_averages,
    kitti_counts,
    kitti_scores,
    sum_counts,
)
from pmbm.metrics.nuscenes import NuscenesScores, nuscenes_scores, with_track_scores
from pmbm.metrics.result import Counts, Definition, Direction, Evaluation, Joined, Undefined
from pmbm.metrics.scene import Scene
from pmbm.metrics.trackeval import SimilarScene, trackeval_counts
from pmbm.metrics.waymo import WaymoCounts, WaymoScene, waymo_counts, waymo_scores

FloatArray = NDArray[np.float64]


def evaluate_argoverse1(
    logs: Sequence[Scene], *, nearest: float = 0.0, farthest: float = 100.0
) -> Evaluation:
    """Argoverse 1 over logs of one class, positions relative to the vehicle, m.

    nearest, farthest : only boxes strictly between these distances take part, m.
    """
    sums: dict[str, float] = {}
    for log in logs:
        counts = argoverse1_counts(log, nearest=nearest, farthest=farthest)
        own = {
            **asdict(counts.clear),
            "frames": counts.frames,
            "id_true_positives": counts.identity.true_positives,
            "orientation_sum": counts.orientation_sum,
            "size_sum": counts.size_sum,
        }
        sums = {key: sums.get(key, 0) + value for key, value in own.items()}
    parameters = {"gate": 2.0, "distance": "xyz", "nearest": nearest, "farthest": farthest}
    return _evaluation(_ARGOVERSE1, sums, parameters, len(logs))


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
    return _evaluation(
        _WAYMO, sums, {"least_overlap": least_overlap, "level": level}, len(sequences)
    )


def evaluate_kitti(sequences: Sequence[KittiScene], least_overlap: float) -> Evaluation:
    """KITTI over sequences of one class.

    least_overlap : of the overlap each `KittiScene` carries.
    """
    counts = asdict(sum_counts(kitti_counts(one, least_overlap) for one in sequences))
    counts["sequences"] = Joined(tuple(sequences))
    return _evaluation(_KITTI, counts, {"least_overlap": least_overlap}, len(sequences))


def evaluate_nuscenes(
    scenes: Sequence[Scene], *, gate: float = 2.0, gaps: str = "filled"
) -> Evaluation:
    """nuScenes over scenes of one class.

    gate : centres strictly nearer in (x, y) match, m.
    gaps : where an id is absent between its first and last frame, boxes are "filled" in by
        interpolation on both sides, as the benchmark means it; "devkit" fills them in as its
        program does, the earlier box with the later one's weight; "left" leaves them.
    """
    if gaps not in _GAPS:
        raise InputError(f"no way '{gaps}' with gaps", field="gaps", expected=", ".join(_GAPS))
    filled = tuple(_GAPS[gaps](with_track_scores(scene)) for scene in scenes)
    parameters = {"gate": gate, "gaps": gaps}
    return _evaluation(_NUSCENES, {"scenes": Joined(filled)}, parameters, len(scenes))


_GAPS: Final[Mapping[str, Callable[[Scene], Scene]]] = {
    "filled": fill_gaps,
    "devkit": lambda scene: fill_gaps(scene, reversed_weights=True),
    "left": lambda scene: scene,
}


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
            **{key: value for key, value in vars(counts).items() if key in _TRACKEVAL_CLEAR},
            **{f"identity.{key}": value for key, value in vars(counts.identity).items()},
            **{f"hota.{key}": value for key, value in vars(counts.hota).items()},
        }
        sums = {key: sums.get(key, 0) + value for key, value in own.items()}
    parameters = {"similarity": similarity, "threshold": threshold}
    return _evaluation(_TRACKEVAL, sums, parameters, len(sequences))


_TRACKEVAL_CLEAR: Final = (
    "matches",
    "misses",
    "false_positives",
    "switches",
    "fragmentations",
    "similarity_sum",
)


def any_definition(name: str, variant: str) -> Definition:
    """The definition behind a name of any variant."""
    if variant in _VARIANTS:
        return _VARIANTS[variant][name]
    return catalogue.definition(name)


def _evaluation(
    definitions: Mapping[str, Definition],
    counts: Counts,
    parameters: Mapping[str, Any],
    recordings: int,
) -> Evaluation:
    if not recordings:
        raise InputError("nothing to evaluate", expected="at least one run")
    return Evaluation(
        tuple(entry.value(counts, parameters=parameters) for entry in definitions.values()),
        recordings=recordings,
    )


def _table(
    variant: str, rows: Iterable[tuple[str, str, Direction, str, Callable[[Counts], Any]]]
) -> dict[str, Definition]:
    return {
        name: Definition(
            name=name,
            variant=variant,
            group=variant,
            unit=unit,
            direction=direction,
            answers=answers,
            formula=formula,
        )
        for name, unit, direction, answers, formula in rows
    }


def _or_undefined(value: float | None, reason: str) -> float | Undefined:
    return Undefined(reason) if value is None else float(value)


_TRUTHS: Final = ("truths", "boxes", "none", "boxes of truth", total("truths"))

_ARGOVERSE1: Final = _table(
    "argoverse1",
    [
        ("mota", "1", "higher", "CLEAR MOT accuracy", formulas.mota),
        ("motp_c", "m", "lower", "centre error", ratio("distance_sum", "matches", NO_MATCH)),
        ("motp_o", "deg", "lower", "yaw error", ratio("orientation_sum", "matches", NO_MATCH)),
        ("motp_i", "1", "lower", "size error", ratio("size_sum", "matches", NO_MATCH)),
        ("false_positives", "boxes", "lower", "boxes of nothing", total("false_positives")),
        ("misses", "boxes", "lower", "objects not found", total("misses")),
        ("id_switches", "events", "lower", "changes of identity", total("switches")),
        ("fragmentations", "events", "lower", "interruptions", total("fragmentations")),
        (
            "idf1",
            "1",
            "higher",
            "agreement of identities",
            lambda counts: (
                2 * counts["id_true_positives"] / (counts["truths"] + counts["tracks"])
                if counts["truths"] + counts["tracks"]
                else Undefined("no truth and no tracks")
            ),
        ),
        (
            "mostly_tracked",
            "1",
            "higher",
            "objects tracked in 80 % of frames or more",
            ratio("mostly_tracked", "objects", NO_TRUTH),
        ),
        (
            "mostly_lost",
            "1",
            "lower",
            "objects tracked in less than 20 % of frames",
            ratio("mostly_lost", "objects", NO_TRUTH),
        ),
        _TRUTHS,
    ],
)


def _waymo(field: str) -> Callable[[Counts], float | Undefined]:
    names = WaymoCounts.__dataclass_fields__

    def formula(counts: Counts) -> float | Undefined:
        if not counts["truths"].any():
            return Undefined(NO_TRUTH)
        scores = waymo_scores(WaymoCounts(**{name: counts[name] for name in names}))
        value = getattr(scores, field)
        return _or_undefined(value, "no score cutoff has a MOTA above 0")

    return formula


_WAYMO: Final = _table(
    "waymo",
    [
        ("mota", "1", "higher", "CLEAR MOT accuracy at the best score cutoff", _waymo("mota")),
        ("motp", "1", "lower", "mean 1 - IoU of matches", _waymo("motp")),
        ("misses", "1", "lower", "objects not found, per object", _waymo("misses")),
        ("mismatches", "1", "lower", "changes of identity, per object", _waymo("mismatches")),
        ("false_positives", "1", "lower", "false boxes, per object", _waymo("false_positives")),
        ("score_cutoff", "1", "none", "the best score cutoff", _waymo("cutoff")),
        ("truths", "boxes", "none", "boxes of truth", _waymo("truths")),
    ],
)


def _kitti(name: str) -> Callable[[Counts], float | Undefined]:
    def formula(counts: Counts) -> float | Undefined:
        own = KittiCounts(**{key: counts[key] for key in KittiCounts.__dataclass_fields__})
        return _or_undefined(kitti_scores(own)[name], NO_TRUTH)

    return formula


def _kitti_average(name: str) -> Callable[[Counts], float | Undefined]:
    def formula(counts: Counts) -> float | Undefined:
        averages = _averages(counts["sequences"], counts["least_overlap"])
        return Undefined(NO_TRUTH) if averages is None else float(getattr(averages, name))

    return formula


@lru_cache(maxsize=1)
def _averages(sequences: Joined, least_overlap: float) -> KittiAverages | None:
    return kitti_averages(sequences.items, least_overlap)


_KITTI: Final = _table(
    "kitti",
    [
        ("mota", "1", "higher", "CLEAR MOT accuracy", _kitti("MOTA")),
        ("motp", "1", "higher", "mean overlap of matches", _kitti("MOTP")),
        ("moda", "1", "higher", "accuracy without identities", _kitti("MODA")),
        ("motal", "1", "higher", "accuracy with log of switches", _kitti("MOTAL")),
        ("id_switches", "events", "lower", "changes of identity", total("switches")),
        ("fragmentations", "events", "lower", "interruptions", total("fragmentations")),
        ("false_positives", "boxes", "lower", "boxes of nothing", total("false_positives")),
        ("misses", "boxes", "lower", "objects not found", total("misses")),
        ("recall", "1", "higher", "share of objects found", _kitti("recall")),
        ("precision", "1", "higher", "share of boxes that are real", _kitti("precision")),
        ("mostly_tracked", "1", "higher", "objects tracked in more than 80 %", _kitti("MT")),
        ("mostly_lost", "1", "lower", "objects tracked in less than 20 %", _kitti("ML")),
        ("samota", "1", "higher", "scaled accuracy over recall", _kitti_average("samota")),
        ("amota", "1", "higher", "accuracy over recall", _kitti_average("amota")),
        ("amotp", "1", "higher", "overlap over recall", _kitti_average("amotp")),
        _TRUTHS,
    ],
)


def _nuscenes(name: str) -> Callable[[Counts], float | Undefined]:
    def formula(counts: Counts) -> float | Undefined:
        scores = _nuscenes_scores(counts["scenes"], counts["gate"])
        if scores is None:
            return Undefined(NO_TRUTH)
        value = scores.at_best[name] if name in scores.at_best else getattr(scores, name)
        return _or_undefined(value, "no recall level is reached")

    return formula


@lru_cache(maxsize=1)
def _nuscenes_scores(scenes: Joined, gate: float) -> NuscenesScores | None:
    return nuscenes_scores(scenes.items, gate)


_NUSCENES: Final = _table(
    "nuscenes",
    [
        ("amota", "1", "higher", "MOTAR over recall", _nuscenes("amota")),
        ("amotp", "m", "lower", "centre error over recall", _nuscenes("amotp")),
        ("motar", "1", "higher", "accuracy at the reached recall", _nuscenes("motar")),
        ("mota", "1", "higher", "CLEAR MOT accuracy, cut at 0", _nuscenes("mota")),
        ("motp", "m", "lower", "centre error", _nuscenes("motp")),
        ("recall", "1", "higher", "share of objects found", _nuscenes("recall")),
        ("false_positives", "boxes", "lower", "boxes of nothing", _nuscenes("fp")),
        ("misses", "boxes", "lower", "objects not found", _nuscenes("fn")),
        ("id_switches", "events", "lower", "changes of identity", _nuscenes("ids")),
        ("fragmentations", "events", "lower", "interruptions", _nuscenes("frag")),
        ("faf", "1", "lower", "false boxes per 100 frames", _nuscenes("faf")),
        ("tid", "s", "lower", "time to the first match", _nuscenes("tid")),
        ("lgd", "s", "lower", "longest gap", _nuscenes("lgd")),
        ("truths", "boxes", "none", "boxes of truth", _nuscenes("gt")),
    ],
)


def _part(prefix: str, formula: Callable[[Counts], Any]) -> Callable[[Counts], Any]:
    """A formula over the counts whose names begin so."""
    return lambda counts: formula(
        {key[len(prefix) :]: value for key, value in counts.items() if key.startswith(prefix)}
    )


def _hota(curve: Callable[[Counts], FloatArray]) -> Callable[[Counts], Any]:
    return _part("hota.", formulas.over_alphas(curve))


_TRACKEVAL: Final = _table(
    "trackeval",
    [
        ("hota", "1", "higher", "detection and association", _hota(formulas.hota_curve)),
        ("deta", "1", "higher", "detection", _hota(formulas.deta_curve)),
        ("assa", "1", "higher", "association", _hota(formulas.assa_curve)),
        ("loca", "1", "higher", "similarity of matches", _hota(formulas.loca_curve)),
        ("mota", "1", "higher", "CLEAR MOT accuracy", formulas.mota),
        (
            "motp",
            "1",
            "higher",
            "similarity of matches",
            ratio("similarity_sum", "matches", NO_MATCH),
        ),
        ("id_switches", "events", "lower", "changes of identity", total("switches")),
        ("fragmentations", "events", "lower", "restarts", total("fragmentations")),
        ("false_positives", "boxes", "lower", "boxes of nothing", total("false_positives")),
        ("misses", "boxes", "lower", "objects not found", total("misses")),
        (
            "idf1",
            "1",
            "higher",
            "agreement of identities",
            _part("identity.", formulas.f1("true_positives", "misses", "false_positives")),
        ),
        _TRUTHS,
    ],
)

_VARIANTS: Final = {
    "argoverse1": _ARGOVERSE1,
    "waymo": _WAYMO,
    "kitti": _KITTI,
    "nuscenes": _NUSCENES,
    "trackeval": _TRACKEVAL,
}
