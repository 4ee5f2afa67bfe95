"""`pmbm study`: a Monte Carlo study that survives whatever ends it."""

from __future__ import annotations

import shlex
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import INTERRUPTED, options
from pmbm.cli.options import FILE
from pmbm.wording import counted, duration

if TYPE_CHECKING:
    from pmbm.study import Cell, Progress, Study


@click.command()
@click.argument("file", type=FILE, metavar="STUDY.toml")
@click.option(
    "--store",
    type=FILE,
    help="Where results go; run again to resume.  [default: STUDY.sqlite]",
)
@options.jobs
@click.option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, in place of --jobs.")
@click.option("--dry-run", is_flag=True, help="Count the trials and estimate the time.")
@click.option("--replay", type=click.IntRange(min=0), metavar="INDEX", help="Show one trial.")
@options.folder("a replay")
@click.option(
    "--export",
    "export_file",
    type=FILE,
    help="Write the scores as .csv or .parquet when done.",
)
def command(
    file: Path,
    store: Path | None,
    jobs: int,
    scheduler: str | None,
    dry_run: bool,
    replay: int | None,
    out: Path,
    export_file: Path | None,
) -> int:
    """Run a study; run it again to resume.  Exit code 1 where trials failed.

    \b
    Examples:
      pmbm study night.toml --jobs 4
      pmbm study night.toml --dry-run
      pmbm study night.toml --replay 17
      pmbm study night.toml --scheduler tcp://10.0.0.1:8786 --export night.csv
    """
    from pmbm.cli.sources import resolve
    from pmbm.study import run_study
    from pmbm.study.file import load_study

    study = load_study(file, resolve)
    _check_gate(study, file)
    store = store or file.with_suffix(".sqlite")
    if replay is not None:
        return _replay(study, file, replay, out)
    if dry_run:
        _estimate(study, store, jobs)
        return 0
    with _interrupted_by_term(), _progress(study) as tell:
        try:
            done = run_study(study, store, jobs=jobs, scheduler=scheduler, tell=tell)
        except KeyboardInterrupt:
            again = shlex.join(["pmbm", "study", str(file), "--store", str(store)])
            click.echo(f"pmbm: stopped; what is done is stored, resume with: {again}", err=True)
            return INTERRUPTED
    return _finish(study, file, store, done, export_file)


def _check_gate(study: Study, file: Path) -> None:
    """Raise InputError for a `[gate]` table that no gate could judge by."""
    from pmbm.errors import InputError
    from pmbm.regression import Rules, gated_metric

    if not study.gate:
        return
    rules = {key: value for key, value in study.gate.items() if key not in _NOT_OF_RULES}
    try:
        metric = gated_metric(study.gate["metric"], study.gate["bounds"])
        # A margin may be left to the command that gates.
        if rules["margin"] is not None or rules["relative_margin"] is not None:
            Rules(**rules).check_range(metric.value_range)
    except InputError as error:
        raise error.located(file=file, field=f"gate.{error.field or 'metric'}") from None


_NOT_OF_RULES = ("metric", "bounds", "candidate")


def _finish(study: Study, file: Path, store: Path, done: Progress, export_file: Path | None) -> int:
    from pmbm.study import export, load_results, read_store

    for index in done.damaged:
        click.echo(f"trial {index} was damaged in the store and was run again", err=True)
    # Tables take a second to load: only where somebody looks at them.
    contents = read_store(store)
    if any(row.outcome != "ok" for row in contents.rows.values()):
        _tell_failures(study, file, load_results(store).failures.to_dict("records"))
    digest = None if contents.damaged else contents.digest()
    click.echo(f"{store}: {done.done} trials, {done.failed} failed, digest {digest}")
    if export_file is not None:
        export(load_results(store), export_file)
    return 1 if done.failed else 0


