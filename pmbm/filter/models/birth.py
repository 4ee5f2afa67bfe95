"""Births spread over the view (Pang & Radha 2021, Sec. 2.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np

from pmbm.filter.density import Mixture
from pmbm.filter.models.motion import Survival
from pmbm.filter.models.view import View
from pmbm.types import FloatArray, Site
from pmbm.validation import COUNT, NOT_NEGATIVE, POSITIVE, check_fields

_GOLDEN_ANGLE_SHARE = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True, eq=False, slots=True)
class Spread:
    """A mixture of weight one that covers the view of the sensor at `pose` (3,)."""

    shape: Mixture
    pose: FloatArray


@dataclass(frozen=True, kw_only=True)
class BroadBirth:
    """Births by a few wide Gaussians over the view and its edge.

    rate : expected new objects per second over the field of view.
    initial : expected number of objects in view before the first frame.
    components : Gaussians that the births are spread over.
    speed_sd : standard deviation of a new object's velocity, per axis, m/s.
    merge_below : components nearer than this squared Mahalanobis distance are merged; 0 is never.
    """

    rate: Annotated[float, NOT_NEGATIVE] = 0.5
    initial: Annotated[float, NOT_NEGATIVE] = 3.0
    components: Annotated[int, COUNT] = 7
    speed_sd: Annotated[float, POSITIVE] = 10.0
    merge_below: Annotated[float, NOT_NEGATIVE] = 1.0

    def __post_init__(self) -> None:
        check_fields(self, "broad birth")

    @property
    def place_by_place(self) -> bool:
        return False

    def births(
        self, site: Site, view: View, dt: float | None, survival: Survival, memory: Spread | None
    ) -> tuple[Mixture, Spread]:
        if memory is None or view.pose.tobytes() != memory.pose.tobytes():
            shape = spread_over(view, self.components, self.speed_sd)
            memory = Spread(shape, view.pose)
        expected = self.initial if dt is None else survival.alive(dt, self.rate)
        if expected == 0:
            return Mixture.empty(), memory
        shape = memory.shape
        return Mixture(shape.log_weight + math.log(expected), shape.mean, shape.cov), memory

    def joined(self, survivors: Mixture, births: Mixture) -> Mixture:
        """The births, and the survivors after them.

        Survivors that begin with the births of the interval before, as they do while the sensor
        stands still, take in the new ones place by place; weight, mean and covariance of the sum
        are kept.
        """
        if self.merge_below == 0:
            return Mixture.joined(survivors, births)
        n = len(births)
        if not np.array_equal(births.mean, survivors.mean[:n]):
            return Mixture.joined(births, survivors)
        log_weight, cov = survivors.log_weight.copy(), survivors.cov.copy()
        log_weight[:n] = np.logaddexp(log_weight[:n], births.log_weight)
        share = np.exp(births.log_weight - log_weight[:n])
        cov[:n] += share[:, None, None] * (births.cov - cov[:n])
        recycled = survivors.recycled_from
        recycled = None if recycled is None else recycled.diluted(share)
        return Mixture(log_weight, survivors.mean, cov, recycled)

    def reduced(
        self, predicted: Mixture, view: View, survival: Survival, memory: Spread, prune: float
    ) -> tuple[Mixture, float]:
        return predicted, 0.0

    def thresholds(self, prune: float) -> tuple[float, float]:
        return prune, self.merge_below


def spread_over(view: View, components: int, speed_sd: float) -> Mixture:
    """A mixture of weight one that covers the view and its edge about evenly, at any velocity.

    components : how many Gaussians; their centres lie on a sunflower's spiral, which fills any
        sector evenly.  speed_sd : of each velocity component, m/s.
    """
    spiral = _spiral(view.half_angle, view.max_range, view.area, components, speed_sd)
    x, y, yaw = view.pose.tolist()
    angle = yaw + view.centre + spiral.turn
    mean = np.zeros((components, 4))
    mean[:, 0] = x + spiral.radius * np.cos(angle)
    mean[:, 1] = y + spiral.radius * np.sin(angle)
    return Mixture(spiral.log_weight, mean, spiral.cov)


class _Spiral(NamedTuple):
    """Gaussians that cover a sector, wherever it lies: bearing off its middle (N,), rad, and
    radius (N,), m, of their centres; log_weight (N,) and cov (N,4,4)."""

    turn: FloatArray
    radius: FloatArray
    log_weight: FloatArray
    cov: FloatArray


@lru_cache(maxsize=8)
def _spiral(
    half_angle: float, max_range: float, area: float, components: int, speed_sd: float
) -> _Spiral:
    i = np.arange(components)
    turn = np.mod(i * _GOLDEN_ANGLE_SHARE, 1.0)
    variance = 0.25 * area / components
    cov = np.diag([variance, variance, speed_sd**2, speed_sd**2])
    return _Spiral(
        half_angle * (2 * turn - 1),
        max_range * np.sqrt((i + 0.5) / components),
        np.full(components, -math.log(components)),
        np.tile(cov, (components, 1, 1)),
    )
