"""Paired trials until the evidence decides: the gate itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from pmbm.errors import InputError, notes_of
from pmbm.regression.metric import ALONGSIDE, GatedMetric
from pmbm.regression.sequence import fewest_trials
from pmbm.regression.stored import StoredBaseline
from pmbm.regression.verdicts import (
    Decision,
    Pairs,
    Rules,
    Verdict,
    check_margin,
    first_verdicts,
    judge,
    overall,
)
from pmbm.seeding import tracker_seed
from pmbm.study.parallel import process_pool
from pmbm.study.sources import Source, recorded
from pmbm.study.trial import score_tracker
from pmbm.tracking import TrackerFactory

AnyTracker = TrackerFactory | str
Progress = Callable[[str, int, int], None]
"""Called with a scenario, its trials done and the most there may be."""


@dataclass(frozen=True)
class GateEntry:
    """One scenario of a gate: a source, and the two trackers to compare on it.

    baseline : a tracker to run beside the candidate, or stored values.
    """

    source: Source
    baseline: AnyTracker | StoredBaseline
    candidate: AnyTracker


@dataclass(frozen=True)
class SceneReport:
    """The gate's findings in one scenario.

    decision : None where the candidate raised instead of tracking.
    error : what it raised, and in which trial.
    worst : the trial with the greatest loss, and that loss; the trial that raised.
    alongside : metric -> mean of baseline and of candidate over the trials that define both.
    recordings, values : of each trial run: the recording's digest, and the candidate's value.
    """

    name: str
    decision: Decision | None
    error: str | None
    worst: int
    worst_loss: float
    alongside: Mapping[str, tuple[float, float]]
    recordings: tuple[str, ...] = field(repr=False)
    values: tuple[float, ...] = field(repr=False)

    @property
    def verdict(self) -> Verdict:
        return Verdict.FAIL if self.decision is None else self.decision.verdict


@dataclass(frozen=True)
class GateReport:
    """The gate's verdict and its reasons: pass, fail or undecided.

    same_code : both trackers are the same code, which passes without a trial.
    """

    metric: GatedMetric
    rules: Rules
    seed: int
    scenes: tuple[SceneReport, ...]
    same_code: bool = False

    def __repr__(self) -> str:
        scenes = ", ".join(f"{scene.name} {scene.verdict}" for scene in self.scenes)
        return f"GateReport({self.verdict} by {self.metric.name}: {scenes or 'the same code'})"

    @property
    def verdict(self) -> Verdict:
        if self.same_code:
            return Verdict.PASS
        return overall([scene.verdict for scene in self.scenes])


@dataclass(frozen=True)
class _Pair:
    """One trial: the recording, and both trackers' scores (None where they are stored)."""

    recording: str
    baseline: Mapping[str, float | None] | None
    candidate: Mapping[str, float | None] | None
    error: str | None = None


def run_gate(
    entries: Mapping[str, GateEntry],
    metric: GatedMetric,
    rules: Rules,
    *,
    seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> GateReport:
    """Run paired trials, looking after each, until every scenario is decided.

    Trial t of every undecided scenario is looked at before trial t + 1 of any, whatever `jobs` is,
    so that the report does not depend on it.

    Raises BaselineMismatch where stored values belong to other recordings, InputError where the
    baseline fails, the metric is undefined, or the margin is none (see `judge`).
    """
    rules.check_range(metric.value_range)
    tell = progress or (lambda name, done, most: None)
    runs = {name: _Run(name, entry) for name, entry in entries.items()}
    most = {name: run.most(rules) for name, run in runs.items()}
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(limits=1))
        ahead = _Ahead(stack.enter_context(_pool(jobs)) if jobs > 1 else None, jobs)
        undecided, pairs = list(runs), dict[str, Pairs]()
        patience = min(*most.values(), fewest_trials(rules.alpha, rules.rarest))
        for trial in range(max(most.values())):
            going = [n for n in undecided if trial < most[n] and runs[n].error is None]
            if not going:
                break
            for name, pair in ahead.results(runs, going, trial, most, seed, metric):
                runs[name].take(trial, pair)
                tell(name, trial + 1, most[name])
            pairs = {n: r.pairs(metric) for n, r in runs.items() if r.baseline}
            # The first values may be zero where the mean is not: a share of them is asked for once
            # a pass is possible, and at the end.
            if trial + 1 == patience:
                check_margin(pairs, rules)
            looks = first_verdicts(pairs, rules)
            undecided = [n for n in runs if n not in looks or looks[n].verdict is Verdict.UNDECIDED]
    found = judge(pairs, rules)
    scenes = tuple(run.report(found.get(name)) for name, run in runs.items())
    return GateReport(metric, rules, seed, scenes)


def paired_values(
    name: str, entry: GateEntry, metric: GatedMetric, *, seed: int, trials: int
) -> Pairs:
    """The values of both trackers in the first trials of a scenario, no verdict asked.

    Raises as `run_gate` does, and InputError where the candidate raises.
    """
    run = _Run(name, entry)
    if isinstance(entry.baseline, StoredBaseline):
        trials = min(trials, len(entry.baseline.trials(name)))
    for trial in range(trials):
        run.take(trial, _run_pair(entry, seed, trial, metric))
        if run.error is not None:
            raise InputError(f"the candidate raised in {run.error} of '{name}'")
    return run.pairs(metric)


