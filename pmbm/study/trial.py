"""One trial: one recording, every tracker over it, their scores."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pmbm.metrics import evaluate
from pmbm.seeding import seeded, tracker_seed
from pmbm.study.configured import follow
from pmbm.tracking import TrackerFactory
from pmbm.types import FloatArray, Recording, TrackSequence


@runtime_checkable
class Source(Protocol):
    """Where recordings come from: a simulated scene or a dataset's log, alike.

    `record` is a pure function: equal arguments give recordings with equal digests.  Sources
    travel to other processes, so they pickle.
    """

    @property
    def name(self) -> str: ...

    def record(self, seed: int, trial: int = 0) -> Recording: ...


Metrics = Callable[[Recording, TrackSequence], Mapping[str, float | None]]
"""Scores of one run by name; None where a score is undefined (MOTA without truth)."""


@dataclass(frozen=True)
class StepTime:
    """CPU time of a tracker's steps in one trial, s: mean, median and 99th percentile."""

    mean: float
    median: float
    p99: float

    @classmethod
    def of(cls, seconds: FloatArray | None) -> StepTime:
        if seconds is None or not len(seconds):
            return cls(0.0, 0.0, 0.0)
        median, p99 = np.percentile(seconds, (50, 99))
        return cls(float(seconds.mean()), float(median), float(p99))


@dataclass(frozen=True)
class TrialResult:
    """What one trial gave: a pure function of source, trackers, seed and trial, but for `time`.

    source : the source's name.
    seed, trial : what was recorded.
    recording : digest of the recording that every tracker saw.
    scores : tracker -> metric -> value, None where undefined.
    time : tracker -> CPU time of its steps; never part of a digest.
    """

    source: str
    seed: int
    trial: int
    recording: str
    scores: Mapping[str, Mapping[str, float | None]]
    time: Mapping[str, StepTime]

    def __reduce__(self) -> tuple[Any, ...]:
        scores = {name: dict(values) for name, values in self.scores.items()}
        identity = (self.source, self.seed, self.trial, self.recording)
        return _make_result, (*identity, scores, dict(self.time))


def run_trial(
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trial: int = 0,
    metrics: Sequence[str] | Metrics | None = None,
) -> TrialResult:
    """Record one trial and score every tracker on that same recording.

    trackers : name in the results -> a factory, or the name of one (shipped, or MODULE:FACTORY).
    metrics : names to keep of what `pmbm.metrics.evaluate` gives, a function of one's own, or
        None for all that `evaluate` gives.

    Every tracker starts from the same global random state, so that what it scores depends on no
    other that runs.  Raises InputError for an unknown tracker or metric.
    """
    recording = source.record(seed, trial)
    scores, times = {}, {}
    for name, tracker in trackers.items():
        scores[name], times[name] = score_tracker(
            recording, tracker, metrics, seed=tracker_seed(seed, trial)
        )
    return _make_result(source.name, seed, trial, recording.digest(), scores, times)


def score_tracker(
    recording: Recording,
    tracker: TrackerFactory | str,
    metrics: Sequence[str] | Metrics | None = None,
    *,
    seed: int,
) -> tuple[dict[str, float | None], StepTime]:
    """The scores of a fresh tracker over a recording, and what its steps cost.

    seed : of global random state, for the tracker and for one's own metrics, see `track`.
    """
    tracks = follow(tracker, recording, seed)
    if callable(metrics):
        with seeded(seed):
            given = metrics(recording, tracks)
    else:
        given = evaluate(recording, tracks, metrics).scalars()
    scores = {key: None if value is None else float(value) for key, value in given.items()}
    return scores, StepTime.of(tracks.seconds)


def _make_result(
    source: str,
    seed: int,
    trial: int,
    recording: str,
    scores: Mapping[str, Mapping[str, float | None]],
    time: Mapping[str, StepTime],
) -> TrialResult:
    frozen = {name: MappingProxyType(dict(values)) for name, values in scores.items()}
    return TrialResult(
        source, seed, trial, recording, MappingProxyType(frozen), MappingProxyType(dict(time))
    )
