"""One trial to look at: recorded again, tracked again, scored again."""

from __future__ import annotations

from collections.abc import Mapping

from pmbm.metrics import evaluate
from pmbm.reports.render import run_page
from pmbm.reports.values import ReplayPage, Section
from pmbm.seeding import tracker_seed
from pmbm.study import Source, StepTime, TrialResult, follow, summarise
from pmbm.tracking import TrackerFactory, tracker_factory


def trial_replay(
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trial: int,
    *,
    title: str = "",
    with_maps: bool = False,
) -> tuple[ReplayPage, TrialResult]:
    """Record a trial and run trackers over it: what to look at, and the scores.

    title : which trial it is, for people; by default its number and seed.
    with_maps : trackers that offer `with_map` are run once more, so made: where they expect
        undetected objects is then shown in detail.  Their tracks and scores stay those without.
    """
    recording = source.record(seed, trial)
    own = tracker_seed(seed, trial)
    tracks, scores, series, times, maps = {}, {}, {}, {}, {}
    for name, tracker in trackers.items():
        tracks[name] = follow(tracker, recording, own)
        found = evaluate(recording, tracks[name])
        scores[name] = found.scalars()
        series[name] = {key: v.series for key, v in found.items() if v.series is not None}
        times[name] = StepTime.of(tracks[name].seconds)
        factory = tracker_factory(tracker) if isinstance(tracker, str) else tracker
        if with_maps and (detailed := getattr(factory, "with_map", None)) is not None:
            maps[name] = follow(detailed, recording, own)
    result = TrialResult(source.name, seed, trial, recording.digest(), scores, times)
    title = title or f"trial {trial} of seed {seed}"
    replay = ReplayPage(recording=recording, tracks=tracks, series=series, maps=maps, title=title)
    return replay, result


def trial_page(
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trial: int,
    *,
    title: str,
    command: str,
    stresses: str = "",
) -> str:
    """A page of one trial: its scores and its replay.

    title : what it is, for people; command : what makes the page again.
    """
    replay, result = trial_replay(source, trackers, seed, trial, with_maps=True)
    section = Section(
        name=source.name,
        stresses=stresses,
        summary=summarise([result]),
        replay=replay,
        provenance=replay.recording.provenance,
    )
    return run_page([section], title=title, command=command)
