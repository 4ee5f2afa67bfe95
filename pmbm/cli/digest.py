"""`pmbm digest`: one line that is equal where the results are equal."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("store", type=click.Path(path_type=Path, dir_okay=False), metavar="STORE.sqlite")
def command(store: Path) -> None:
    """Print a hash of a study's results, and how many there are.

    Equal results give equal lines, whatever computed them, in whatever order and in however many
    attempts.

    \b
    Example:
      pmbm digest night.sqlite
    """
    from pmbm.study import read_store

    contents = read_store(store)
    click.echo(f"{contents.digest()} {len(contents.rows)} trials")
