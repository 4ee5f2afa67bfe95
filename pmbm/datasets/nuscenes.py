"""nuScenes: tables of JSON records, detections and results of one JSON file; everything in the
global frame, times in microseconds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from pmbm.datasets.files import (
    LARGEST_SIZE,
    Place,
    json_integer,
    json_key,
    json_list,
    json_object,
    json_text,
    json_vector,
    prepare_folder,
    read_json,
    replace_text,
    safe_name,
)
from pmbm.datasets.frames import Comparison
from pmbm.datasets.logs import (
    Box,
    Timeline,
    checked_classes,
    each_name_once,
    log_comparison,
    log_recording,
    log_tracks,
    submission_boxes,
)
from pmbm.datasets.poses import Pose, matrix_yaw, pose, quaternion_matrix, yaw_quaternion
from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import to_local
from pmbm.types import Label, Recording, TrackSequence

_LABELS: Final[Mapping[str, Label]] = {
    "car": Label.CAR,
    "truck": Label.TRUCK,
    "bus": Label.BUS,
    "trailer": Label.OTHER,
    "motorcycle": Label.MOTORCYCLIST,
    "bicycle": Label.CYCLIST,
    "pedestrian": Label.PEDESTRIAN,
}
CLASSES: Final = tuple(_LABELS)
_CATEGORIES: Final = {
    "vehicle.bicycle": "bicycle",
    "vehicle.bus.bendy": "bus",
    "vehicle.bus.rigid": "bus",
    "vehicle.car": "car",
    "vehicle.motorcycle": "motorcycle",
    "vehicle.trailer": "trailer",
    "vehicle.truck": "truck",
    "human.pedestrian.adult": "pedestrian",
    "human.pedestrian.child": "pedestrian",
    "human.pedestrian.construction_worker": "pedestrian",
    "human.pedestrian.police_officer": "pedestrian",
}
_RACK: Final = "static_object.bicycle_rack"
_OTHER_DETECTIONS: Final = ("construction_vehicle", "traffic_cone", "barrier")
_RANGE: Final = {"car": 50.0, "truck": 50.0, "bus": 50.0, "trailer": 50.0} | dict.fromkeys(
    ("motorcycle", "bicycle", "pedestrian"), 40.0
)
"""Metres from the vehicle, seen from above, within which a class is scored."""
_VISIBILITY: Final = {"": 1.0, "1": 0.2, "2": 0.5, "3": 0.7, "4": 0.9}
"""The middle of the share of pixels that each token stands for."""
_PER_SECOND: Final = 10**6
_MOST_BOXES: Final = 500
_META: Final = {
    "use_camera": False,
    "use_lidar": True,
    "use_radar": False,
    "use_map": False,
    "use_external": False,
}


@dataclass(frozen=True, kw_only=True)
class NuScenes:
    """Scenes of a version.

    root : the folder of the tables, such as `v1.0-mini`.
    detections : a detection file with every sample of the scenes; None for none.
    classes : of the seven that are tracked.

    World: the map's frame.  Truth is observable where the benchmark counts it: with a lidar or
    radar point, in its class's range, not in a bicycle rack.  Results are files of the submission's
    form, one a scene; `submit` joins them.
    """

    root: Path
    detections: str | None = None
    classes: tuple[str, ...] = CLASSES

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", Path(self.root))
        object.__setattr__(self, "classes", checked_classes(self.classes, _LABELS, "nuScenes"))

    @property
    def labels(self) -> tuple[int, ...]:
        """The labels of the classes asked for, in their order."""
        return tuple(_LABELS[name] for name in self.classes)

    def sequences(self) -> list[str]:
        """The names of all scenes."""
        return sorted(self._tables.scenes)

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One scene in the map's frame; without `truth` its annotations are not read.

        Raises InputError for missing or bad tables, and for a sample without detections listed.
        """
        tokens, timeline = self._frames(sequence)
        found = None
        if self.detections is not None:
            path = Path(self.detections)
            found = _read_results(path, tokens, "detection", named=False)
        return log_recording(
            name=f"nuscenes-{sequence}",
            timeline=timeline,
            truth=self._truth(tokens, timeline) if truth else None,
            detections=found,
            labels=_LABELS,
            classes=self.classes,
            max_range=max(_RANGE.values()),
            provenance={"dataset": "nuscenes", "sequence": sequence},
        )

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """Write `out`/SCENE.json, of the submission's form with every sample of the scene, and give
        its path.  Raises InputError where a sample has more than 500 boxes."""
        tokens, timeline = self._frames(sequence)
        results = {}
        for token, boxes in zip(
            tokens, submission_boxes(timeline, tracks, _LABELS, self.classes), strict=True
        ):
            if len(boxes) > _MOST_BOXES:
                raise InputError(
                    "nuScenes: too many boxes in a sample",
                    frame=token,
                    expected=f"at most {_MOST_BOXES}",
                    got=len(boxes),
                    hint="raise the score from which tracks are reported",
                )
            results[token] = [_row(box, token) for box in boxes]
        name = safe_name(sequence, Place(self.root), "sequences")
        path = prepare_folder(Path(out)) / f"{name}.json"
        _write(path, results)
        return path

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/SCENE.json in the map's frame, one report for every sample.

        Raises InputError for missing samples."""
        tokens, timeline = self._frames(sequence)
        return log_tracks(timeline, self._results(sequence, tokens, folder), _LABELS)

    def compared(self, sequence: str, kind: str, folder: Path) -> Comparison:
        """Annotations and results of one class in the map's frame, what the benchmark does not
        count left out on both sides."""
        tokens, timeline = self._frames(sequence)
        racks = [self._racks(token) for token in tokens]
        sides = [
            [
                [box for box in frame if box.observable and _counted(box, where, near)]
                for frame, where, near in zip(frames, timeline.poses, racks, strict=True)
            ]
            for frames in (
                self._truth(tokens, timeline),
                self._results(sequence, tokens, folder),
            )
        ]
        return log_comparison(timeline, sides[0], sides[1], kind, _LABELS)

    def submit(self, sequences: Sequence[str], out: Path) -> Path:
        """Join the results of these scenes into `out`/submission.json.

        Raises InputError where a scene has no result."""
        joined: dict[str, Any] = {}
        for sequence in sequences:
            tokens, _ = self._frames(sequence)
            boxes = self._results(sequence, tokens, out)
            joined |= {
                token: [_row(box, token) for box in frame]
                for token, frame in zip(tokens, boxes, strict=True)
            }
        path = Path(out) / "submission.json"
        _write(path, joined)
        return path

    @cached_property
    def _tables(self) -> _Tables:
        return _Tables(self.root)

    def _frames(self, sequence: str) -> tuple[list[str], Timeline]:
        return self._tables.timeline(sequence)

    def _truth(self, tokens: Sequence[str], timeline: Timeline) -> list[list[Box]]:
        return [
            self._tables.boxes(token, where)
            for token, where in zip(tokens, timeline.poses, strict=True)
        ]

    def _racks(self, token: str) -> list[Box]:
        return self._tables.racks(token)

    def _results(self, sequence: str, tokens: Sequence[str], folder: Path) -> list[list[Box]]:
        name = safe_name(sequence, Place(Path(folder)), "sequences")
        return _read_results(Path(folder) / f"{name}.json", tokens, "tracking", named=True)


class _Tables:
    """The tables of a version by token, read when they are needed."""

    def __init__(self, root: Path) -> None:
        self.root = root

    @cached_property
    def scenes(self) -> dict[str, tuple[Place, Mapping[str, Any]]]:
        found: dict[str, tuple[Place, Mapping[str, Any]]] = {}
        for place, record in self._table("scene").values():
            name = json_text(json_key(record, "name", place), place, "name")
            if name in found:
                raise place.error("two scenes of one name", field="name", got=name)
            found[name] = (place, record)
        return found

    @cached_property
    def samples(self) -> dict[str, tuple[Place, Mapping[str, Any]]]:
        return self._table("sample")

    @cached_property
    def lidar_poses(self) -> dict[str, str]:
        """Sample -> ego pose of its lidar key frame."""
        sensors = self._table("sensor")
        mounted = self._table("calibrated_sensor")
        found: dict[str, str] = {}
        for place, record in self._table("sample_data").values():
            if json_key(record, "is_key_frame", place) is not True:
                continue
            where, mount = self._at(mounted, record, "calibrated_sensor_token", place)
            sensor_place, sensor = self._at(sensors, mount, "sensor_token", where)
            if json_key(sensor, "channel", sensor_place) != "LIDAR_TOP":
                continue
            token = json_text(json_key(record, "sample_token", place), place, "sample_token")
            if token in found:
                raise place.error("two lidar key frames of one sample", field="sample_token")
            found[token] = json_text(
                json_key(record, "ego_pose_token", place), place, "ego_pose_token"
            )
        return found

    @cached_property
    def ego_poses(self) -> dict[str, tuple[Place, Mapping[str, Any]]]:
        return self._table("ego_pose")

    @cached_property
    def annotations(self) -> dict[str, list[tuple[Place, Mapping[str, Any], str]]]:
        """Sample -> place, record and category's name of each annotation."""
        instances, categories = self._table("instance"), self._table("category")
        found: dict[str, list[tuple[Place, Mapping[str, Any], str]]] = {}
        for place, record in self._table("sample_annotation").values():
            token = json_text(json_key(record, "sample_token", place), place, "sample_token")
            if token not in self.samples:
                raise place.error("no such sample", field="sample_token", got=token)
            where, instance = self._at(instances, record, "instance_token", place)
            kind_place, kind = self._at(categories, instance, "category_token", where)
            name = json_text(json_key(kind, "name", kind_place), kind_place, "name")
            found.setdefault(token, []).append((place, record, name))
        return found

    def timeline(self, scene: str) -> tuple[list[str], Timeline]:
        """The tokens of the scene's samples in order, and their times and poses."""
        if scene not in self.scenes:
            raise InputError(
                f"nuScenes: no scene '{scene}'",
                file=self.root / "scene.json",
                hint=nearest_hint(scene, self.scenes, "scene"),
            )
        place, record = self.scenes[scene]
        expected = json_integer(json_key(record, "nbr_samples", place), place, "nbr_samples")
        token = json_text(
            json_key(record, "first_sample_token", place), place, "first_sample_token"
        )
        tokens: list[str] = []
        stamps: list[int] = []
        poses: list[Pose] = []
        while token:
            where, sample = self._record(self.samples, token, place, "next")
            where = Place(where.file, frame=token, rows=where.rows)
            if len(tokens) >= expected:
                raise where.error("more samples than the scene has", expected=expected)
            stamp = json_integer(json_key(sample, "timestamp", where), where, "timestamp")
            if stamps and stamp <= stamps[-1]:
                raise where.error(
                    "times must increase", field="timestamp", expected=f"above {stamps[-1]}",
                    got=stamp,
                )  # fmt: skip
            tokens.append(token)
            stamps.append(stamp)
            poses.append(self._pose(token, where))
            following = json_key(sample, "next", where)
            token = json_text(following, where, "next") if following != "" else ""
        if len(tokens) != expected:
            raise place.error(
                "fewer samples than the scene has", field="nbr_samples", expected=expected,
                got=len(tokens),
            )  # fmt: skip
        return tokens, Timeline(tuple(stamps), _PER_SECOND, tuple(poses), world_boxes=True)

    def boxes(self, token: str, where: Pose) -> list[Box]:
        """The annotations of a sample, of the classes that are tracked."""
        racks = self.racks(token)
        boxes = []
        for place, record, category in self.annotations.get(token, []):
            kind = _CATEGORIES.get(category)
            if kind is None:
                continue
            name = str(record["instance_token"])
            box = _read_box(record, kind, name, Place(place.file, token, name, place.rows))
            points = sum(
                json_integer(json_key(record, field, place), place, field)
                for field in ("num_lidar_pts", "num_radar_pts")
            )
            level = json_key(record, "visibility_token", place)
            if not isinstance(level, str) or level not in _VISIBILITY:
                raise place.error(
                    "an unknown visibility", field="visibility_token",
                    expected=list(_VISIBILITY), got=level,
                )  # fmt: skip
            seen = points > 0 and _counted(box, where, racks)
            boxes.append(replace(box, observable=seen, visibility=_VISIBILITY[level]))
        return each_name_once(boxes, Place(self._path("sample_annotation"), token), "instance")

    def racks(self, token: str) -> list[Box]:
        """The bicycle racks of a sample."""
        return [
            _read_box(record, _RACK, "", Place(place.file, frame=token, rows=place.rows))
            for place, record, category in self.annotations.get(token, [])
            if category == _RACK
        ]

    def _pose(self, sample: str, place: Place) -> Pose:
        if sample not in self.lidar_poses:
            raise Place(self._path("sample_data"), frame=sample).error(
                "a sample without a lidar key frame"
            )
        token = self.lidar_poses[sample]
        where, record = self._record(self.ego_poses, token, place, "ego_pose_token")
        where = Place(where.file, frame=sample, object_id=token, rows=where.rows)
        rotation = json_vector(json_key(record, "rotation", where), where, "rotation", 4)
        translation = json_vector(json_key(record, "translation", where), where, "translation", 3)
        return pose(quaternion_matrix(rotation, where), translation, where)

    def _path(self, name: str) -> Path:
        return self.root / f"{name}.json"

    def _table(self, name: str) -> dict[str, tuple[Place, Mapping[str, Any]]]:
        path = self._path(name)
        found: dict[str, tuple[Place, Mapping[str, Any]]] = {}
        for row, item in enumerate(json_list(read_json(path), Place(path))):
            place = Place(path, rows=(row,))
            record = json_object(item, place)
            token = json_text(json_key(record, "token", place), place, "token")
            if token in found:
                raise place.error("two records of one token", field="token", got=token)
            found[token] = (place, record)
        return found

    def _at(
        self,
        table: Mapping[str, tuple[Place, Mapping[str, Any]]],
        record: Mapping[str, Any],
        field: str,
        place: Place,
    ) -> tuple[Place, Mapping[str, Any]]:
        token = json_text(json_key(record, field, place), place, field)
        return self._record(table, token, place, field)

    def _record(
        self,
        table: Mapping[str, tuple[Place, Mapping[str, Any]]],
        token: str,
        place: Place,
        field: str,
    ) -> tuple[Place, Mapping[str, Any]]:
        if token not in table:
            raise place.error("a token that no record has", field=field, got=token)
        return table[token]


