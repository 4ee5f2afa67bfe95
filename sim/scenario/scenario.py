"""Scenarios: named worlds, as TOML files, that give a recording for a seed.

The scene (truth alone) and the detector are two steps: everything that changes only the detector
shares one scene.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import corners
from pmbm.provenance import provenance
from pmbm.sim import schema
from pmbm.sim.scenario.cache import cached
from pmbm.sim.scenario.checks import check_clock, check_in_range, check_sweep
from pmbm.sim.streams import Streams
from pmbm.sim.toml_tables import read_toml
from pmbm.sim.world import scripted
from pmbm.sim.world.apart import followed, marked_crashed
from pmbm.sim.world.recorded import files_state, recorded_paths
from pmbm.sim.world.scene import Scene
from pmbm.sim.world.trajectory import GROUP, Trajectory, to_scene
from pmbm.types import FloatArray, MountedSensor, Recording, Site

if TYPE_CHECKING:
    from pmbm.sim.detector.model import DetectorModel
    from pmbm.sim.detector.mounted import SimulatedSensor

_SCENE_KEYS = ("duration", "rate", "simulation_rate", "warmup", "scene")
"""The keys of a scenario's document that its truth depends on; the rest concerns the detector."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A world that can be recorded: a `Source` (it has `name` and `record`).

    document : the scenario's file as plain values, valid at every level of its sweep.
    file : where it came from, for messages.
    level : the swept level that it is held at; None is the file's default.
    """

    document: Mapping[str, Any]
    file: str | None = None
    level: Any = None
    form: schema.ScenarioForm = field(init=False, repr=False)

    def __post_init__(self) -> None:
        form = schema.parse(dict(self.document), self.file)
        object.__setattr__(self, "form", form)
        check_clock(form, self.file)
        if form.sweep is not None:
            check_sweep(form, self.document, self.file)
            for level in form.sweep.levels:
                at_level = schema.parse(self._document_at(level), self.file)
                check_clock(at_level, self.file)
        self._level(self.level)
        checked = []
        for level in self.levels or (None,):
            document = self._document_at(level)
            table = [document.get("detector"), document.get("sensors")]
            if table not in checked:
                self.detector(level)
                self.sensors(level)
                checked.append(table)

    def __repr__(self) -> str:
        return f"Scenario('{self.name}')"

    def __reduce__(self) -> tuple[Any, ...]:
        return Scenario, (dict(self.document), self.file, self.level)

    @property
    def name(self) -> str:
        """The file's name, with the level behind an @ where it is held at one."""
        return self.form.name if self.level is None else f"{self.form.name}@{self.level:g}"

    @property
    def stresses(self) -> str:
        return self.form.stresses

    @property
    def levels(self) -> tuple[Any, ...]:
        """The levels of the sweep, the null level first, or empty without a sweep."""
        return () if self.form.sweep is None else tuple(self.form.sweep.levels)

    @property
    def default_level(self) -> Any:
        """The level of a plain run: None without a sweep."""
        sweep = self.form.sweep
        if sweep is None or self.level is not None:
            return self.level
        return sweep.levels[0] if sweep.default is None else sweep.default

    def at(self, level: Any) -> Scenario:
        """The same scenario, held at a level: a Source of its own.

        Raises InputError for an unknown level.
        """
        return Scenario(self.document, self.file, self._level(level))

    def record(self, seed: int, trial: int = 0, level: Any = None) -> Recording:
        """The truth of one run and what the detector delivers of it.

        level : one of `levels`; None is `default_level`.
        Raises InputError for an unknown level or a seed that is not a whole number >= 0.
        """
        scene, sensors = self.scene(seed, trial, level), self.sensors(level)
        if sensors:
            from pmbm.sim.detector.mounted import detect_by_all

            return detect_by_all(scene, sensors, seed, trial)
        return self.detector(level).detect(scene, seed, trial)

    def scene(self, seed: int, trial: int = 0, level: Any = None) -> Scene:
        """The truth alone."""
        check_seed(seed, trial)
        document = self._document_at(self._level(level))
        # In the file's order, which numbers the objects.
        key = json.dumps({k: document[k] for k in _SCENE_KEYS if k in document})
        try:
            world = self.form.scene
            state = files_state(world) if isinstance(world, schema.RecordedScene) else ()
            scene = simulated_scene(key, self.form.name, int(seed), int(trial), state)
        except InputError as error:
            raise (error if error.file else error.located(file=self.file)) from None
        check_in_range(scene, self.form, self.file)
        return scene

    def detector(self, level: Any = None) -> DetectorModel:
        """The detector model at a level: of the one sensor, and of those among several that have
        none of their own."""
        table = self._document_at(self._level(level)).get("detector", {})
        return self._profile(table, "detector")

    @property
    def mounted(self) -> tuple[MountedSensor, ...]:
        """The sensors as trackers are told of them, where the scenario has several."""
        return tuple(sensor.mounted for sensor in self.sensors())

    def sensors(self, level: Any = None) -> tuple[SimulatedSensor, ...]:
        """The sensors at a level, where the scenario has several, or empty where it has one."""
        document = self._document_at(self._level(level))
        if not document.get("sensors"):
            return ()
        from pmbm.sim.detector.mounted import SimulatedSensor

        form = schema.parse(document, self.file)
        shared = self.detector(level)
        return tuple(
            SimulatedSensor(
                mounted=_mounted(name, sensor, form.scene.sensor.max_range),
                detector=shared
                if sensor.detector is None
                else self._profile(sensor.detector, f"sensors.{name}.detector"),
                every=form.rate // (sensor.rate or form.rate),
                first=round(sensor.phase * form.rate),
            )
            for name, sensor in form.sensors.items()
        )

    def _profile(self, table: Mapping[str, Any], key: str) -> DetectorModel:
        """The detector model that a table of this file describes."""
        from pmbm.sim.detector.model import load_profile

        overrides = dict(table)
        profile = overrides.pop("profile", "nominal")
        try:
            return load_profile(profile, overrides)
        except InputError as error:
            if error.file:
                raise
            # It is this file's own table that is wrong, not that of the profile's file.
            field = f"{key}.{error.field or 'profile'}"
            raise error.located(file=self.file, field=field) from None

    def base(self) -> Scenario:
        """The same file without its sweep: the factor is off, as written."""
        return Scenario({k: v for k, v in self.document.items() if k != "sweep"}, self.file)

    def _level(self, level: Any) -> Any:
        if level is None:
            return self.default_level
        if isinstance(level, str):
            # As commands have it.
            with contextlib.suppress(ValueError):
                level = float(level)
        if level not in self.levels:
            raise InputError(
                f"scenario '{self.form.name}' has no such level",
                expected=", ".join(map(str, self.levels)) or "no level: it sweeps nothing",
                got=level,
            )
        return level

    def _document_at(self, level: Any) -> dict[str, Any]:
        """The document with the swept keys set to their values at a level."""
        document = copy.deepcopy({k: v for k, v in self.document.items() if k != "sweep"})
        sweep = self.form.sweep
        if sweep is None or level is None:
            return document
        index = sweep.levels.index(level)
        columns = sweep.set or {sweep.parameter: sweep.levels}
        for key, values in columns.items():
            table = document
            *path, last = key.split(".")
            for part in path:
                table = table.setdefault(part, {})
            table[last] = values[index]
        return document


