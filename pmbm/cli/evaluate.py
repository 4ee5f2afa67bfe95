"""`pmbm evaluate`: any tracker's output, by the rules of the dataset it was made on."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import click

from pmbm.cli import dataset_options, options
from pmbm.cli.many import ManyValues

Figures = Mapping[str, "float | None"]


@click.command(cls=ManyValues)
@dataset_options.dataset
@dataset_options.root("The dataset's folder, with its truth.")
@click.option(
    "--results",
    type=click.Path(path_type=Path),
    required=True,
    help="What a tracker wrote: a folder, or what pmbm submit packs it into.",
)
@dataset_options.classes
@dataset_options.sequences
@click.option(
    "--rule",
    metavar="NAME",
    help="One of the dataset's own, for kitti iou3d, bev, iou2d or devkit.  [default: its first]",
)
@click.option("--each", is_flag=True, help="A row for every sequence, too.")
@options.figures
@dataset_options.jobs
def command(
    dataset_name: str,
    root: Path,
    results: Path,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
    rule: str | None,
    each: bool,
    json_file: str | None,
    jobs: int,
) -> None:
    """Score RESULTS on DATASET by that dataset's own rules, class by class.  A sequence without a
    result is refused, never left out.

    \b
    Example:
      pmbm evaluate kitti --root kitti --results results --classes Car --sequences 0006 0008
    """
    from pmbm.cli.dataset_scores import rule_of, score_sequence
    from pmbm.cli.progress import spread
    from pmbm.datasets import chosen_sequences, open_dataset

    dataset = open_dataset(dataset_name, root=root, classes=classes or None)
    by = rule_of(dataset, rule)
    names = chosen_sequences(dataset, sequences)
    pairs = [(kind, name) for kind in dataset.classes for name in names]
    tasks = [(dataset, name, kind, results, rule) for kind, name in pairs]
    scored = dict(zip(pairs, spread(score_sequence, tasks, jobs, "sequences"), strict=True))
    table: dict[str, dict[str, Figures]] = {}
    reasons: dict[str, dict[str, dict[str, str]]] = {}
    for kind in dataset.classes:
        parts = {"all": names} | ({name: [name] for name in names} if each else {})
        runs = {part: [scored[kind, name] for name in own] for part, own in parts.items()}
        table[kind] = {part: by.figures(found) for part, found in runs.items()}
        reasons[kind] = {part: by.reasons(found) for part, found in runs.items()}
    if json_file is not None:
        figures = {"dataset": dataset_name, "rule": by.says, "scores": table, "reasons": reasons}
        write_json(json_file, figures)
    if json_file != "-":
        _show(f"{dataset_name}: {by.says}", table)
        for kind, rows in reasons.items():
            for part, found in rows.items():
                for line in undefined_lines(found):
                    click.echo(f"{kind}, {part}: {line}")


def write_json(file: str, figures: Mapping[str, object]) -> None:
    """Figures into a file, or to standard output as "-"."""
    from pmbm.durable import replace_text

    text = json.dumps(figures, indent=1, allow_nan=False)
    if file == "-":
        click.echo(text)
    else:
        replace_text(Path(file), text + "\n")


def _show(title: str, table: Mapping[str, Mapping[str, Figures]]) -> None:
    from rich.console import Console
    from rich.table import Table

    columns = list(next(iter(next(iter(table.values())).values())))
    shown = Table(title=title, title_justify="left")
    shown.add_column("class", no_wrap=True)
    shown.add_column("sequence", no_wrap=True)
    for name in columns:
        shown.add_column(name, justify="right", no_wrap=True)
    for kind, rows in table.items():
        for sequence, scores in rows.items():
            shown.add_row(kind, sequence, *(_cell(scores[name]) for name in columns))
        shown.add_section()
    console = Console()
    # A table that goes into a file or a pipe is not cut to the width of a screen.
    (console if console.is_terminal else Console(width=_PIPE_WIDTH)).print(shown)


def undefined_lines(reasons: Mapping[str, str]) -> Iterator[str]:
    """A line for each reason why figures of a row are undefined."""
    for reason in dict.fromkeys(reasons.values()):
        figures = [name for name, why in reasons.items() if why == reason]
        yield f"no {', '.join(figures)}: {reason}"


_PIPE_WIDTH = 200


def _cell(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:z.4f}"
