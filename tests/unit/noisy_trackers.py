"""Trackers that draw from global random state, as many that are published do."""

import dataclasses
import random

import numpy as np

from pmbm.types import Tracks


class Noisy:
    """Detections as tracks, moved by numpy's and Python's global generators; ids count on from
    tracker to tracker in a counter of the class."""

    count = 0

    def step(self, detections):
        n = len(detections)
        Noisy.count += n
        noise = np.random.normal(0.0, 0.3, (n, 3)) + random.gauss(0.0, 0.1)  # noqa: NPY002
        return Tracks(
            time=detections.time,
            id=np.arange(Noisy.count - n, Noisy.count),
            position=detections.position + noise,
            size=detections.size,
            yaw=detections.yaw,
            velocity=np.zeros((n, 2)),
            score=detections.score,
            label=detections.label,
        )


class Seeded(Noisy):
    """The same, by a generator of its own."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def step(self, detections):
        tracks = super().step(detections)
        moved = detections.position + self.rng.normal(0.0, 0.3, detections.position.shape)
        return dataclasses.replace(tracks, position=moved)


class Raises(Noisy):
    def step(self, detections):
        super().step(detections)
        raise RuntimeError("lost my way")
