"""`pmbm gate`: pass, fail or undecided, by paired trials against a baseline."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import options, settings
from pmbm.cli.options import FILE
from pmbm.cli.settings import configured
from pmbm.wording import counted, duration

if TYPE_CHECKING:
    from pmbm.regression import GatedMetric, GateEntry, GateReport, Pilot, Rules, wording
    from pmbm.study import Cell, ConfiguredTracker, Study

_EXIT = {"pass": 0, "fail": 1, "undecided": 3}
_PILOT = 10


@click.command()
@click.argument("study_name", metavar="STUDY.toml|SCENARIO|MODULE:SOURCE")
@click.option(
    "--against",
    metavar="GITREF|TRACKER",
    help="The baseline to run beside the candidate: a commit, branch or tag (checked out in a git "
    "worktree), a shipped tracker, or MODULE:FACTORY.  [default: the stored baseline]",
)
@click.option("--tracker", metavar="NAME", help="The candidate.  [default: the study's first]")
@settings.option
@click.option("--metric", metavar="NAME", help="What is gated.  [default: the study's, or ospa]")
@click.option("--margin", type=float, help="Tolerated loss, in the metric's unit.")
@click.option("--relative-margin", type=float, help="Tolerated loss, as a share.")
@click.option("--alpha", type=float, help="Probability of a wrong verdict.  [default: 0.01]")
@click.option("--max-trials", type=int, help="Undecided after so many.  [default: 600]")
@click.option("--seed", type=click.IntRange(min=0), help="[default: the study's]")
@options.jobs
@click.option(
    "--baseline",
    type=FILE,
    help="The stored baseline.  [default: STUDY.baseline.json]",
)
@click.option(
    "--plan",
    is_flag=True,
    help=f"Say how many trials the margin takes at least, and, after {_PILOT} of each scenario, "
    "how many with their spread, and the time.",
)
@click.option("--accept", is_flag=True, help="Store the candidate's values as the new baseline.")
@click.option(
    "--replay",
    type=click.IntRange(min=0),
    metavar="INDEX",
    help="Show one trial of these trackers, as the gate names it.",
)
@options.folder("a replay")
@click.option("--junit", type=FILE, help="JUnit XML.")
@click.option("--github", is_flag=True, help="Annotations.  [default: on in GitHub Actions]")
@click.option("--bisect", metavar="GOOD..BAD", help="Name the first commit that fails.")
def command(
    study_name: str,
    against: str | None,
    baseline: Path | None,
    plan: bool,
    accept: bool,
    replay: int | None,
    out: Path,
    junit: Path | None,
    github: bool,
    bisect: str | None,
    jobs: int,
    **options: Any,
) -> int:
    """Did the tracker get worse?  Exit code 0: no; 1: yes; 3: undecided; 2: bad input.

    Both trackers run over the same recordings, trial by trial, until the evidence decides.

    \b
    Examples:
      pmbm gate night.toml --against main --jobs 4 --junit gate.xml
      pmbm gate crossing --against argoverse --metric gospa --margin 0.05
      pmbm gate night.toml --against main --plan
      pmbm gate night.toml --accept
      pmbm gate night.toml --bisect v1.0..main
    """
    from pmbm.durable import check_writable, replace_text
    from pmbm.regression import wording

    task = _task(study_name, baseline, jobs, {"against": against, **options})
    if replay is not None:
        return _replay(task, against, replay, out)
    if plan:
        _plan(task, against)
        return 0
    for file in (task.baseline if accept else None, junit):
        if file is not None:
            check_writable(file)
    if accept:
        _accept(task)
        return 0
    if bisect is not None:
        return _bisect(task, bisect)
    with ExitStack() as stack:
        report = _compare(task, stack, against)
    commands = task.commands(against)
    text = wording.in_words(report, commands)
    code = _EXIT[report.verdict]
    if code == 1 and against is not None and _is_accepted(task):
        text += f"\naccepted in {task.baseline}: passes"
        code = 0
    if code == _EXIT["undecided"] and against is None:
        text += (
            f"\n{task.baseline} holds no more trials: --against GITREF runs both trackers until "
            "the evidence decides"
        )
    click.echo(text)
    if junit is not None:
        replace_text(junit, wording.junit(report, commands, task.study.name))
    if github or os.environ.get("GITHUB_ACTIONS") == "true":
        click.echo(wording.github(report, commands))
    return code


@dataclass(frozen=True)
class _Task:
    """A gate as it was asked for."""

    name: str
    study: Study
    candidate: str
    metric: GatedMetric
    rules: Rules
    baseline: Path
    jobs: int
    given: tuple[str, ...]

    @property
    def cells(self) -> dict[str, Cell]:
        return {cell.label: cell for cell in self.study.cells}

    def tracker(self, cell: Cell) -> ConfiguredTracker:
        return cell.trackers[self.candidate]

    @property
    def accept(self) -> str:
        """The command that stores the candidate's values."""
        return shlex.join(["pmbm", "gate", self.name, "--tracker", self.candidate, "--accept"])

    def commands(self, against: str | None) -> wording.Commands:
        from pmbm.regression import wording

        # Beside another tracker there is no change to accept.
        change = against is None or not self.is_tracker(against)
        return wording.Commands(self.replay, self.accept if change else None)

    def is_tracker(self, against: str) -> bool:
        """Whether the baseline is named as a tracker is, not as a commit."""
        from pmbm.tracking import SHIPPED_TRACKERS

        return against in self.study.trackers or against in SHIPPED_TRACKERS or ":" in against

    def replay(self, label: str, trial: int) -> str:
        """The command that shows a trial; in every study, however many trials that plans."""
        index = trial * len(self.study.cells) + list(self.cells).index(label)
        return shlex.join(["pmbm", "gate", self.name, *self.given, "--replay", str(index)])


