"""`pmbm export`: recordings of scenarios or datasets as files that other programs read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from pmbm.cli import dataset_options, options
from pmbm.cli.many import ManyValues

if TYPE_CHECKING:
    from pmbm.types import Recording

Writer = Callable[["Recording", str, Path], Path]
"""Writes a recording under a name into a folder, and gives the file to look at first."""


def _csv(recording: Recording, name: str, out: Path) -> Path:
    return _tables(recording, name, out, "csv")


def _parquet(recording: Recording, name: str, out: Path) -> Path:
    return _tables(recording, name, out, "parquet")


def _mcap(recording: Recording, name: str, out: Path) -> Path:
    """A log without tracks."""
    from pmbm.datasets.files import Place, prepare_folder, safe_name
    from pmbm.reports.values import ReplayPage
    from pmbm.reports.viewers import write_log

    safe_name(name, Place(out), "name")
    file = prepare_folder(out) / f"{name}.mcap"
    write_log(ReplayPage(recording=recording, tracks={}, title=name), file)
    return file


FORMATS: Final[dict[str, Writer]] = {"csv": _csv, "parquet": _parquet, "mcap": _mcap}
"""Of `--format`; a format is a function here."""


@click.command(cls=ManyValues)
@click.argument("source", metavar="SCENARIO|FILE.toml|DATASET")
@click.option(
    "--format", "form", type=click.Choice(list(FORMATS)), default="csv", show_default=True
)
@click.option("--out", type=dataset_options.FOLDER, required=True, help="Folder for the files.")
@options.seed
@options.trials
@options.level
@dataset_options.root("The dataset's folder.", required=False)
@dataset_options.detections("As for pmbm track.", required=False)
@dataset_options.poses
@dataset_options.classes
@dataset_options.sequences
@click.pass_context
def command(
    context: click.Context,
    source: str,
    form: str,
    out: Path,
    seed: int,
    trials: int,
    level: str | None,
    root: Path | None,
    detections: str | None,
    poses: Path | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
) -> None:
    """Write recordings as tables: truth, detections and poses, one row a box, and table.toml; what
    the dataset `table` reads of them has the same bits (docs/guide/tables.md).  Or, as mcap, for a
    viewer (docs/guide/viewers.md).

    \b
    Examples:
      pmbm export truck_occlusion --seed 7 --out logs
      pmbm export kitti --root kitti --detections 'kitti/detections/pointrcnn_{class}' \\
        --sequences 0006 --format parquet --out logs
    """
    from pmbm.datasets import DATASETS

    if source in DATASETS:
        _refuse(context, source, ("seed", "trials", "level"))
        recordings = _logged(source, root, detections, poses, classes, sequences)
    else:
        _refuse(context, source, ("root", "detections", "poses", "classes", "sequences"))
        recordings = _simulated(source, seed, trials, level)
    for name, recording in recordings:
        click.echo(FORMATS[form](recording, name, out))


def _simulated(
    name: str, seed: int, trials: int, level: str | None
) -> Iterator[tuple[str, Recording]]:
    from pmbm.cli.sources import resolve

    source = resolve(name, {} if level is None else {"level": level})
    for trial in range(trials):
        plain = source.name.replace("@", "_at_")
        yield f"{plain}-{seed}-{trial}", source.record(seed, trial)


def _logged(
    name: str,
    root: Path | None,
    detections: str | None,
    poses: Path | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
) -> Iterator[tuple[str, Recording]]:
    from pmbm.datasets import chosen_sequences, open_dataset

    dataset = open_dataset(
        name, root=root, detections=detections, poses=poses, classes=classes or None
    )
    for sequence in chosen_sequences(dataset, sequences):
        yield sequence, dataset.recording(sequence)


def _tables(recording: Recording, name: str, out: Path, form: str) -> Path:
    """The recording as tables, and table.toml.

    Raises InputError where the folder's table.toml tells of another site.
    """
    from pmbm.datasets.files import Place, prepare_folder, safe_name
    from pmbm.datasets.table import SETTINGS, site_document
    from pmbm.datasets.table_files import write_table
    from pmbm.durable import replace_text
    from pmbm.errors import InputError
    from pmbm.sim.toml_tables import toml_text
    from pmbm.tables.writing import recording_columns

    safe_name(name, Place(out), "name")
    text = toml_text({"frame": "world", "site": site_document(recording.site)})
    settings = prepare_folder(out) / SETTINGS
    if settings.exists() and settings.read_text(encoding="utf-8") != text:
        raise InputError(
            "tables of another site", file=settings, hint="write them into a folder of their own"
        )
    replace_text(settings, text)
    for what, columns in recording_columns(recording).items():
        write_table(prepare_folder(out / what) / f"{name}.{form}", columns)
    return out / "truth" / f"{name}.{form}"


def _refuse(context: click.Context, source: str, names: tuple[str, ...]) -> None:
    """Raise InputError for options that do not concern the source."""
    from pmbm.errors import InputError

    for name in names:
        if context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
            raise InputError(f"'{source}' takes no such option", field=f"--{name}")
