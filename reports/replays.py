"""Replays of one trial: recorded again, tracked again, scored again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pmbm.metrics import evaluate
from pmbm.metrics.catalogue import definition
from pmbm.metrics.core.result import OBSERVABLE
from pmbm.reports.matching import identity_switches
from pmbm.reports.render import run_page
from pmbm.reports.values import ReplayPage, Section
from pmbm.seeding import tracker_seed
from pmbm.study import (
    Source,
    StepTime,
    TrackerError,
    TrialResult,
    follow,
    recorded,
    summarise,
)
from pmbm.tracking import TrackerFactory, tracker_factory

_OF_SWITCHES = ("id_switches", "fragmentations", "idf1", "idp", "idr", "assa", "id_kept")
"""Metrics that changes of ids decide."""
_SERIES_OF = {"misses": "gospa_missed_observable", "false_positives": "gospa_false_observable"}
"""Counts, and the series that shows where they arise."""
_BY_DEFAULT = ("gospa_observable", "gospa")
_START = 1.0
"""s at the start of a run that no replay begins in: nothing is tracked yet."""


def trial_replay(
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trial: int,
    *,
    title: str = "",
    with_maps: bool = False,
) -> tuple[ReplayPage, TrialResult]:
    """Record a trial and run trackers over it: what to look at, and the scores.  A tracker that
    raises is in neither, but among the result's errors.

    title : which trial it is, for people; by default its number and seed.
    with_maps : trackers that offer `with_map` are run once more, so made: where they expect
        undetected objects is then shown in detail.  Their tracks and scores stay those without.
    """
    recording = recorded(source, seed, trial)
    own = tracker_seed(seed, trial)
    tracks, series, times, maps = {}, {}, {}, {}
    scores: dict[str, dict[str, float | None]] = {}
    errors: dict[str, TrackerError] = {}
    for name, tracker in trackers.items():
        try:
            tracks[name] = follow(tracker, recording, own)
        except MemoryError:
            raise
        except Exception as error:
            scores[name], errors[name] = {}, TrackerError.of(error)
            continue
        found = evaluate(recording, tracks[name])
        scores[name] = found.scalars()
        series[name] = {key: v.series for key, v in found.items() if v.series is not None}
        times[name] = StepTime.of(tracks[name].seconds)
        factory = tracker_factory(tracker) if isinstance(tracker, str) else tracker
        if with_maps and (detailed := getattr(factory, "with_map", None)) is not None:
            maps[name] = follow(detailed, recording, own)
    result = TrialResult(source.name, seed, trial, recording.digest(), scores, times, errors)
    title = title or f"trial {trial} of seed {seed}"
    replay = ReplayPage(recording=recording, tracks=tracks, series=series, maps=maps, title=title)
    return replay, result


def at_event(replay: ReplayPage, metric: str) -> ReplayPage:
    """The replay, to begin where the first tracker is worst by a metric after the first second: at
    its first identity switch for what switches decide, at the worst frame of the metric's series
    where it has one, else of GOSPA."""
    if not replay.tracks:
        return replay
    name, tracks = next(iter(replay.tracks.items()))
    base = metric.removesuffix(OBSERVABLE)
    if base in _OF_SWITCHES and (switches := identity_switches(replay.recording, tracks)):
        return replace(replay, start=switches[0].frame)
    series = replay.series.get(name, {})
    wanted = (_SERIES_OF.get(base, metric), base, *_BY_DEFAULT)
    shown = next((each for each in wanted if each in series), None)
    if shown is None or not len(tracks):
        return replay
    sign = -1.0 if definition(shown).direction == "higher" else 1.0
    values = np.nan_to_num(sign * series[shown], nan=-np.inf)
    times = np.array([replay.recording.truth[frame].time for frame in tracks.frame])
    late = times > times[0] + _START
    values = np.where(late, values, -np.inf) if late.any() else values
    return replace(replay, start=int(tracks.frame[np.argmax(values)]))


def trial_page(
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trial: int,
    *,
    title: str,
    command: str,
    stresses: str = "",
    metric: str = "gospa_observable",
) -> tuple[str, TrialResult]:
    """A page of one trial, with its scores and its replay, and these scores.

    title : what it is, for people; command : what makes the page again.
    metric : the replay begins where the first tracker is worst by it, see `at_event`.
    """
    replay, result = trial_replay(source, trackers, seed, trial, with_maps=True)
    replay = at_event(replay, metric)
    section = Section(
        name=source.name,
        stresses=stresses,
        summary=summarise([result]),
        replay=replay,
        provenance=replay.recording.provenance,
        problems=problems([result]),
    )
    return run_page([section], title=title, command=command), result


def problems(results: Sequence[TrialResult]) -> tuple[str, ...]:
    """The trackers that raised, and in which trials, a line each, with what is known besides."""
    return tuple(
        "; ".join(
            [
                f"{name} raised in trial {result.trial}: {error.message}",
                *(" ".join(note.split()) for note in error.notes),
            ]
        )
        for result in results
        for name, error in result.errors.items()
    )
