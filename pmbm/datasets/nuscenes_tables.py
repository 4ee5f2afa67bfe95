"""nuScenes' files: tables of records that point at each other by token, and files of results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from pmbm.datasets.files import (
    LARGEST_SIZE,
    Place,
    as_read,
    id_value,
    integer_value,
    json_key,
    json_list,
    json_object,
    json_vector,
    read_json,
    text_value,
)
from pmbm.datasets.logs import Box, Timeline, each_name_once
from pmbm.datasets.poses import Pose, matrix_yaw, pose, quaternion_matrix
from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import to_local
from pmbm.types import Label

LABELS: Final[Mapping[str, Label]] = {
    "car": Label.CAR,
    "truck": Label.TRUCK,
    "bus": Label.BUS,
    "trailer": Label.OTHER,
    "motorcycle": Label.MOTORCYCLIST,
    "bicycle": Label.CYCLIST,
    "pedestrian": Label.PEDESTRIAN,
}
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
_NOT_TRACKED: Final = frozenset(
    {
        "animal",
        "human.pedestrian.personal_mobility",
        "human.pedestrian.stroller",
        "human.pedestrian.wheelchair",
        "movable_object.barrier",
        "movable_object.debris",
        "movable_object.pushable_pullable",
        "movable_object.trafficcone",
        "vehicle.construction",
        "vehicle.emergency.ambulance",
        "vehicle.emergency.police",
        _RACK,
    }
)
"""The dataset's categories of boxes that belong to none of the classes."""
RANGE: Final = {"car": 50.0, "truck": 50.0, "bus": 50.0, "trailer": 50.0} | dict.fromkeys(
    ("motorcycle", "bicycle", "pedestrian"), 40.0
)
"""Metres from the vehicle, seen from above, within which a class is scored."""
_VISIBILITY: Final = {"": 1.0, "1": 0.2, "2": 0.5, "3": 0.7, "4": 0.9}
"""The middle of the share of pixels that each token stands for."""
_OTHER_DETECTIONS: Final = ("construction_vehicle", "traffic_cone", "barrier")
_PER_SECOND: Final = 10**6


class Tables:
    """The tables of a version by token, read when they are needed."""

    def __init__(self, root: Path) -> None:
        self.root = root

    @cached_property
    def scenes(self) -> dict[str, tuple[Place, Mapping[str, Any]]]:
        found: dict[str, tuple[Place, Mapping[str, Any]]] = {}
        for place, record in self._table("scene").values():
            name = text_value(json_key(record, "name", place), place, "name")
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
            token = text_value(json_key(record, "sample_token", place), place, "sample_token")
            if token in found:
                raise place.error("two lidar key frames of one sample", field="sample_token")
            found[token] = text_value(
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
            token = text_value(json_key(record, "sample_token", place), place, "sample_token")
            if token not in self.samples:
                raise place.error("no such sample", field="sample_token", got=token)
            where, instance = self._at(instances, record, "instance_token", place)
            kind_place, kind = self._at(categories, instance, "category_token", where)
            name = text_value(json_key(kind, "name", kind_place), kind_place, "name")
            if name not in _CATEGORIES and name not in _NOT_TRACKED:
                raise kind_place.error(
                    "an unknown category", field="name", got=name,
                    hint=nearest_hint(name, (*_CATEGORIES, *_NOT_TRACKED), "category"),
                )  # fmt: skip
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
        expected = integer_value(json_key(record, "nbr_samples", place), place, "nbr_samples")
        token = text_value(
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
            stamp = integer_value(json_key(sample, "timestamp", where), where, "timestamp")
            if stamps and stamp <= stamps[-1]:
                raise where.error(
                    "times must increase", field="timestamp", expected=f"above {stamps[-1]}",
                    got=stamp,
                )  # fmt: skip
            tokens.append(token)
            stamps.append(stamp)
            poses.append(self._pose(token, where))
            following = json_key(sample, "next", where)
            token = text_value(following, where, "next") if following != "" else ""
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
                integer_value(json_key(record, field, place), place, field)
                for field in ("num_lidar_pts", "num_radar_pts")
            )
            level = json_key(record, "visibility_token", place)
            if not isinstance(level, str) or level not in _VISIBILITY:
                raise place.error(
                    "an unknown visibility", field="visibility_token",
                    expected=list(_VISIBILITY), got=level,
                )  # fmt: skip
            seen = points > 0 and counted(box, where, racks)
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
            token = text_value(json_key(record, "token", place), place, "token")
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
        token = text_value(json_key(record, field, place), place, field)
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


def counted(box: Box, where: Pose, racks: Sequence[Box]) -> bool:
    """Whether the box is in its class's range, and no cycle in a rack."""
    away = float(np.hypot(*(np.array(box.place[:2]) - where.translation[:2])))
    if away >= RANGE[box.kind]:
        return False
    return box.kind not in ("bicycle", "motorcycle") or not any(
        _inside(rack, box) for rack in racks
    )


def _inside(rack: Box, box: Box) -> bool:
    local = to_local(box.place[:2], (*rack.place[:2], rack.yaw))
    return bool((np.abs(local) <= np.array(rack.size[:2]) / 2).all())


MODALITIES: Final = {
    "use_camera": False,
    "use_lidar": True,
    "use_radar": False,
    "use_map": False,
    "use_external": False,
}
"""What a file of results was made from that does not say it."""


def read_results(path: Path) -> Mapping[str, Any]:
    """A file of results, of detections or tracks, as it stands."""
    return json_object(read_json(path), Place(path))


def modalities(document: Mapping[str, Any], path: Path) -> dict[str, bool]:
    """What the results in that file were made from, by its `meta`.

    Raises InputError for a `meta` that says something else than true or false.
    """
    place = Place(path)
    meta = json_object(document.get("meta", {}), place, "meta")
    for name in MODALITIES:
        if not isinstance(meta.get(name, False), bool):
            raise place.error("not a yes or no", field=f"meta.{name}", got=as_read(meta[name]))
    # A file that names one of them says of the others that they were not used.
    return {name: meta.get(name, False if meta else MODALITIES[name]) for name in MODALITIES}


def result_boxes(
    document: Mapping[str, Any], path: Path, tokens: Sequence[str], prefix: str, *, named: bool
) -> list[list[Box]]:
    """The boxes of these samples, all of which the file must list."""
    place = Place(path)
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
            name = id_value(json_key(record, "tracking_id", place), place, "tracking_id")
            place = Place(path, token, name, (row,))
        kind = text_value(json_key(record, f"{prefix}_name", place), place, f"{prefix}_name")
        if kind in _OTHER_DETECTIONS and not named:
            continue
        if kind not in LABELS:
            raise place.error(
                "an unknown class", field=f"{prefix}_name", got=kind,
                hint=nearest_hint(kind, LABELS),
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
