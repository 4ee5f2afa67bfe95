"""`pmbm submit`: results of many sequences as the one file that a benchmark takes."""

from __future__ import annotations

from pathlib import Path

import click

from pmbm.cli import dataset_options
from pmbm.cli.dataset_options import FOLDER
from pmbm.cli.many import ManyValues


@click.command(cls=ManyValues)
@dataset_options.dataset
@dataset_options.root("The dataset's folder.")
@click.option("--results", type=FOLDER, required=True, help="What pmbm track wrote.")
@dataset_options.detections("As for pmbm track, where there are no labels.", required=False)
@dataset_options.classes
@dataset_options.sequences
@click.option("--method", help="Waymo: the method's name, at most 25 characters.")
@click.option("--account", help="Waymo: the account that submits.")
def command(
    dataset_name: str,
    root: Path,
    results: Path,
    detections: str | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
    method: str | None,
    account: str | None,
) -> None:
    """Check RESULTS, sequence by sequence, and pack them into the file that the benchmark takes, in
    the same folder: a zip file (kitti, argoverse1), submission.json (nuscenes), submission.bin
    (waymo), submission.feather (argoverse2).

    \b
    Example:
      pmbm submit nuscenes --root v1.0-trainval --results results
    """
    import inspect

    from pmbm.datasets import chosen_sequences, open_dataset
    from pmbm.errors import InputError

    dataset = open_dataset(dataset_name, root=root, detections=detections, classes=classes or None)
    needed = inspect.signature(dataset.submit).parameters
    options: dict[str, str] = {}
    for name, given in (("method", method), ("account", account)):
        if name not in needed and given is not None:
            raise InputError(f"{dataset_name} takes no such option", field=f"--{name}")
        if name in needed:
            if given is None:
                raise InputError("missing option", field=f"--{name}")
            options[name] = given
    names = chosen_sequences(dataset, sequences)
    click.echo(dataset.submit(names, results, **options))
