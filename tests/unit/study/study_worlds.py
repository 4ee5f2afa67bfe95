"""Small worlds, trackers and scores for tests of studies; all pickle by name."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmbm.types import Detections, GroundTruth, Recording, Tracks


@dataclass(frozen=True)
class Convoy:
    """Cars in a row, driving east at 10 m/s, seen with noise; every detection is a car's."""

    name: str = "convoy"
    cars: int = 3
    frames: int = 6
    noise: float = 0.3

    def record(self, seed, trial=0):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial,)))
        start = np.column_stack([np.arange(self.cars) * 15.0, np.zeros(self.cars)])
        truth, detections = [], []
        for k in range(self.frames):
            xy = start + np.array([k * 1.0, 0.0])
            box = {
                "time": 0.1 * k,
                "size": np.tile([4.5, 1.9, 1.6], (self.cars, 1)),
                "yaw": np.zeros(self.cars),
                "label": np.zeros(self.cars),
            }
            z = np.full((self.cars, 1), 0.8)
            truth.append(
                GroundTruth(
                    **box,
                    id=np.arange(self.cars),
                    position=np.hstack([xy, z]),
                    velocity=np.tile([10.0, 0.0], (self.cars, 1)),
                    visibility=np.ones(self.cars),
                    observable=np.ones(self.cars),
                    crashed=np.zeros(self.cars),
                )
            )
            seen = xy + rng.normal(scale=self.noise, size=xy.shape)
            detections.append(
                Detections(
                    **box, position=np.hstack([seen, z]), score=rng.uniform(0.5, 1.0, self.cars)
                )
            )
        return Recording(
            name=self.name,
            truth=truth,
            detections=detections,
            frame=np.arange(self.frames),
            stamp=np.arange(self.frames) * 100,
            origin=[np.arange(self.cars)] * self.frames,
        )


@dataclass(frozen=True)
class Echo:
    """Reports every detection as a track, shifted by `bias` metres; ids are rows."""

    bias: float = 0.0

    def step(self, detections):
        n = len(detections)
        return Tracks(
            time=detections.time,
            id=np.arange(n),
            position=detections.position + np.array([self.bias, 0.0, 0.0]),
            size=detections.size,
            yaw=detections.yaw,
            velocity=np.zeros((n, 2)),
            score=detections.score,
            label=detections.label,
        )


def biased():
    return Echo(bias=1.0)


class Picky:
    """Echo, which raises in trials whose seed for trackers is odd."""

    def __init__(self, seed):
        self.seed = seed

    def step(self, detections):
        if self.seed % 2:
            raise ValueError(f"not with {self.seed}")
        return Echo().step(detections)


class Blind:
    """Reports nothing."""

    def step(self, detections):
        return Tracks.empty(detections.time)


def toy_scores(recording, tracks):
    """Mean distance of reports to their cars (None without reports), and reports per frame."""
    errors = [
        np.linalg.norm(report.position[:, :2] - recording.truth[frame].position[:, :2], axis=1)
        for report, frame in zip(tracks, tracks.frame, strict=True)
        if len(report)
    ]
    return {
        "error": float(np.concatenate(errors).mean()) if errors else None,
        "reports": float(np.mean([len(report) for report in tracks])),
    }


@dataclass(frozen=True)
class Trouble(Convoy):
    """A convoy whose trials go wrong as `how` says: trial -> what happens there."""

    how: tuple[tuple[int, str], ...] = ()
    folder: str = ""

    def record(self, seed, trial=0):
        what = dict(self.how).get(trial)
        if what == "raises":
            raise RuntimeError(f"trial {trial} at {object()!r} went wrong")
        if what == "hangs":
            time.sleep(600)
        if what == "hangs deaf":
            signal.signal(signal.SIGALRM, signal.SIG_IGN)
            time.sleep(600)
        if what == "dies":
            os.kill(os.getpid(), signal.SIGKILL)
        if what == "dies once":
            mark = Path(self.folder) / f"died{trial}"
            if not mark.exists():
                mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
        if what == "eats":
            np.ones(10**10)
        if what == "slow":
            time.sleep(0.15)
        return super().record(seed, trial)
