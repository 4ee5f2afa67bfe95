"""`pmbm run`: one or a few trials of a scenario, a table and an HTML replay."""

from __future__ import annotations

import itertools
import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import INTERRUPTED, options, settings
from pmbm.cli.options import FILE
from pmbm.wording import counted

if TYPE_CHECKING:
    from rich.text import Text

    from pmbm.reports.values import Section
    from pmbm.study import Estimate, Source, Summary, TrialResult

HEADLINE = (
    "gospa",
    "gospa_localisation",
    "gospa_missed",
    "gospa_false",
    "ospa",
    "mota",
    "motp",
    "idf1",
    "hota",
    "id_switches",
    "fragmentations",
    "false_positives",
    "misses",
)
"""What the table shows; the JSON holds everything."""


@click.command()
@click.argument("scenarios", nargs=-1, required=True, metavar="NAME|FILE.toml|MODULE:SOURCE...")
@options.trials
@options.seed
@click.option(
    "--tracker",
    "trackers",
    multiple=True,
    default=("pmbm", "argoverse"),
    show_default=True,
    metavar=options.TRACKER,
    help="A tracker to run; give it several times to compare. The first is compared with the rest.",
)
@settings.option
@options.level
@options.figures
@options.folder("the page")
@click.option(
    "--log",
    type=FILE,
    metavar="FILE.mcap|FILE.rrd",
    help="Write the replayed trial for a viewer too: Foxglove or Rerun.",
)
@click.option("--page", help="The page's name, without .html.  [default: the scenario's name]")
@click.option("--replay", "replay_trial", type=click.IntRange(min=0), default=0, show_default=True)
@click.option(
    "--explain",
    type=click.IntRange(min=0),
    metavar="TRACK_ID",
    help="Tell this track's life in the replayed trial, as the first tracker saw it.",
)
@click.option(
    "--map/--no-map",
    "with_maps",
    default=True,
    show_default=True,
    help="Run the replayed trial of pmbm once more, to show where it expects undetected objects.",
)
@options.jobs
def command(
    scenarios: tuple[str, ...],
    trials: int,
    seed: int,
    trackers: tuple[str, ...],
    settings: tuple[str, ...],
    level: str | None,
    json_file: str | None,
    out: Path,
    log: Path | None,
    page: str | None,
    replay_trial: int,
    explain: int | None,
    with_maps: bool,
    jobs: int,
) -> int:
    """Run trackers over trials of a scenario: a table, and a page to look at.  Exit code 1 where a
    tracker raised.

    \b
    Examples:
      pmbm run truck_occlusion
      pmbm run crossing --trials 20 --tracker pmbm --tracker argoverse --json -
      pmbm run my_scene.toml --tracker my_package.tracking:MyTracker
      pmbm run my_package.drives:Drives --tracker pmbm --set sensor.clutter_rate=2
      pmbm run truck_occlusion --explain 9
      pmbm run truck_occlusion --log truck.mcap
    """
    from pmbm.cli.settings import named
    from pmbm.cli.sources import resolve
    from pmbm.durable import check_writable, replace_text
    from pmbm.errors import InputError
    from pmbm.reports.render import run_page
    from pmbm.reports.replays import problems
    from pmbm.study import TrialsInterrupted, summarise
    from pmbm.study.study import check_sensors
    from pmbm.tracking import tracker_factory

    if replay_trial >= trials:
        raise InputError(
            "there is no such trial to replay",
            field="--replay",
            expected=f"0 to {trials - 1}",
            got=replay_trial,
        )
    # Workers look the names up themselves, where pickled modules might be out of their reach.
    chosen = named(trackers, settings)
    factories = {k: tracker_factory(v) if isinstance(v, str) else v for k, v in chosen.items()}
    sources: list[Any] = [resolve(name, {}) for name in scenarios]
    for source, tracker in itertools.product(sources, chosen.values()):
        if not isinstance(tracker, str):
            check_sensors(tracker, source)
    if level is not None:
        sources = [_at(source, level) for source in sources]
    # Found out before any trial, not after all.
    if log is not None:
        _check_log(log, scenarios)
    target = out / f"{page or sources[0].name}.html"
    check_writable(target)
    json_target = None if json_file in (None, "-") else Path(str(json_file))
    if json_target is not None:
        check_writable(json_target)

    stories = []
    if explain is not None:
        from pmbm.cli.story import story_of

        name = next(iter(chosen))
        stories = [
            story_of(source, name, factories[name], seed, replay_trial, explain)
            for source in sources
        ]
    figures, sections, failed, stopped = [], [], False, False
    for source in sources:
        results: Sequence[TrialResult]
        try:
            results = _run(source, chosen, seed, trials, jobs, quiet=json_file == "-")
        except TrialsInterrupted as interrupt:
            results, stopped = interrupt.results, True
            click.echo(f"pmbm: stopped: {source.name} has {len(results)} of {trials}", err=True)
            if not results:
                break
        summary = summarise(results)
        figures.append(_figures(source.name, len(results), seed, summary))
        wrong = problems(results)
        # Who is in a hurry gets no replay, which takes another trial.
        shown = None if stopped else replay_trial
        sections.append(_section(source, chosen, seed, shown, summary, with_maps, wrong))
        _show(source.name, summary, results, to_stderr=json_file == "-")
        for line in wrong:
            click.echo(f"{source.name}: {line}", err=True)
        failed |= bool(wrong)
        if stopped:
            break
    if not sections:
        return INTERRUPTED

    repeat = shlex.join(["pmbm", *_arguments()])
    title = sources[0].name if len(sources) == 1 else (page or "run")
    replace_text(target, run_page(sections, title=title, command=repeat))
    click.echo(f"{target}", err=True)
    replayed = sections[0].replay
    if log is not None and replayed is not None:
        from pmbm.reports.viewers import write_log

        write_log(replayed, log)
        click.echo(f"{log}", err=True)
    for story in stories:
        click.echo(story, err=json_file == "-")
    if json_file is not None:
        text = json.dumps(figures[0] if len(figures) == 1 else figures, indent=1, allow_nan=False)
        if json_target is None:
            click.echo(text)
        else:
            replace_text(json_target, text + "\n")
    return INTERRUPTED if stopped else int(failed)


