"""The bound: what a tracker could do with these detections if it knew where each came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from filterpy.kalman import KalmanFilter

from pmbm.errors import InputError
from pmbm.types import (
    CLUTTER,
    Detections,
    GroundTruth,
    Recording,
    Tracks,
    TrackSequence,
)
from pmbm.validation import Checker

_MEASURED: Final = np.eye(2, 4)


@dataclass(frozen=True, kw_only=True)
class ClairvoyantConfig:
    """The Gaussian model of the clairvoyant; to bound a filter, give it that filter's values.

    acceleration_density : of the white acceleration, m^2/s^3.
    position_sd : of a detected position, per axis, m.
    birth_velocity_sd : per axis, m/s.
    """

    acceleration_density: float = 2.0
    position_sd: float = 0.3
    birth_velocity_sd: float = 10.0

    def __post_init__(self) -> None:
        door = Checker(self, type(self).__name__)
        for name in ("acceleration_density", "position_sd", "birth_velocity_sd"):
            door.number(name, above=0.0)


@dataclass
class _Known:
    """The filter over [x, y, vx, vy] of one object, and its last detection."""

    kalman: Any
    detections: Detections
    row: int


def clairvoyant(recording: Recording, config: ClairvoyantConfig | None = None) -> TrackSequence:
    """The tracks that perfect association gives: each object, from its first detection until it
    leaves, carries its true id; its position and velocity are those of a Kalman filter over its own
    detections (nearly constant velocity), its height, size and heading those of the last of them.

    Causal: a report uses no later detection.  Not a `Tracker`, because it reads the origins and the
    true births and deaths; no tracker with the same model can be expected to do better.

    Raises InputError where the recording's origins are unknown.
    """
    if recording.origin is None:
        raise InputError(
            f"recording '{recording.name}': the origin of its detections is unknown",
            field="origin",
            hint="give it matched ones, for example with pmbm.datasets.with_origins",
        )
    config = config or ClairvoyantConfig()
    known: dict[int, _Known] = {}
    steps: dict[int, Tracks] = {}
    given = recording.handed_over().tolist()
    time = -np.inf
    for delivery in given:
        detections, frame = recording.detections[delivery], int(recording.frame[delivery])
        origin, truth = recording.origin[delivery], recording.truth[frame]
        elapsed, time = detections.time - time, detections.time
        present = set(truth.id.tolist())
        known = {object_id: value for object_id, value in known.items() if object_id in present}
        for value in known.values():
            _predict(value.kalman, elapsed, config)
        for row in np.flatnonzero(origin != CLUTTER).tolist():
            _look(known, int(truth.id[origin[row]]), detections, row, config)
        steps[frame] = _report(known, truth, time)
    return TrackSequence(
        steps=tuple(steps.values()),
        frame=np.array(list(steps), dtype=np.int64),
        dropped=len(recording.detections) - len(given),
    )


def _predict(kalman: Any, elapsed: float, config: ClairvoyantConfig) -> None:
    transition = np.eye(4)
    transition[[0, 1], [2, 3]] = elapsed
    # White acceleration through an interval (Bar-Shalom et al. 2001, Sec. 6.2.2).
    axis = [[elapsed**3 / 3, elapsed**2 / 2], [elapsed**2 / 2, elapsed]]
    noise = np.kron(axis, np.eye(2)) * config.acceleration_density
    kalman.predict(F=transition, Q=noise)


def _look(
    known: dict[int, _Known],
    object_id: int,
    detections: Detections,
    row: int,
    config: ClairvoyantConfig,
) -> None:
    place = detections.position[row, :2]
    if object_id in known:
        known[object_id].kalman.update(place)
        known[object_id].detections, known[object_id].row = detections, row
        return
    kalman = KalmanFilter(4, 2)
    kalman.x[:2, 0] = place
    kalman.H = _MEASURED
    kalman.R = np.eye(2) * config.position_sd**2
    kalman.P = np.diag(np.repeat([config.position_sd**2, config.birth_velocity_sd**2], 2))
    known[object_id] = _Known(kalman, detections, row)


def _report(known: dict[int, _Known], truth: GroundTruth, time: float) -> Tracks:
    ids = sorted(known)
    if not ids:
        return Tracks.empty(time)
    state = np.stack([known[object_id].kalman.x[:, 0] for object_id in ids])
    last = [(known[object_id].detections, known[object_id].row) for object_id in ids]
    true_row = {object_id: row for row, object_id in enumerate(truth.id.tolist())}
    return Tracks(
        time=time,
        id=np.array(ids),
        position=np.column_stack([state[:, :2], [seen.position[row, 2] for seen, row in last]]),
        size=np.stack([seen.size[row] for seen, row in last]),
        yaw=np.array([seen.yaw[row] for seen, row in last]),
        velocity=state[:, 2:],
        score=np.ones(len(ids)),
        label=truth.label[[true_row[object_id] for object_id in ids]],
        covariance=np.stack([known[object_id].kalman.P for object_id in ids]),
    )
