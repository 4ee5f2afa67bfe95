"""KITTI tracking's text files: labels, results, detections, calibration and poses.

Tables stay in the dataset's own terms: rectified camera-0 axes (x right, y down, z forward),
boxes by the centre of their bottom face and a yaw about +y; images of camera 2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from pmbm.datasets.files import LARGEST_SIZE, Place, text_rows
from pmbm.datasets.poses import Pose, pose
from pmbm.errors import nearest_hint
from pmbm.types import BoolArray, FloatArray, IntArray

TYPES: Final = (
    "Car",
    "Van",
    "Truck",
    "Pedestrian",
    "Person",
    "Person_sitting",
    "Cyclist",
    "Tram",
    "Misc",
)
DONT_CARE: Final = "DontCare"
_TYPE_OF: Final = {name.lower(): name for name in (*TYPES, DONT_CARE)}
_DETECTED_TYPES: Final = {1: "Pedestrian", 2: "Car", 3: "Cyclist"}
LONGEST: Final = 20_000
"""Frames beyond which a sequence's length is not believed (the longest has 1,176)."""
_LARGEST_ANGLE: Final = 10.0
_LARGEST_PIXEL: Final = 1e5
_LARGEST_SCORE: Final = 1e6
_SENSOR_FROM_CAMERA: Final = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""From the camera's axes to x forward, y left, z up."""
_IMAGE_SIZES: Final = {
    721.5: (1242, 375),
    718.9: (1241, 376),
    718.3: (1238, 374),
    707.1: (1224, 370),
}
"""Focal length of the recording day -> width and height of its rectified images, pixels."""
_EARTH_RADIUS: Final = 6378137.0


_PER_ROW: Final = (
    "frame",
    "id",
    "truncated",
    "occluded",
    "alpha",
    "box",
    "size",
    "bottom",
    "rotation_y",
    "solid",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class KittiObjects:
    """Rows of a label, result or detection file.

    frame, id (N,) : id is -1 in detections, which have none.
    type (N,) : the class names.
    truncated, occluded (N,), alpha (N,) : as in the file.
    box (N,4) : left, top, right, bottom, pixels; a point (-1 -1 -1 -1, 0 0 0 0) is a filler.
    size (N,3) : length, width, height, m.
    bottom (N,3) : centre of the bottom face, m, camera axes.
    rotation_y (N,) : rad.
    solid (N,) : whether there is a 3D box; size, bottom and rotation_y are 0 where there is none.
    score (N,) or None : of results and detections, unbounded.
    dont_care_frame (D,), dont_care_box (D,4) : the image regions that labels leave out.
    """

    frame: IntArray
    id: IntArray
    type: tuple[str, ...]
    truncated: FloatArray
    occluded: IntArray
    alpha: FloatArray
    box: FloatArray
    size: FloatArray
    bottom: FloatArray
    rotation_y: FloatArray
    solid: BoolArray
    score: FloatArray | None
    dont_care_frame: IntArray
    dont_care_box: FloatArray

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: Sequence[int]) -> KittiObjects:
        """The table with these rows only; the regions stay."""
        index = np.asarray(rows, dtype=np.int64)
        return KittiObjects(
            type=tuple(self.type[i] for i in index),
            score=None if self.score is None else self.score[index],
            dont_care_frame=self.dont_care_frame,
            dont_care_box=self.dont_care_box,
            **{name: getattr(self, name)[index] for name in _PER_ROW},
        )

    @property
    def in_image(self) -> BoolArray:
        """Whether each has an image box and no filler (N,)."""
        left, top, right, bottom = self.box.T
        return (right > left) | (bottom > top)

    def by_id(self) -> KittiObjects:
        """The rows in order of frame, then id."""
        return self.take(np.lexsort((self.id, self.frame)).tolist())

    @property
    def length(self) -> int:
        """Frames up to the last one that is named."""
        return int(max([-1, *self.frame.tolist(), *self.dont_care_frame.tolist()])) + 1


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraCalibration:
    """projection (3,4) : pixels of camera 2 from rectified camera-0 points.
    camera_from_imu (3,4), or None where the file has no such chain.
    image_size : width, height, pixels."""

    projection: FloatArray
    camera_from_imu: FloatArray | None
    image_size: tuple[int, int]

    @property
    def half_field_of_view(self) -> float:
        """Angle from the axis to the image's farther side, rad."""
        centre = self.projection[0, 2]
        side = max(centre, self.image_size[0] - centre)
        return float(np.arctan2(side, self.projection[0, 0]))


