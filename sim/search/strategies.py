"""Hypothesis strategies: scenes, detectors and recordings that shrink to what breaks a tracker.

Everything is valid as drawn, small comes first, and shrinking ends at one standing car, two frames
and a perfect detector.  The calls that hypothesis prints for a failure can be pasted as they stand:
`traffic(...)` and `faulty(...)` are plain functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from hypothesis import strategies as st
from numpy.typing import NDArray

from pmbm.geometry import corners, wrap_angle
from pmbm.labels import Label
from pmbm.sim.detector.boxes import TYPICAL_SIZE
from pmbm.sim.detector.clutter import ClutterModel
from pmbm.sim.detector.knobs import Curve
from pmbm.sim.detector.model import DetectorModel, load_profile
from pmbm.sim.detector.sensor import SensorModel
from pmbm.sim.world.scene import Scene, make_scene
from pmbm.types import FloatArray, Recording, Site

_RATE = 10.0
_WALL = ((12.0, 4.0), (24.0, 4.0), (24.0, 5.0), (12.0, 5.0))


@dataclass(frozen=True, kw_only=True)
class Mover:
    """Something that moves on a line or an arc; angles in degrees, where people read them.

    distance : from the sensor at the start, m.
    bearing : of its start, deg.
    speed : m/s.
    heading : at the start, deg.
    turn : deg/s.
    label : what it is; its size follows.
    born : frames before it appears.
    gone : frames at the end without it.
    """

    distance: float = 10.0
    bearing: float = 0.0
    speed: float = 0.0
    heading: float = 0.0
    turn: float = 0.0
    label: Label = Label.CAR
    born: int = 0
    gone: int = 0

    def path(self, frames: int) -> tuple[FloatArray, FloatArray]:
        """Position (F,3) and yaw (F,) in the frames."""
        time = np.arange(frames) / _RATE
        yaw = np.radians(self.heading + self.turn * time)
        step = self.speed / _RATE * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        bearing = np.radians(self.bearing)
        start = self.distance * np.array([np.cos(bearing), np.sin(bearing)])
        position = np.zeros((frames, 3))
        position[:, :2] = start + np.cumsum(step, axis=0) - step[0]
        position[:, 2] = TYPICAL_SIZE[self.label][2] / 2
        return position, wrap_angle(yaw)


def traffic(movers: Sequence[Mover], frames: int = 20, wall: bool = False) -> Scene:
    """A scene of movers about a standing sensor that looks all round, 10 frames a second.

    A mover that would drive through an earlier one is left out: bodies do not overlap.  With
    `wall` a wall of 12 m stands 4 m to the left of the sensor's axis.
    """
    paths: list[tuple[FloatArray, FloatArray]] = []
    there: list[Mover] = []
    for mover in movers:
        path = mover.path(frames)
        if not any(_meet(mover, path, *other) for other in zip(there, paths, strict=True)):
            there.append(mover)
            paths.append(path)
    rows = []
    for frame in range(frames):
        present = [
            number
            for number, mover in enumerate(there)
            if min(mover.born, frames - 1) <= frame < max(frames - mover.gone, mover.born + 1)
        ]
        yaw = np.array([paths[n][1][frame] for n in present])
        speed = np.array([there[n].speed for n in present])
        rows.append(
            {
                "id": np.array(present, dtype=np.int64) + 1,
                "position": np.array([paths[n][0][frame] for n in present]).reshape(-1, 3),
                "size": np.array([TYPICAL_SIZE[there[n].label] for n in present]).reshape(-1, 3),
                "yaw": yaw,
                "velocity": np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1),
                "label": np.array([int(there[n].label) for n in present], dtype=np.int64),
            }
        )
    site = Site(occluders=(np.array(_WALL),) if wall else ())
    return make_scene("traffic", site, _RATE, (0.0, 0.0, 0.0), rows)


def faulty(
    *,
    misses: float = 0.0,
    burst: float = 1.0,
    noise: float = 0.0,
    clutter: float = 0.0,
    persistent: float = 0.0,
    flips: float = 0.0,
    duplicates: float = 0.0,
    dropped: float = 0.0,
    late: float = 0.0,
    pose_noise: float = 0.0,
) -> DetectorModel:
    """A detector with these faults and no others: probabilities, frames, m, boxes a frame."""
    perfect = load_profile("perfect")
    return replace(
        perfect,
        objects=replace(
            perfect.objects,
            detection_probability=Curve.constant(1.0 - misses),
            miss_burst_length=burst,
            radial_noise=Curve.constant(noise),
            lateral_noise=Curve.constant(noise),
            flip_probability=flips,
            duplicate_probability=duplicates,
        ),
        clutter=ClutterModel(rate=clutter, persistent_share=persistent),
        sensor=SensorModel(
            drop_probability=dropped, late_probability=late, ego_position_noise=pose_noise
        ),
    )


def scenes(*, max_vehicles: int = 6, max_frames: int = 40) -> st.SearchStrategy[Scene]:
    """Scenes of 1 to `max_vehicles` movers and 2 to `max_frames` frames."""
    few_frames = st.integers(0, max(max_frames // 4, 1))
    labels = [Label.CAR, Label.TRUCK, Label.PEDESTRIAN, Label.CYCLIST]
    movers = st.builds(
        Mover,
        distance=st.integers(8, 80),
        bearing=st.integers(0, 355),
        speed=st.integers(0, 20),
        heading=st.integers(0, 355),
        turn=st.integers(-30, 30),
        label=st.sampled_from(labels),
        born=few_frames,
        gone=few_frames,
    )
    return st.builds(
        traffic,
        st.lists(movers, min_size=1, max_size=max_vehicles),
        frames=st.integers(2, max_frames),
        wall=st.booleans(),
    )


def detectors() -> st.SearchStrategy[DetectorModel]:
    """Detectors with any mixture of faults, each as likely absent as present."""

    def share(most: int) -> st.SearchStrategy[float]:
        return st.just(0.0) | st.integers(0, most).map(lambda percent: percent / 100)

    return st.builds(
        faulty,
        misses=share(50),
        burst=st.just(1.0) | st.integers(1, 10).map(float),
        noise=share(60),
        clutter=share(800),
        persistent=share(100),
        flips=share(30),
        duplicates=share(30),
        dropped=share(20),
        late=share(20),
        pose_noise=share(30),
    )


def recordings(
    scene: st.SearchStrategy[Scene] | None = None,
    detector: st.SearchStrategy[DetectorModel] | None = None,
) -> st.SearchStrategy[Recording]:
    """What detectors make of scenes, with any seed; default `scenes()` and `detectors()`."""
    return st.builds(
        _detect,
        scenes() if scene is None else scene,
        detectors() if detector is None else detector,
        seed=st.integers(0, 2**32 - 1),
    )


def _detect(scene: Scene, detector: DetectorModel, seed: int) -> Recording:
    return detector.detect(scene, seed)


def _meet(
    mover: Mover,
    path: tuple[FloatArray, FloatArray],
    other: Mover,
    other_path: tuple[FloatArray, FloatArray],
) -> bool:
    """Whether two movers touch in any frame."""
    first, second = _outlines(mover, *path), _outlines(other, *other_path)
    return bool(shapely.intersects(first, second).any())


def _outlines(mover: Mover, position: FloatArray, yaw: FloatArray) -> NDArray[Any]:
    size = np.broadcast_to(TYPICAL_SIZE[mover.label], position.shape)
    outlines: NDArray[Any] = shapely.polygons(corners(position, size, yaw))
    return outlines
