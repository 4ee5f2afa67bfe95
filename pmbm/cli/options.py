"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

FOLDER: Final = click.Path(path_type=Path, file_okay=False)
FILE: Final = click.Path(path_type=Path, dir_okay=False)

jobs: Final = click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True)
seed: Final = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
trials: Final = click.option("--trials", type=click.IntRange(min=1), default=1, show_default=True)
level: Final = click.option("--level", help="One of the swept parameter.  [default: the file's]")
figures: Final = click.option(
    "--json", "json_file", metavar="FILE|-", help="Write the figures as JSON."
)
TRACKER: Final = "NAME|MODULE:FACTORY|exec:COMMAND"
"""How a tracker is named."""
tracker: Final = click.option(
    "--tracker", "tracker_name", default="pmbm", show_default=True, metavar=TRACKER
)
mode: Final = click.option(
    "--mode",
    type=click.Choice(["online", "batch"]),
    default="online",
    show_default=True,
    help="Report each frame as it comes, or look back from the end.",
)


def folder(of: str) -> Decorator:
    """The option for the folder of what a command shows."""
    return click.option(
        "--out", type=FOLDER, default=Path("reports"), show_default=True, help=f"Folder for {of}."
    )