def _counted(box: Box, where: Pose, racks: Sequence[Box]) -> bool:
    """Whether the box is in its class's range, and no cycle in a rack."""
    away = float(np.hypot(*(np.array(box.place[:2]) - where.translation[:2])))
    if away >= _RANGE[box.kind]:
        return False
    return box.kind not in ("bicycle", "motorcycle") or not any(
        _inside(rack, box) for rack in racks
    )


def _inside(rack: Box, box: Box) -> bool:
    local = to_local(box.place[:2], (*rack.place[:2], rack.yaw))
    return bool((np.abs(local) <= np.array(rack.size[:2]) / 2).all())


def _read_results(
    path: Path, tokens: Sequence[str], prefix: str, *, named: bool
) -> list[list[Box]]:
    """The boxes of these samples, all of which the file must list."""
    place = Place(path)
    document = json_object(read_json(path), place)
    results = json_object(json_key(document, "results", place), place, "results")
    frames = []
    for token in tokens:
        where = Place(path, frame=token)
        if token not in results:
            raise where.error("a sample is missing", field="results")
        items = json_list(results[token], where, "results")
        boxes = list(_result_boxes(items, token, prefix, path, named))
        frames.append(each_name_once(boxes, where, "tracking_id") if named else boxes)
    return frames


def _result_boxes(
    items: Sequence[Any], token: str, prefix: str, path: Path, named: bool
) -> Iterator[Box]:
    for row, item in enumerate(items):
        place = Place(path, frame=token, rows=(row,))
        record = json_object(item, place)
        if json_key(record, "sample_token", place) != token:
            raise place.error(
                "a box of another sample", field="sample_token", got=record["sample_token"]
            )
        name = ""
        if named:
            name = json_text(json_key(record, "tracking_id", place), place, "tracking_id")
            place = Place(path, token, name, (row,))
        kind = json_text(json_key(record, f"{prefix}_name", place), place, f"{prefix}_name")
        if kind in _OTHER_DETECTIONS and not named:
            continue
        if kind not in _LABELS:
            raise place.error(
                "an unknown class", field=f"{prefix}_name", got=kind,
                hint=nearest_hint(kind, _LABELS),
            )  # fmt: skip
        field = f"{prefix}_score"
        score = place.finite(json_key(record, field, place), field, within=1.0)
        if score < 0:
            raise place.error("a number out of range", field=field, expected="[0, 1]", got=score)
        yield replace(_read_box(record, kind, name, place), score=score)


def _read_box(record: Mapping[str, Any], kind: str, name: str, place: Place) -> Box:
    """Sizes are width, length, height here."""
    x, y, z = json_vector(json_key(record, "translation", place), place, "translation", 3)
    width, length, height = json_vector(
        json_key(record, "size", place), place, "size", 3, above=0.0, within=LARGEST_SIZE
    )
    rotation = json_vector(json_key(record, "rotation", place), place, "rotation", 4)
    yaw = matrix_yaw(quaternion_matrix(rotation, place))
    return Box(kind, name, (x, y, z), (length, width, height), yaw)


def _row(box: Box, token: str) -> dict[str, Any]:
    length, width, height = box.size
    return {
        "sample_token": token,
        "translation": list(box.place),
        "size": [width, length, height],
        "rotation": yaw_quaternion(box.yaw),
        "velocity": list(box.velocity or (0.0, 0.0)),
        "tracking_id": box.name,
        "tracking_name": box.kind,
        "tracking_score": box.score,
    }


def _write(path: Path, results: Mapping[str, Any]) -> None:
    replace_text(path, json.dumps({"meta": _META, "results": results}, indent=1, allow_nan=False))
