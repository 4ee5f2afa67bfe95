"""The values that pass between the parts: detections, truth, tracks, recordings.

Conventions (all types, all modules)
------------------------------------
- SI units; angles in radians in [-pi, pi); one world frame: right-handed, x east or forward,
  y north or left, z up, yaw counter-clockwise from x.
- Values are frozen and arrays are read-only, C-ordered float64 (ids int64, labels int8, flags
  bool).  Each is checked once, where it is made, and `InputError` names what is wrong.
- A missing thing is an absent row, never -1 or NaN.  In tables of indices alone, the named
  constants `CLUTTER` and `ABSENT` mean "no row".

Letters in shapes: N detections or objects in a frame, K tracks in a frame, P mixture components,
F frames of truth, D deliveries of detections, S steps of a tracker.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.errors import NOT_YET_CONFIRMED, InputError, nearest_hint
from pmbm.geometry import normal_density, normal_in_polygon
from pmbm.labels import Label
from pmbm.validation import Checker, frozen
from pmbm.wording import counted

if TYPE_CHECKING:
    import pandas as pd

    from pmbm.tables.reading import Parts

__all__ = [
    "ABSENT",
    "CLUTTER",
    "BoolArray",
    "Detections",
    "FloatArray",
    "GaussianMixture",
    "GroundTruth",
    "IntArray",
    "Label",
    "MountedSensor",
    "Recording",
    "Site",
    "TrackSequence",
    "Tracks",
]

CLUTTER: Final = -1
"""In `Recording.origin`: this detection comes from no object."""
ABSENT: Final = -1
"""In tables of indices: there is no row to point to."""

_IF_SET: Final = {"digest": "if set"}
"""Of fields that came later: where they are empty, hashes are what they were without them."""

_PAIRS_AT_ONCE = 1_000_000
"""Points times components looked at together: some tens of MB."""
_IDS_SHOWN = 8
"""Track ids that a repr shows."""

_OF_THE_SENSOR = ("sensor_pose", "sensor_velocity")
"""Arrays that have no row for each detection."""

_Table = TypeVar("_Table", bound="Detections | GroundTruth | GaussianMixture | Tracks")
_Frame = TypeVar("_Frame", bound="Detections | GroundTruth | Tracks")


@dataclass(frozen=True, eq=False, kw_only=True)
class Detections:
    """The detections of one frame.

    time : seconds.
    position (N,3) : box centres in the world, m.
    size (N,3) : length, width, height, m, all > 0.
    yaw (N,) : rad.
    score (N,) : confidence in [0, 1].
    label (N,) : `Label` values.
    sensor_pose (3,) : x, y, yaw of the sensor in the world.
    raw_score (N,) or None : the detector's own score on its own scale, where it differs.
    sensor : name of the sensor, of those of the `Site`; empty where there is only one.
    radial_velocity (N,) or None : rate of change of the distance from the sensor, m/s, where it is
        measured: of the object's velocity less the sensor's the part along the line of sight.
    sensor_velocity (2,) or None : of the sensor itself in the world, m/s, with what a turn of the
        vehicle adds at its mount; given beside `radial_velocity`.
    """

    time: float
    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    score: FloatArray
    label: NDArray[np.int8]
    sensor_pose: FloatArray = field(default_factory=lambda: np.zeros(3))
    raw_score: FloatArray | None = None
    sensor: str = field(default="", metadata=_IF_SET)
    radial_velocity: FloatArray | None = field(default=None, metadata=_IF_SET)
    sensor_velocity: FloatArray | None = field(default=None, metadata=_IF_SET)

    def __post_init__(self) -> None:
        door = Checker(self, "detections")
        door.time()
        n = door.rows("position", 3)
        door.boxes(n)
        door.unit_interval("score", n)
        door.labels(n)
        door.floats("sensor_pose", (3,))
        if self.raw_score is not None:
            door.floats("raw_score", (n,))
        if not isinstance(self.sensor, str):
            raise InputError("detections", field="sensor", expected="a name", got=self.sensor)
        if self.radial_velocity is not None:
            door.floats("radial_velocity", (n,))
            if self.sensor_velocity is None:
                raise InputError(
                    "detections: radial velocities without that of the sensor",
                    field="sensor_velocity",
                    expected="(2,) m/s in the world",
                    got=None,
                )
        if self.sensor_velocity is not None:
            door.floats("sensor_velocity", (2,))

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        return f"Detections({counted(len(self), 'box', 'boxes')} at {self.time:g} s)"

    @property
    def distance(self) -> FloatArray:
        """(N,) m from the sensor on the ground."""
        x, y, _ = self.sensor_pose
        return np.hypot(self.position[:, 0] - x, self.position[:, 1] - y)

    @classmethod
    def empty(
        cls, time: float, sensor_pose: ArrayLike = (0.0, 0.0, 0.0), sensor: str = ""
    ) -> Detections:
        """A frame in which the sensor looked and saw nothing."""
        return cls(
            time=time,
            position=np.zeros((0, 3)),
            size=np.zeros((0, 3)),
            yaw=np.zeros(0),
            score=np.zeros(0),
            label=np.zeros(0, np.int8),
            sensor_pose=np.asarray(sensor_pose, dtype=np.float64),
            sensor=sensor,
        )

    def take(self, rows: ArrayLike) -> Detections:
        """The same frame with only these rows (indices or a mask), in this order."""
        return _take(self, rows)


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundTruth:
    """The objects that are really there at one time.

    time : seconds.
    id (N,) : int64, unique in the frame, the same object through the recording.
    position (N,3), size (N,3), yaw (N,) : the boxes, as in `Detections`.
    velocity (N,2) : m/s in the world.
    label (N,) : `Label` values.
    visibility (N,) : unoccluded share of the object's angular extent seen from the sensor.
    observable (N,) : inside the field of view and range, and visibility >= 0.1.
    crashed (N,) : has collided.
    """

    time: float
    id: IntArray
    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    velocity: FloatArray
    label: NDArray[np.int8]
    visibility: FloatArray
    observable: BoolArray
    crashed: BoolArray

    def __post_init__(self) -> None:
        door = Checker(self, "ground truth")
        door.time()
        n = door.rows("position", 3)
        door.ids(n)
        door.boxes(n)
        door.floats("velocity", (n, 2))
        door.labels(n)
        door.unit_interval("visibility", n)
        door.flags("observable", n)
        door.flags("crashed", n)

    def __len__(self) -> int:
        return len(self.id)

    def __repr__(self) -> str:
        return f"GroundTruth({counted(len(self), 'object')} at {self.time:g} s)"

    def take(self, rows: ArrayLike) -> GroundTruth:
        """The same frame with only these rows (indices or a mask), in this order."""
        return _take(self, rows)


@dataclass(frozen=True, eq=False, kw_only=True)
class GaussianMixture:
    """A weighted sum of Gaussians over x = [x, y, vx, vy]; here the intensity of undetected
    objects, so the weights add up to an expected number of objects.

    log_weight (P,) : -inf is a weight of zero.
    mean (P,4) : m and m/s, in the world.
    cov (P,4,4) : symmetric, positive semi-definite.
    """

    log_weight: FloatArray
    mean: FloatArray
    cov: FloatArray

    def __post_init__(self) -> None:
        door = Checker(self, "Gaussian mixture")
        n = door.rows("mean", 4)
        door.floats("cov", (n, 4, 4))
        door.floats("log_weight", (n,), allow_minus_inf=True)

    def __len__(self) -> int:
        return len(self.log_weight)

    def __repr__(self) -> str:
        weight = float(np.exp(self.log_weight).sum())
        return f"GaussianMixture({counted(len(self), 'component')}, {weight:.3g} objects)"

    @classmethod
    def empty(cls) -> GaussianMixture:
        """The intensity of nothing."""
        return cls(log_weight=np.zeros(0), mean=np.zeros((0, 4)), cov=np.zeros((0, 4, 4)))

    def take(self, rows: ArrayLike) -> GaussianMixture:
        """The same with these components only (indices or a mask), in this order."""
        return _take(self, rows)

    def intensity(self, points: ArrayLike) -> FloatArray:
        """(M,) expected objects per m^2, of any velocity, at points (M,2) in the world, m."""
        points = _table_of_points(points, "points", least=0)
        weight, mean, cov = np.exp(self.log_weight), self.mean[:, :2], self.cov[:, :2, :2]
        rows = max(1, _PAIRS_AT_ONCE // max(1, len(self)))
        parts = [
            normal_density(points[i : i + rows], mean, cov) @ weight
            for i in range(0, len(points), rows)
        ]
        return np.concatenate([np.zeros(0), *parts])

    def expected_count(self, polygon: ArrayLike) -> float:
        """Expected objects in a simple polygon (V,2) in the world, convex or not, m; exact to about
        1e-14 of each component's weight (`pmbm.geometry.normal_in_polygon`).
        """
        corners = _table_of_points(polygon, "polygon", least=3)
        inside = normal_in_polygon(corners, self.mean[:, :2], self.cov[:, :2, :2])
        return float(np.exp(self.log_weight) @ inside)


@dataclass(frozen=True, eq=False, kw_only=True)
class Tracks:
    """The tracks of one report.

    time : seconds.
    id (K,) : int64, at least 0, unique in the frame, the same object through the run.
    position (K,3), size (K,3), yaw (K,) : the boxes, as in `Detections`.
    velocity (K,2) : m/s in the world.
    score (K,) : probability that the object exists, in [0, 1].
    label (K,) : `Label` values.
    covariance (K,4,4) or None : of [x, y, vx, vy].
    undetected : the intensity of objects in view that have no track, or None: never detected yet,
        or given up as a track and perhaps there.
    """

    time: float
    id: IntArray
    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    velocity: FloatArray
    score: FloatArray
    label: NDArray[np.int8]
    covariance: FloatArray | None = None
    undetected: GaussianMixture | None = None

    def __post_init__(self) -> None:
        door = Checker(self, "tracks")
        door.time()
        n = door.rows("position", 3)
        door.ids(n, negative=NOT_YET_CONFIRMED)
        door.boxes(n)
        door.floats("velocity", (n, 2))
        door.unit_interval("score", n)
        door.labels(n)
        if self.covariance is not None:
            door.floats("covariance", (n, 4, 4))

    def __len__(self) -> int:
        return len(self.id)

    def __repr__(self) -> str:
        ids = ", ".join(map(str, self.id[:_IDS_SHOWN].tolist()))
        more = ", ..." if len(self) > _IDS_SHOWN else ""
        shown = f", ids {ids}{more}" if len(self) else ""
        return f"Tracks({counted(len(self), 'track')} at {self.time:g} s{shown})"

    @classmethod
    def empty(cls, time: float) -> Tracks:
        """A frame in which the tracker reports nothing."""
        return cls(
            time=time,
            id=np.zeros(0, np.int64),
            position=np.zeros((0, 3)),
            size=np.zeros((0, 3)),
            yaw=np.zeros(0),
            velocity=np.zeros((0, 2)),
            score=np.zeros(0),
            label=np.zeros(0, np.int8),
        )

    def take(self, rows: ArrayLike) -> Tracks:
        """The same frame with only these rows (indices or a mask), in this order."""
        return _take(self, rows)


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackSequence(Sequence[Tracks]):
    """The reports of a tracker over a recording: one `Tracks` per step, in order of time.

    steps : the reports.
    frame (S,) : the truth frame each report belongs to, strictly increasing.
    seconds (S,) : CPU time of each step, s (never part of a result or a digest).
    dropped : deliveries not given to the tracker because they were older than its last step.
    inspections : what the tracker's `inspect()` gave after each step, or None.
    """

    steps: tuple[Tracks, ...]
    frame: IntArray
    seconds: FloatArray | None = None
    dropped: int = 0
    inspections: tuple[Any, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        door = Checker(self, "track sequence")
        door.ints("frame", (len(self.steps),))
        if len(self.frame) and (self.frame[0] < 0 or np.any(np.diff(self.frame) <= 0)):
            raise InputError(
                "track sequence: frames must increase",
                field="frame",
                rows=np.flatnonzero(np.diff(self.frame) <= 0) + 1,
                got=self.frame.tolist(),
            )
        if self.seconds is not None:
            door.floats("seconds", (len(self.steps),))

    def __len__(self) -> int:
        return len(self.steps)

    def __repr__(self) -> str:
        ids = len({i for tracks in self.steps for i in tracks.id.tolist()})
        late = f", {counted(self.dropped, 'late delivery', 'late deliveries')}" * (self.dropped > 0)
        return f"TrackSequence({counted(len(self), 'step')}, {counted(ids, 'track id')}{late})"

    @overload
    def __getitem__(self, index: int) -> Tracks: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Tracks, ...]: ...
    def __getitem__(self, index: int | slice) -> Tracks | tuple[Tracks, ...]:
        return self.steps[index]

    def __iter__(self) -> Iterator[Tracks]:
        return iter(self.steps)


@dataclass(frozen=True, eq=False, kw_only=True)
class MountedSensor:
    """One of several sensors: where it is mounted and what it can see.

    name : as `Detections.sensor` has it.
    mount (3,) : x forward, y left, m, and yaw, rad, in the frame of what carries it.
    fov_centre, fov_half_angle, max_range : its field of view, as in `Site`.
    latency : s from a measurement to its delivery.
    """

    name: str
    mount: FloatArray = field(default_factory=lambda: np.zeros(3))
    fov_centre: float = 0.0
    fov_half_angle: float = float(np.pi)
    max_range: float = 100.0
    latency: float = 0.0

    def __post_init__(self) -> None:
        door = Checker(self, f"sensor '{self.name}'")
        if not isinstance(self.name, str) or not self.name:
            raise InputError("mounted sensor", field="name", expected="a name", got=self.name)
        door.floats("mount", (3,))
        door.number("fov_centre")
        door.number("fov_half_angle", above=0.0, at_most=float(np.pi))
        door.number("max_range", above=0.0)
        door.number("latency", at_least=0.0)

    def pose_on(self, carrier: FloatArray) -> FloatArray:
        """The sensor's pose (...,3) in the world where its carrier's is `carrier` (...,3)."""
        x, y, yaw = np.moveaxis(carrier, -1, 0)
        forward, left, turn = self.mount
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.stack(
            [x + forward * cos - left * sin, y + forward * sin + left * cos, yaw + turn], axis=-1
        )

    def carrier_of(self, pose: FloatArray) -> FloatArray:
        """The carrier's pose (3,) where the sensor's is `pose` (3,)."""
        forward, left, turn = self.mount.tolist()
        x, y, yaw = pose.tolist()
        yaw -= turn
        cos, sin = math.cos(yaw), math.sin(yaw)
        return np.array([x - (forward * cos - left * sin), y - (forward * sin + left * cos), yaw])


@dataclass(frozen=True, eq=False, kw_only=True)
class Site:
    """Where the sensor stands and what it can see: everything that does not move.

    occluders : convex polygons, each (V,2), in the world.
    fov_centre, fov_half_angle : the field of view, relative to the sensor's yaw; half-angle pi
        is all round.
    max_range : m.
    drivable_area : polygons, each (V,2), in the world, or None where unknown.
    sensors : where there are several, each with a view of its own; the fields above then say where
        objects are followed at all, about what carries the sensors.
    """

    occluders: tuple[FloatArray, ...] = ()
    fov_centre: float = 0.0
    fov_half_angle: float = float(np.pi)
    max_range: float = 100.0
    drivable_area: tuple[FloatArray, ...] | None = None
    sensors: tuple[MountedSensor, ...] = field(default=(), metadata=_IF_SET)

    def __post_init__(self) -> None:
        door = Checker(self, "site")
        object.__setattr__(self, "sensors", tuple(self.sensors))
        names = [one.name for one in self.sensors]
        if len(set(names)) < len(names):
            raise InputError("site", field="sensors", expected="each name once", got=names)
        object.__setattr__(self, "occluders", door.polygons("occluders", self.occluders))
        if self.drivable_area is not None:
            object.__setattr__(
                self, "drivable_area", door.polygons("drivable_area", self.drivable_area)
            )
        door.number("fov_centre")
        door.number("fov_half_angle", above=0.0, at_most=float(np.pi))
        door.number("max_range", above=0.0)

    def __repr__(self) -> str:
        view = np.degrees(2.0 * self.fov_half_angle)
        return (
            f"Site({counted(len(self.occluders), 'occluder')}, field of view {view:.3g} degrees, "
            f"range {self.max_range:g} m)"
        )

    def sensor(self, name: str) -> MountedSensor | None:
        """The sensor of that name, or None where the site names none at all.

        Raises InputError, with the nearest name, where it names others.
        """
        for one in self.sensors:
            if one.name == name:
                return one
        if not self.sensors:
            return None
        names = [one.name for one in self.sensors]
        raise InputError(
            f"the site has no sensor '{name}'",
            field="sensor",
            expected=" or ".join(names),
            got=name,
            hint=nearest_hint(name, names, "sensor"),
        )

    def carrier_pose(self, detections: Detections) -> FloatArray:
        """The pose (3,) of what carries the sensor of these detections, which is that sensor's
        where there is only one."""
        mounted, pose = self.sensor(detections.sensor), detections.sensor_pose
        return pose if mounted is None else mounted.carrier_of(pose)

    @property
    def latency(self) -> float:
        """The latency of the slowest sensor, s."""
        return max((one.latency for one in self.sensors), default=0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """One run of the world, frame by frame: the truth, and what the detector delivered of it.

    name : of the scene or the log.
    site : what does not move.
    truth : F frames, times strictly increasing.
    detections : D deliveries, in order of arrival (a late one has an earlier time).
    frame (D,) : the truth frame of each delivery; a frame without one was dropped by the sensor.
    origin : per delivery (N,) truth row of each detection, or CLUTTER; None where unknown.  For
        statistics alone: `run` never shows it to a tracker.
    stamp (F,) : int64 time in the source's own unit.
    object_name : id -> the source's own id.
    provenance : what is needed to make the recording again.
    observable_by : where there are several sensors, the name of each -> per frame (N,) what it
        could see; the truth is observable where any could.
    """

    name: str
    truth: tuple[GroundTruth, ...]
    detections: tuple[Detections, ...]
    frame: IntArray
    stamp: IntArray
    site: Site = field(default_factory=Site)
    origin: tuple[IntArray, ...] | None = None
    object_name: Mapping[int, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    observable_by: Mapping[str, tuple[BoolArray, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "truth", tuple(self.truth))
        object.__setattr__(self, "detections", tuple(self.detections))
        object.__setattr__(self, "observable_by", MappingProxyType(dict(self.observable_by)))
        object.__setattr__(self, "object_name", MappingProxyType(dict(self.object_name)))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))
        door = Checker(self, f"recording '{self.name}'")
        door.ints("frame", (len(self.detections),))
        door.ints("stamp", (len(self.truth),))
        outside = np.flatnonzero((self.frame < 0) | (self.frame >= len(self.truth)))
        if len(outside):
            raise InputError(
                f"recording '{self.name}': a delivery belongs to no frame",
                field="frame",
                rows=outside,
                expected=f"0 to {len(self.truth) - 1}",
                got=self.frame[outside].tolist(),
            )
        times = np.array([frame.time for frame in self.truth])
        unordered = np.flatnonzero(np.diff(times) <= 0) + 1
        if len(unordered):
            raise InputError(
                f"recording '{self.name}': times of the truth must increase",
                frame=int(unordered[0]),
                field="truth.time",
                got=times[unordered[0]],
            )
        if self.origin is not None:
            self._check_origin()
        for name in {one.sensor for one in self.detections}:
            self.site.sensor(name)

    def _check_origin(self) -> None:
        assert self.origin is not None
        if len(self.origin) != len(self.detections):
            raise InputError(
                f"recording '{self.name}': one origin per delivery",
                field="origin",
                expected=len(self.detections),
                got=len(self.origin),
            )
        checked = []
        for delivery, rows in enumerate(self.origin):
            rows = frozen(np.asarray(rows, dtype=np.int64))
            objects = len(self.truth[self.frame[delivery]])
            if rows.shape != (len(self.detections[delivery]),) or np.any(
                (rows < CLUTTER) | (rows >= objects)
            ):
                raise InputError(
                    f"recording '{self.name}': origin must name a truth row for each detection",
                    frame=int(self.frame[delivery]),
                    field="origin",
                    expected=f"{len(self.detections[delivery])} of {CLUTTER} to {objects - 1}",
                    got=rows.tolist(),
                )
            checked.append(rows)
        object.__setattr__(self, "origin", tuple(checked))

    def __len__(self) -> int:
        """Frames of truth."""
        return len(self.truth)

    def __repr__(self) -> str:
        objects = len({i for frame in self.truth for i in frame.id.tolist()})
        boxes = sum(len(delivery) for delivery in self.detections)
        return (
            f"Recording('{self.name}': {counted(len(self), 'frame')}, "
            f"{counted(objects, 'object')}, {counted(boxes, 'detection')})"
        )

    def handed_over(self) -> IntArray:
        """The deliveries (S,) that a tracker is given, in that order.

        That of their arrival; but each is held back until the slowest sensor's `latency` after its
        measurement, so that those of faster sensors wait for it.  What is older than one before it
        is left out, and so is a second delivery of a frame by one sensor.
        """
        wait, slow = self.site.latency, {one.name: one.latency for one in self.site.sensors}
        time = np.array([one.time for one in self.detections])
        arrived = np.maximum.accumulate(
            time + np.array([slow.get(one.sensor, 0.0) for one in self.detections])
        )
        order = np.argsort(np.maximum(arrived, time + wait), kind="stable")
        kept: list[int] = []
        last_time, last_frame = -np.inf, -1
        given: set[str] = set()
        for delivery in order.tolist():
            sensor, frame = self.detections[delivery].sensor, int(self.frame[delivery])
            if frame > last_frame:
                given = set()
            if time[delivery] < last_time or frame < last_frame or sensor in given:
                continue
            kept.append(delivery)
            given.add(sensor)
            last_time, last_frame = float(time[delivery]), frame
        return np.array(kept, dtype=np.int64)

    def seen_by(self, sensor: str) -> Recording:
        """The same recording, where observable is what this sensor could see.

        Raises InputError, with the nearest name, where there is no such sensor.
        """
        if sensor not in self.observable_by:
            raise InputError(
                f"recording '{self.name}' does not say what '{sensor}' could see",
                field="sensor",
                hint=nearest_hint(sensor, self.observable_by, "sensor"),
            )
        truth = tuple(
            replace(frame, observable=flags)
            for frame, flags in zip(self.truth, self.observable_by[sensor], strict=True)
        )
        return replace(self, truth=truth)

    def __reduce__(self) -> tuple[Any, ...]:
        # Mapping proxies do not pickle; plain dicts do, and become proxies again on arrival.
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values["object_name"] = dict(self.object_name)
        values["provenance"] = dict(self.provenance)
        values["observable_by"] = dict(self.observable_by)
        return _make_recording, (values,)

    def to_tables(self) -> dict[str, pd.DataFrame]:
        """Truth, detections and poses as tables, one row a box (columns: docs/guide/tables.md).

        Names of objects that are in no frame are left out.
        Raises InputError where some deliveries have raw scores and others have not, and where one
        has a velocity of its sensor and no radial ones.
        """
        import pandas as pd

        from pmbm.tables.writing import recording_columns

        found = recording_columns(self)
        return {what: pd.DataFrame(columns) for what, columns in found.items()}

    @classmethod
    def from_tables(
        cls,
        tables: Mapping[str, Any],
        *,
        name: str = "table",
        site: Site | None = None,
        frame: Literal["world", "ego"] = "world",
        classes: Mapping[str, Label | None] | None = None,
        rate: float = 10.0,
        provenance: Mapping[str, Any] | None = None,
    ) -> Recording:
        """The recording of the tables `truth`, `detections` and `poses`, any of which may be
        missing: what `to_tables` gives, or a user's own.

        tables : DataFrames.  frame : that boxes are given in; "ego" needs poses.
        classes : the tables' own names -> labels, None for those left out.
        rate : frames a second, where no table has times.

        Raises InputError with table, column and row.
        """
        from pmbm.tables.reading import cells_of, parts

        found = parts(cells_of(tables), frame=frame, classes=classes, rate=rate)
        return cls.from_parts(found, name=name, site=site or Site(), provenance=provenance or {})

    @classmethod
    def from_parts(
        cls, parts: Parts, *, name: str, site: Site, provenance: Mapping[str, Any]
    ) -> Recording:
        """The recording of what was read of its tables, see `pmbm.tables`."""
        return cls(
            name=name,
            site=site,
            truth=frames_of(GroundTruth, parts.clock.time.tolist(), parts.truth_count, parts.truth),
            detections=frames_of(
                Detections,
                parts.delivery_time.tolist(),
                parts.detection_count,
                parts.detections,
                parts.delivery_pose,
                parts.of_sensor,
            ),
            frame=parts.frame,
            stamp=parts.stamp,
            origin=None if parts.origin is None else tuple(parts.origin),
            object_name=parts.object_name,
            provenance=provenance,
            observable_by=parts.observable_by,
        )

    def truth_digest(self) -> str:
        """A hash of the site, the stamps and the truth: equal bits, equal hash."""
        return digest_of(
            self.site,
            self.stamp,
            sorted(self.object_name.items()),
            *self.truth,
        )

    def detections_digest(self) -> str:
        """A hash of the deliveries and their frames: equal bits, equal hash."""
        return digest_of(self.frame, *self.detections)

    def digest(self) -> str:
        """A hash of the whole recording but its name and provenance."""
        return digest_of(
            self.truth_digest(), self.detections_digest(), list(self.origin or ("unknown",))
        )


def _table_of_points(points: ArrayLike, name: str, least: int) -> FloatArray:
    """Points (M,2), at least so many, all finite."""
    table = np.asarray(points, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < least or not np.isfinite(table).all():
        raise InputError(
            "Gaussian mixture: not a table of points",
            field=name,
            expected=f"finite numbers, (M,2) with M >= {least}",
            got=table.shape,
        )
    return table


def _make_recording(values: dict[str, Any]) -> Recording:
    return Recording(**values)


def _take(value: _Table, rows: ArrayLike) -> _Table:
    """A copy of a table-like value with only these rows of every per-row field."""
    index = np.asarray(rows)
    if index.size == 0 and index.dtype != np.bool_:
        index = index.astype(np.int64)
    picked = {}
    for f in fields(value):
        content = getattr(value, f.name)
        per_row = isinstance(content, np.ndarray) and f.name not in _OF_THE_SENSOR
        picked[f.name] = content[index] if per_row else content
    return type(value)(**picked)


def unchecked(kind: type[_Table], **values: Any) -> _Table:
    """A value made without the checks, by code that has made sure of all that they would find.

    All fields are given, with their final types; arrays are handed over, not copied, and become
    read-only.  For results made in an inner loop, where the checks would cost more than the result.
    """
    value = object.__new__(kind)
    for content in values.values():
        if isinstance(content, np.ndarray):
            content.setflags(write=False)
    value.__dict__.update(values)
    return value


def checked_rows(
    kind: type[_Frame],
    time: Sequence[float],
    count: IntArray,
    columns: Mapping[str, NDArray[Any]],
    sensor_pose: FloatArray | None = None,
) -> dict[str, NDArray[Any]]:
    """One table of the rows of many frames, checked in one go, as values of this kind hold them.

    time (F,) : s.  count (F,) : rows of each frame.  sensor_pose (F,3) : of detections.
    columns : name -> (R, ...), the frames' rows one after the other.

    Raises InputError as the value of the first frame that is wrong does.
    """
    given: dict[str, Any] = dict(columns)
    ids, frame = given.get("id"), np.repeat(np.arange(len(count)), count)
    good = bool(np.isfinite(time).all())
    if sensor_pose is not None:
        good &= bool(np.isfinite(sensor_pose).all())
    if ids is not None:
        # Each id once in a frame, not once in the table.
        order = np.lexsort((ids, frame))
        good &= not ((np.diff(ids[order]) == 0) & (np.diff(frame[order]) == 0)).any()
        given["id"] = np.arange(len(ids))
    try:
        whole = kind(time=0.0, **given)
    except InputError:
        good = False
    if not good:
        for index, at in enumerate(time):
            rows = frame == index
            one: dict[str, Any] = {name: values[rows] for name, values in columns.items()}
            if sensor_pose is not None:
                one["sensor_pose"] = sensor_pose[index]
            kind(time=at, **one)
    checked = {name: getattr(whole, name) for name in columns}
    if ids is not None:
        checked["id"] = frozen(np.asarray(ids, np.int64))
    return checked


def frames_of(
    kind: type[_Frame],
    time: Sequence[float],
    count: IntArray,
    table: Mapping[str, NDArray[Any]],
    sensor_pose: FloatArray | None = None,
    each: Mapping[str, Sequence[Any]] | None = None,
    **constant: Any,
) -> tuple[_Frame, ...]:
    """The values of many frames from their `checked_rows`.

    constant : fields that are the same in all.  each : others, by frame.
    """
    columns: dict[str, list[Any]] = {}
    end = np.cumsum(count).tolist()
    spans = list(zip([0, *end], end, strict=False))
    for f in fields(kind):
        if f.name in table:
            # Slices of what is read-only are so too, and cost less than to be made so.
            values = table[f.name].view()
            values.flags.writeable = False
            columns[f.name] = [values[start:stop] for start, stop in spans]
        else:
            otherwise = None if f.default is MISSING else f.default
            columns[f.name] = [constant.get(f.name, otherwise)] * len(spans)
    columns |= {name: list(values) for name, values in (each or {}).items()}
    columns["time"] = [float(at) for at in time]
    if sensor_pose is not None:
        columns["sensor_pose"] = list(frozen(np.array(sensor_pose, np.float64)))
    names = tuple(columns)
    found = []
    for contents in zip(*columns.values(), strict=True):
        value = object.__new__(kind)
        value.__dict__.update(zip(names, contents, strict=True))
        found.append(value)
    return tuple(found)


def digest_of(*parts: Any) -> str:
    """A hash of values, arrays by their bits: equal values, equal hash."""
    hasher = hashlib.sha256()
    for part in parts:
        _feed(hasher, part)
    return hasher.hexdigest()


def _feed(hasher: Any, part: Any) -> None:
    """Feed one value, with its type and shape, so that no two different values look alike."""
    if isinstance(part, np.ndarray):
        hasher.update(f"array {part.dtype.str} {part.shape};".encode())
        hasher.update(np.ascontiguousarray(part).tobytes())
    elif isinstance(part, list | tuple):
        hasher.update(f"{len(part)} items;".encode())
        for item in part:
            _feed(hasher, item)
    elif hasattr(part, "__dataclass_fields__"):
        hasher.update(f"{type(part).__name__};".encode())
        for f in fields(part):
            content = getattr(part, f.name)
            if f.metadata.get("digest") == "if set":
                if content is None or (not isinstance(content, np.ndarray) and not content):
                    continue
                hasher.update(f"{f.name};".encode())
            _feed(hasher, content)
    else:
        hasher.update(f"{type(part).__name__} {part!r};".encode())