def _mounted(name: str, sensor: schema.MountedSensorForm, reach: float) -> MountedSensor:
    """The sensor as trackers are told of it, in a scene that goes as far as `reach`, m."""
    x, y, yaw_deg = sensor.mount
    return MountedSensor(
        name=name,
        mount=np.array([x, y, np.deg2rad(yaw_deg)]),
        fov_centre=float(np.deg2rad(sensor.fov_centre_deg)),
        fov_half_angle=min(float(np.deg2rad(sensor.fov_deg / 2)), float(np.pi)),
        max_range=sensor.max_range or reach - float(np.hypot(x, y)),
        latency=sensor.latency,
    )


def load_scenario(name_or_path: str | Path) -> Scenario:
    """The scenario of that name in the catalogue, or in that TOML file; with @LEVEL behind it,
    held at a level of its sweep.

    Raises InputError with the nearest valid name, or with the file and key that is wrong.
    """
    text, _, level = str(name_or_path).partition("@")
    path = Path(text)
    if not (text.endswith(".toml") or "/" in text or "\\" in text):
        names = scenario_names()
        if text not in names:
            raise InputError(f"no scenario '{text}'", hint=nearest_hint(text, names, "scenario"))
        path = catalogue_folder() / f"{text}.toml"
    document = _with_own_files(_extended(read_toml(path), str(path)), path.parent)
    scenario = Scenario(document, str(path))
    return scenario.at(level) if level else scenario


