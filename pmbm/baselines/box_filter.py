"""The one Kalman filter of boxes that every baseline runs on, made with filterpy.

State, n = 10 or 11: [x, y, z, yaw, length, width, height, vx, vy, vz] and, where there are eleven,
the yaw rate; metres and radians, velocities per frame.  Measured are the first seven.
Source: Weng et al., "3D Multi-Object Tracking: A Baseline and New Evaluation Metrics" (AB3DMOT),
Sec. III; with eleven states, Chiu et al. 2020, "Probabilistic 3D Multi-Object Tracking for
Autonomous Driving", Sec. III.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from filterpy.kalman import KalmanFilter

from pmbm.errors import InputError
from pmbm.geometry import wrap_angle
from pmbm.types import Detections, FloatArray, GroundTruth
from pmbm.validation import Checker

BOX: Final = 7
"""Measured components: x, y, z, yaw, length, width, height."""
YAW: Final = 3
_HORIZONTAL: Final = np.array([0, 1, 7, 8])
"""Where x, y, vx, vy are in the state."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxNoise:
    """Variances of the filter, all matrices being diagonal.

    initial (n,) : P at a track's first detection, its velocities unknown.
    process (n,) : Q added per frame.
    measurement (7,) : R.
    """

    initial: FloatArray
    process: FloatArray
    measurement: FloatArray

    def __post_init__(self) -> None:
        door = Checker(self, "box noise")
        states = np.size(self.initial)
        door.floats("initial", (states,))
        door.floats("process", (states,))
        door.floats("measurement", (BOX,))
        if states not in (10, 11):
            raise InputError("box noise", field="initial", expected="10 or 11 states", got=states)
        for name, least in (("initial", 0.0), ("process", -1.0), ("measurement", 0.0)):
            values = getattr(self, name)
            if (values <= least).any() or (values < 0).any():
                raise InputError("box noise", field=name, expected="variances", got=values)

    @classmethod
    def uniform(
        cls,
        *,
        initial: float,
        initial_velocity: float,
        process: float,
        process_velocity: float,
        measurement: float,
    ) -> BoxNoise:
        """Ten states with one variance for the box and one for its velocity."""
        return cls(
            initial=np.repeat([initial, initial_velocity], [BOX, 3]),
            process=np.repeat([process, process_velocity], [BOX, 3]),
            measurement=np.full(BOX, measurement),
        )


def measured_boxes(boxes: Detections | GroundTruth) -> FloatArray:
    """The boxes of one frame as measurements (N,7)."""
    return np.column_stack([boxes.position, boxes.yaw, boxes.size])


def fold_half_turns(angle: FloatArray) -> FloatArray:
    """Differences of yaw in [-pi/2, pi/2], rad: a box looks the same from both ends, and a detector
    may name either its front."""
    turn = wrap_angle(angle)
    return np.where(np.abs(turn) > np.pi / 2, wrap_angle(turn + np.pi), turn)


def first_state(box: FloatArray, noise: BoxNoise) -> Any:
    """A filter that starts at `box` (7,) with velocity zero."""
    n = len(noise.initial)
    kalman = KalmanFilter(dim_x=n, dim_z=BOX)
    kalman.x[:BOX, 0] = box
    kalman.P = np.diag(noise.initial)
    kalman.R = np.diag(noise.measurement)
    kalman.H = np.eye(BOX, n)
    return kalman


def predict(kalman: Any, noise: BoxNoise, frames: float) -> None:
    """Advance by `frames` of the rate that velocities are counted at; Q grows in proportion."""
    n = kalman.dim_x
    transition = np.eye(n)
    rates = np.arange(n - BOX)
    transition[rates, BOX + rates] = frames
    kalman.predict(F=transition, Q=np.diag(noise.process * frames))
    kalman.x[YAW] = wrap_angle(kalman.x[YAW])


def innovations(kalman: Any, boxes: FloatArray) -> FloatArray:
    """Measured minus predicted (N,7), flipped detections corrected by pi."""
    difference = boxes - kalman.x[:BOX, 0]
    difference[:, YAW] = fold_half_turns(difference[:, YAW])
    return difference


def correct(kalman: Any, box: FloatArray) -> None:
    """Update with one measured box (7,)."""
    kalman.update(kalman.x[:BOX, 0] + innovations(kalman, box[None])[0])
    kalman.x[YAW] = wrap_angle(kalman.x[YAW])


def horizontal_covariance(kalman: Any, frame_rate: float) -> FloatArray:
    """Covariance (4,4) of [x, y, vx, vy] in m and m/s."""
    unit = np.array([1.0, 1.0, frame_rate, frame_rate])
    return kalman.P[np.ix_(_HORIZONTAL, _HORIZONTAL)] * np.outer(unit, unit)
