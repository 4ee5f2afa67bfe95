"""The detector model: truth in, boxes out that err as a real detector's do.

It is what the world does.  What a tracker believes of its sensor is another type; robustness is
the mismatch between the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from scipy import special

from pmbm.errors import InputError, nearest_hint
from pmbm.labels import Label
from pmbm.sim.detector.boxes import Boxes, Targets, concatenate, polar, targets
from pmbm.sim.detector.calibration import reliability_of
from pmbm.sim.detector.clutter import ClutterModel, FalseBoxes, clutter
from pmbm.sim.detector.knobs import (
    NO_UNKNOWN_KEYS,
    Curve,
    NamedLabel,
    without_proxies,
)
from pmbm.sim.detector.objects import ObjectModel, sense
from pmbm.sim.detector.sensor import SensorModel, arrivals, blind, clock_error, moved, reported_pose
from pmbm.sim.streams import Purpose, Streams
from pmbm.sim.toml_tables import read_toml, table_of, validated
from pmbm.sim.world.scene import Scene
from pmbm.types import (
    CLUTTER,
    Detections,
    FloatArray,
    IntArray,
    Recording,
    checked_rows,
    frames_of,
)
from pmbm.validation import POSITIVE, Bounds, check_fields


@dataclass(frozen=True, kw_only=True)
class DetectorModel:
    """A detector as a whole; as it stands, a perfect one.

    name : of the profile.
    objects : how objects are detected, of every label that `label` does not list.
    label : the same for single labels.
    clutter : false boxes.
    sensor : what happens to whole frames.
    score_temperature, score_offset : miscalibration of all scores: the log-odds of a score are
        divided by the temperature (above 1 is too timid, below 1 too bold), then the offset is
        added.
    score_floor : no box is reported with less; scores are squeezed into what is above it.
    radial_velocity : whether it measures radial velocities, as a radar does.
    provenance : where the numbers come from.
    """

    name: str = "perfect"
    objects: ObjectModel = field(default_factory=ObjectModel)
    label: Mapping[NamedLabel, ObjectModel] = field(default_factory=dict)
    clutter: ClutterModel = field(default_factory=ClutterModel)
    sensor: SensorModel = field(default_factory=SensorModel)
    score_temperature: Annotated[float, POSITIVE] = 1.0
    score_offset: Annotated[float, Bounds()] = 0.0
    score_floor: Annotated[float, Bounds(0.0, 0.99)] = 0.0
    radial_velocity: bool = False
    provenance: str = ""

    def __post_init__(self) -> None:
        check_fields(self, "detector model")
        ordered = {Label(label): self.label[label] for label in sorted(self.label)}
        object.__setattr__(self, "label", MappingProxyType(ordered))

    def __repr__(self) -> str:
        return f"DetectorModel('{self.name}')"

    def __reduce__(self) -> tuple[Any, ...]:
        return without_proxies(self)

    def of(self, label: Label) -> ObjectModel:
        """The model of how objects of that label are detected."""
        return self.label.get(label, self.objects)

    def detect(
        self,
        scene: Scene,
        seed: int,
        trial: int = 0,
        *,
        sensor: str = "",
        sensor_velocity: FloatArray | None = None,
    ) -> Recording:
        """The recording that this detector makes of a scene.

        sensor : name of the sensor, where there are several: then it draws on streams of its own.
        sensor_velocity (F,2) : of the sensor in the world, m/s; by default that of the scene's
            poses, which leaves a sensor on a turning vehicle what the turn adds.

        Every random draw has a stream and a row of its own (see `pmbm.sim.streams`), so the same
        scene, seed and trial give the same bits, and changing a knob changes only what it is about.
        Boxes of a frame are listed by falling score; an origin stands twice where an object was
        reported twice.  The expected calibration error of the scores is in the provenance.
        """
        streams = Streams(seed, trial, sensor)
        if sensor_velocity is None and self.radial_velocity:
            sensor_velocity = velocity_of(scene.sensor_pose, scene.rate)
        seen = self._as_measured(scene, streams)
        boxes = concatenate(
            [
                *(
                    sense(
                        self.of(Label(label)), seen.take(seen.label == label), streams, self.clutter
                    )
                    for label in np.unique(seen.label).tolist()
                ),
                clutter(self.clutter, scene, streams),
            ]
        )
        if self.sensor.outage_duration > 0:
            boxes = boxes.take(~blind(self.sensor, scene, boxes))
        boxes = replace(boxes, score=self._as_reported(boxes.score))
        radial = None
        if self.radial_velocity:
            assert sensor_velocity is not None
            radial = self._radial_velocity(scene, boxes, seen, sensor_velocity, streams)
        pose = scene.sensor_pose
        if self.sensor.ego_position_noise > 0 or self.sensor.ego_yaw_noise > 0:
            pose = reported_pose(self.sensor, scene, streams)
            boxes = moved(boxes, scene.sensor_pose, pose)
        time = np.array([truth.time for truth in scene.truth])
        delivered = arrivals(self.sensor, time, streams)
        frames = _by_frame(boxes, scene, pose, sensor, radial, sensor_velocity)
        deliveries = [frames[frame] for frame in delivered]
        made = {
            "seed": seed,
            "trial": trial,
            "profile": self.plain(),
            "score_error": reliability_of(deliveries).expected_error or 0.0,
        }
        return Recording(
            name=scene.name,
            site=scene.site,
            truth=scene.truth,
            detections=tuple(detections for detections, _ in deliveries),
            frame=delivered,
            origin=tuple(origin for _, origin in deliveries),
            stamp=scene.stamp,
            object_name=scene.object_name,
            provenance={**scene.provenance, "detector": made},
        )

    def _as_measured(self, scene: Scene, streams: Streams) -> Targets:
        """The targets where they are at the moment of measurement."""
        seen = targets(scene)
        if self.sensor.time_jitter == 0:
            return seen
        late = clock_error(self.sensor, len(scene), streams)[seen.frame]
        position = seen.position.copy()
        position[:, :2] += late[:, None] * seen.velocity
        return replace(seen, position=position)

    def _radial_velocity(
        self,
        scene: Scene,
        boxes: Boxes,
        seen: Targets,
        sensor_velocity: FloatArray,
        streams: Streams,
    ) -> FloatArray:
        """(R,) m/s: how fast the distance from the sensor to what caused each box changes."""
        pose, own = scene.sensor_pose[boxes.frame], sensor_velocity[boxes.frame]
        _, bearing = polar(boxes.position, pose)
        sight = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        radial = boxes.ground_speed - (sight * own).sum(axis=1)
        # Row of the targets, of every frame and truth row.
        stride = 1 + max((len(frame) for frame in scene.truth), default=0)
        key = seen.frame * stride + seen.row
        real = np.flatnonzero(boxes.origin != CLUTTER)
        at = np.searchsorted(key, boxes.frame[real] * stride + boxes.origin[real])
        sight = np.stack([np.cos(seen.bearing), np.sin(seen.bearing)], axis=1)
        closing = (sight * (seen.velocity - sensor_velocity[seen.frame])).sum(axis=1)
        error = seen.members.normals(streams, Purpose.RADIAL, 1)[:, 0]
        for label in np.unique(seen.label).tolist():
            error[seen.label == label] *= self.of(Label(label)).radial_velocity_noise
        radial[real] = (closing + error)[at]
        return radial

    def _as_reported(self, score: FloatArray) -> FloatArray:
        if self.score_temperature != 1.0 or self.score_offset != 0.0:
            inner = np.clip(score, 1e-12, 1 - 1e-12)
            score = special.expit(special.logit(inner) / self.score_temperature + self.score_offset)
        return self.score_floor + (1.0 - self.score_floor) * score

    def plain(self) -> dict[str, Any]:
        """The model as a profile file says it: `load_profile` of it gives the model back."""
        return {
            "name": self.name,
            "provenance": self.provenance,
            "score_temperature": self.score_temperature,
            "score_offset": self.score_offset,
            "score_floor": self.score_floor,
            **({"radial_velocity": True} if self.radial_velocity else {}),
            "objects": _plain(self.objects),
            "label": _plain_by_label(self.label, self.objects),
            "clutter": _plain(self.clutter),
            "sensor": _plain(self.sensor),
        }


DetectorModel.__pydantic_config__ = NO_UNKNOWN_KEYS  # type: ignore[attr-defined]


def load_profile(
    profile: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | None = None
) -> DetectorModel:
    """A detector model from a shipped profile's name, a TOML file or a document already read.

    `overrides` has the file's own structure.  What it says under `objects` holds for every label;
    what it says under `label.NAME` for that one.

    Raises InputError naming file and key: unknown names and keys with the nearest valid one,
    impossible values with what was expected.
    """
    if isinstance(profile, Mapping):
        model = _model(profile, None)
    else:
        path = _profile_path(profile)
        model = _model(read_toml(path), path)
    if not overrides:
        return model
    return _model(_overridden(model.plain(), overrides), None)


def shipped_profiles() -> tuple[str, ...]:
    """Names of the profiles that come with the package."""
    folder = resources.files("pmbm.sim.detector") / "profiles"
    names = (entry.name for entry in folder.iterdir())
    return tuple(sorted(name[: -len(".toml")] for name in names if name.endswith(".toml")))


def _profile_path(profile: str | Path) -> Path:
    if isinstance(profile, Path) or profile.endswith(".toml"):
        return Path(profile)
    names = shipped_profiles()
    if profile not in names:
        raise InputError(
            f"no detector profile '{profile}'",
            expected="a shipped profile or a path that ends in .toml",
            hint=nearest_hint(profile, names, "profile"),
        )
    return Path(str(resources.files("pmbm.sim.detector") / "profiles" / f"{profile}.toml"))


def _model(document: Mapping[str, Any], file: object) -> DetectorModel:
    """The model that a document describes: the tables of a label refine the shared ones."""
    false_boxes = table_of(document, "clutter", file=file)
    look = {f.name: false_boxes[f.name] for f in fields(FalseBoxes) if f.name in false_boxes}
    filled = {
        **document,
        "label": _refined(document, table_of(document, "objects", file=file), "label", file=file),
        "clutter": {
            **false_boxes,
            "label": _refined(document, look, "clutter", "label", file=file),
        },
    }
    return validated(DetectorModel, filled, file=file)


def _refined(
    document: Mapping[str, Any], shared: Mapping[str, Any], *path: str, file: object
) -> dict[str, Any]:
    """The tables by label at a path, each on top of the shared one."""
    return {
        name: {**shared, **table_of(document, *path, name, file=file)}
        for name in table_of(document, *path, file=file)
    }


def _overridden(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """The document with what the overrides say; a shared table speaks for every label."""
    objects, clutter = table_of(overrides, "objects"), table_of(overrides, "clutter")
    clutter.pop("label", None)
    return {
        **base,
        **overrides,
        "objects": {**base["objects"], **objects},
        "label": _labels_overridden(base["label"], objects, overrides, "label"),
        "clutter": {
            **base["clutter"],
            **clutter,
            "label": _labels_overridden(
                base["clutter"]["label"], clutter, overrides, "clutter", "label"
            ),
        },
        "sensor": {**base["sensor"], **table_of(overrides, "sensor")},
    }


def _labels_overridden(
    base: Mapping[str, Any], shared: Mapping[str, Any], overrides: Mapping[str, Any], *path: str
) -> dict[str, Any]:
    """The tables by label, without what the shared one says anew, with those at a path."""
    left = {
        name: {key: value for key, value in table.items() if key not in shared}
        for name, table in base.items()
    }
    changed = {
        name: {**left.get(name, {}), **table_of(overrides, *path, name)}
        for name in table_of(overrides, *path)
    }
    return {**left, **changed}


def _plain(part: Any) -> dict[str, Any]:
    """A part of the model as a table of a file; a label's table says what differs."""
    table: dict[str, Any] = {}
    for f in fields(part):
        value = getattr(part, f.name)
        if value is None:
            continue
        if isinstance(value, Curve):
            value = value.plain()
        elif isinstance(value, tuple):
            value = list(value)
        elif f.name == "label":
            value = _plain_by_label(value, part)
        elif isinstance(value, Mapping):
            value = {label.name.lower(): share for label, share in value.items()}
        table[f.name] = value
    return table


