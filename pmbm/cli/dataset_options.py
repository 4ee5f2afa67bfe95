"""Arguments and options that the commands on datasets share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

FOLDER: Final = click.Path(path_type=Path, file_okay=False)
FILE: Final = click.Path(path_type=Path, dir_okay=False)
ROOT: Final = click.Path(path_type=Path)
"""A folder; of Waymo, also the one file that holds the truth."""

dataset: Final = click.argument("dataset_name", metavar="DATASET")
poses: Final = click.option(
    "--poses", type=FOLDER, help="Poses, where the dataset has them elsewhere."
)
classes: Final = click.option(
    "--classes", multiple=True, metavar="CLASS...", help="[default: all scored ones]"
)
sequences: Final = click.option(
    "--sequences", multiple=True, metavar="NAME...", help="[default: all there are]"
)
rule: Final = click.option("--rule", help="One of the dataset's own.  [default: its first]")
jobs: Final = click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True)


def root(help_text: str, *, kind: click.Path = ROOT, required: bool = True) -> Decorator:
    """The option for the dataset's folder."""
    return click.option("--root", type=kind, required=required, help=help_text)


def detections(help_text: str, *, required: bool = True) -> Decorator:
    """The option for the detections."""
    return click.option("--detections", metavar="PATH", required=required, help=help_text)
