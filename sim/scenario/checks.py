"""Checks of scenario files for values that are possible each by itself and not together."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any, Final

from pmbm.errors import InputError, InputWarning, Verbatim, nearest_hint
from pmbm.sim import schema
from pmbm.sim.world.scene import Scene

_SAME_PLACE: Final = 0.5
"""m by which one road's end may miss the beginning of the next."""


def check_clock(form: schema.ScenarioForm, file: str | None) -> None:
    """Refuse rates, durations, sensors and occluders that contradict each other (InputError)."""
    if form.simulation_rate % form.rate:
        divisors = [d for d in range(1, form.simulation_rate + 1) if form.simulation_rate % d == 0]
        raise InputError(
            "the sensor's rate must divide the simulation's",
            file=file,
            field="rate",
            expected=f"one of {', '.join(map(str, divisors))}",
            got=form.rate,
        )
    if round(form.duration * form.rate) < 1:
        raise InputError("shorter than one frame", file=file, field="duration", got=form.duration)
    scene = form.scene
    if not isinstance(scene, schema.GymnasiumScene) and scene.ego and scene.sensor.pose:
        raise InputError(
            "the ego carries the sensor, so the sensor has no pose of its own",
            file=file,
            field="scene.sensor.pose",
            hint="leave out one of scene.ego and scene.sensor.pose",
        )
    if isinstance(scene, schema.RecordedScene) and not (scene.ego or scene.sensor.pose):
        raise InputError(
            "nothing carries the sensor",
            file=file,
            field="scene.ego",
            expected="the id of a vehicle, or sensor = { pose = [x, y, yaw_deg] }",
        )
    if isinstance(scene, schema.RoadScene):
        _check_roads(scene, file)
    for name, sensor in form.sensors.items():
        _check_sensor(form, name, sensor, file)
    for name, occluder in scene.occluders.items():
        if (occluder.box is None) == (occluder.polygon is None):
            raise InputError(
                "an occluder is a box or a polygon",
                file=file,
                field=f"scene.occluders.{name}",
                expected="exactly one of box and polygon",
            )


def _check_roads(scene: schema.RoadScene, file: str | None) -> None:
    """Refuse roads that lead to one that begins elsewhere, copies that stand in each other, and
    more arrivals than a lane can carry (InputError)."""
    for name, road in scene.roads.items():
        follower = scene.roads.get(road.leads_to or "")
        end = _end(road, last=True)
        start = None if follower is None else _end(follower, last=False)
        if end is None or start is None:
            continue
        apart = math.dist(end, start)
        if apart > _SAME_PLACE:
            raise InputError(
                f"road '{name}' does not end where '{road.leads_to}' begins",
                file=file,
                field=f"scene.roads.{name}.leads_to",
                expected=f"a road that begins at ({end[0]:.3g}, {end[1]:.3g})",
                got=Verbatim(f"({start[0]:.3g}, {start[1]:.3g}), {apart:.3g} m from there"),
            )
    for name, actor in scene.actors.items():
        length, _, _ = actor.size
        if actor.count > 1 and abs(actor.spacing) < length and not actor.jitter.spawn:
            raise InputError(
                "copies stand in each other",
                file=file,
                field=f"scene.actors.{name}.spacing",
                expected=f"at least the length of each, {length:g} m",
                got=Verbatim(f"{actor.spacing:g} m"),
            )
    for name, entry in scene.entries.items():
        length, _, _ = entry.size
        if entry.rate * length > entry.speed:
            raise InputError(
                "more arrivals than a lane can carry",
                file=file,
                field=f"scene.entries.{name}.rate",
                expected=f"at most {entry.speed / length:.3g} a second, bumper to bumper",
                got=entry.rate,
            )


def _end(road: schema.Road, *, last: bool) -> tuple[float, float] | None:
    """The place where the road begins or ends, m, or None where the file does not say it whole."""
    if road.start is not None and road.end is not None:
        x, y = road.end if last else road.start
        return x, y
    if road.centre is None or road.radius is None or road.from_deg is None or road.to_deg is None:
        return None
    angle = math.radians(road.to_deg if last else road.from_deg)
    return (
        road.centre[0] + road.radius * math.cos(angle),
        road.centre[1] + road.radius * math.sin(angle),
    )


