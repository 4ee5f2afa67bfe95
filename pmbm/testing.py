"""Subjects of scenario tests: the outcome of trials, and a gate against regressions.

The pytest plugin makes these; they may be used without it as well.
"""

from __future__ import annotations

import hashlib
import re
import shlex
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any
from unittest import SkipTest

from pmbm.durable import replace_text
from pmbm.errors import InputError
from pmbm.metrics import evaluate
from pmbm.metrics.catalogue import definition
from pmbm.seeding import tracker_seed
from pmbm.study import NamedSource, Source, estimate, is_named_source, recorded
from pmbm.tracking import TrackerFactory, track, tracker_factory
from pmbm.types import Recording, TrackSequence
from pmbm.wording import counted

if TYPE_CHECKING:
    from pmbm.regression import GateReport

_KEPT = 8
"""Outcomes kept at a time, for further tests over the same trials."""


@dataclass(frozen=True)
class ShownTrial:
    """A replay that was written: where, and what to say of it."""

    file: Path
    text: str


@dataclass(frozen=True, eq=False)
class Run:
    """The recording of one trial and the tracker's tracks over it."""

    trial: int
    recording: Recording
    tracks: TrackSequence

    def __repr__(self) -> str:
        return f"Run(trial {self.trial} of '{self.recording.name}': {len(self.tracks)} steps)"


@dataclass(eq=False)
class Outcome:
    """A tracker over trials of a scenario.

    source, tracker : what was recorded, and the tracker's name.
    runs : the trials.
    seed : of all.

    Each question remembers its metric, so that a failing test can show the worst trial by it.
    """

    source: Source
    tracker: str
    factory: TrackerFactory
    seed: int
    runs: tuple[Run, ...]
    _asked: str = field(default="gospa", repr=False)
    _known: dict[str, list[float | None]] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        trials = counted(len(self.runs), "trial")
        return f"Outcome('{self.tracker}' over {trials} of '{self.source.name}', seed {self.seed})"

    def values(self, metric: str) -> list[float | None]:
        """The metric's value in each trial, None where undefined.

        Raises InputError for an unknown metric, with the nearest valid name.
        """
        definition(metric)
        self._asked = metric
        if metric not in self._known:
            self._known[metric] = [
                evaluate(run.recording, run.tracks, [metric])[metric].value for run in self.runs
            ]
        return list(self._known[metric])

    def mean(self, metric: str) -> float:
        """The mean of a metric over the trials that define it.

        Raises AssertionError where no trial does.
        """
        values = self._defined(metric)
        return sum(values) / len(values)

    def min(self, metric: str) -> float:
        """The least value of a metric."""
        return min(self._defined(metric))

    def max(self, metric: str) -> float:
        """The greatest value of a metric."""
        return max(self._defined(metric))

    def interval(self, metric: str) -> tuple[float, float]:
        """The 95 % interval of its mean, see `pmbm.intervals`.

        Raises AssertionError where fewer than two trials define it, or where all trials have one
        value and the metric has no ends.
        """
        found = estimate(self.values(metric), definition(metric).scale)
        if found.low is None or found.high is None:
            known = "is defined in" if found.n < 2 else "has one value in all"
            raise AssertionError(f"{metric} {known} {found.n} trials: no interval")
        return found.low, found.high

    def measure(self, function: Callable[[Recording, TrackSequence], float]) -> list[float]:
        """The values of a measure of one's own over the trials."""
        return [function(run.recording, run.tracks) for run in self.runs]

    def worst(self, metric: str | None = None) -> int:
        """The trial that is worst by a metric (the last asked for), undefined values apart."""
        name = metric or self._asked
        sign = -1.0 if definition(name).direction == "higher" else 1.0
        values = self.values(name)
        worst = max(
            range(len(values)),
            key=lambda i: -float("inf") if values[i] is None else sign * float(values[i] or 0.0),
        )
        return self.runs[worst].trial

    def write_replay(self, folder: Path, node: str) -> ShownTrial:
        """Write the worst trial's replay, for the test of that node id."""
        metric = self._asked
        trial = self.worst()
        command = shlex.join(["pytest", node, "--pmbm-replay", str(trial)])
        trackers = {self.tracker: self.factory}
        file = _write_page(folder, node, self.source, trackers, self.seed, trial, command, metric)
        lines = [
            *self._told(metric),
            f"worst trial by {metric}: {trial} of seed {self.seed}",
            f"replay: {file}",
            command,
        ]
        return ShownTrial(file, "\n".join(lines))

    def _told(self, metric: str) -> list[str]:
        """The metric's value in each trial, its mean and the interval, as lines."""
        values = self.values(metric)
        shown = " ".join("undefined" if value is None else f"{value:.4g}" for value in values)
        known = definition(metric)
        found = estimate(values, known.scale)
        ends = "" if found.low is None else f", 95 % interval [{found.low:.4g}, {found.high:.4g}]"
        mean = "undefined" if found.mean is None else f"{found.mean:.4g}{ends}"
        unit = "" if known.unit == "1" else f" ({known.unit})"
        told = f"{metric} in {counted(len(values), 'trial')}{unit}: {shown}"
        return [*wrap(told, 100, subsequent_indent="    "), f"mean {mean}"]

    def _defined(self, metric: str) -> list[float]:
        values = [value for value in self.values(metric) if value is not None]
        if not values:
            raise AssertionError(f"{metric} is undefined in all {len(self.runs)} trials")
        return values


