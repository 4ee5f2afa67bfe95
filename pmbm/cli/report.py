"""`pmbm report`: a stored study as one HTML file, and as Markdown for a pull request."""

from __future__ import annotations

from pathlib import Path

import click

from pmbm.cli import options
from pmbm.cli.options import FILE


@click.command()
@click.argument("store", type=FILE, metavar="STORE.sqlite")
@click.option(
    "--study",
    type=FILE,
    metavar="FILE.toml",
    help="The study's file, beside which its scenarios' files are.  [default: STORE.toml]",
)
@options.folder("the page")
@click.option("--markdown", metavar="FILE|-", help="Also write Markdown for a pull request.")
@click.option(
    "--worst",
    type=click.IntRange(min=0),
    default=3,
    show_default=True,
    help="How many of the worst trials to play again in the page.",
)
@click.option(
    "--reference",
    metavar="TRACKER",
    help="The tracker that the others are compared with.  [default: the study's first]",
)
def command(
    store: Path,
    study: Path | None,
    out: Path,
    markdown: str | None,
    worst: int,
    reference: str | None,
) -> None:
    """Write a study's results as one page that opens from disk; also while the study runs.

    \b
    Examples:
      pmbm report night.sqlite
      pmbm report night.sqlite --worst 0 --markdown -
    """
    from pmbm.cli.sources import resolve
    from pmbm.durable import replace_text
    from pmbm.reports.study_report import study_markdown, study_page
    from pmbm.reports.study_source import stored_report

    report = stored_report(store, resolve, study=study, worst=worst, reference=reference)
    out.mkdir(parents=True, exist_ok=True)
    page = out / f"{store.stem}.html"
    replace_text(page, study_page(report))
    click.echo(f"{page}", err=True)
    if markdown == "-":
        click.echo(study_markdown(report), nl=False)
    elif markdown is not None:
        replace_text(Path(markdown), study_markdown(report))