def _plain_by_label(models: Mapping[Label, Any], shared: Any) -> dict[str, Any]:
    """The values of the models of single labels that differ from the shared one."""
    return {
        label.name.lower(): {
            key: value
            for key, value in _plain(model).items()
            if getattr(model, key) != getattr(shared, key)
        }
        for label, model in models.items()
    }


def velocity_of(pose: FloatArray, rate: float) -> FloatArray:
    """Velocities (F,2) m/s of poses (F,3), `rate` of them a second, by finite differences."""
    if len(pose) < 3:
        return np.zeros((len(pose), 2)) + (pose[-1, :2] - pose[0, :2]) * rate
    return np.asarray(np.gradient(pose[:, :2], 1.0 / rate, axis=0, edge_order=2))


def _by_frame(
    boxes: Boxes,
    scene: Scene,
    pose: FloatArray,
    sensor: str,
    radial: FloatArray | None,
    sensor_velocity: FloatArray | None,
) -> list[tuple[Detections, IntArray]]:
    """Detections and origins of every frame, the surest first."""
    order = np.lexsort((-boxes.score, boxes.frame))
    boxes = boxes.take(order)
    count = np.bincount(boxes.frame, minlength=len(scene))
    time = [truth.time for truth in scene.truth]
    columns = {name: getattr(boxes, name) for name in ("position", "size", "yaw", "score", "label")}
    table = checked_rows(Detections, time, count, columns, pose)
    frames = frames_of(Detections, time, count, table, pose, sensor=sensor)
    cuts = np.cumsum(count)[:-1]
    if radial is not None and sensor_velocity is not None:
        measured = np.split(radial[order], cuts)
        frames = tuple(
            replace(frame, radial_velocity=values, sensor_velocity=own)
            for frame, values, own in zip(frames, measured, sensor_velocity, strict=True)
        )
    return list(zip(frames, np.split(boxes.origin, cuts), strict=True))
