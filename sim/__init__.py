"""Synthetic traffic: scenes, a detector that errs like a real one, scenarios.

Public names are loaded when they are first used: importing `pmbm.sim` imports no simulator.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pmbm.sim.detector.model import DetectorModel, load_profile
    from pmbm.sim.scenario.scenario import Scenario, load_scenario, scenario_names
    from pmbm.sim.world.scene import Scene, make_scene

_HOME = {
    "DetectorModel": "pmbm.sim.detector.model",
    "Scenario": "pmbm.sim.scenario.scenario",
    "Scene": "pmbm.sim.world.scene",
    "load_profile": "pmbm.sim.detector.model",
    "load_scenario": "pmbm.sim.scenario.scenario",
    "make_scene": "pmbm.sim.world.scene",
    "scenario_names": "pmbm.sim.scenario.scenario",
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
        raise AttributeError(f"module 'pmbm.sim' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
