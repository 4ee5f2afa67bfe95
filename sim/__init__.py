"""Synthetic traffic: scenes, a detector that errs like a real one, scenarios.

Public names are loaded when they are first used: importing `sim` imports no simulator.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sim.detector import DetectorModel, load_profile
    from sim.scenario import Scenario, load_scenario, scenario_names
    from sim.scene import Scene, make_scene

_HOME = {
    "DetectorModel": "sim.detector",
    "Scenario": "sim.scenario",
    "Scene": "sim.scene",
    "load_profile": "sim.detector",
    "load_scenario": "sim.scenario",
    "make_scene": "sim.scene",
    "scenario_names": "sim.scenario",
}

__all__ = [
    "DetectorModel",
    "Scenario",
    "Scene",
    "load_profile",
    "load_scenario",
    "make_scene",
    "scenario_names",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sim' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
