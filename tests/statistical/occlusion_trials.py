"""What becomes of identities and of first reports around occlusions: trackers over shared trials.

Every tracker sees the same recordings, so that all differences are paired by seed.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from pmbm.metrics.core.clear_matching import clear_matches
from pmbm.metrics.core.scene import scene_of
from pmbm.metrics.families.occlusion import occlusions
from pmbm.tracking import TrackerFactory, make_tracker, run
from pmbm.types import Recording

GATE = 2.0
"""m; within which a track follows an object."""
BINS = ((0.5, 1.5), (1.5, 2.5), (2.5, 3.5), (3.5, 6.0), (6.0, 15.0))
"""s of full occlusion."""
THREE_SECONDS = BINS[2]


@dataclass(frozen=True)
class Trial:
    """One tracker over one recording.

    ghost : s of reports, added up over tracks, that are near no object, seen or hidden.
    kept : (object, s at which it went out of sight) -> s out of sight, and whether it came back
        under its old id; None: it had none.
    told : share of the frames that those objects are out of sight in which a report is near them.
    delay : object that is out of sight at first -> s from when it could first be seen to its first
        report; infinite without one.
    """

    ghost: float
    kept: Mapping[tuple[int, float], tuple[float, bool | None]]
    told: float
    delay: Mapping[int, float]


def trial(recording: Recording, factory: TrackerFactory) -> Trial:
    """Run a tracker over a recording and follow every object in and out of sight."""
    tracks = run(make_tracker(factory, recording.site), recording)
    scene = scene_of(recording, tracks)
    matches = clear_matches(scene, GATE)
    truth = scene.truth
    hit = np.zeros(len(truth), bool)
    hit[matches.truth] = True
    kept, told = {}, []
    for spell in occlusions(scene, matches):
        key = int(truth.index[spell.rows[0]]), spell.begin
        kept[key] = spell.end - spell.begin, None if spell.before is None else spell.kept
        told.append(float(hit[spell.rows].mean()))
    delay = {}
    order = truth.by_object
    for rows in np.split(order, np.flatnonzero(np.diff(truth.index[order])) + 1):
        seen = np.flatnonzero(truth.observable[rows])
        if not len(seen) or seen[0] == 0:
            continue
        times = scene.time[truth.frame[rows]]
        found = times[seen[0] :][hit[rows][seen[0] :]]
        delay[int(truth.index[rows[0]])] = (
            float(found[0] - times[seen[0]]) if len(found) else np.inf
        )
    step = float(np.median(np.diff(scene.time)))
    ghost = float(len(scene.tracks) - len(matches.track)) * step
    return Trial(ghost, kept, float(np.mean(told)) if told else 0.0, delay)


def kept_shares(
    trials: Mapping[str, list[Trial]], seconds: tuple[float, float]
) -> tuple[dict[str, np.ndarray], int]:
    """Tracker -> share of the occlusions of that length after which the old id came back, seed by
    seed, and how many occlusions: those of objects that every tracker was following.  Seeds
    without any are left out."""
    shares: dict[str, list[float]] = {name: [] for name in trials}
    count = 0
    for seed in range(len(next(iter(trials.values())))):
        found = [trials[name][seed].kept for name in trials]
        keys = [
            key
            for key, (length, _) in found[0].items()
            if seconds[0] <= length < seconds[1] and all(one[key][1] is not None for one in found)
        ]
        count += len(keys)
        if keys:
            for name, one in zip(trials, found, strict=True):
                shares[name].append(float(np.mean([one[key][1] for key in keys])))
    return {name: np.array(values) for name, values in shares.items()}, count


def at_equal_ghost_time(
    sweep: Iterable[tuple[float, np.ndarray]], ghost: float
) -> tuple[np.ndarray, float]:
    """The best that a baseline's sweep reaches with at most this ghost time, between its points
    too: kept shares seed by seed, and their ghost time.

    sweep : mean ghost time and kept shares by seed of each setting.  A baseline that has more ghost
    time at every setting is given its point with the least.
    """
    points = sorted(sweep, key=lambda point: point[0])
    least = points[0]
    options = [least, *(point for point in points if point[0] <= ghost)]
    for (low, below), (high, above) in itertools.pairwise(points):
        if low <= ghost < high:
            share = (ghost - low) / (high - low)
            options.append((ghost, (1 - share) * below + share * above))
    best = max(options, key=lambda point: float(point[1].mean()))
    return best[1], best[0]


def mean_interval(values: np.ndarray, confidence: float = 0.95) -> tuple[float, float, float]:
    """Mean and Student-t interval over seeds."""
    mean, n = float(np.mean(values)), len(values)
    half = float(stats.t.ppf(0.5 + confidence / 2, n - 1) * np.std(values, ddof=1) / np.sqrt(n))
    return mean, mean - half, mean + half


def reduction(before: np.ndarray, after: np.ndarray) -> tuple[float, float, float]:
    """1 - mean(after) / mean(before) of paired values, and its 95 % interval (delta method)."""
    ratio = float(after.mean() / before.mean())
    _, low, high = mean_interval(after - ratio * before)
    half = (high - low) / 2 / float(before.mean())
    return 1 - ratio, 1 - ratio - half, 1 - ratio + half