def read_objects(path: Path, *, scored: bool) -> KittiObjects:
    """A label file (17 columns) or, `scored`, a result file (18, or 17 where no result has a score,
    which then is 1).

    As the benchmark's own readers do, takes class names in any case and whole numbers written as
    decimals, and of results passes over DontCare and the id -1, and takes an image box alone, with
    fillers (-1 or 0) for the sides of the 3D box.

    A file that is as it was when it was last read is not read again: its classes are compared one
    by one.

    Raises InputError for anything but finite boxes of known classes, each id once in a frame.
    """
    try:
        state = path.stat()
    except (OSError, ValueError):
        return _objects_in(path, scored)
    return _remembered(path, scored, (state.st_ino, state.st_mtime_ns, state.st_size))


@lru_cache(maxsize=8)
def _remembered(path: Path, scored: bool, _state: tuple[int, int, int]) -> KittiObjects:
    return _objects_in(path, scored)


def _objects_in(path: Path, scored: bool) -> KittiObjects:
    columns: tuple[int, ...] = (17, 18) if scored else (17,)
    named: list[tuple[int, int, str]] = []
    numbers: list[list[float]] = []
    regions: list[list[float]] = []
    seen = set()
    for place, tokens in text_rows(path, None):
        _check_columns(place, tokens, *columns)
        # One length for all: a line that lost its score is no line without one.
        columns = (len(tokens),)
        frame = place.whole(tokens[0], "frame", at_least=0, at_most=LONGEST - 1)
        place = Place(path, frame=frame, rows=place.rows)
        kind = _known_type(place, tokens[2])
        if kind == DONT_CARE and not scored:
            regions.append([frame, *_pixels(place, tokens[6:10])])
            continue
        object_id = place.whole(tokens[1], "track_id", at_least=-1 if scored else 0)
        if scored and (kind == DONT_CARE or object_id == -1):
            continue
        place = Place(path, frame=frame, object_id=object_id, rows=place.rows)
        if (frame, object_id) in seen:
            raise place.error("the same id twice in a frame", field="track_id", got=object_id)
        seen.add((frame, object_id))
        named.append((frame, object_id, kind))
        numbers.append(
            [
                place.number(tokens[3], "truncated", within=2.0),
                place.whole(tokens[4], "occluded", at_least=-1, at_most=3),
                place.number(tokens[5], "alpha", within=_LARGEST_ANGLE),
                *_pixels(place, tokens[6:10]),
                *(_solid_or_flat(place, tokens) if scored else _geometry(place, tokens[10:17])),
                place.number(tokens[17], "score", within=_LARGEST_SCORE) if tokens[17:] else 1.0,
            ]
        )
    return _table(named, numbers, regions, scored=scored)


