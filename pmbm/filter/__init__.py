"""The Poisson multi-Bernoulli mixture filter (Pang & Radha, ICASSP 2021).

Letters used in this folder alone:

    F, Q     how a state moves over one interval, and the noise added, over [x, y, vx, vy]
    H, R     what of it is measured ([x, y]), and the measurement's covariance
    P, S     covariance of a state, and of a measurement expected from it: S = H P H' + R
    K, W     Kalman gain, and the same for whitened innovations: K = W L^-1 with S = L L'
    r        probability that an object exists
    w        weight of a hypothesis or of a component; all are kept as logs
    P_D, P_S probability of being detected, and of living on
    e        expected density of first detections at a measurement: sum of w P_D N(z)
    lambda_c density of clutter, per m^2 and frame
"""

from __future__ import annotations

from typing import Any

from pmbm.errors import InputError
from pmbm.filter.config import PMBMConfig, Reduction, Report
from pmbm.filter.explain.inspection import Inspection
from pmbm.filter.models.birth import BroadBirth
from pmbm.filter.models.birth_map import BirthMap
from pmbm.filter.models.detection import DetectionChain, DetectionFromScores, FixedDetection
from pmbm.filter.models.motion import ConstantVelocity, Survival
from pmbm.filter.models.object_classes import ObjectClasses
from pmbm.filter.models.score_levels import LastingScores, ScoreLevels
from pmbm.filter.models.score_record import RecordWeights, ScoreRecord
from pmbm.filter.models.scores import EveryScore, FirstScore, IgnoreScores
from pmbm.filter.models.sensor import Sensor
from pmbm.filter.smoothing import smooth
from pmbm.filter.tracker import PMBMTracker, State, step

__all__ = [
    "BirthMap",
    "BroadBirth",
    "ConstantVelocity",
    "DetectionChain",
    "DetectionFromScores",
    "EveryScore",
    "FirstScore",
    "FixedDetection",
    "IgnoreScores",
    "Inspection",
    "LastingScores",
    "ObjectClasses",
    "PMBMConfig",
    "PMBMTracker",
    "RecordWeights",
    "Reduction",
    "Report",
    "ScoreLevels",
    "ScoreRecord",
    "Sensor",
    "State",
    "Survival",
    "smooth",
    "step",
]

_RENAMED = {"Kinds": "ObjectClasses", "Levels": "ScoreLevels", "Visibility": "DetectionChain"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        raise InputError(f"pmbm.filter has no '{name}'", hint=f"it is now {_RENAMED[name]}")
    raise AttributeError(f"module 'pmbm.filter' has no attribute {name!r}")
