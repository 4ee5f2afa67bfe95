"""`pmbm scenarios`: the catalogue, or one scenario in words and as a picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import options

if TYPE_CHECKING:
    from pmbm.sim import Scenario


@click.command()
@click.argument("name", required=False, metavar="[NAME|FILE.toml]")
@click.option("--schema", is_flag=True, help="Print the JSON Schema of scenario files.")
@options.seed
@options.level
@options.folder("the picture")
def command(name: str | None, schema: bool, seed: int, level: str | None, out: Path) -> None:
    """List what ships, or show what one scenario stresses and draw it.

    \b
    Examples:
      pmbm scenarios
      pmbm scenarios truck_occlusion --level 4
      pmbm scenarios my_scene.toml --out pictures
      pmbm scenarios --schema > scenario.schema.json
    """
    if schema:
        from pmbm.sim.schema import json_schema

        click.echo(json.dumps(json_schema(), indent=1))
        return
    from pmbm.sim import load_scenario

    if name is None:
        _list()
        return
    scenario = load_scenario(name)
    if level is not None:
        scenario = scenario.at(level)
    out.mkdir(parents=True, exist_ok=True)
    _describe(scenario)
    click.echo(f"picture     {_draw(scenario, seed, out)}")


def _list() -> None:
    from pmbm.sim import load_scenario, scenario_names

    names = scenario_names()
    width = max(map(len, names))
    for name in names:
        click.echo(f"{name:{width}}  {load_scenario(name).stresses}")
    click.echo("\npmbm scenarios NAME shows one in full; pmbm run NAME tracks it.")


def _describe(scenario: Scenario) -> None:
    form = scenario.form
    rows = {
        "stresses": form.stresses,
        "scene": _kind(scenario),
        "duration": f"{form.duration:g} s at {form.rate:g} Hz",
        "detector": form.detector.get("profile", "nominal"),
        "sweeps": _swept(scenario) or "nothing",
    }
    if form.sweep is not None:
        rows["at level"] = f"{scenario.default_level:g}"
        rows["check"] = (
            "no significant improvement from one level to the next"
            if form.check.monotone
            else f"not monotone: {form.check.why}"
        )
    click.echo(scenario.name)
    for key, text in rows.items():
        click.echo(f"{key:11} {text}")


def _kind(scenario: Scenario) -> str:
    scene: Any = scenario.form.scene
    return scene.id if scene.kind == "gymnasium" else f"own {scene.kind}"


def _swept(scenario: Scenario) -> str:
    sweep = scenario.form.sweep
    if sweep is None:
        return ""
    levels = ", ".join(f"{level:g}" for level in sweep.levels)
    return f"{sweep.parameter.split('.')[-1]} {levels} {sweep.unit}".strip()


def _draw(scenario: Scenario, seed: int, out: Path) -> Path:
    from pmbm.reports.drawing import save
    from pmbm.reports.figures import scene_picture

    path = out / f"{scenario.name}.png"
    save(scene_picture(scenario.record(seed)), path)
    return path
