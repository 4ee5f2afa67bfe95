"""The truth of one run of the world, before any detector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.errors import InputError
from pmbm.geometry import corners, visible_fractions, wrap_angle
from pmbm.labels import OBSERVABLE_SHARE
from pmbm.types import (
    BoolArray,
    FloatArray,
    GroundTruth,
    IntArray,
    Recording,
    Site,
    checked_rows,
    frames_of,
)
from pmbm.validation import Checker, frozen
from pmbm.wording import counted


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """The truth of one run of the world, and where the sensor was.

    name : of the scenario or the log.
    site : static occluders, field of view, range.
    truth : F frames, times strictly increasing, with visibility and observable filled in.
    sensor_pose (F,3) : x, y, yaw of the sensor in the world, m and rad.
    stamp (F,) : int64 time in ns.
    rate : frames a second, Hz.
    object_name : id -> what the source calls the object.
    provenance : what is needed to make the scene again.
    """

    name: str
    site: Site
    truth: tuple[GroundTruth, ...]
    sensor_pose: FloatArray
    stamp: IntArray
    rate: float
    object_name: Mapping[int, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "truth", tuple(self.truth))
        object.__setattr__(self, "object_name", MappingProxyType(dict(self.object_name)))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))
        door = Checker(self, f"scene '{self.name}'")
        door.number("rate", above=0.0)
        door.floats("sensor_pose", (len(self.truth), 3))
        door.ints("stamp", (len(self.truth),))
        times = np.array([frame.time for frame in self.truth])
        for what, values in (("truth.time", times), ("stamp", self.stamp)):
            unordered = np.flatnonzero(np.diff(values) <= 0) + 1
            if len(unordered):
                raise InputError(
                    f"scene '{self.name}': times must increase",
                    frame=int(unordered[0]),
                    field=what,
                    got=values[unordered[0]],
                )

    def __len__(self) -> int:
        """Frames of truth."""
        return len(self.truth)

    def __repr__(self) -> str:
        return f"Scene('{self.name}': {counted(len(self), 'frame')} at {self.rate:g} Hz)"

    def __reduce__(self) -> tuple[Any, ...]:
        # Mapping proxies do not pickle; plain dicts do, and become proxies again on arrival.
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values["object_name"] = dict(self.object_name)
        values["provenance"] = dict(self.provenance)
        return _make_scene, (values,)

    def truth_digest(self) -> str:
        """The `truth_digest` of every recording made of this scene."""
        return Recording(
            name=self.name,
            site=self.site,
            truth=self.truth,
            detections=(),
            frame=np.zeros(0, np.int64),
            stamp=self.stamp,
            object_name=self.object_name,
        ).truth_digest()


def look(
    site: Site,
    sensor_pose: FloatArray,
    count: IntArray,
    position: FloatArray,
    size: FloatArray,
    yaw: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """What the sensor at `sensor_pose` (F,3) could see of the R boxes of F frames, `count` (F,) in
    each: their visible share (R,) of angular extent, and whether each is observable (R,): inside
    the field of view and the range, and at least a tenth visible.  Boxes of a frame shadow each
    other; so do the site's occluders."""
    visibility = visible_fractions(
        corners(position, size, yaw), count, sensor_pose[:, :2], site.occluders
    )
    pose = np.repeat(sensor_pose, count, axis=0)
    offset = position[:, :2] - pose[:, :2]
    bearing = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - pose[:, 2] - site.fov_centre)
    inside = (np.hypot(offset[:, 0], offset[:, 1]) <= site.max_range) & (
        np.abs(bearing) <= site.fov_half_angle
    )
    return visibility, inside & (visibility >= OBSERVABLE_SHARE)


def truth_of(
    site: Site,
    sensor_pose: FloatArray,
    time: Sequence[float],
    count: IntArray,
    columns: Mapping[str, NDArray[Any]],
) -> tuple[GroundTruth, ...]:
    """The truth of F frames from one table of their rows, with what the sensor could see of each.

    sensor_pose (F,3), time (F,), count (F,) : of the frames.
    columns : as of `GroundTruth`, the frames' rows one after the other, but for the visibility.

    Raises InputError where a frame is not what `GroundTruth` asks for.
    """
    rows = len(columns["id"])
    unseen = {**columns, "visibility": np.zeros(rows), "observable": np.zeros(rows, bool)}
    table = checked_rows(GroundTruth, time, count, unseen)
    visibility, observable = look(
        site, sensor_pose, count, table["position"], table["size"], table["yaw"]
    )
    table |= {"visibility": frozen(visibility), "observable": frozen(observable)}
    return frames_of(GroundTruth, time, count, table)


def make_scene(
    name: str,
    site: Site,
    rate: float,
    sensor_pose: ArrayLike,
    frames: Sequence[Mapping[str, Any]],
    *,
    object_name: Mapping[int, str] | None = None,
    provenance: Mapping[str, Any] | None = None,
    stamp: ArrayLike | None = None,
) -> Scene:
    """A scene from plain arrays: the way in for a user's own truth.

    `frames` holds one mapping a frame with `id`, `position`, `size`, `yaw`, `velocity` and `label`
    (as in `GroundTruth`), and optionally `crashed` and `time` (default: frame / rate).  Visibility
    and observability are worked out here.

    Raises InputError where the arrays are not what `GroundTruth` asks for.
    """
    poses = np.asarray(sensor_pose, dtype=np.float64)
    if poses.shape == (3,):
        poses = np.broadcast_to(poses, (len(frames), 3))
    if poses.shape != (len(frames), 3):
        raise InputError(
            f"scene '{name}': one sensor pose a frame",
            field="sensor_pose",
            expected=f"shape ({len(frames)}, 3)",
            got=f"shape {poses.shape}",
        )
    # The first value checks the arrays, so that the look need not.
    unseen = [
        GroundTruth(
            **{
                "time": index / rate,
                "crashed": np.zeros(len(values["id"]), bool),
                **values,
                "visibility": np.zeros(len(values["id"])),
                "observable": np.zeros(len(values["id"]), bool),
            }
        )
        for index, values in enumerate(frames)
    ]
    columns = {
        f.name: np.concatenate([getattr(frame, f.name) for frame in unseen])
        for f in fields(GroundTruth)
        if f.name not in ("time", "visibility", "observable") and unseen
    }
    time, count = [frame.time for frame in unseen], np.array([len(frame) for frame in unseen])
    truth = truth_of(site, poses, time, count, columns) if unseen else ()
    if stamp is None:
        stamp = np.array([round(frame.time * 1e9) for frame in truth], dtype=np.int64)
    return Scene(
        name=name,
        site=site,
        truth=truth,
        sensor_pose=poses,
        stamp=np.asarray(stamp),
        rate=rate,
        object_name=object_name or {},
        provenance=provenance or {},
    )


def _make_scene(values: dict[str, Any]) -> Scene:
    return Scene(**values)
