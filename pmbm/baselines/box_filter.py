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

from pmbm.geometry import wrap_angle
from pmbm.types import Detections, FloatArray

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


def measured_boxes(detections: Detections) -> FloatArray:
    """The detections as measurements (N,7)."""
    return np.column_stack([detections.position, detections.yaw, detections.size])


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
    """Measured minus predicted (N,7), flipped detections corrected by pi: the yaw's part is in
    [-pi/2, pi/2], because a box looks the same from both ends and a detector may name either."""
    difference = boxes - kalman.x[:BOX, 0]
    turn = wrap_angle(difference[:, YAW])
    difference[:, YAW] = np.where(np.abs(turn) > np.pi / 2, wrap_angle(turn + np.pi), turn)
    return difference


def correct(kalman: Any, box: FloatArray) -> None:
    """Update with one measured box (7,)."""
    kalman.update(kalman.x[:BOX, 0] + innovations(kalman, box[None])[0])
    kalman.x[YAW] = wrap_angle(kalman.x[YAW])


def horizontal_covariance(kalman: Any, frame_rate: float) -> FloatArray:
    """Covariance (4,4) of [x, y, vx, vy] in m and m/s."""
    unit = np.array([1.0, 1.0, frame_rate, frame_rate])
    return kalman.P[np.ix_(_HORIZONTAL, _HORIZONTAL)] * np.outer(unit, unit)