def _task(name: str, baseline: Path | None, jobs: int, options: dict[str, Any]) -> _Task:
    from pmbm.errors import InputError, nearest_hint
    from pmbm.regression import Rules, gated_metric

    given = {key: value for key, value in options.items() if value is not None}
    study = _study(name, given)
    wanted = dict(study.gate) or {"metric": "ospa"}
    if {"margin", "relative_margin"} & set(given):
        wanted |= {"margin": None, "relative_margin": None}
    wanted |= {k: given[k] for k in _GATE_OPTIONS if k in given}
    candidate = given.get("tracker") or wanted.pop("candidate", None) or study.trackers[0]
    wanted.pop("candidate", None)
    if candidate not in study.trackers:
        raise InputError(
            f"no tracker '{candidate}' in {name}",
            field="--tracker",
            hint=nearest_hint(candidate, study.trackers, "tracker"),
        )
    changed = given.get("settings", ())
    if changed:
        study = _with_settings(study, candidate, changed)
    metric = gated_metric(wanted.pop("metric"), wanted.pop("bounds", None))
    try:
        rules = Rules(**wanted)
    except InputError as error:
        raise error.located(
            file=name if study.gate else None,
            hint=error.hint or "say --margin or --relative-margin, or write a [gate] table",
        ) from None
    stem = Path(name).with_suffix("") if name.endswith(".toml") else Path(name)
    return _Task(
        name=name,
        study=study,
        candidate=candidate,
        metric=metric,
        rules=rules,
        baseline=baseline or Path(f"{stem}.baseline.json"),
        jobs=jobs,
        given=tuple(
            word
            for key in _SAID_AGAIN
            if key in given
            for word in (f"--{key.replace('_', '-')}", str(given[key]))
        )
        + tuple(word for one in changed for word in ("--set", one)),
    )


_SAID_AGAIN = ("against", "tracker", "seed", "metric", "margin", "relative_margin")
"""Options that a replay of the same trial needs."""
_GATE_OPTIONS = ("metric", "margin", "relative_margin", "alpha", "max_trials")


def _study(name: str, given: Mapping[str, Any]) -> Study:
    from pmbm.cli.sources import resolve
    from pmbm.study import Cell, ConfiguredTracker, Study
    from pmbm.study.file import load_study

    if name.endswith(".toml"):
        study = load_study(name, resolve)
        tracker = given.get("tracker")
        if tracker is not None and tracker not in study.trackers and ":" in tracker:
            extra = {tracker: ConfiguredTracker(tracker)}
            cells = tuple(replace(c, trackers={**c.trackers, **extra}) for c in study.cells)
            study = replace(study, cells=cells)
        return study if "seed" not in given else replace(study, seed=given["seed"])
    tracker = given.get("tracker", "pmbm")
    cell = Cell(name, {}, resolve(name, {}), {tracker: ConfiguredTracker(tracker)})
    return Study(name=name, cells=(cell,), trials=1, seed=given.get("seed", 0))


