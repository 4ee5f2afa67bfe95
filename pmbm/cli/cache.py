"""`pmbm cache`: the scenes kept on disk."""

from __future__ import annotations

import time

import click


@click.group(invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Show what is in the cache of simulated scenes, list it, or clear it.

    The folder is PMBM_CACHE, or the platform's folder for caches.

    \b
    Examples:
      pmbm cache
      pmbm cache list
      pmbm cache clear --older-than 7
    """
    if context.invoked_subcommand is None:
        from pmbm.sim.scenario.cache import cache_folder, entries

        held = list(entries())
        click.echo(f"folder  {cache_folder()}")
        click.echo(f"scenes  {len(held)}")
        click.echo(f"size    {_megabytes(sum(entry.bytes for entry in held))}")


@command.command("list")
@click.argument("scenario", required=False)
def list_entries(scenario: str | None) -> None:
    """List the scenes that are kept, of one scenario or of all.

    \b
    Example:
      pmbm cache list truck_occlusion
    """
    from rich.console import Console
    from rich.table import Table

    from pmbm.errors import nearest_hint
    from pmbm.sim.scenario.cache import entries

    held = list(entries())
    names = {entry.scenario for entry in held}
    if scenario is not None and scenario not in names:
        click.echo(f"no scene of '{scenario}' is kept; {nearest_hint(scenario, names)}")
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("scenario")
    for heading in ("seed", "trial", "size", "used"):
        table.add_column(heading, justify="right")
    for entry in held:
        if scenario in (None, entry.scenario):
            table.add_row(
                entry.scenario,
                str(entry.seed),
                str(entry.trial),
                _megabytes(entry.bytes),
                _ago(time.time() - entry.used),
            )
    Console().print(table)


@command.command("clear")
@click.argument("scenario", required=False)
@click.option(
    "--older-than", type=click.FloatRange(min=0), metavar="DAYS", help="Only what lay unused."
)
def clear_entries(scenario: str | None, older_than: float | None) -> None:
    """Delete the scenes that are kept, of one scenario or of all.

    \b
    Example:
      pmbm cache clear --older-than 7
    """
    from pmbm.sim.scenario.cache import clear, entries

    latest = time.time() - 86400 * (older_than or 0)
    chosen = [
        entry
        for entry in entries()
        if scenario in (None, entry.scenario) and (older_than is None or entry.used < latest)
    ]
    freed = sum(entry.bytes for entry in chosen)
    click.echo(f"deleted {clear(chosen)} scenes, {_megabytes(freed)}")


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"


def _ago(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= length:
            return f"{seconds / length:.0f} {unit} ago"
    return "just now"
