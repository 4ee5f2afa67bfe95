"""One trial: one recording, every tracker over it, their scores."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from pmbm.errors import InputError, notes_of
from pmbm.metrics import evaluate
from pmbm.seeding import seeded, tracker_seed
from pmbm.study.configured import factory_of, follow
from pmbm.study.sources import Source, recorded
from pmbm.tracking import TrackerFactory
from pmbm.types import FloatArray, Recording, TrackSequence

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
class TrackerError:
    """What a tracker raised: its type and message in one line, the traceback, and what is known
    besides, such as the last lines of a program on stderr."""

    message: str
    traceback: str = field(compare=False, repr=False)
    notes: tuple[str, ...] = field(default=(), compare=False, repr=False)

    @classmethod
    def of(cls, error: Exception) -> TrackerError:
        message = " ".join(f"{type(error).__name__}: {error}".split())
        return cls(message, "".join(traceback.format_exception(error)), notes_of(error))


@dataclass(frozen=True)
class TrialResult:
    """What one trial gave: a pure function of source, trackers, seed and trial, but for `time`.

    source : the source's name.
    seed, trial : what was recorded.
    recording : digest of the recording that every tracker saw.
    scores : tracker -> metric -> value, None where undefined; nothing of a tracker that raised.
    time : tracker -> CPU time of its steps; never part of a digest.
    errors : tracker -> what it raised, of those that did.
    """

    source: str
    seed: int
    trial: int
    recording: str
    scores: Mapping[str, Mapping[str, float | None]]
    time: Mapping[str, StepTime]
    errors: Mapping[str, TrackerError] = field(default_factory=dict)

    def of(self, tracker: str) -> Mapping[str, float | None]:
        """The scores of a tracker.

        Raises InputError where it raised.
        """
        if tracker in self.errors:
            raise InputError(
                f"tracker '{tracker}' raised in trial {self.trial} of '{self.source}', seed "
                f"{self.seed}: {self.errors[tracker].message}"
            )
        return self.scores[tracker]

    def __repr__(self) -> str:
        trackers = ", ".join(self.scores)
        return f"TrialResult(trial {self.trial} of '{self.source}', seed {self.seed}: {trackers})"

    def __reduce__(self) -> tuple[Any, ...]:
        scores = {name: dict(values) for name, values in self.scores.items()}
        identity = (self.source, self.seed, self.trial, self.recording)
        return _make_result, (*identity, scores, dict(self.time), dict(self.errors))


def run_trial(
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trial: int = 0,
    metrics: Sequence[str] | Metrics | None = None,
) -> TrialResult:
    """Record one trial and score every tracker on that same recording.

    trackers : name in the results -> a factory, or the name of one (shipped, MODULE:FACTORY or
        exec:COMMAND).
    metrics : names to keep of what `pmbm.metrics.evaluate` gives, a function of one's own, or
        None for all that `evaluate` gives.

    Every tracker starts from the same global random state, so that what it scores depends on no
    other that runs; one that raises loses its own scores (see `TrialResult.errors`) and nobody
    else's.  Raises InputError for an unknown tracker or metric.
    """
    recording = recorded(source, seed, trial)
    own = tracker_seed(seed, trial)
    scores: dict[str, dict[str, float | None]] = {}
    times, errors = {}, {}
    factories = {name: factory_of(tracker) for name, tracker in trackers.items()}
    for name, factory in factories.items():
        try:
            tracks = follow(factory, recording, own)
        except MemoryError:
            raise
        except Exception as error:
            scores[name], errors[name] = {}, TrackerError.of(error)
            continue
        scores[name] = _scored(recording, tracks, metrics, own)
        times[name] = StepTime.of(tracks.seconds)
    return _make_result(source.name, seed, trial, recording.digest(), scores, times, errors)


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
    return _scored(recording, tracks, metrics, seed), StepTime.of(tracks.seconds)


def _scored(
    recording: Recording,
    tracks: TrackSequence,
    metrics: Sequence[str] | Metrics | None,
    seed: int,
) -> dict[str, float | None]:
    if callable(metrics):
        with seeded(seed):
            given = metrics(recording, tracks)
    else:
        given = evaluate(recording, tracks, metrics).scalars()
    return {key: None if value is None else float(value) for key, value in given.items()}


def _make_result(
    source: str,
    seed: int,
    trial: int,
    recording: str,
    scores: Mapping[str, Mapping[str, float | None]],
    time: Mapping[str, StepTime],
    errors: Mapping[str, TrackerError],
) -> TrialResult:
    frozen = {name: MappingProxyType(dict(values)) for name, values in scores.items()}
    return TrialResult(
        source,
        seed,
        trial,
        recording,
        MappingProxyType(frozen),
        MappingProxyType(dict(time)),
        MappingProxyType(dict(errors)),
    )