def _with_settings(study: Study, candidate: str, given: tuple[str, ...]) -> Study:
    """The study with further parameters of one tracker."""
    from pmbm.study import ConfiguredTracker

    cells = []
    for cell in study.cells:
        known = cell.trackers[candidate]
        more = dict(known.parameters) | dict(configured(known.factory, given).parameters)
        changed = ConfiguredTracker(known.factory, tuple(more.items()))
        cells.append(replace(cell, trackers={**cell.trackers, candidate: changed}))
    return replace(study, cells=tuple(cells))


def _compare(task: _Task, stack: ExitStack, against: str | None) -> GateReport:
    """The gate's report against stored values, another tracker, or another commit's."""
    from pmbm.regression import GateReport

    entries = _entries(task, stack, against)
    if entries is None:
        return GateReport(task.metric, task.rules, task.study.seed, (), same_code=True)
    return _run(task, entries)


def _entries(task: _Task, stack: ExitStack, against: str | None) -> dict[str, GateEntry] | None:
    """Each scenario with both its trackers, or None where they are the same code."""
    from pmbm.regression import GateEntry, load_baseline
    from pmbm.regression.gitref import GitTracker, checked_out, same_sources
    from pmbm.study import ConfiguredTracker

    cells = task.cells
    if against is None:
        stored = load_baseline(task.baseline, task.accept)
        stored.check(task.metric, task.study.seed)
        baselines: dict[str, Any] = dict.fromkeys(cells, stored)
    elif against in task.study.trackers:
        baselines = {label: cell.trackers[against] for label, cell in cells.items()}
    elif task.is_tracker(against):
        tracker = ConfiguredTracker(against)
        tracker.bound()
        baselines = dict.fromkeys(cells, tracker)
    else:
        folder = stack.enter_context(checked_out(against))
        own = {label: task.tracker(cell) for label, cell in cells.items()}
        if all(same_sources(folder, tracker.factory) for tracker in own.values()):
            return None
        baselines = {
            label: GitTracker(folder, tracker.factory, tracker.parameters)
            for label, tracker in own.items()
        }
    return {
        label: GateEntry(cell.source, baselines[label], task.tracker(cell))
        for label, cell in cells.items()
    }


def _replay(task: _Task, against: str | None, index: int, out: Path) -> int:
    """Show one trial of the candidate, and of the tracker that it is compared with."""
    from pmbm.cli.study import write_replay

    labels = list(task.cells)
    label, trial = labels[index % len(labels)], index // len(labels)
    trackers: dict[str, Any] = {task.candidate: task.tracker(task.cells[label])}
    with ExitStack() as stack:
        entries = None if against is None else _entries(task, stack, against)
        if entries is not None and against != task.candidate:
            trackers[str(against)] = entries[label].baseline
        return write_replay(
            out / f"{task.study.name}-gate-{index}.html",
            task.cells[label],
            trackers,
            task.study.seed,
            trial,
            task.replay(label, trial),
            task.metric.name,
        )


def _plan(task: _Task, against: str | None) -> None:
    """Say what the gate will take: what the margin needs, then what a few trials show."""
    from pmbm.regression import run_pilot
    from pmbm.regression.verdicts import check_margin

    rules, metric = task.rules, task.metric
    rules.check_range(metric.value_range)
    click.echo(
        f"{metric.name}: range {metric.value_range:g}, alpha {rules.alpha:g} over "
        f"{counted(len(task.cells), 'scenario')}"
    )
    if rules.margin is not None:
        share = 100 * rules.margin / metric.value_range
        needed = _at_least(task, rules.margin)
        click.echo(f"margin {rules.margin:g}, {share:.3g} % of the range: {needed}")
    seconds = 0.0
    with ExitStack() as stack:
        entries = _entries_to_try(task, stack, against)
        if entries is None:
            click.echo("both trackers are the same code: a pass without a trial")
            return
        for label, entry in entries.items():
            pilot = run_pilot(label, entry, metric, seed=task.study.seed, trials=_PILOT)
            check_margin({label: pilot.pairs}, rules)
            if rules.margin is None:
                margin = float(rules.margins(pilot.pairs.baseline).mean())
                click.echo(f"{label}: margin {margin:.4g}: {_at_least(task, margin)}")
            trials = _tell_spread(task, label, pilot)
            seconds += pilot.seconds * trials
    processes = counted(task.jobs, "process", "processes")
    click.echo(f"in all about {duration(seconds / task.jobs)} with {processes}")


def _at_least(task: _Task, margin: float) -> str:
    from pmbm.regression import least_trials

    needed = least_trials(margin, task.metric.value_range, task.rules, len(task.cells))
    most = task.rules.max_trials
    few = f", more than max_trials, {most}" if needed > most else ""
    return f"at least {needed} trials{few}, unless the candidate is better"