def read_detections(path: Path, kind: str | None) -> KittiObjects:
    """A detection file (15 columns, commas), all of one class where `kind` is given."""
    named: list[tuple[int, int, str]] = []
    numbers: list[list[float]] = []
    for place, tokens in text_rows(path, ","):
        _check_columns(place, tokens, 15)
        frame = place.whole(tokens[0], "frame", at_least=0, at_most=LONGEST - 1)
        place = Place(path, frame=frame, rows=place.rows)
        number = place.whole(tokens[1], "class")
        found = _DETECTED_TYPES.get(number)
        if found is None or (kind is not None and found != kind):
            wanted = [key for key, name in _DETECTED_TYPES.items() if kind in (None, name)]
            raise place.error("an unexpected class", field="class", expected=wanted, got=number)
        named.append((frame, -1, found))
        numbers.append(
            [
                *(-1.0, -1.0),
                place.number(tokens[14], "alpha", within=_LARGEST_ANGLE),
                *_pixels(place, tokens[2:6]),
                *_geometry(place, tokens[7:14]),
                place.number(tokens[6], "score", within=_LARGEST_SCORE),
            ]
        )
    return _table(named, numbers, [], scored=True)


def format_objects(objects: KittiObjects) -> str:
    """The result file's text: 18 columns, lengths and angles to 1e-10."""
    assert objects.score is not None
    lines = []
    for i in range(len(objects)):
        length, width, height = objects.size[i]
        numbers = (height, width, length, *objects.bottom[i], objects.rotation_y[i])
        lines.append(
            f"{objects.frame[i]} {objects.id[i]} {objects.type[i]} "
            f"{objects.truncated[i]:g} {objects.occluded[i]} {objects.alpha[i]:.10f} "
            + " ".join(f"{pixel:.4f}" for pixel in objects.box[i])
            + "".join(f" {number:.10f}" for number in numbers)
            + f" {objects.score[i]:.10g}\n"
        )
    return "".join(lines)


def read_calibration(path: Path) -> CameraCalibration:
    """P2 and the chain of frames; keys with or without their colon, by either of their names."""
    matrices: dict[str, tuple[Place, list[float]]] = {}
    for place, tokens in text_rows(path, None):
        key = tokens[0].removesuffix(":")
        if key in matrices:
            raise place.error("a matrix is given twice", field=key)
        matrices[key] = (place, [place.number(token, key) for token in tokens[1:]])

    def matrix(names: Sequence[str], shape: tuple[int, int]) -> FloatArray | None:
        for name in names:
            if name in matrices:
                place, values = matrices[name]
                if len(values) != shape[0] * shape[1]:
                    raise place.error(
                        "a matrix of the wrong size",
                        field=name,
                        expected=shape[0] * shape[1],
                        got=len(values),
                    )
                return np.array(values).reshape(shape)
        return None

    projection = matrix(["P2"], (3, 4))
    place = Place(path)
    if projection is None:
        raise place.error("a matrix is missing", field="P2", hint=nearest_hint("P2", matrices))
    focal = float(projection[0, 0])
    if not (0 < focal < _LARGEST_PIXEL) or abs(projection[2, 2] - 1) > 0.1:
        raise place.error("not a camera", field="P2", expected="f > 0 and P2[2,2] = 1")
    parts = [
        matrix(["R0_rect", "R_rect"], (3, 3)),
        matrix(["Tr_velo_to_cam", "Tr_velo_cam"], (3, 4)),
        matrix(["Tr_imu_to_velo", "Tr_imu_velo"], (3, 4)),
    ]
    chain = None
    if all(part is not None for part in parts):
        chain = np.linalg.multi_dot([_square(part) for part in parts if part is not None])[:3]
    nearest = min(_IMAGE_SIZES, key=lambda known: abs(known - focal))
    return CameraCalibration(
        projection=projection, camera_from_imu=chain, image_size=_IMAGE_SIZES[nearest]
    )


