"""`pmbm versus`: one tracker of a stored study against each of the others."""

from __future__ import annotations

from pathlib import Path

import click

FILE = click.Path(path_type=Path, dir_okay=False)


@click.command()
@click.argument("store", type=FILE, metavar="STORE.sqlite")
@click.option("--metric", default="gospa", show_default=True)
@click.option("--reference", metavar="TRACKER", help="[default: the study's first]")
@click.option("--out", type=FILE, metavar="FILE.md", help="[default: standard output]")
def command(store: Path, metric: str, reference: str | None, out: Path | None) -> None:
    """Where a study's first tracker is better, no different or worse than each of the others, as a
    table in Markdown: paired differences, adjusted by Holm over all of them.

    \b
    Example:
      pmbm versus night.sqlite --metric gospa --out night.md
    """
    import shlex

    from pmbm.durable import replace_text
    from pmbm.errors import InputError, nearest_hint
    from pmbm.reports.versus import versus_markdown
    from pmbm.study import load_results
    from pmbm.tracking import SHIPPED_BOUNDS

    results = load_results(store)
    if reference is not None and reference not in results.trackers:
        hint = nearest_hint(reference, results.trackers, "tracker")
        raise InputError(f"no tracker '{reference}' in this study", field="--reference", hint=hint)
    trackers = results.document["cells"][0]["trackers"]
    bounds = [one["name"] for one in trackers if one["factory"] in SHIPPED_BOUNDS]
    words = ["pmbm", "versus", store.name, "--metric", metric]
    words += [] if reference is None else ["--reference", reference]
    commands = [shlex.join(["pmbm", "study", f"{results.name}.toml"]), shlex.join(words)]
    text = versus_markdown(results, metric, reference=reference, bounds=bounds, commands=commands)
    if out is None:
        click.echo(text, nl=False)
    else:
        replace_text(out, text)
        click.echo(out)
