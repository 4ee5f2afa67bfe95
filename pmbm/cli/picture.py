"""`pmbm picture`: one frame of a trial, or its error over time, as SVG or PNG for a document."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmbm.cli import options, settings
from pmbm.cli.options import FILE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pmbm.reports.values import ReplayPage

KINDS = ("scene", "hidden", "errors")


@click.command()
@click.argument("scenario", metavar="NAME|FILE.toml")
@click.option(
    "--kind",
    type=click.Choice(KINDS),
    default="scene",
    show_default=True,
    help="The frame from above; where undetected objects are expected, for which pmbm keeps them "
    "place by place; or GOSPA in its parts.",
)
@click.option(
    "--tracker",
    "trackers",
    multiple=True,
    default=("pmbm",),
    show_default=True,
    metavar=options.TRACKER,
    help="A tracker to draw; give it several times for several panels.",
)
@settings.option
@click.option(
    "--frame", type=click.IntRange(min=0), help="[default: the one with the most hidden objects]"
)
@options.seed
@options.level
@click.option("--dark", is_flag=True, help="For a dark page.")
@click.option(
    "--out",
    type=FILE,
    help="FILE.svg or FILE.png.  [default: reports/NAME-KIND.png]",
)
def command(
    scenario: str,
    kind: str,
    trackers: tuple[str, ...],
    settings: tuple[str, ...],
    frame: int | None,
    seed: int,
    level: str | None,
    dark: bool,
    out: Path | None,
) -> None:
    """Draw one trial for a README or a paper.

    \b
    Examples:
      pmbm picture truck_occlusion --tracker pmbm --tracker argoverse --frame 120
      pmbm picture occluded_birth --kind hidden --out docs/hidden.svg
      pmbm picture crossing --kind errors --tracker pmbm --tracker waymo
    """
    from pmbm.cli.settings import named
    from pmbm.cli.sources import resolve
    from pmbm.errors import InputError
    from pmbm.reports.figures import save
    from pmbm.reports.replays import trial_replay

    if out is not None and out.suffix.lower() not in (".svg", ".png"):
        raise InputError("unknown format", field="--out", expected=".svg or .png", got=out.name)
    source = resolve(scenario, {} if level is None else {"level": level})
    chosen = named(trackers, settings)
    replay, result = trial_replay(source, chosen, seed, 0, with_maps=kind == "hidden")
    for name in chosen:
        result.of(name)
    figure = _figure(kind, replay, frame, dark=dark)
    out = out or Path("reports") / f"{source.name}-{kind}.png"
    out.parent.mkdir(parents=True, exist_ok=True)
    save(figure, out)
    click.echo(f"{out}")


def _figure(kind: str, replay: ReplayPage, frame: int | None, *, dark: bool) -> Figure:
    from pmbm.reports.figures import error_picture, hidden_traffic_picture, scene_picture

    recording, tracks = replay.recording, replay.tracks
    if kind == "errors":
        return error_picture(recording, tracks, dark=dark)
    if kind == "hidden":
        name = next(iter(tracks))
        return hidden_traffic_picture(
            recording, replay.maps.get(name, tracks[name]), frame, dark=dark
        )
    return scene_picture(recording, tracks, frame, dark=dark)
