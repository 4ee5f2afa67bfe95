"""What a radar measures: range and azimuth, and how fast the range changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmbm.types import Detections, FloatArray

if TYPE_CHECKING:
    from pmbm.filter.models.sensor import Sensor

_LEFT = np.array([-1.0, 1.0])


@dataclass(frozen=True, eq=False, slots=True)
class RadarScan:
    """What is particular to the M measurements of a radar.

    R (M,2,2) : covariance of each measured position in the world, m^2.
    sight (M,2) : unit vectors from the sensor to the measured positions.
    radial_speed (M,) or None : of the objects over the ground along `sight`, m/s: the rate of
        change of the range, with the sensor's own motion taken out.
    radial_variance (M,) : of these, m^2/s^2.
    """

    R: FloatArray
    sight: FloatArray
    radial_speed: FloatArray | None
    radial_variance: FloatArray

    def columns(self) -> tuple[FloatArray, FloatArray, FloatArray | None, FloatArray]:
        """The fields, as the kernel takes them."""
        return self.R, self.sight, self.radial_speed, self.radial_variance

    @staticmethod
    def of(sensor: Sensor, detections: Detections) -> RadarScan | None:
        """Of these detections, or None where they measure positions alone, all alike."""
        polar = sensor.azimuth_sd is not None
        radial = None if sensor.radial_velocity_sd is None else detections.radial_velocity
        if not polar and radial is None:
            return None
        R = position_covariance(sensor, detections)
        sight, distance = _line_of_sight(detections)
        if radial is None:
            return RadarScan(R, sight, None, np.zeros(len(detections)))
        assert detections.sensor_velocity is not None
        assert sensor.radial_velocity_sd is not None
        along = sight @ detections.sensor_velocity
        across = _left_of(sight) @ detections.sensor_velocity
        # The measured bearing's error turns the line of sight on the relative velocity across it.
        bearing_sd = sensor.azimuth_sd or sensor.position_sd / distance
        variance = sensor.radial_velocity_sd**2 + (bearing_sd * across) ** 2
        return RadarScan(R, sight, radial + along, variance)


def position_covariance(sensor: Sensor, detections: Detections) -> FloatArray:
    """(M,2,2) covariances of measured positions in the world, m^2.

    Those of range and azimuth are turned into the world along the measured line of sight, not that
    to where an object is expected: so a measurement has one covariance, whatever is known before
    it, and the order of two sensors' deliveries of one time makes no difference.
    """
    if sensor.range_sd is None or sensor.azimuth_sd is None:
        return np.broadcast_to(sensor.R, (len(detections), 2, 2))
    along, distance = _line_of_sight(detections)
    across = _left_of(along)
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
    sight, _ = _line_of_sight(detections)
    speed = detections.radial_velocity + sight @ detections.sensor_velocity
    variance = sensor.clutter_speed_sd**2 + sensor.radial_velocity_sd**2
    density: FloatArray = -0.5 * (np.log(2 * np.pi * variance) + speed**2 / variance)
    return density


def _line_of_sight(detections: Detections) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (M,2) from the sensor to the measured positions, and their distances (M,), m."""
    offset = detections.position[:, :2] - detections.sensor_pose[:2]
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-6)
    return offset / distance[:, None], distance


def _left_of(sight: FloatArray) -> FloatArray:
    """(M,2) at right angles to unit vectors (M,2)."""
    return sight[:, ::-1] * _LEFT