def read_poses(path: Path, calibration: CameraCalibration) -> tuple[Pose, ...]:
    """The pose of the sensor (camera 0 with x forward, y left, z up) in the world for every frame,
    from a file with a line per frame: 12 numbers, the camera in the frame of the first camera; or
    the 30 of the dataset's GPS and inertial unit, from which the world is east, north, up of the
    first frame's place.
    """
    rows: list[tuple[Place, list[float]]] = []
    for place, tokens in text_rows(path, None):
        _check_columns(place, tokens, 30 if len(tokens) == 30 else 12)
        if rows and len(tokens) != len(rows[0][1]):
            raise place.error("lines of different kinds", expected=len(rows[0][1]), got=len(tokens))
        where = Place(path, frame=len(rows), rows=place.rows)
        rows.append((where, [where.number(token, "pose") for token in tokens]))
    if not rows:
        raise Place(path).error("no poses", expected="a line per frame")
    if len(rows) > LONGEST:
        raise Place(path).error("too many poses", expected=f"at most {LONGEST}", got=len(rows))
    return _camera_poses(rows) if len(rows[0][1]) == 12 else _imu_poses(rows, calibration, path)


def _camera_poses(rows: Sequence[tuple[Place, list[float]]]) -> tuple[Pose, ...]:
    axes = _SENSOR_FROM_CAMERA
    poses = []
    for place, values in rows:
        matrix = np.array(values).reshape(3, 4)
        poses.append(pose(axes @ matrix[:, :3] @ axes.T, axes @ matrix[:, 3], place))
    return tuple(poses)


def _imu_poses(
    rows: Sequence[tuple[Place, list[float]]], calibration: CameraCalibration, path: Path
) -> tuple[Pose, ...]:
    """Mercator metres at the first frame's latitude; R = Rz(yaw) Ry(pitch) Rx(roll)."""
    if calibration.camera_from_imu is None:
        raise Place(path).error("the calibration has no chain from the inertial unit to the camera")
    imu_from_camera = np.linalg.inv(_square(calibration.camera_from_imu))
    scale = np.cos(np.radians(rows[0][1][0]))
    first: FloatArray | None = None
    poses = []
    for place, values in rows:
        latitude, longitude, altitude, roll, pitch, yaw = values[:6]
        if abs(latitude) >= 85:
            raise place.error("a latitude out of range", field="lat", got=latitude)
        east = scale * np.radians(longitude) * _EARTH_RADIUS
        north = scale * _EARTH_RADIUS * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))
        where = np.array([east, north, altitude])
        first = where if first is None else first
        world_from_imu = np.eye(4)
        world_from_imu[:3, :3] = _turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll)
        world_from_imu[:3, 3] = where - first
        camera = world_from_imu @ imu_from_camera
        poses.append(pose(camera[:3, :3] @ _SENSOR_FROM_CAMERA.T, camera[:3, 3], place))
    return tuple(poses)


def _turn(axis: int, angle: float) -> FloatArray:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return matrix


def _square(matrix: FloatArray) -> FloatArray:
    square = np.eye(4)
    square[: matrix.shape[0], : matrix.shape[1]] = matrix
    return square


def image_boxes(corners: FloatArray, calibration: CameraCalibration) -> Iterator[FloatArray | None]:
    """The image rectangle (left, top, right, bottom) around each box's visible part, cut at the
    image's sides; None where no part is in the image.

    corners (N,8,3) : camera axes; bit 0, 1, 2 of a corner's index say which side it is on.
    """
    last = np.array(calibration.image_size) - 1.0
    for box in corners:
        points = np.vstack([box[box[:, 2] >= _NEAR], *_crossings(box)])
        if len(points) == 0:
            yield None
            continue
        image = points @ calibration.projection[:, :3].T + calibration.projection[:, 3]
        pixels = image[:, :2] / image[:, 2:]
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        if (high <= 0).any() or (low >= last).any():
            yield None
        else:
            yield np.concatenate([np.clip(low, 0, last), np.clip(high, 0, last)])


_NEAR: Final = 0.1
"""Metres in front of the camera at which boxes are cut before they are projected."""


def _crossings(box: FloatArray) -> Iterator[FloatArray]:
    """Points (1,3) where an edge of the box passes the near plane."""
    for corner in range(8):
        for bit in (1, 2, 4):
            a, b = box[corner], box[corner ^ bit]
            if a[2] < _NEAR <= b[2]:
                yield (a + (b - a) * (_NEAR - a[2]) / (b[2] - a[2]))[None]


