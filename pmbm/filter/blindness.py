"""A sensor of several that has gone blind: its deliveries keep coming, and are empty."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pmbm.filter.density import Density, summed
from pmbm.types import FloatArray

_SEEING, _BLIND = 100.0, 10.0
"""s, mean time for which a sensor sees, and for which it is blind: two states of a Markov chain."""

_SURE = 0.9
"""P(blind) above which a sensor is taken for blind: so one that sees is taken at its word."""
_LONG = 1.0
"""s."""


@dataclass(frozen=True, slots=True)
class Blindness:
    """How probably a sensor is blind, as of its last delivery.

    time : s.  probability : P(blind).  since : s, from when on it was taken for blind; NaN where it
        is not.
    """

    time: float
    probability: float = 0.0
    since: float = math.nan

    @property
    def blind(self) -> bool:
        return not math.isnan(self.since)

    @property
    def lasts(self) -> bool:
        """Whether it has been blind for so long that it should be said."""
        return self.time - self.since >= _LONG

    def told(self, name: str) -> str:
        """In words, of the sensor of that name."""
        return (
            f"the sensor '{name}' is taken for blind: it has detected nothing since "
            f"{self.since:g} s, though tracks are in its view; until it does, its misses do not "
            "count"
        )

    def after_detections(self, time: float) -> Blindness:
        """After a delivery with detections: who sees something is not blind."""
        return Blindness(time)

    def after_none(self, time: float, log_chance: float) -> Blindness:
        """After an empty delivery, of a log probability `log_chance` if the sensor sees.

        It is taken for blind or not, by what is likelier: so one that sees is taken at its word.
        Once it is, only a detection says that it sees again: that nothing is in its view is no
        sign of it.
        """
        if self.blind:
            return replace(self, time=time)
        usual = _BLIND / (_SEEING + _BLIND)
        memory = math.exp(-(time - self.time) * (1 / _SEEING + 1 / _BLIND))
        before = usual + (self.probability - usual) * memory
        probability = before / (before + (1 - before) * math.exp(log_chance))
        return Blindness(time, probability, time if probability > _SURE else math.nan)


def log_chance_of_none(predicted: Density, P_D: FloatArray) -> float:
    """Log probability that none of the tracks is detected; P_D (H,) of the local hypotheses.

    False detections do not count: how many a sensor has is known worst of all.
    """
    local = predicted.local
    detected = predicted.hypothesis_probability() * local.existence * P_D
    each = summed(detected, local.track, len(predicted.track_id))
    return float(np.log1p(-np.minimum(each, 1 - 1e-12)).sum())
