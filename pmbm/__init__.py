"""Prove a multi-object tracker in controlled traffic before it meets the road.

Public names are loaded when they are first used, so that `import pmbm` costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pmbm.baselines import ArgoverseTracker
    from pmbm.errors import BaselineMismatch, InputError
    from pmbm.filter import PMBMConfig, PMBMTracker
    from pmbm.metrics import evaluate
    from pmbm.tracking import Tracker, run
    from pmbm.types import (
        ABSENT,
        CLUTTER,
        Detections,
        GaussianMixture,
        GroundTruth,
        Label,
        Recording,
        Site,
        Tracks,
        TrackSequence,
    )

_HOME = {
    "ABSENT": "pmbm.types",
    "ArgoverseTracker": "pmbm.baselines",
    "BaselineMismatch": "pmbm.errors",
    "CLUTTER": "pmbm.types",
    "Detections": "pmbm.types",
    "GaussianMixture": "pmbm.types",
    "GroundTruth": "pmbm.types",
    "InputError": "pmbm.errors",
    "Label": "pmbm.types",
    "PMBMConfig": "pmbm.filter",
    "PMBMTracker": "pmbm.filter",
    "Recording": "pmbm.types",
    "Site": "pmbm.types",
    "TrackSequence": "pmbm.types",
    "Tracker": "pmbm.tracking",
    "Tracks": "pmbm.types",
    "evaluate": "pmbm.metrics",
    "run": "pmbm.tracking",
}

__all__ = [
    "ABSENT",
    "CLUTTER",
    "ArgoverseTracker",
    "BaselineMismatch",
    "Detections",
    "GaussianMixture",
    "GroundTruth",
    "InputError",
    "Label",
    "PMBMConfig",
    "PMBMTracker",
    "Recording",
    "Site",
    "TrackSequence",
    "Tracker",
    "Tracks",
    "evaluate",
    "run",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'pmbm' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
