"""One trial: one recording, every tracker over it, their scores."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.tracking import TrackerFactory, make_tracker, run, tracker_factory
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

    Raises InputError for an unknown tracker or metric.
    """
    recording = source.record(seed, trial)
    measure = metrics if callable(metrics) else _chosen(metrics)
    scores, times = {}, {}
    for name, tracker in trackers.items():
        factory = tracker_factory(tracker) if isinstance(tracker, str) else tracker
        tracks = run(make_tracker(factory, recording.site), recording)
        scores[name] = {key: _number(value) for key, value in measure(recording, tracks).items()}
        times[name] = StepTime.of(tracks.seconds)
    return _make_result(source.name, seed, trial, recording.digest(), scores, times)


def _chosen(names: Sequence[str] | None) -> Metrics:
    from pmbm.metrics import evaluate

    def measure(recording: Recording, tracks: TrackSequence) -> Mapping[str, float | None]:
        scalars = evaluate(recording, tracks).scalars()
        if names is None:
            return scalars
        for name in names:
            if name not in scalars:
                raise InputError(
                    f"no metric '{name}'",
                    field="metrics",
                    hint=nearest_hint(name, scalars, "metric"),
                )
        return {name: scalars[name] for name in names}

    return measure


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


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
