"""The filter beside the floor and its rivals, frame by frame on the same detections."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from floor import Floor
from large import MILLION
from rivals import Filterpy, Worker
from world import SIZE, World

from pmbm import PMBMTracker, Tracks, evaluate
from pmbm.labels import Label

SEEDS = range(5)
WARM_UP, FRAMES = 20, 60
HERE = Path(__file__).parent
LARGE = (1_000, 10_000, 100_000)

Figure = tuple[float, dict[str, Any]]


class Race:
    """CPU seconds a frame (median over frames) and scores, of everyone in one run.

    ours, floor, floor2 : seconds.  rival : name -> seconds.  scores : name -> GOSPA and MOTA.
    """

    def __init__(self, objects: int, seed: int, rivals: tuple[str, ...], spacing: float = 15.0):
        world = World(objects, spacing, seed)
        recording = world.recording(FRAMES)
        tracker = PMBMTracker(world.config(), world.site)
        runners = {name: Filterpy() if name == "filterpy" else Worker(name) for name in rivals}
        floor = Floor(recording.truth[0].position[:, :2], recording.truth[0].velocity)
        seconds: dict[str, list[float]] = {}
        shown: dict[str, list[Tracks]] = {name: [] for name in ("pmbm", *rivals)}
        for truth, detections in zip(recording.truth, recording.detections, strict=True):
            z = detections.position[:, :2].copy()
            begin = time.process_time()
            tracks = tracker.step(detections)
            seconds.setdefault("pmbm", []).append(time.process_time() - begin)
            shown["pmbm"].append(tracks)
            for name, runner in runners.items():
                rows = runner.step(z)
                seconds.setdefault(name, []).append(rows[0, 0])
                shown[name].append(_as_tracks(truth.time, rows[1:]))
            for name, value in zip(
                ("floor", "floor2"), floor.seconds(z, truth.position[:, :2]), strict=True
            ):
                seconds.setdefault(name, []).append(value)
        for runner in runners.values():
            if isinstance(runner, Worker):
                runner.close()
        self.seconds = {name: float(np.median(s[WARM_UP:])) for name, s in seconds.items()}
        self.scores = {name: _scores(recording, tracks) for name, tracks in shown.items()}


@cache
def races(objects: int) -> list[Race]:
    """One race a seed; at 50 objects with every rival."""
    rivals = {50: ("filterpy", "stonesoup", "motpy", "norfair"), 1000: ()}.get(
        objects, ("filterpy",)
    )
    return [Race(objects, seed, rivals) for seed in SEEDS]


def over(objects: int, numerator: str, denominator: str) -> Figure:
    return _over(races(objects), numerator, denominator)


def _over(runs: list[Race], numerator: str, denominator: str) -> Figure:
    """Median over runs of the ratio of two times, and everybody's scores."""
    ratios = [run.seconds[numerator] / run.seconds[denominator] for run in runs]
    details: dict[str, Any] = {"ratio_min": min(ratios), "ratio_max": max(ratios)}
    for name in (numerator, denominator):
        details[f"{name}_ms"] = 1e3 * float(np.median([run.seconds[name] for run in runs]))
        if name in runs[0].scores:
            for metric in ("gospa", "mota"):
                values = [run.scores[name][metric] for run in runs]
                details[f"{name}_{metric}"] = float(np.mean(values))
    return float(np.median(ratios)), details


def a50() -> Figure:
    return over(50, "pmbm", "floor")


def a200() -> Figure:
    return over(200, "pmbm", "floor")


def a1000() -> Figure:
    return over(1000, "pmbm", "floor2")


def c10() -> Figure:
    return over(10, "filterpy", "pmbm")


def c50() -> Figure:
    return over(50, "filterpy", "pmbm")


def c200() -> Figure:
    return over(200, "filterpy", "pmbm")


def d_stonesoup() -> Figure:
    return over(50, "stonesoup", "pmbm")


def d_motpy() -> Figure:
    return over(50, "motpy", "pmbm")


def d_norfair() -> Figure:
    return over(50, "norfair", "pmbm")


def d_lmb_gibbs() -> Figure:
    return _over([Race(50, seed, ("lmb_gibbs",)) for seed in SEEDS], "lmb_gibbs", "pmbm")