_OWN_KEYS = ("name", "stresses", "extends", "sweep", "check")
"""What a file never takes over from the one that it extends."""


def _extended(document: dict[str, Any], file: str) -> dict[str, Any]:
    """The document laid over that of the scenario which it extends, table by table."""
    if "extends" not in document:
        return document
    base_name, names = document["extends"], scenario_names()
    if base_name not in names:
        raise InputError(
            "extends no scenario of the catalogue",
            file=file,
            field="extends",
            got=base_name,
            hint=nearest_hint(base_name, names, "scenario"),
        )
    base_file = catalogue_folder() / f"{base_name}.toml"
    base = _with_own_files(read_toml(base_file), base_file.parent)
    if "extends" in base:
        raise InputError(
            "extends a scenario that itself extends another",
            file=file,
            field="extends",
            got=base_name,
            hint=f"extend '{base['extends']}'",
        )
    merged = {key: value for key, value in base.items() if key not in _OWN_KEYS}
    return _merge(merged, {key: value for key, value in document.items() if key != "extends"})


def _with_own_files(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The document with the files that it names, of recorded traffic and of detector profiles,
    found from its own folder."""
    scene = document.get("scene")
    if isinstance(scene, dict) and scene.get("kind") == "recorded":
        found = dict(scene)
        if isinstance(scene.get("file"), str):
            found["file"] = str(folder.absolute() / scene["file"])
        if isinstance(scene.get("types"), list):
            found["types"] = [str(folder.absolute() / str(name)) for name in scene["types"]]
        document = {**document, "scene": found}
    sensors = document.get("sensors")
    if isinstance(sensors, dict):
        own = {
            name: _with_own_files(sensor, folder) if isinstance(sensor, dict) else sensor
            for name, sensor in sensors.items()
        }
        document = {**document, "sensors": own}
    detector = document.get("detector")
    if not isinstance(detector, dict):
        return document
    profile = detector.get("profile")
    if not (isinstance(profile, str) and profile.endswith(".toml")):
        return document
    return {**document, "detector": {**detector, "profile": str(folder.absolute() / profile)}}


def _merge(under: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(under)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            value = _merge(below, value)
        merged[key] = value
    return merged


def scenario_names() -> tuple[str, ...]:
    """The names in the catalogue, sorted."""
    return tuple(sorted(path.stem for path in catalogue_folder().glob("*.toml")))


def catalogue_folder() -> Path:
    """The folder of the catalogue's files."""
    from importlib.resources import files

    folder = Path(str(files("pmbm.sim"))) / "scenarios"
    if not any(folder.glob("*.toml")):
        raise InputError("the catalogue of scenarios is missing", expected=folder)
    return folder


def check_seed(seed: int, trial: int) -> None:
    """Raise InputError unless both are whole numbers, at least zero."""
    for field_name, value in (("seed", seed), ("trial", trial)):
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not whole or value < 0:
            raise InputError(
                f"bad {field_name}", field=field_name, expected="a whole number >= 0", got=value
            )


@functools.lru_cache(maxsize=8)
def simulated_scene(
    key: str, name: str, seed: int, trial: int, _files: tuple[tuple[str, int, int], ...] = ()
) -> Scene:
    """The scene described by `key` (JSON of the document's scene part) and by its files' state,
    simulated at most once."""
    document = json.loads(key)
    form = schema.parse({"name": name, "stresses": "its own truth", **document})
    if isinstance(form.scene, schema.ScriptedScene | schema.RecordedScene):
        # As quickly made as read.
        return simulate(form, seed, trial)
    return cached(name, key, seed, trial, lambda: simulate(form, seed, trial))


def simulate(form: schema.ScenarioForm, seed: int, trial: int = 0) -> Scene:
    """Run the world of a form: its truth is a pure function of the form, the seed and the trial.

    Raises InputError where vehicles crash in a scene that refuses crashes.
    """

    world, streams = form.scene, Streams(seed, trial)
    frames = round(form.duration * form.rate)
    step = form.simulation_rate // form.rate
    # One tick more than the last frame needs, for central differences.
    ticks = (frames - 1) * step + 2
    own_path = world.ego if isinstance(world, schema.ScriptedScene) else None
    poses = scripted.sensor_poses(own_path, world.sensor.pose, ticks, form.simulation_rate)
    paths: list[Trajectory] = []
    drivable = None
    occluders = [_polygon(occluder) for occluder in world.occluders.values()]
    if isinstance(world, schema.RecordedScene):
        paths, carried = recorded_paths(world, ticks, form.simulation_rate)
        poses = poses if carried is None else carried
    elif not isinstance(world, schema.ScriptedScene):
        from pmbm.sim.world import traffic

        opened = (
            traffic.open_gymnasium(world, form.simulation_rate, streams)
            if isinstance(world, schema.GymnasiumScene)
            else traffic.open_roads(world, form.simulation_rate, streams)
        )
        occluders += traffic.obstacles(opened)
        drivable = tuple(traffic.drivable_area(opened))
        warmup = round(form.warmup * form.simulation_rate)
        paths, poses = traffic.drive(opened, ticks, warmup, world.sensor.max_range, poses)
        paths = marked_crashed(paths)
        if world.crashes == "refused":
            _refuse_crashes(form.name, seed, trial, opened, paths, form.simulation_rate)
    # Scripted groups come behind every group that a traffic scene may have.
    group = 1000 * GROUP
    solid = world.overlaps == "refused"
    tracks: list[Trajectory] = []
    for name, track in world.tracks.items():
        group += GROUP
        tracks += scripted.track_trajectories(
            group, name, track, ticks, form.simulation_rate, streams
        )
    if solid and tracks:
        reach = world.sensor.max_range
        tracks, overlap = followed(tracks, paths, poses, reach, form.simulation_rate)
        if overlap is not None:
            tick, first, second = overlap
            raise InputError(
                f"scenario '{form.name}' refuses overlaps, and {first.name} and {second.name} "
                f"overlap (seed {seed}, trial {trial}, t = {tick / form.simulation_rate:g} s)",
                field="scene.overlaps",
                hint='say overlaps = "allowed", or keep them apart',
            )
    paths += tracks
    if isinstance(world, schema.ScriptedScene):
        for name, births in world.births.items():
            group += GROUP
            paths += scripted.birth_trajectories(
                group,
                name,
                births,
                poses,
                world.sensor.max_range,
                form.simulation_rate,
                streams,
                paths if solid else None,
            )
    site = Site(
        occluders=tuple(occluders),
        fov_centre=float(np.deg2rad(world.sensor.fov_centre_deg)),
        fov_half_angle=min(float(np.deg2rad(world.sensor.fov_deg / 2)), float(np.pi)),
        max_range=world.sensor.max_range,
        drivable_area=drivable,
    )
    return to_scene(
        form.name,
        site,
        paths,
        poses,
        tick_rate=form.simulation_rate,
        rate=form.rate,
        frames=frames,
        provenance=provenance(scenario=form.name, seed=seed, trial=trial),
    )


def _refuse_crashes(
    name: str, seed: int, trial: int, opened: Any, paths: list[Any], tick_rate: int
) -> None:
    crashed = [
        (path.first + int(np.argmax(path.crashed)), path.name)
        for path in paths
        if any(path.crashed)
    ]
    if opened.ego is not None and opened.ego.crashed:
        crashed.append((0, "the ego"))
    if crashed:
        tick, who = min(crashed)
        raise InputError(
            f"scenario '{name}' refuses crashes, and {who} crashed (seed {seed}, trial {trial}, "
            f"t = {tick / tick_rate:g} s)",
            field="scene.crashes",
            hint='say crashes = "allowed", or keep the vehicles apart',
        )


def _polygon(occluder: schema.Occluder) -> FloatArray:
    if occluder.polygon is not None:
        return np.array(occluder.polygon)
    assert occluder.box is not None
    x, y, length, width, yaw_deg = occluder.box
    box = corners([[x, y, 0.0]], [[length, width, 1.0]], [np.deg2rad(yaw_deg)])
    return np.asarray(box[0])
