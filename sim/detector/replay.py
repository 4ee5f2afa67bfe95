"""Truth from anywhere, seen by the detector model.

A dataset's labels become a scene by `replay`, a user's own arrays by
`pmbm.sim.world.scene.make_scene`; with a detector model either is a source of recordings like any
scenario.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmbm.errors import InputError
from pmbm.sim.detector.model import DetectorModel
from pmbm.sim.world.scene import Scene, look
from pmbm.types import FloatArray, GroundTruth, Recording


@dataclass(frozen=True)
class Replay:
    """A scene and a detector model: a source, whose trials differ in the detector's luck alone.

    scene : the truth, and where the sensor was.
    detector : what it is seen by.
    """

    scene: Scene
    detector: DetectorModel

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.scene.name

    def record(self, seed: int, trial: int = 0) -> Recording:
        """The recording of one trial."""
        return self.detector.detect(self.scene, seed, trial)


def replay(recording: Recording, *, shadows: bool = False) -> Scene:
    """The truth of a recording as a scene, its own detections left out.

    The sensor's pose is that of the deliveries, linear in time where a frame has none.  Visibility
    is what the recording says; with `shadows` it is worked out anew from the boxes and the site's
    occluders.

    Raises InputError where the recording has fewer than two frames or no delivery.
    """
    if len(recording) < 2 or not len(recording.detections):
        raise InputError(
            f"recording '{recording.name}' cannot be replayed",
            expected="two frames of truth and a delivery that tells where the sensor was",
            got=f"{len(recording)} frames, {len(recording.detections)} deliveries",
        )
    time = np.array([frame.time for frame in recording.truth])
    pose = _poses(recording, time)
    truth = recording.truth
    if shadows:
        truth = _seen_from(recording, pose)
    return Scene(
        name=recording.name,
        site=recording.site,
        truth=truth,
        sensor_pose=pose,
        stamp=recording.stamp,
        rate=float(1 / np.median(np.diff(time))),
        object_name=recording.object_name,
        provenance={"replayed": dict(recording.provenance), "shadows": shadows},
    )


def _poses(recording: Recording, time: FloatArray) -> FloatArray:
    """The sensor's pose (F,3) at the times of the truth."""
    frame, first = np.unique(recording.frame, return_index=True)
    known = np.array([recording.site.carrier_pose(recording.detections[d]) for d in first])
    known[:, 2] = np.unwrap(known[:, 2])
    return np.stack([np.interp(time, time[frame], column) for column in known.T], axis=1)


def _seen_from(recording: Recording, pose: FloatArray) -> tuple[GroundTruth, ...]:
    truth = recording.truth
    count = np.array([len(frame) for frame in truth])
    boxes = (
        np.concatenate([getattr(frame, name) for frame in truth])
        for name in ("position", "size", "yaw")
    )
    seen = look(recording.site, pose, count, *boxes)
    end = np.cumsum(count)[:-1]
    return tuple(
        replace(frame, visibility=visibility, observable=observable)
        for frame, visibility, observable in zip(
            truth, *(np.split(values, end) for values in seen), strict=True
        )
    )