def d_lmb_murty() -> Figure:
    """Of one seed: a frame takes it a second."""
    return _over([Race(50, 0, ("lmb_murty",))], "lmb_murty", "pmbm")


def e() -> Figure:
    """200 objects 5 m apart over 200 objects 15 m apart, frame by frame."""
    ratios = []
    for seed in SEEDS:
        times: list[list[float]] = [[], []]
        worlds = [World(200, spacing, seed) for spacing in (5.0, 15.0)]
        trackers = [PMBMTracker(world.config(), world.site) for world in worlds]
        for frames in zip(*(world.frames(FRAMES) for world in worlds), strict=True):
            for tracker, (_, detections), taken in zip(trackers, frames, times, strict=True):
                begin = time.process_time()
                tracker.step(detections)
                taken.append(time.process_time() - begin)
        dense, wide = (float(np.median(taken[WARM_UP:])) for taken in times)
        ratios.append(dense / wide)
    return float(np.median(ratios)), {"ratio_min": min(ratios), "ratio_max": max(ratios)}


def large() -> list[dict[str, Any]]:
    """Seconds a frame and peak memory of large scenes."""
    return _runs(LARGE, SEEDS)


def _runs(sizes: Sequence[int], seeds: Sequence[int]) -> list[dict[str, Any]]:
    return [_large_alone(objects, seed) for seed in seeds for objects in sizes]


@cache
def _large_alone(objects: int, seed: int) -> dict[str, Any]:
    """In a process of its own, which loads nothing but the tracker."""
    run = subprocess.run(
        [sys.executable, str(HERE / "large.py"), str(objects), str(seed)],
        check=True,
        capture_output=True,
        text=True,
    )
    found: dict[str, Any] = json.loads(run.stdout)
    return found


def b_slope() -> Figure:
    """Slope of log seconds a frame over log objects, 10^3 to 10^5."""
    slopes = []
    for seed in SEEDS:
        runs = [run for run in large() if run["seed"] == seed]
        size, seconds = ([np.log(run[name]) for run in runs] for name in ("objects", "seconds"))
        slopes.append(float(np.polyfit(size, seconds, 1)[0]))
    each = {
        f"us_per_object_{n}": 1e6
        * float(np.median([run["seconds"] / n for run in large() if run["objects"] == n]))
        for n in LARGE
    }
    return float(np.median(slopes)), {"slope_min": min(slopes), "slope_max": max(slopes), **each}


def b_memory() -> Figure:
    """Peak memory in MB of a process that tracks 10^5 objects."""
    peaks = [run["megabytes"] for run in large() if run["objects"] == LARGE[-1]]
    return float(np.median(peaks)), {"max": max(peaks)}


def b_million() -> Figure:
    """Slope of log seconds over log objects, 10^5 to 10^6, of the first 5 frames, when nothing is
    known yet and most is to be done."""
    fewer, run = _runs([LARGE[-1], MILLION], seeds=[0])
    times = run["first_five"] / fewer["first_five"]
    slope = np.log10(times) / np.log10(MILLION / LARGE[-1])
    return float(slope), {"seconds": run["first_five"], "megabytes": run["megabytes"]}


def b_million_memory() -> Figure:
    """Peak memory in GB of the same."""
    (run,) = _runs([MILLION], seeds=[0])
    return run["megabytes"] / 1e3, {}


def _as_tracks(when: float, rows: np.ndarray) -> Tracks:
    n = len(rows)
    return Tracks(
        time=when,
        id=rows[:, 0].astype(np.int64),
        position=np.column_stack([rows[:, 1:], np.full(n, SIZE[2] / 2)]),
        size=np.tile(SIZE, (n, 1)),
        yaw=np.zeros(n),
        velocity=np.zeros((n, 2)),
        score=np.ones(n),
        label=np.full(n, Label.CAR),
    )


def _scores(recording: Any, tracks: list[Tracks]) -> dict[str, float]:
    found = evaluate(recording, tracks, ["gospa", "mota"]).scalars()
    return {name: float(found[name] or 0.0) for name in ("gospa", "mota")}