def to_camera(points: FloatArray) -> FloatArray:
    """Points (...,3) from x forward, y left, z up to the camera's axes."""
    return points @ _SENSOR_FROM_CAMERA


def to_sensor(points: FloatArray) -> FloatArray:
    """Points (...,3) from the camera's axes to x forward, y left, z up."""
    return points @ _SENSOR_FROM_CAMERA.T


def _check_columns(place: Place, tokens: Sequence[str], *columns: int) -> None:
    if len(tokens) not in columns:
        expected = " or ".join(map(str, columns))
        raise place.error("a line of the wrong length", expected=expected, got=len(tokens))


def _known_type(place: Place, token: str) -> str:
    kind = _TYPE_OF.get(token.lower())
    if kind is None:
        raise place.error(
            "an unknown class", field="type", got=token, hint=nearest_hint(token, TYPES)
        )
    return kind


def _pixels(place: Place, tokens: Sequence[str]) -> list[float]:
    names = ("bbox.left", "bbox.top", "bbox.right", "bbox.bottom")
    box = [
        place.number(token, name, within=_LARGEST_PIXEL)
        for token, name in zip(tokens, names, strict=True)
    ]
    if box[0] > box[2] or box[1] > box[3]:
        raise place.error("an image box without inside", field="bbox", got=box)
    return box


def _geometry(place: Place, tokens: Sequence[str]) -> list[float]:
    """l, w, h, x, y, z, ry of the file's h, w, l, x, y, z, ry."""
    height, width, length = (
        place.number(token, name, above=0.0, within=LARGEST_SIZE)
        for token, name in zip(tokens[:3], ("height", "width", "length"), strict=True)
    )
    x, y, z = (
        place.number(token, name) for token, name in zip(tokens[3:6], ("x", "y", "z"), strict=True)
    )
    return [length, width, height, x, y, z, _angle(place, tokens[6])]


def _solid_or_flat(place: Place, tokens: Sequence[str]) -> list[float]:
    """The geometry of a result, or zeros where fillers stand in its place."""
    sides = [
        place.number(token, name)
        for token, name in zip(tokens[10:13], ("height", "width", "length"), strict=True)
    ]
    if any(side not in (-1.0, 0.0) for side in sides):
        return _geometry(place, tokens[10:17])
    box = [float(token) for token in tokens[6:10]]
    if box[:2] == box[2:]:
        raise place.error(
            "neither an image box nor a 3D box", field="height", expected="above 0", got=sides[0]
        )
    return [0.0] * 7


def _angle(place: Place, token: str) -> float:
    return place.number(token, "rotation_y", within=_LARGEST_ANGLE)


def _table(
    named: Sequence[tuple[int, int, str]],
    numbers: Sequence[Sequence[float]],
    regions: Sequence[Sequence[float]],
    *,
    scored: bool,
) -> KittiObjects:
    """numbers : truncated, occluded, alpha, image box, l w h, x y z, ry, score."""
    number = np.array(numbers, dtype=np.float64).reshape(-1, 15)
    region = np.array(regions, dtype=np.float64).reshape(-1, 5)
    return KittiObjects(
        frame=np.array([frame for frame, _, _ in named], dtype=np.int64),
        id=np.array([object_id for _, object_id, _ in named], dtype=np.int64),
        type=tuple(kind for _, _, kind in named),
        truncated=number[:, 0],
        occluded=number[:, 1].astype(np.int64),
        alpha=number[:, 2],
        box=number[:, 3:7],
        size=number[:, 7:10],
        bottom=number[:, 10:13],
        rotation_y=number[:, 13],
        solid=number[:, 7:10].min(axis=1, initial=np.inf) > 0,
        score=number[:, 14] if scored else None,
        dont_care_frame=region[:, 0].astype(np.int64),
        dont_care_box=region[:, 1:],
    )
