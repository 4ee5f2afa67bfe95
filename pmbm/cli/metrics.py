"""`pmbm metrics`: which metric answers which question."""

from __future__ import annotations

import click


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME...]")
def command(names: tuple[str, ...]) -> None:
    """List the metrics by name, with the question each answers; a name that ends in "_observable"
    scores only what could be seen.

    \b
    Examples:
      pmbm metrics
      pmbm metrics gospa id_kept
    """
    from rich.console import Console
    from rich.table import Table

    from pmbm.metrics.catalogue import definition, every

    shown = [definition(name) for name in names] or list(every())
    table = Table(box=None, pad_edge=False)
    table.add_column("metric", no_wrap=True)
    table.add_column("question")
    table.add_column("unit", no_wrap=True)
    table.add_column("better", no_wrap=True)
    table.add_column("given", no_wrap=True)
    for entry in shown:
        better = "" if entry.direction == "none" else entry.direction
        given = "always" if entry.default else "by name"
        table.add_row(entry.name, entry.answers, entry.unit, better, given)
    Console().print(table, markup=False)
