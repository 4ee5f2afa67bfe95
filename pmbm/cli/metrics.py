"""`pmbm metrics`: which metric answers which question."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

if TYPE_CHECKING:
    from pmbm.metrics.core.family import Family
    from pmbm.metrics.core.result import Metric

_HEADER: Final = ["metric", "question", "unit", "better", "given"]


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME...]")
@click.option("--markdown", metavar="FILE|-", help="Write the page of all metrics, and no table.")
def command(names: tuple[str, ...], markdown: str | None) -> None:
    """List the metrics by name, with the question each answers; a name that ends in "_observable"
    scores only what could be seen.

    \b
    Examples:
      pmbm metrics
      pmbm metrics gospa id_kept
      pmbm metrics --markdown docs/metrics.md
    """
    from pmbm.durable import replace_text
    from pmbm.metrics.catalogue import FAMILIES, definition

    if markdown is not None:
        text = "\n".join(_page())
        if markdown == "-":
            click.echo(text, nl=False)
        else:
            replace_text(Path(markdown), text)
        return
    every = [metric for family in FAMILIES for metric in family.metrics]
    _show([definition(name) for name in names] or every)


def _show(metrics: list[Metric]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for name in _HEADER:
        table.add_column(name, no_wrap=name != "question")
    for metric in metrics:
        table.add_row(*_row(metric))
    Console().print(table, markup=False)


def _row(metric: Metric) -> list[str]:
    better = "" if metric.direction == "none" else metric.direction
    given = "always" if metric.default else "by name"
    return [metric.name, metric.question, metric.unit, better, given]


_BEFORE: Final = """\
# Metrics: which answers which question

`pmbm metrics --markdown docs/metrics.md` writes this page. `evaluate(recording, tracks)` gives
every metric by name, those marked "by name" where they are asked for, each with its rule, unit,
direction and, where there is one, its value frame by frame. A name scores all objects; the same
name with `_observable` at its end scores only objects that could be seen: an object that is not
observable in a frame is ignored there, matched it counts neither way, missed it is no miss. What is
undefined is `None` with a reason.
"""
_BENCHMARKS: Final = """\
## Benchmarks

Each benchmark's own rules, its quirks only under its name: `pmbm evaluate DATASET --rule RULE`, and
as functions in `pmbm.metrics.benchmarks`.
"""


def _page() -> Iterator[str]:
    """The lines of docs/metrics.md."""
    from pmbm.datasets import DATASETS, adapter
    from pmbm.metrics.catalogue import FAMILIES
    from pmbm.reports.tables import markdown_table

    yield _BEFORE
    for family in FAMILIES:
        yield f"## {family.name}"
        yield ""
        yield f"{family.rule[0].upper()}{family.rule[1:]}{_parameters(family)}."
        yield ""
        rows = [[f"`{name}`", *rest] for name, *rest in map(_row, family.metrics)]
        yield markdown_table(_HEADER, rows, len(_HEADER))
        yield ""
    yield _BENCHMARKS
    rows = [
        [dataset, f"`{name}`", rule.says, ", ".join(rule.shown)]
        for dataset in DATASETS
        for name, rule in adapter(dataset).rules.items()
    ]
    yield markdown_table(["dataset", "rule", "compares", "figures"], rows, 4)
    yield ""


def _parameters(family: Family) -> str:
    """The parameters that the family counts with by default, from its values."""
    import numpy as np

    from pmbm.metrics.core.family import Work
    from pmbm.metrics.core.parameters import MetricParameters
    from pmbm.metrics.core.result import settings
    from pmbm.metrics.core.scene import make_scene

    nothing = Work(make_scene([], []), MetricParameters())
    with np.errstate(all="ignore"):
        given = settings(family.count(nothing).parameters)
    return f". Parameters: {given}" if given else ""
