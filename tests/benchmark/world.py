"""The traffic that speed is measured on: objects that keep their distance, and a plain detector."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pmbm import Detections, GroundTruth, PMBMConfig, Recording, Site
from pmbm.filter import BroadBirth, Sensor
from pmbm.labels import Label

DT = 0.1
DETECTION_PROBABILITY = 0.9
MEASUREMENT_SD = 0.3
SIZE = (4.5, 1.9, 1.6)


@dataclass(frozen=True)
class World:
    """N objects on a square grid, each on a circle of its own around its point of the grid.

    objects : N.  spacing : between points of the grid, m; circles have a fifth of it as radius, and
    objects a speed of at most 5 m/s and an acceleration of at most 2 m/s^2.  Detections: P_D 0.9,
    sd 0.3 m per axis, clutter of N / 5 per frame, uniform over the square; 10 Hz.
    """

    objects: int
    spacing: float
    seed: int

    @property
    def side(self) -> float:
        """m, of the square that the objects fill."""
        return self.spacing * math.ceil(math.sqrt(self.objects))

    @property
    def site(self) -> Site:
        return Site(max_range=self.side * math.sqrt(0.5) + self.spacing)

    def config(self, *, occlusion: bool = False) -> PMBMConfig:
        """The default preset, told the world's rates and, unless asked, that nothing hides behind
        anything here.

        Clutter and objects at the start are rates over the field of view, a disk, and the square is
        only a part of it.
        """
        share = math.pi * self.site.max_range**2 / self.side**2
        return PMBMConfig(
            sensor=Sensor(clutter_rate=self.objects / 5 * share, occlusion=occlusion),
            birth=BroadBirth(initial=self.objects * share),
        )

    def frames(self, count: int) -> list[tuple[GroundTruth, Detections]]:
        """The first `count` frames."""
        return list(self.each_frame(count))

    def each_frame(self, count: int) -> Iterator[tuple[GroundTruth, Detections]]:
        """The same, one after another, for scenes that are too large to keep."""
        random, moved = self._start()
        for frame in range(count):
            position, velocity, yaw = moved(frame)
            yield (
                _truth(DT * frame, position, velocity, yaw),
                self._detected(random, DT * frame, position, yaw),
            )

    def each_scan(self, count: int) -> Iterator[Detections]:
        """The detections of the same frames, and nothing kept beside them."""
        random, moved = self._start()
        for frame in range(count):
            yield self._detected(random, DT * frame, *moved(frame)[::2])

    def _start(self) -> tuple[np.random.Generator, Callable[[int], tuple[np.ndarray, ...]]]:
        """The random numbers to come, and position (N,2), velocity (N,2) and yaw (N,) by frame."""
        random = np.random.default_rng([self.seed, self.objects, round(10 * self.spacing)])
        n = self.objects
        columns = math.ceil(math.sqrt(n))
        place = np.stack(np.divmod(np.arange(n), columns), axis=1) + 0.5
        centre = place * self.spacing - self.side / 2
        radius = self.spacing / 5
        turning = min(5 / radius, math.sqrt(2 / radius)) * random.uniform(-1, 1, n)
        start = random.uniform(-math.pi, math.pi, n)

        def moved(frame: int) -> tuple[np.ndarray, ...]:
            phase = start + turning * DT * frame
            heading = np.stack([-np.sin(phase), np.cos(phase)], axis=1)
            position = centre + radius * np.stack([np.cos(phase), np.sin(phase)], axis=1)
            velocity = radius * turning[:, None] * heading
            return position, velocity, np.arctan2(velocity[:, 1], velocity[:, 0])

        return random, moved

    def _detected(
        self, random: np.random.Generator, time: float, position: np.ndarray, yaw: np.ndarray
    ) -> Detections:
        seen = random.random(self.objects) < DETECTION_PROBABILITY
        clutter = random.poisson(self.objects / 5)
        measured = np.concatenate(
            [
                position[seen] + random.normal(scale=MEASUREMENT_SD, size=(seen.sum(), 2)),
                random.uniform(-self.side / 2, self.side / 2, size=(clutter, 2)),
            ]
        )
        heading_of = np.concatenate([yaw[seen], random.uniform(-math.pi, math.pi, clutter)])
        order = random.permutation(len(measured))
        return _seen(time, measured[order], heading_of[order])

    def recording(self, count: int) -> Recording:
        """The same as a `Recording`, to score on."""
        truth, detections = zip(*self.frames(count), strict=True)
        return Recording(
            name=f"{self.objects} objects, {self.spacing:g} m apart",
            site=self.site,
            truth=truth,
            detections=detections,
            frame=np.arange(count),
            stamp=np.arange(count),
        )


def _truth(time, position, velocity, yaw) -> GroundTruth:
    n = len(position)
    return GroundTruth(
        time=time,
        id=np.arange(n),
        position=_at_height(position),
        size=np.tile(SIZE, (n, 1)),
        yaw=yaw,
        velocity=velocity,
        label=np.full(n, Label.CAR),
        visibility=np.ones(n),
        observable=np.ones(n, bool),
        crashed=np.zeros(n, bool),
    )


def _seen(time, position, yaw) -> Detections:
    n = len(position)
    return Detections(
        time=time,
        position=_at_height(position),
        size=np.tile(SIZE, (n, 1)),
        yaw=yaw,
        score=np.full(n, 0.5),
        label=np.full(n, Label.CAR),
    )


def _at_height(position):
    return np.column_stack([position, np.full(len(position), SIZE[2] / 2)])
