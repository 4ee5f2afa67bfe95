"""Motion and survival models (Pang & Radha 2021, Sec. 2.5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np

from pmbm.types import FloatArray
from pmbm.validation import NOT_NEGATIVE, POSITIVE, SHARE, check_fields, frozen


@dataclass(frozen=True, kw_only=True)
class ConstantVelocity:
    """Velocity driven by continuous white noise.

    acceleration_density : spectral density of the white-noise acceleration, m^2/s^3.
    """

    acceleration_density: Annotated[float, NOT_NEGATIVE] = 2.0

    def __post_init__(self) -> None:
        check_fields(self, "constant velocity")

    def transition(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """F and Q (4,4) over `dt` seconds.

        The continuous form, so that predicting over a and then over b is predicting over a + b
        (Bar-Shalom, Li & Kirubarajan 2001, Sec. 6.2.2).
        """
        return _constant_velocity(self.acceleration_density, dt)


@lru_cache(maxsize=64)
def _constant_velocity(density: float, dt: float) -> tuple[FloatArray, FloatArray]:
    a, b, c = dt**3 / 3, dt**2 / 2, dt
    F = np.array([[1, 0, dt, 0], [0, 1, 0, dt], [0, 0, 1, 0], [0, 0, 0, 1]], np.float64)
    Q = np.array([[a, 0, b, 0], [0, a, 0, b], [b, 0, c, 0], [0, b, 0, c]], np.float64)
    return frozen(F), frozen(density * Q)


@dataclass(frozen=True, kw_only=True)
class Survival:
    """The probability that an object lives on.

    probability : P_S over `interval`.  interval : s.
    """

    probability: Annotated[float, SHARE] = 0.995
    interval: Annotated[float, POSITIVE] = 0.1

    def __post_init__(self) -> None:
        check_fields(self, "survival")

    def over(self, dt: float) -> float:
        """P_S over `dt` seconds."""
        return self.probability ** (dt / self.interval)

    def alive(self, dt: float, rate: float) -> float:
        """Expected number of objects that appear during `dt` seconds, `rate` in one, and are alive
        at its end.

        rate (1 - exp(-mu dt)) / mu with the death rate mu = -ln(P_S) / interval, so that the
        expected number after many short intervals is that after one long one.
        """
        if dt == 0 or self.probability == 0:
            return 0.0
        mu = -math.log(self.probability) / self.interval
        return rate * (dt if mu == 0 else -math.expm1(-mu * dt) / mu)