def outcome_of(
    source: Source | str,
    tracker: TrackerFactory | str,
    *,
    tracker_name: str,
    folder: Path,
    trials: int,
    seed: int = 0,
    level: Any = None,
    only: int | None = None,
) -> Outcome:
    """The outcome of a tracker over trials of a scenario; the last few are kept.

    source : a source, a scenario's name, or its file relative to `folder`.
    only : run this trial alone.
    """
    key = str(folder / source) if isinstance(source, str) and source.endswith(".toml") else source
    arguments: tuple[Any, ...] = (key, tracker, tracker_name, trials, seed, level, only)
    if all(isinstance(argument, Hashable) for argument in arguments):
        return _kept_outcome(*arguments)
    return _outcome(*arguments)


def _outcome(
    source: Source | str,
    tracker: TrackerFactory | str,
    tracker_name: str,
    trials: int,
    seed: int,
    level: Any,
    only: int | None,
) -> Outcome:
    world = _source(source, level)
    factory = tracker_factory(tracker) if isinstance(tracker, str) else tracker
    runs = []
    for trial in range(trials) if only is None else [only]:
        recording = recorded(world, seed, trial)
        try:
            tracks = track(factory, recording, tracker_seed(seed, trial))
        except Exception as error:
            error.add_note(
                f"tracker '{tracker_name}' in trial {trial} of '{world.name}', seed {seed}"
            )
            raise
        runs.append(Run(trial, recording, tracks))
    return Outcome(world, tracker_name, factory, seed, tuple(runs))


_kept_outcome = lru_cache(maxsize=_KEPT)(_outcome)