def check_in_range(scene: Scene, form: schema.ScenarioForm, file: str | None) -> None:
    """Warn of a scene none of whose objects ever came within the sensor's range (InputWarning):
    its truth is empty, although the file places objects."""
    world = form.scene
    placed: list[schema.Track | schema.Actor] = [*world.tracks.values()]
    if isinstance(world, schema.RoadScene):
        placed += world.actors.values()
    recorded = isinstance(world, schema.RecordedScene)
    if any(map(len, scene.truth)) or not (recorded or any(each.count for each in placed)):
        return
    where = f" (file {file})" if file else ""
    warnings.warn(
        f"scenario '{scene.name}': no object ever comes within the sensor's range of "
        f"{scene.site.max_range:g} m, so that the truth is empty{where}",
        InputWarning,
        stacklevel=3,
    )


def _check_sensor(
    form: schema.ScenarioForm, name: str, sensor: schema.MountedSensorForm, file: str | None
) -> None:
    """Refuse one of several sensors that the scenario's clock or scene cannot have (InputError)."""

    def bad(problem: str, key: str, **details: Any) -> InputError:
        return InputError(problem, file=file, field=f"sensors.{name}.{key}", **details)

    rate = sensor.rate or form.rate
    if form.rate % rate:
        divisors = [d for d in range(1, form.rate + 1) if form.rate % d == 0]
        raise bad(
            "a sensor's rate must divide the scenario's",
            "rate",
            expected=f"one of {', '.join(map(str, divisors))}",
            got=rate,
            hint="raise the scenario's rate: that of its truth",
        )
    frames = sensor.phase * form.rate
    if abs(frames - round(frames)) > 1e-6 or round(frames) >= form.rate // rate:
        raise bad(
            "no phase of this sensor",
            "phase",
            expected=f"a multiple of 1/{form.rate} s below 1/{rate} s",
            got=sensor.phase,
        )
    reach, offset = form.scene.sensor.max_range, math.hypot(*sensor.mount[:2])
    if offset >= reach or (sensor.max_range or 0.0) + offset > reach:
        raise bad(
            "the sensor sees farther than the scene goes",
            "mount" if sensor.max_range is None else "max_range",
            expected=f"with its offset at most scene.sensor.max_range = {reach:g} m",
            got=offset + (sensor.max_range or 0.0),
            hint="raise scene.sensor.max_range",
        )


def check_sweep(form: schema.ScenarioForm, document: Mapping[str, Any], file: str | None) -> None:
    """Refuse a sweep whose levels or keys cannot be (InputError)."""
    sweep = form.sweep
    assert sweep is not None

    def bad(problem: str, key: str, **details: Any) -> InputError:
        return InputError(problem, file=file, field=f"sweep.{key}", **details)

    if len(set(map(repr, sweep.levels))) < len(sweep.levels):
        raise bad("each level once", "levels", got=sweep.levels)
    if sweep.default is not None and sweep.default not in sweep.levels:
        raise bad("not one of the levels", "default", expected=sweep.levels, got=sweep.default)
    for key, values in sweep.set.items():
        if len(values) != len(sweep.levels):
            raise bad(
                "one value a level", f"set.{key}", expected=len(sweep.levels), got=len(values)
            )
    roots = [name for name in schema.ScenarioForm.model_fields if name not in ("name", "sweep")]
    for key in sweep.set or (sweep.parameter,):
        root, *rest = key.split(".")
        if root not in roots:
            raise bad(
                f"no key '{key}' in a scenario file",
                "set" if sweep.set else "parameter",
                hint=nearest_hint(root, roots, "first part"),
            )
        check_sensor_in(
            document, key, file=file, field="sweep.set" if sweep.set else "sweep.parameter"
        )
        table: Any = document
        for part in (root, *rest[:-1]):
            table = table.get(part, {}) if isinstance(table, Mapping) else None
        if rest and not isinstance(table, Mapping):
            raise bad(f"'{key}' names no table of this file", "set" if sweep.set else "parameter")
    if not form.check.monotone and not form.check.why:
        raise InputError("a factor that is not monotone says why", file=file, field="check.why")


def check_sensor_in(document: Mapping[str, Any], key: str, **where: Any) -> None:
    """Refuse a dotted key of a sensor that a scenario's document does not have (InputError): it
    would stand for one more sensor.

    where : of the error (`file=`, `field=`).
    """
    root, *rest = key.split(".")
    names = list(document.get("sensors", {}))
    if root == "sensors" and len(rest) > 1 and rest[0] not in names:
        raise InputError(
            f"no sensor '{rest[0]}' in the scenario",
            expected=" or ".join(names) or "none: it has a single sensor",
            got=key,
            hint=nearest_hint(rest[0], names, "sensor") if names else "sweep keys of detector",
            **where,
        )
