"""A world of one car and trackers of known error, for tests of the gate."""

from dataclasses import dataclass

import numpy as np

from pmbm.types import Detections, GroundTruth, Recording, Tracks


@dataclass(frozen=True)
class OneCar:
    """A car that stands at x = 20 m + a draw a trial; the detector sees it where it is."""

    name: str = "one_car"
    frames: int = 2

    def record(self, seed, trial=0):
        x = 20.0 + np.random.default_rng([seed, trial]).normal()
        truth, detections = [], []
        for k in range(self.frames):
            box = {
                "time": 0.1 * k,
                "position": [[x, 0.0, 0.8]],
                "size": [[4.5, 1.9, 1.6]],
                "yaw": [0.0],
                "label": [0],
            }
            truth.append(
                GroundTruth(
                    **box,
                    id=[0],
                    velocity=[[0.0, 0.0]],
                    visibility=[1.0],
                    observable=[True],
                    crashed=[False],
                )
            )
            detections.append(Detections(**box, score=[1.0]))
        return Recording(
            name=self.name,
            truth=truth,
            detections=detections,
            frame=np.arange(self.frames),
            stamp=np.arange(self.frames),
        )


@dataclass(frozen=True)
class Shifted:
    """Reports every detection `shift` metres off, and a scene-dependent `spread` more."""

    shift: float = 0.0
    spread: float = 0.0

    def step(self, detections):
        n = len(detections)
        x = detections.position[:, :1]
        off = self.shift + self.spread * np.sin(1e4 * x)
        return Tracks(
            time=detections.time,
            id=np.arange(n),
            position=detections.position + np.hstack([off, 0 * x, 0 * x]),
            size=detections.size,
            yaw=detections.yaw,
            velocity=np.zeros((n, 2)),
            score=detections.score,
            label=detections.label,
        )


def exact():
    return Shifted()


def metre_off():
    return Shifted(1.0, 0.1)


class Breaks:
    """Raises in trials whose car stands beyond 21 m."""

    def step(self, detections):
        if detections.position[0, 0] > 21.0:
            raise RuntimeError("lost my way")
        return exact().step(detections)
