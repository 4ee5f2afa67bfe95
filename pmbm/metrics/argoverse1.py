"""The Argoverse 1 tracking rules (argoverse-api, `eval_tracking.py`).

CLEAR MOT by the standard rule at 2 m between centres in (x, y, z), per class, inside a range of
the sensor, with three precisions of the matched pairs: centre (MOTP-C, m), orientation (MOTP-O,
degrees) and size (MOTP-I, 1 - aligned IoU).  MOTP-O and MOTP-I are means over the pairs that
MOTP-C matches, as the benchmark defines them; its program mixes in distances of two other
matchings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.metrics.clear import ClearCounts, clear_counts, clear_matches, gated_pairs
from pmbm.metrics.identity import IdentityCounts, identity_counts
from pmbm.metrics.scene import Scene

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Argoverse1Counts:
    """What the benchmark counts over a run of one class.

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
    scene: Scene,
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