def _entries_to_try(
    task: _Task, stack: ExitStack, against: str | None
) -> dict[str, GateEntry] | None:
    """As `_entries`; where nothing is stored yet, the candidate beside itself, for the time."""
    from pmbm.errors import BaselineMismatch
    from pmbm.regression import GateEntry

    try:
        return _entries(task, stack, against)
    except BaselineMismatch as error:
        click.echo(f"spread unknown: {error}")
        return {
            label: GateEntry(cell.source, task.tracker(cell), task.tracker(cell))
            for label, cell in task.cells.items()
        }


def _tell_spread(task: _Task, label: str, pilot: Pilot) -> int:
    """Say what a pass takes with the spread of a pilot, and give the trials that will run."""
    from pmbm.regression import trials_with_spread

    needed = trials_with_spread(pilot.pairs, task.rules, len(task.cells))
    trials = min(needed or task.rules.max_trials, task.rules.max_trials)
    capped = "" if needed == trials else f"; undecided after max_trials, {trials}"
    click.echo(
        f"{label}: spread {pilot.spread:.2g} over {len(pilot.pairs.loss)} trials: a pass takes "
        f"{f'about {needed}' if needed else 'more than 5000'} without change, "
        f"{pilot.seconds:.2g} s each{capped}"
    )
    return trials


def _run(task: _Task, entries: dict[str, Any]) -> GateReport:
    from pmbm.regression import run_gate

    with _progress(task) as tell:
        return run_gate(
            entries,
            task.metric,
            task.rules,
            seed=task.study.seed,
            jobs=task.jobs,
            progress=tell,
        )


@contextmanager
def _progress(task: _Task) -> Iterator[Any]:
    from pmbm.cli.progress import bar

    with bar() as shown:
        tasks = {label: shown.add_task(label, total=None) for label in task.cells}

        def tell(name: str, done: int, most: int) -> None:
            shown.update(tasks[name], completed=done, total=most)

        yield tell


def _accept(task: _Task) -> None:
    """Run the candidate alone and store its values."""
    from pmbm.regression import store_baseline

    with _progress(task) as tell:
        changes = store_baseline(
            task.baseline,
            {label: (cell.source, task.tracker(cell)) for label, cell in task.cells.items()},
            task.metric,
            task.rules,
            seed=task.study.seed,
            tracker=task.candidate,
            code=task.study.hash,
            jobs=task.jobs,
            progress=tell,
        )
    click.echo(f"{task.baseline}: stored")
    for change in changes:
        click.echo(change.in_words(task.metric.name))


def _is_accepted(task: _Task) -> bool:
    from pmbm.errors import InputError
    from pmbm.regression import load_baseline

    try:
        return load_baseline(task.baseline).code == task.study.hash
    except InputError:
        return False


def _bisect(task: _Task, interval: str) -> int:
    """Name the first commit of GOOD..BAD whose tracker fails against GOOD's."""
    from pmbm.errors import InputError
    from pmbm.regression import GateEntry, Verdict
    from pmbm.regression.gitref import (
        GitTracker,
        check_ref,
        checked_out,
        commits_of,
        repository_of,
        subject_of,
    )

    good, dots, bad = interval.partition("..")
    if not (good and dots and bad) or bad.startswith("."):
        raise InputError("bad interval", field="--bisect", expected="GOOD..BAD", got=interval)
    for ref in (good, bad):
        check_ref(ref)
    top = repository_of(Path.cwd())
    commits = commits_of(top, interval)
    if not commits:
        raise InputError("no commits there", field="--bisect", got=interval)

    def verdict_of(commit: str) -> Verdict:
        with checked_out(good) as old, checked_out(commit) as new:
            entries = {}
            for label, cell in task.cells.items():
                name, parameters = task.tracker(cell).factory, task.tracker(cell).parameters
                entries[label] = GateEntry(
                    cell.source,
                    GitTracker(old, name, parameters),
                    GitTracker(new, name, parameters),
                )
            verdict = _run(task, entries).verdict
        click.echo(f"{verdict:9}  {subject_of(top, commit)}")
        return verdict

    if verdict_of(commits[-1]) is not Verdict.FAIL:
        click.echo(f"{bad} does not fail against {good}")
        return 3
    low, high = 0, len(commits) - 1
    while low < high:
        middle = (low + high) // 2
        if verdict_of(commits[middle]) is Verdict.FAIL:
            high = middle
        else:
            low = middle + 1
    click.echo(f"first bad commit: {subject_of(top, commits[low])}")
    return 1