def _tell_failures(study: Study, file: Path, failures: Sequence[Mapping[Any, Any]]) -> None:
    """Print each kind of failure once, with the command that replays its first trial."""
    kinds: dict[tuple[str, str], list[Mapping[Any, Any]]] = {}
    for row in failures:
        kinds.setdefault((row["outcome"], row["error"]), []).append(row)
    for (outcome, error), (row, *like) in list(kinds.items())[:_MOST_KINDS]:
        label = study.cells[row["cell"]].label
        again = shlex.join(["pmbm", "study", str(file), "--replay", str(row["index"])])
        others = f", and in {len(like)} more" if like else ""
        click.echo(f"{outcome}: trial {row['trial']} of {label}{others}: {error}; replay: {again}")
        if row["note"] and not row["note"].startswith("Traceback"):
            click.echo(row["note"])
    if len(kinds) > _MOST_KINDS:
        click.echo(f"and {counted(len(kinds) - _MOST_KINDS, 'other kind')} of failure")


_MOST_KINDS = 20
"""Kinds of failures that are printed."""


def _estimate(study: Study, store: Path, jobs: int) -> None:
    """Count what is left, and time a trial of up to three cells where nothing is stored yet."""
    import time

    from pmbm.study import load_results

    done, seconds = 0, []
    if store.exists():
        results = load_results(store)
        done = results.done
        seconds = results.outcomes["seconds"].dropna().tolist()
    if not seconds:
        for index in range(min(3, len(study.cells))):
            start = time.perf_counter()
            study.run(index)
            seconds.append(time.perf_counter() - start)
    each = sum(seconds) / len(seconds)
    left = max(len(study) - done, 0)
    click.echo(
        f"{len(study)} trials ({len(study.cells)} cells x {study.trials}), {done} stored, "
        f"{left} to run: about {duration(left * each / jobs)} with "
        f"{counted(jobs, 'process', 'processes')} ({each:.2g} s a trial)"
    )


def _replay(study: Study, file: Path, index: int, out: Path) -> int:
    """Run one trial here and write its replay as a page."""
    from pmbm.errors import InputError

    if index >= len(study):
        raise InputError(
            "no such trial", field="--replay", expected=f"0 to {len(study) - 1}", got=index
        )
    cell, trial = study.cell(index), study.trial(index)
    command = shlex.join(["pmbm", "study", str(file), "--replay", str(index)])
    metric = study.gate.get("metric", "gospa_observable")
    target = out / f"{study.name}-{index}.html"
    return write_replay(target, cell, cell.trackers, study.seed, trial, command, metric)


def write_replay(
    file: Path,
    cell: Cell,
    trackers: Mapping[str, Any],
    seed: int,
    trial: int,
    command: str,
    metric: str,
) -> int:
    """Write the page of one trial, and say where; of a tracker that raised, the traceback.

    Gives the exit code: 1 where a tracker raised.
    """
    from pmbm.durable import replace_text
    from pmbm.reports.replays import trial_page

    title = f"{cell.label}, trial {trial}"
    page, result = trial_page(
        cell.source, trackers, seed, trial, title=title, command=command, metric=metric
    )
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_text(file, page)
    for name, error in result.errors.items():
        click.echo(f"tracker '{name}' raised:\n{error.traceback}", err=True)
    click.echo(f"trial {trial} of {cell.label}: {file}")
    return 1 if result.errors else 0


@contextmanager
def _progress(study: Study) -> Iterator[Any]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from pmbm.cli.progress import bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    line = _line_now_and_then(study.name)
    with bar(*columns) as shown:
        task = shown.add_task(study.name, total=len(study))

        def tell(progress: Any) -> None:
            name = study.name
            if progress.failed:
                name += f" ({progress.failed} failed)"
            shown.update(task, completed=progress.done, description=name)
            if shown.disable:
                line(progress)

        yield tell


_LINE_EVERY = 30.0
"""s between two lines of progress where there is no terminal."""


def _line_now_and_then(name: str) -> Any:
    """A progress callback that prints a line now and then, for logs."""
    import time

    said = time.monotonic()

    def tell(progress: Any) -> None:
        nonlocal said
        if time.monotonic() - said < _LINE_EVERY:
            return
        said = time.monotonic()
        failed = f", {progress.failed} failed" if progress.failed else ""
        trials = counted(progress.total, "trial")
        click.echo(f"{name}: {progress.done} of {trials}{failed}", err=True)

    return tell


@contextmanager
def _interrupted_by_term() -> Iterator[None]:
    """Treat a request to terminate as an interrupt, so that no worker stays behind."""

    def stop(_signal: int, _frame: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