class _Run:
    """The trials of one scenario as they come in."""

    def __init__(self, name: str, entry: GateEntry) -> None:
        self.name = name
        self.entry = entry
        self.baseline: list[float] = []
        self.candidate: list[float] = []
        self.recordings: list[str] = []
        self.alongside: list[tuple[Mapping[str, float | None], Mapping[str, float | None]]] = []
        self.error: str | None = None

    def most(self, rules: Rules) -> int:
        stored = self.entry.baseline
        if not isinstance(stored, StoredBaseline):
            return rules.max_trials
        return min(rules.max_trials, len(stored.trials(self.name)))

    def take(self, trial: int, pair: _Pair) -> None:
        stored = self.entry.baseline
        if isinstance(stored, StoredBaseline):
            value = stored.value(self.name, trial, pair.recording)
        else:
            assert pair.baseline is not None
            value = _defined(pair.baseline)
        if pair.candidate is None:
            self.error = f"trial {trial}: {pair.error}"
            return
        self.baseline.append(value)
        self.candidate.append(_defined(pair.candidate))
        self.recordings.append(pair.recording)
        self.alongside.append((pair.baseline or {}, pair.candidate))

    def pairs(self, metric: GatedMetric) -> Pairs:
        return Pairs(
            baseline=np.array(self.baseline),
            candidate=np.array(self.candidate),
            value_range=metric.value_range,
        )

    def report(self, decision: Decision | None) -> SceneReport:
        losses = np.array(self.candidate) - np.array(self.baseline)
        worst = int(losses.argmax()) if len(losses) else 0
        return SceneReport(
            name=self.name,
            decision=None if self.error else decision,
            error=self.error,
            worst=len(losses) if self.error else worst,
            worst_loss=float(losses[worst]) if len(losses) else 0.0,
            alongside=self._means(),
            recordings=tuple(self.recordings),
            values=tuple(self.candidate),
        )

    def _means(self) -> dict[str, tuple[float, float]]:
        means = {}
        for name in ALONGSIDE:
            both = [
                (x, y)
                for b, c in self.alongside
                if (x := b.get(name)) is not None and (y := c.get(name)) is not None
            ]
            if both:
                means[name] = (
                    float(np.mean([x for x, _ in both])),
                    float(np.mean([y for _, y in both])),
                )
        return means


class _Ahead:
    """Results of trials in order, computed a few ahead where there are workers."""

    def __init__(self, pool: Executor | None, jobs: int) -> None:
        self._pool = pool
        self._jobs = jobs
        self._waiting: dict[tuple[str, int], Future[_Pair]] = {}

    def results(
        self,
        runs: Mapping[str, _Run],
        going: list[str],
        trial: int,
        most: Mapping[str, int],
        seed: int,
        metric: GatedMetric,
    ) -> Iterator[tuple[str, _Pair]]:
        if self._pool is None:
            for name in going:
                yield name, _run_pair(runs[name].entry, seed, trial, metric)
            return
        reach = -(-self._jobs // len(going))
        for later in range(trial, trial + reach + 1):
            for name in going:
                if later < most[name] and (name, later) not in self._waiting:
                    self._waiting[name, later] = self._pool.submit(
                        _run_pair, runs[name].entry, seed, later, metric
                    )
        for name in going:
            yield name, self._waiting.pop((name, trial)).result()


def _run_pair(entry: GateEntry, seed: int, trial: int, metric: GatedMetric) -> _Pair:
    recording = recorded(entry.source, seed, trial)
    digest = recording.digest()
    own = tracker_seed(seed, trial)
    baseline = None
    if not isinstance(entry.baseline, StoredBaseline):
        try:
            baseline, _ = score_tracker(recording, entry.baseline, metric, seed=own)
        except InputError as error:
            raise error.located(run=f"baseline, trial {trial} of '{entry.source.name}'") from error
        except Exception as error:
            raise InputError(
                f"the baseline raised {type(error).__name__} in trial {trial} of "
                f"'{entry.source.name}': {error}"
            ) from error
    try:
        candidate, _ = score_tracker(recording, entry.candidate, metric, seed=own)
    except InputError as error:
        if error.field == "metric":
            raise
        return _Pair(digest, baseline, None, "\n".join([str(error), *notes_of(error)]))
    except Exception as error:
        return _Pair(digest, baseline, None, f"{type(error).__name__}: {error}")
    return _Pair(digest, baseline, candidate)


def _defined(scores: Mapping[str, float | None]) -> float:
    value = scores["gated"]
    assert value is not None
    return value


@contextmanager
def _pool(jobs: int) -> Iterator[Executor]:
    """A process pool that leaves no worker behind, whatever ends the gate."""
    pool = process_pool(jobs)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, kill_workers=True)  # type: ignore[call-arg]