def _check_log(log: Path, scenarios: Sequence[str]) -> None:
    from pmbm.errors import InputError
    from pmbm.reports.viewers import check_log

    if len(scenarios) > 1:
        raise InputError(
            "a log holds one trial", field="--log", expected="one scenario", got=list(scenarios)
        )
    check_log(log)


def _arguments() -> Sequence[str]:
    import sys

    return sys.argv[1:]


def _at(source: Any, text: str) -> Any:
    """The source at the level that reads like this; a scenario refuses a text that none does."""
    from pmbm.errors import InputError

    if not hasattr(source, "at"):
        raise InputError(f"source '{source.name}' has no levels", field="--level", got=text)
    return source.at({str(level): level for level in source.levels}.get(text, text))


def _run(
    source: Source,
    trackers: Mapping[str, Any],
    seed: int,
    trials: int,
    jobs: int,
    *,
    quiet: bool,
) -> list[TrialResult]:
    from pmbm.cli.progress import bar
    from pmbm.study import run_trials

    with bar(quiet=quiet) as shown:
        task = shown.add_task(source.name, total=trials)
        return run_trials(
            source,
            trackers,
            seed,
            trials,
            jobs,
            progress=lambda done, total: shown.update(task, completed=done, total=total),
        )


def _figures(name: str, trials: int, seed: int, summary: Summary) -> dict[str, Any]:
    return {
        "scenario": name,
        "trials": trials,
        "seed": seed,
        "trackers": {
            tracker: {
                metric: {"mean": value.mean, "sem": value.sem, "n": value.n}
                for metric, value in estimates.items()
            }
            for tracker, estimates in summary.estimates.items()
        },
    }


def _section(
    source: Any,
    trackers: Mapping[str, Any],
    seed: int,
    trial: int | None,
    summary: Summary,
    with_maps: bool,
    wrong: tuple[str, ...],
) -> Section:
    from pmbm.reports.replays import trial_replay
    from pmbm.reports.values import Section

    replay = None
    if trial is not None:
        replay, _ = trial_replay(source, trackers, seed, trial, with_maps=with_maps)
    return Section(
        name=source.name,
        stresses=getattr(source, "stresses", ""),
        summary=summary,
        replay=replay,
        provenance={} if replay is None else replay.recording.provenance,
        problems=wrong,
    )


def _show(name: str, summary: Summary, results: Sequence[TrialResult], *, to_stderr: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    title = f"{name}: {counted(summary.trials, 'trial')}, mean and 95 % interval"
    table = Table(title=title, title_justify="left")
    table.add_column("metric", no_wrap=True)
    for tracker in summary.trackers:
        table.add_column(tracker, justify="right", no_wrap=True)
    for tracker in summary.differences:
        table.add_column(f"{tracker} - {summary.reference}", justify="right", no_wrap=True)
    for metric in HEADLINE:
        means = [summary.estimates[tracker].get(metric) for tracker in summary.trackers]
        differences = [each.get(metric) for each in summary.differences.values()]
        table.add_row(
            metric,
            *(_text(value, summary.trials) for value in [*means, *differences]),
        )
    table.add_row("ms per step", *(_step_time(results, name) for name in summary.trackers))
    console = Console(stderr=to_stderr)
    if not console.is_terminal:
        # A file has no width of its own; rich's guess of 80 columns would cut names short.
        width = 40 + sum(max(24, len(str(column.header)) + 3) for column in table.columns)
        console = Console(stderr=to_stderr, width=width)
    console.print(table)


def _step_time(results: Sequence[TrialResult], tracker: str) -> str:
    """Mean CPU time of a tracker's steps over the trials that it finished, ms."""
    times = [result.time[tracker].mean for result in results if tracker in result.time]
    return f"{1000 * sum(times) / len(times):.2f}" if times else "-"


def _text(value: Estimate | None, trials: int) -> Text:
    from rich.text import Text

    from pmbm.reports.tables import words

    # Brackets are text here, not rich's marks; a terminal's minus is the keyboard's.
    return Text(str(words(value, trials) or "undefined").replace("−", "-"))