@dataclass(eq=False)
class TrackingGate:
    """A gate in a test: whether a tracker got worse.

    folder, test, node : where the test is, a name for its baselines, and its node id.
    update : store the tracker under test as the new baseline.
    most : trials at most, instead of what a check says.
    only : show this trial alone, and judge nothing.
    tell : called with a scenario, its trials done and the most there may be.
    stored : of each baseline that was stored, its file and what it changed.
    """

    folder: Path
    test: str
    node: str
    update: bool = False
    most: int | None = None
    only: int | None = None
    tell: Callable[[str, int, int], None] | None = None
    stored: list[str] = field(default_factory=list)
    _show: Callable[[Path, str], ShownTrial] | None = field(default=None, repr=False)

    def check(
        self,
        tracker: TrackerFactory | str,
        *,
        scenario: Source | str,
        metric: str = "ospa",
        margin: float | None = None,
        relative_margin: float | None = None,
        against: TrackerFactory | str | None = None,
        alpha: float = 0.01,
        rarest: float = 0.05,
        max_trials: int = 300,
        seed: int = 0,
        bounds: Sequence[float] | None = None,
        jobs: int = 1,
    ) -> GateReport:
        """Fail the test unless paired trials prove that the tracker lost less than the margin.

        against : a tracker to run beside it; by default its values are compared with those of the
            stored baseline, a JSON file in `baselines` beside the test.

        The other arguments are those of `pmbm.regression.Rules` and `gated_metric`.  Raises
        BaselineMismatch where there is no stored baseline, or none for these recordings; SkipTest
        where one trial alone is to be shown.
        """
        __tracebackhide__ = True
        from pmbm.regression import GateEntry, Rules, Verdict, gated_metric, load_baseline, run_gate
        from pmbm.regression.wording import Commands, in_words

        rules = Rules(
            margin=margin,
            relative_margin=relative_margin,
            alpha=alpha,
            rarest=rarest,
            max_trials=self.most or max_trials,
        )
        gated = gated_metric(metric, bounds)
        beside = scenario.endswith(".toml") if isinstance(scenario, str) else False
        source = _source(str(self.folder / str(scenario)) if beside else scenario, None)
        file = self.folder / "baselines" / f"{_slug(f'{self.test}-{source.name}-{metric}')}.json"
        accept = shlex.join(["pytest", self.node, "--pmbm-update-baselines"])
        trackers = {"candidate": tracker} | ({} if against is None else {"baseline": against})

        def show(trial: int, folder: Path, node: str) -> ShownTrial:
            command = self._replay(trial)
            page = _write_page(folder, node, source, trackers, seed, trial, command, metric)
            return ShownTrial(page, f"trial {trial} of seed {seed}\nreplay: {page}\n{command}")

        if self.only is not None:
            self._show = partial(show, self.only)
            raise SkipTest(f"trial {self.only} alone is shown, and nothing judged")
        if self.update and against is None:
            self._store(source, tracker, gated, rules, seed, jobs, file)
        if against is None:
            baseline: Any = load_baseline(file, accept)
            baseline.check(gated, seed)
        else:
            baseline = against
        entries = {source.name: GateEntry(source, baseline, tracker)}
        report = run_gate(entries, gated, rules, seed=seed, jobs=jobs, progress=self.tell)
        self._show = partial(show, report.scenes[0].worst)
        if report.verdict is not Verdict.PASS:
            change = accept if against is None else None
            commands = Commands(lambda name, trial: self._replay(trial), change)
            raise AssertionError(in_words(report, commands))
        return report

    def _replay(self, trial: int) -> str:
        return shlex.join(["pytest", self.node, "--pmbm-replay", str(trial)])

    def write_replay(self, folder: Path, node: str) -> ShownTrial | None:
        """Write the replay of the last check's worst trial, or None before any check."""
        return None if self._show is None else self._show(folder, node)

    def _store(
        self,
        source: Source,
        tracker: TrackerFactory | str,
        gated: Any,
        rules: Any,
        seed: int,
        jobs: int,
        file: Path,
    ) -> None:
        """Store the tracker's values; a worse tracker's too, but as a failure."""
        __tracebackhide__ = True
        from pmbm.regression import store_baseline

        (change,) = store_baseline(
            file,
            {source.name: (source, tracker)},
            gated,
            rules,
            seed=seed,
            tracker=getattr(tracker, "__qualname__", str(tracker)),
            code="",
            jobs=jobs,
            progress=self.tell,
        )
        told = change.in_words(gated.name)
        self.stored.append(f"{file}: {told}")
        if change.worse:
            raise AssertionError(
                f"{told}\nstored all the same in {file}: the worse tracker is the baseline from "
                "now on; git restore the file to undo that"
            )


def _source(source: Source | str, level: Any) -> Source:
    """The source itself, or the scenario of that name or file, at a level of its sweep."""
    if isinstance(source, str):
        from pmbm.sim import load_scenario

        found: Any = NamedSource(source) if is_named_source(source) else load_scenario(source)
    else:
        found = source
    if level is None:
        return found
    if not hasattr(found, "at"):
        raise InputError(f"source '{found.name}' has no levels", field="level", got=level)
    return found.at(level)


def _write_page(
    folder: Path,
    node: str,
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trial: int,
    command: str,
    metric: str,
) -> Path:
    from pmbm.reports.replays import trial_page

    page, _ = trial_page(source, trackers, seed, trial, title=node, command=command, metric=metric)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{_slug(node)}.html"
    replace_text(file, page)
    return file


def _slug(text: str) -> str:
    """A file name for a text; the hash keeps apart what looks alike."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", text)[-80:].strip("-.")
    return f"{plain}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"
