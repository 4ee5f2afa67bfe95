"""Arguments and options that the commands on datasets share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

from pmbm.cli.options import FILE, FOLDER, Decorator, jobs

__all__ = [
    "FILE", "FOLDER", "beside", "classes", "dataset", "detected", "detections", "jobs", "poses",
    "root", "rule", "sequences",
]  # fmt: skip

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
beside: Final = click.option(
    "--beside",
    multiple=True,
    metavar="PATH",
    help="Detections of another detector on the same sequences: a fit is held to what all such "
    "say, instead of to what is known before.  Can be repeated.",
)
rule: Final = click.option("--rule", help="One of the dataset's own.  [default: its first]")


def root(help_text: str, *, kind: click.Path = ROOT, required: bool = True) -> Decorator:
    """The option for the dataset's folder."""
    return click.option("--root", type=kind, required=required, help=help_text)


def detections(help_text: str, *, required: bool = True) -> Decorator:
    """The option for the detections."""
    return click.option("--detections", metavar="PATH", required=required, help=help_text)


def detected(root_help: str, detections_help: str, *, kind: click.Path = ROOT) -> Decorator:
    """The argument and the options of a command that reads a dataset's detections."""
    parts = (dataset, root(root_help, kind=kind), detections(detections_help), poses, classes,
             sequences)  # fmt: skip

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for part in reversed(parts):
            command = part(command)
        return command

    return decorate
