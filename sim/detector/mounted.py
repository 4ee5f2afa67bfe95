"""Several sensors on one carrier: each looks from its own place, at its own rate, with a detector
of its own, and what they deliver is one recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pmbm.sim.detector.model import DetectorModel, velocity_of
from pmbm.sim.world.scene import Scene, look
from pmbm.types import (
    Detections,
    IntArray,
    MountedSensor,
    Recording,
)

_Value = TypeVar("_Value", np.float64, np.bool_)


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedSensor:
    """One of several sensors of a scene.

    mounted : its name, mount, view and latency, as trackers are told.
    detector : what it makes of the truth that it sees.
    every, first : it looks at every so many frames of the scene, beginning with frame `first`.
    """

    mounted: MountedSensor
    detector: DetectorModel
    every: int = 1
    first: int = 0


def detect_by_all(
    scene: Scene, sensors: Sequence[SimulatedSensor], seed: int, trial: int = 0
) -> Recording:
    """The recording that several sensors make of a scene, whose poses are those of their carrier.

    Each draws on streams that its name keys, so that another one moves nothing of what it delivers.
    Deliveries come in order of arrival, by name where two arrive together.  An object is as visible
    as the sensor with the best sight of it sees it, and observable where any sensor could see it.
    """
    count = np.array([len(frame) for frame in scene.truth])
    boxes = [
        np.concatenate([getattr(frame, name) for frame in scene.truth])
        for name in ("position", "size", "yaw")
    ]
    deliveries: list[tuple[float, str, int, Detections, IntArray]] = []
    visible, observable, errors = [], {}, {}
    for one in sorted(sensors, key=lambda one: one.mounted.name):
        name, pose = one.mounted.name, one.mounted.pose_on(scene.sensor_pose)
        site = replace(
            scene.site,
            fov_centre=one.mounted.fov_centre,
            fov_half_angle=one.mounted.fov_half_angle,
            max_range=one.mounted.max_range,
        )
        share, seen = look(site, pose, count, *boxes)
        visible.append(np.where(seen, share, 0.0))
        shares, flags = _by_frame(share, count), _by_frame(seen, count)
        observable[name] = flags
        rows = np.arange(one.first, len(scene), one.every)
        own = Scene(
            name=scene.name,
            site=site,
            truth=tuple(
                replace(scene.truth[row], visibility=shares[row], observable=flags[row])
                for row in rows
            ),
            sensor_pose=pose[rows],
            stamp=scene.stamp[rows],
            rate=scene.rate / one.every,
        )
        # The velocity is that of all frames, not of those alone at which this sensor looks.
        velocity = velocity_of(pose, scene.rate)[rows]
        made = one.detector.detect(own, seed, trial, sensor=name, sensor_velocity=velocity)
        errors[name] = made.provenance["detector"]
        assert made.origin is not None
        arrival = -np.inf
        for detections, row, origin in zip(
            made.detections, made.frame.tolist(), made.origin, strict=True
        ):
            # What comes late comes with what overtook it.
            arrival = max(arrival, detections.time + one.mounted.latency)
            deliveries.append((arrival, name, int(rows[row]), detections, origin))
    # In order of names already, and of arrival within each.
    deliveries.sort(key=lambda one: one[0])
    best = _by_frame(np.max(visible, axis=0), count)
    any_could = [np.any(flags, axis=0) for flags in zip(*observable.values(), strict=True)]
    return Recording(
        name=scene.name,
        site=replace(scene.site, sensors=tuple(one.mounted for one in sensors)),
        truth=tuple(
            replace(frame, visibility=share, observable=flags)
            for frame, share, flags in zip(scene.truth, best, any_could, strict=True)
        ),
        detections=tuple(one[3] for one in deliveries),
        frame=np.array([one[2] for one in deliveries], np.int64),
        origin=tuple(one[4] for one in deliveries),
        stamp=scene.stamp,
        object_name=scene.object_name,
        provenance={**scene.provenance, "detector": errors},
        observable_by=observable,
    )


def _by_frame(values: NDArray[_Value], count: IntArray) -> tuple[NDArray[_Value], ...]:
    return tuple(np.split(values, np.cumsum(count)[:-1]))
