"""What scenario tests look at: the outcome of trials, and a gate against regressions.

The pytest plugin makes these; they may be used without it as well.
"""

from __future__ import annotations

import hashlib
import re
import shlex
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmbm.durable import replace_text
from pmbm.metrics import evaluate
from pmbm.metrics.catalogue import definition
from pmbm.seeding import tracker_seed
from pmbm.study import Source, estimate
from pmbm.tracking import TrackerFactory, track, tracker_factory
from pmbm.types import Recording, TrackSequence

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
    """One trial: what was recorded and what the tracker made of it."""

    trial: int
    recording: Recording
    tracks: TrackSequence


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
        """Its mean over the trials that define it.

        Raises AssertionError where no trial does.
        """
        values = self._defined(metric)
        return sum(values) / len(values)

    def min(self, metric: str) -> float:
        """Its least value."""
        return min(self._defined(metric))

    def max(self, metric: str) -> float:
        """Its greatest value."""
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
        """One's own measure of each trial."""
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
        file = _write_page(
            folder, node, self.source, {self.tracker: self.factory}, self.seed, trial, command
        )
        text = f"worst trial by {metric}: {trial} of seed {self.seed}\nreplay: {file}\n{command}"
        return ShownTrial(file, text)

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
        recording = world.record(seed, trial)
        tracks = track(factory, recording, tracker_seed(seed, trial))
        runs.append(Run(trial, recording, tracks))
    return Outcome(world, tracker_name, factory, seed, tuple(runs))


_kept_outcome = lru_cache(maxsize=_KEPT)(_outcome)


@dataclass(eq=False)
class TrackingGate:
    """Says whether a tracker got worse, in a test.

    folder, test, node : where the test is, a name for its baselines, and its node id.
    update : store the tracker under test as the new baseline.
    most : trials at most, instead of what a check says.
    """

    folder: Path
    test: str
    node: str
    update: bool = False
    most: int | None = None
    stored: list[Path] = field(default_factory=list)
    _show: Callable[[Path, str], ShownTrial] | None = None

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
        BaselineMismatch where there is no stored baseline, or none for these recordings.
        """
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
        if self.update and against is None:
            self._store(source, tracker, gated, rules, seed, jobs, file)
        if against is None:
            baseline: Any = load_baseline(file, accept)
            baseline.check(gated, seed)
        else:
            baseline = against
        entries = {source.name: GateEntry(source, baseline, tracker)}
        report = run_gate(entries, gated, rules, seed=seed, jobs=jobs)
        worst = report.scenes[0].worst
        trackers = {"candidate": tracker} | ({} if against is None else {"baseline": against})

        def show(folder: Path, node: str) -> ShownTrial:
            shown = _write_page(folder, node, source, trackers, seed, worst, _repeat(node))
            return ShownTrial(shown, f"worst trial: {worst} of seed {seed}\nreplay: {shown}")

        self._show = show
        if report.verdict is not Verdict.PASS:
            # A replay is written after the test; its command is the test itself.
            commands = Commands(lambda name, trial: _repeat(self.node), accept)
            raise AssertionError(in_words(report, commands))
        return report

    def write_replay(self, folder: Path, node: str) -> ShownTrial | None:
        """Write the replay of the last check's worst trial; None before any check."""
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
        from pmbm.regression import StoredBaseline
        from pmbm.study import run_trials

        results = run_trials(
            source, {"candidate": tracker}, seed, rules.max_trials, jobs, metrics=gated
        )
        trials = tuple(
            (result.recording, float(result.scores["candidate"]["gated"] or 0.0))
            for result in results
        )
        StoredBaseline(
            metric=gated.name,
            bounds=gated.bounds,
            seed=seed,
            tracker=getattr(tracker, "__qualname__", str(tracker)),
            code="",
            scenarios={source.name: trials},
        ).write(file)
        self.stored.append(file)


def _source(source: Source | str, level: Any) -> Source:
    """The source itself, or the scenario of that name or file, at a level of its sweep."""
    if isinstance(source, str):
        from pmbm.sim import load_scenario

        found: Any = load_scenario(source)
    else:
        found = source
    return found if level is None else found.at(level)


def _write_page(
    folder: Path,
    node: str,
    source: Source,
    trackers: dict[str, TrackerFactory | str],
    seed: int,
    trial: int,
    command: str,
) -> Path:
    from pmbm.reports.replays import trial_page

    page = trial_page(source, trackers, seed, trial, title=node, command=command)
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{_slug(node)}.html"
    replace_text(file, page)
    return file


def _repeat(node: str) -> str:
    return shlex.join(["pytest", node])


def _slug(text: str) -> str:
    """A file name for a text; the hash keeps apart what looks alike."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", text).strip("-.")[-80:]
    return f"{plain}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"
