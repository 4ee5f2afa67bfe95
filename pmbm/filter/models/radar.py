"""What a radar measures: range and azimuth, and how fast the range changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmbm.types import Detections, FloatArray

if TYPE_CHECKING:
    from pmbm.filter.models.sensor import Sensor


@dataclass(frozen=True, eq=False, slots=True)
class RadarScan:
    """What is particular to the M measurements of a radar.

    R (M,2,2) : covariance of each measured position in the world, m^2.
    pose (3,), velocity (2,) : of the sensor in the world, m, rad and m/s.
    radial_velocity (M,) or None : rate of change of the range, m/s; sd : its standard deviation.
    """

    R: FloatArray
    pose: FloatArray
    velocity: FloatArray
    radial_velocity: FloatArray | None
    sd: float

    @staticmethod
    def of(sensor: Sensor, detections: Detections) -> RadarScan | None:
        """Of these detections; None where they measure positions alone, all alike."""
        polar = sensor.range_sd is not None and sensor.azimuth_sd is not None
        radial = None if sensor.radial_velocity_sd is None else detections.radial_velocity
        if not polar and radial is None:
            return None
        velocity = detections.sensor_velocity
        return RadarScan(
            world_covariance(sensor, detections)
            if polar
            else np.broadcast_to(sensor.R, (len(detections), 2, 2)),
            detections.sensor_pose,
            np.zeros(2) if velocity is None else velocity,
            radial,
            sensor.radial_velocity_sd or 0.0,
        )


def world_covariance(sensor: Sensor, detections: Detections) -> FloatArray:
    """(M,2,2) covariances of positions that were measured as range and azimuth, m^2.

    Turned into the world along the measured line of sight, not that to where an object is expected:
    so a measurement has one covariance, whatever is known before it, and the order of two sensors'
    deliveries of one time makes no difference.
    """
    assert sensor.range_sd is not None
    assert sensor.azimuth_sd is not None
    offset = detections.position[:, :2] - detections.sensor_pose[:2]
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-6)
    along = offset / distance[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    wide = (distance * sensor.azimuth_sd) ** 2 + sensor.range_sd**2 * 1e-12
    return (
        sensor.range_sd**2 * along[:, :, None] * along[:, None, :]
        + wide[:, None, None] * across[:, :, None] * across[:, None, :]
    )


def log_clutter_velocity(sensor: Sensor, detections: Detections) -> FloatArray:
    """(M,) log density, s/m, of the radial velocities in clutter: over the ground it moves with a
    normal speed along the line of sight."""
    assert detections.radial_velocity is not None
    assert detections.sensor_velocity is not None
    assert sensor.radial_velocity_sd is not None
    offset = detections.position[:, :2] - detections.sensor_pose[:2]
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-6)
    speed = detections.radial_velocity + offset @ detections.sensor_velocity / distance
    variance = sensor.clutter_speed_sd**2 + sensor.radial_velocity_sd**2
    density: FloatArray = -0.5 * (np.log(2 * np.pi * variance) + speed**2 / variance)
    return density
