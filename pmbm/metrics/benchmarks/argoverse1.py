"""The Argoverse 1 tracking rules (argoverse-api, `eval_tracking.py`).

CLEAR MOT by the standard rule at 2 m between centres in (x, y, z), per class, inside a range of
the sensor, with three precisions of the matched pairs: centre (MOTP-C, m), orientation (MOTP-O,
degrees) and size (MOTP-I, 1 - aligned IoU).  MOTP-O and MOTP-I are means over the pairs that
MOTP-C matches, as the benchmark defines them; its program mixes in distances of two other
matchings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pmbm.arrays import FloatArray
from pmbm.metrics.benchmarks.rules import (
    ERRORS,
    TRUTHS,
    ComparedSequence,
    ScoringRule,
    benchmark_evaluation,
    benchmark_metrics,
)
from pmbm.metrics.core.clear_matching import clear_matches, gated_pairs
from pmbm.metrics.core.formulas import F1, NO_MATCH, NO_TRUTH, Ratio, Total
from pmbm.metrics.core.result import Evaluation
from pmbm.metrics.core.scene import ScoredScene, make_scene
from pmbm.metrics.families.clear import MOTA, ClearCounts, clear_counts
from pmbm.metrics.families.identity import IdentityCounts, identity_counts


@dataclass(frozen=True, kw_only=True)
class Argoverse1Counts:
    """The benchmark's counts over a run of one class.

    frames : frames in which either side has a box.
    clear, identity : events.
    orientation_sum : over matches, degrees.  size_sum : over matches, 1 - aligned IoU.
    """

    frames: int
    clear: ClearCounts
    identity: IdentityCounts
    orientation_sum: float
    size_sum: float


def argoverse1_counts(
    scene: ScoredScene,
    *,
    nearest: float = 0.0,
    farthest: float = 100.0,
    sensor: ArrayLike = (0.0, 0.0, 0.0),
    gate: float = 2.0,
) -> Argoverse1Counts:
    """Score one class of a log.

    nearest, farthest : only boxes with nearest < distance to the sensor < farthest take part, m.
    sensor (3,) or (F,3) : where the sensor is.
    """
    centre = np.broadcast_to(np.asarray(sensor, np.float64), (len(scene), 3))
    inside = []
    for boxes in (scene.truth, scene.tracks):
        away = np.linalg.norm(boxes.position - centre[boxes.frame], axis=1)
        inside.append((nearest < away) & (away < farthest))
    scene = scene.with_rows(*inside)
    matches = clear_matches(scene, gate)
    size_truth, size_track = scene.truth.size[matches.truth], scene.tracks.size[matches.track]
    overlap = np.minimum(size_truth, size_track).prod(axis=1)
    union = size_truth.prod(axis=1) + size_track.prod(axis=1) - overlap
    turn = _orientation_error(
        np.abs(scene.tracks.yaw[matches.track] - scene.truth.yaw[matches.truth])
    )
    frames = len(scene)
    return Argoverse1Counts(
        frames=int(((scene.truth.count(frames) + scene.tracks.count(frames)) > 0).sum()),
        clear=clear_counts(scene, matches),
        identity=identity_counts(scene, gated_pairs(scene, gate)),
        orientation_sum=float(np.degrees(turn).sum()),
        size_sum=float((1.0 - overlap / union).sum()),
    )


def _orientation_error(difference: FloatArray) -> FloatArray:
    """The benchmark's angle between two yaws, rad.

    Quirk kept: from half a turn on the remainder is taken from pi whatever the number of half
    turns, so 1.5 pi becomes 0.5 pi as it should but exactly pi becomes pi and 2 pi becomes pi.
    """
    half_turns, rest = np.divmod(difference, np.pi)
    return np.where(half_turns == 0, difference, np.pi - rest)


METRICS: Final = benchmark_metrics(
    "argoverse1",
    ("mota", "1", "higher", "CLEAR MOT accuracy", MOTA),
    ("motp_c", "m", "lower", "centre error", Ratio("distance_sum", "matches", NO_MATCH)),
    ("motp_o", "deg", "lower", "yaw error", Ratio("orientation_sum", "matches", NO_MATCH)),
    ("motp_i", "1", "lower", "size error", Ratio("size_sum", "matches", NO_MATCH)),
    ("false_positives", "boxes", "lower", "boxes of nothing", Total("false_positives")),
    ("misses", "boxes", "lower", "objects not found", Total("misses")),
    ("id_switches", "events", "lower", "changes of identity", Total("switches")),
    ("fragmentations", "events", "lower", "interruptions", Total("fragmentations")),
    (
        "idf1",
        "1",
        "higher",
        "agreement of identities",
        F1("id_true_positives", "id_misses", "id_false_positives"),
    ),
    (
        "mostly_tracked",
        "1",
        "higher",
        "objects tracked in 80 % of frames or more",
        Ratio("mostly_tracked", "objects", NO_TRUTH),
    ),
    (
        "mostly_lost",
        "1",
        "lower",
        "objects tracked in less than 20 % of frames",
        Ratio("mostly_lost", "objects", NO_TRUTH),
    ),
    TRUTHS,
)


def evaluate_argoverse1(
    logs: Sequence[ScoredScene], *, nearest: float = 0.0, farthest: float = 100.0
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
            **{f"id_{key}": value for key, value in asdict(counts.identity).items()},
            "orientation_sum": counts.orientation_sum,
            "size_sum": counts.size_sum,
        }
        sums = {key: sums.get(key, 0) + value for key, value in own.items()}
    parameters = {"gate": 2.0, "distance": "xyz", "nearest": nearest, "farthest": farthest}
    return benchmark_evaluation(METRICS, sums, parameters, len(logs))


def _score(sequence: ComparedSequence, _kind: str) -> Evaluation:
    return evaluate_argoverse1([make_scene(sequence.truth, sequence.tracks)])


RULES: Final = {
    "argoverse1": ScoringRule(
        _score,
        "centres within 2 m, boxes within 100 m",
        {
            "MOTA": "mota",
            "MOTP-C": "motp_c",
            "MOTP-O": "motp_o",
            "MOTP-I": "motp_i",
            **ERRORS,
            "IDF1": "idf1",
            "MT": "mostly_tracked",
            "ML": "mostly_lost",
            "GT": "truths",
        },
    ),
}
