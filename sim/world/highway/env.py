"""The one door to highway-env: what the project uses of it, and the scenes it registers.

Nothing else imports highway_env, and nothing imports this module before traffic is simulated:
it pulls in pygame, and pandas and matplotlib where an environment observes or draws.

highway-env's world has y pointing down and headings clockwise seen from above; everything here and
in `actors` and `traffic` beside it speaks its frame, and `traffic` mirrors what it records.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType
from typing import Any

from pmbm.errors import InputError, nearest_hint


class _Later(ModuleType):
    """A module that is imported when something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(import_module(self.__name__), name)


@contextmanager
def _imported_later(*names: str) -> Iterator[None]:
    """Let what is imported meanwhile have these modules as `_Later`, parents before what is in
    them, unless they are loaded already."""
    put: dict[str, ModuleType] = {}
    for name in names:
        if name in sys.modules:
            continue
        put[name] = sys.modules[name] = _Later(name)
        parent, _, own = name.rpartition(".")
        if parent in put:
            setattr(put[parent], own, put[name])
    try:
        yield
    finally:
        for name, module in put.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]


os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
# Together they take two seconds to load, and no recording needs them.
with warnings.catch_warnings(), _imported_later("pandas", "matplotlib", "matplotlib.pyplot"):
    # Rendering libraries that are never used here warn about their own dependencies.
    warnings.simplefilter("ignore")
    import gymnasium
    import highway_env  # noqa: F401  (registers the environments)
    from highway_env import utils
    from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
    from highway_env.road.regulation import RegulatedRoad
    from highway_env.road.road import Road, RoadNetwork
    from highway_env.vehicle.behavior import IDMVehicle
    from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
    from highway_env.vehicle.kinematics import Vehicle
    from highway_env.vehicle.objects import Landmark, Obstacle, RoadObject

__all__ = [
    "ENVIRONMENTS",
    "AbstractLane",
    "CircularLane",
    "ControlledVehicle",
    "IDMVehicle",
    "Landmark",
    "MDPVehicle",
    "Obstacle",
    "RegulatedRoad",
    "Road",
    "RoadNetwork",
    "RoadObject",
    "SineLane",
    "StraightLane",
    "Vehicle",
    "make_environment",
    "utils",
]

ENVIRONMENTS = (
    "exit-v1",
    "highway-v0",
    "intersection-v2",
    "merge-generic-v1",
    "merge-v1",
    "roundabout-generic-v1",
    "roundabout-v1",
    "two-way-v0",
    "u-turn-v1",
)
"""The registered scenes that may be recorded.  Where there are two versions it is the newer: the
older do not let cars see their leaders across road segments."""

_OURS = frozenset(
    {
        "simulation_frequency",
        "policy_frequency",
        "other_vehicles_type",
        "controlled_vehicles",
        "observation",
        "action",
        "neighbour_vehicles_connected_lanes",
    }
)
"""Keys of an environment's configuration that the recorder itself sets or stands on."""

_NOT_COUNTS = frozenset({"duration", "ego_spacing", "vehicles_density"})
"""Settings whose default happens to be a whole number, and which need not be one."""


def check_environment(env_id: str, config: Mapping[str, Any]) -> None:
    """Raise InputError where the id cannot be recorded, or where the configuration has a key that
    the environment does not know (highway-env itself swallows those in silence)."""
    if env_id not in ENVIRONMENTS:
        raise InputError(
            f"no recordable environment '{env_id}'",
            field="scene.id",
            hint=nearest_hint(env_id, ENVIRONMENTS, "id"),
        )
    known = _default_config(env_id)
    for key, value in config.items():
        if key in _OURS:
            raise InputError(
                f"'{key}' is set by the recorder",
                field=f"scene.config.{key}",
                hint="leave it out",
            )
        if key not in known:
            raise InputError(
                f"{env_id} has no setting '{key}'",
                field=f"scene.config.{key}",
                hint=nearest_hint(key, set(known) - _OURS, "setting"),
            )
        default = known[key]
        number = isinstance(default, int | float) and not isinstance(default, bool)
        fits = (
            isinstance(value, int | float) and not isinstance(value, bool)
            if number
            else default is None or isinstance(value, type(default))
        )
        if isinstance(default, int) and isinstance(value, float) and key not in _NOT_COUNTS:
            fits = False
        if not fits:
            raise InputError(
                f"{env_id} cannot use this value",
                field=f"scene.config.{key}",
                expected=f"{type(default).__name__} like {default!r}",
                got=value,
            )


def make_environment(
    env_id: str, config: Mapping[str, Any], *, vehicle_type: str, rate: int, seed: int
) -> Any:
    """The registered environment through `gymnasium.make`, reset with `seed`.

    vehicle_type : import path of the class of the other cars.  Always one of ours: environments
        write to that class (the intersection rewrites its headways), and on the stock class the
        write would reach every other scene of the process.
    rate : simulation steps a second, Hz.
    """
    settings = {
        **config,
        "simulation_frequency": rate,
        "policy_frequency": 1,
        "other_vehicles_type": vehicle_type,
        # Of nothing: no agent looks, and looking costs more than making the world.
        "observation": {"type": "AttributesObservation", "attributes": []},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = gymnasium.make(env_id, config=settings, disable_env_checker=True)
        # The constructor has already made one unseeded world; this one replaces it.
        env.reset(seed=seed)
    return env


def _default_config(env_id: str) -> dict[str, Any]:
    from gymnasium.envs.registration import load_env_creator

    entry_point = gymnasium.spec(env_id).entry_point
    assert isinstance(entry_point, str)
    config: dict[str, Any] = load_env_creator(entry_point).default_config()
    return config
