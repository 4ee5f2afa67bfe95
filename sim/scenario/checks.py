"""What a scenario file may not say although each of its values is possible by itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmbm.errors import InputError, nearest_hint
from pmbm.sim import schema


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
    for name, occluder in scene.occluders.items():
        if (occluder.box is None) == (occluder.polygon is None):
            raise InputError(
                "an occluder is a box or a polygon",
                file=file,
                field=f"scene.occluders.{name}",
                expected="exactly one of box and polygon",
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
        table: Any = document
        for part in (root, *rest[:-1]):
            table = table.get(part, {}) if isinstance(table, Mapping) else None
        if rest and not isinstance(table, Mapping):
            raise bad(f"'{key}' names no table of this file", "set" if sweep.set else "parameter")
    if not form.check.monotone and not form.check.why:
        raise InputError("a factor that is not monotone says why", file=file, field="check.why")
