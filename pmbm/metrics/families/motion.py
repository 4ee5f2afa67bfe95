"""Motion: velocity and heading of matched objects, by the standard CLEAR matching."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from pmbm.arrays import FloatArray
from pmbm.geometry import wrap_angle
from pmbm.metrics.core.clear_matching import Matches
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import NO_MATCH, Ratio
from pmbm.metrics.core.result import Counts, Metric
from pmbm.metrics.core.scene import ScoredScene


def velocity_error(scene: ScoredScene, matches: Matches) -> FloatArray:
    """Length of the difference of velocities of each matched pair (A,), m/s."""
    difference = scene.tracks.velocity[matches.track] - scene.truth.velocity[matches.truth]
    return np.hypot(difference[:, 0], difference[:, 1])


def yaw_error(scene: ScoredScene, matches: Matches) -> FloatArray:
    """Absolute difference of yaws of each matched pair (A,), in [0, pi] rad."""
    return np.abs(wrap_angle(scene.tracks.yaw[matches.track] - scene.truth.yaw[matches.truth]))


@dataclass(frozen=True)
class RootMeanSquare:
    """Parts: the root of the mean square."""

    squares: str
    bottom: str

    def __call__(self, counts: Counts) -> Mapping[str, float]:
        if not counts[self.bottom]:
            return {}
        return {"root_mean_square": float(np.sqrt(counts[self.squares] / counts[self.bottom]))}


def _count(work: Work) -> Tally:
    speed = velocity_error(work.scene, work.matches)
    yaw = yaw_error(work.scene, work.matches)
    flipped = yaw > np.pi / 2
    return Tally.of(
        {
            "matches": len(work.matches),
            "velocity_error": float(speed.sum()),
            "velocity_square": float((speed**2).sum()),
            "yaw_error": float(yaw[~flipped].sum()),
            "upright": int((~flipped).sum()),
            "flips": int(flipped.sum()),
        },
        gate=work.parameters.gate,
    )


FAMILY: Final = Family(
    name="motion",
    rule="the pairs that CLEAR MOT matches",
    count=_count,
    metrics=(
        Metric(
            name="velocity_error",
            unit="m/s",
            direction="lower",
            question="How wrong is the velocity of matched objects?",
            formula=Ratio("velocity_error", "matches", NO_MATCH),
            parts=RootMeanSquare("velocity_square", "matches"),
        ),
        Metric(
            name="yaw_error",
            unit="rad",
            direction="lower",
            question="How wrong is the heading of matched objects that are not flipped?",
            formula=Ratio("yaw_error", "upright", "no matched object without a flipped heading"),
        ),
        share(
            name="yaw_flips",
            direction="lower",
            question="What share of matched objects points backwards (yaw off by more than 90 "
            "degrees)?",
            formula=Ratio("flips", "matches", NO_MATCH),
        ),
    ),
)
