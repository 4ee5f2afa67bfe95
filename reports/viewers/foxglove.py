"""A trial as an MCAP file that Foxglove draws; equal trials give equal bytes."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson

from pmbm.durable import replace_bytes
from pmbm.reports.hidden_grid import decoded
from pmbm.reports.values import ReplayPage
from pmbm.reports.viewers.foxglove_schemas import SCHEMAS
from pmbm.reports.viewers.layout import (
    Clock,
    Colour,
    colour,
    colour_of_tracker,
    grids,
    label_name,
    origin_of,
    spread,
    track_text,
    view_outline,
)
from pmbm.types import Detections, FloatArray, GroundTruth, Tracks

_WORLD: Final = "world"
_SCENE: Final = "scene"
_STRIP, _LOOP = 0, 1
_DELETE_ALL: Final = 1
_FLOAT32: Final = 7
_THIN: Final = 0.1

Message = tuple[int, str, str, Any]
"""Stamp, topic, schema's name and value."""


def write_mcap(replay: ReplayPage, file: Path) -> None:
    """Write a trial as MCAP, whole or not at all."""
    from mcap.writer import CompressionType, Writer

    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD)
    writer.start(library="pmbm")
    scene = _Scene(replay)
    known: dict[str, int] = {}
    channels: dict[str, int] = {}
    # A stable sort: what is of one time stays in the order of the topics.
    for sequence, (stamp, topic, title, value) in enumerate(
        sorted(scene.messages(), key=lambda message: message[0])
    ):
        if title not in known:
            known[title] = writer.register_schema(
                title, "jsonschema", json.dumps(SCHEMAS[title]).encode()
            )
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "json", known[title])
        data = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY)
        writer.add_message(channels[topic], stamp, data, stamp, sequence)
    writer.add_metadata("pmbm", scene.metadata())
    writer.finish()
    replace_bytes(file, stream.getvalue())


class _Scene:
    """One trial's messages.  Positions are in the frame "scene", which is moved from the world by a
    round number of metres where the world's coordinates are large."""

    def __init__(self, replay: ReplayPage) -> None:
        self.replay = replay
        self.clock = Clock(replay.recording)
        self.origin = origin_of(replay.recording)

    def metadata(self) -> dict[str, str]:
        recording = self.replay.recording
        return {
            "recording": recording.name,
            "digest": recording.digest(),
            "trial": self.replay.title,
            "trackers": json.dumps(list(self.replay.tracks)),
            "origin": json.dumps(self.origin.tolist()),
            "time_offset": json.dumps(self.clock.offset),
        }

    def messages(self) -> Iterator[Message]:
        recording = self.replay.recording
        first = self.clock(min(recording.truth[0].time, *(d.time for d in recording.detections)))
        yield (
            first,
            "/tf",
            "foxglove.FrameTransform",
            _transform(first, _WORLD, _SCENE, self.origin, 0.0),
        )
        yield first, "/site", "foxglove.SceneUpdate", self._site(first)
        for truth in recording.truth:
            yield self._update("/truth", truth.time, self._objects(truth))
        for detections in recording.detections:
            name = detections.sensor or "sensor"
            stamp = self.clock(detections.time)
            place = np.array([*detections.sensor_pose[:2], 0.0]) - self.origin
            yield (
                stamp,
                "/tf",
                "foxglove.FrameTransform",
                _transform(stamp, _SCENE, name, place, float(detections.sensor_pose[2])),
            )
            topic = f"/detections/{detections.sensor}".rstrip("/")
            yield self._update(topic, detections.time, self._detected(detections))
        for index, (name, sequence) in enumerate(self.replay.tracks.items()):
            own = colour_of_tracker(index)
            for tracks in sequence:
                topic = f"/tracks/{name}"
                yield self._update(topic, tracks.time, self._tracked(tracks, own))
        yield from self._metrics()
        yield from self._unseen()

    def _update(self, topic: str, time: float, entities: Sequence[dict[str, Any]]) -> Message:
        """All that a topic shows at a time, in place of what it showed before."""
        stamp = self.clock(time)
        everything = {"timestamp": _time(stamp), "type": _DELETE_ALL, "id": ""}
        for entity in entities:
            entity["timestamp"] = _time(stamp)
        value = {"deletions": [everything], "entities": list(entities)}
        return stamp, topic, "foxglove.SceneUpdate", value

    def _objects(self, truth: GroundTruth) -> list[dict[str, Any]]:
        return [
            self._box(
                truth,
                row,
                identity=str(int(truth.id[row])),
                text=f"{int(truth.id[row])} {label_name(truth.label[row])}",
                own=colour("truth"),
                visibility=f"{truth.visibility[row]:.3f}",
                observable=str(bool(truth.observable[row])).lower(),
            )
            for row in range(len(truth))
        ]

    def _detected(self, detections: Detections) -> list[dict[str, Any]]:
        return [
            self._box(
                detections,
                row,
                identity=str(row),
                text=f"{detections.score[row]:.2f}",
                own=colour("detection"),
                score=repr(float(detections.score[row])),
            )
            for row in range(len(detections))
        ]

    def _tracked(self, tracks: Tracks, own: Colour) -> list[dict[str, Any]]:
        entities = []
        for row in range(len(tracks)):
            entity = self._box(
                tracks,
                row,
                identity=str(int(tracks.id[row])),
                text=track_text(tracks, row),
                own=own,
                score=repr(float(tracks.score[row])),
            )
            x, y, z = tracks.position[row] - self.origin
            vx, vy = tracks.velocity[row]
            # Where it will be in a second.
            entity["lines"].append(_line([[x, y], [x + vx, y + vy]], z, _STRIP, own))
            ellipse = spread(tracks, row)
            if ellipse is not None:
                entity["lines"].append(_line(ellipse - self.origin[:2], z, _LOOP, own))
            entities.append(entity)
        return entities

    def _box(
        self,
        boxes: GroundTruth | Detections | Tracks,
        row: int,
        *,
        identity: str,
        text: str,
        own: Colour,
        **metadata: str,
    ) -> dict[str, Any]:
        """The entity of one box, with its text above it."""
        place = boxes.position[row] - self.origin
        size = boxes.size[row]
        entity = _entity(identity, _SCENE)
        metadata = {"label": label_name(boxes.label[row]), **metadata}
        entity["metadata"] = [{"key": key, "value": value} for key, value in metadata.items()]
        entity["cubes"] = [
            {
                "pose": _pose(place, float(boxes.yaw[row])),
                "size": _vector(size),
                "color": _rgba(own),
            }
        ]
        above = place + np.array([0.0, 0.0, size[2] / 2 + 0.5])
        entity["texts"] = [
            {
                "pose": _pose(above, 0.0),
                "billboard": True,
                "font_size": 0.7,
                "scale_invariant": False,
                "color": _rgba((*own[:3], 1.0)),
                "text": text,
            }
        ]
        return entity

    def _site(self, stamp: int) -> dict[str, Any]:
        """Occluders, the drivable area, and the view of each sensor, which moves with it."""
        site = self.replay.recording.site
        standing = _entity("site", _SCENE)
        for polygons, name in ((site.occluders, "building"), (site.drivable_area or (), "line")):
            standing["lines"] += [
                _line(polygon - self.origin[:2], 0.0, _LOOP, colour(name, 1.0))
                for polygon in polygons
            ]
        entities = [standing]
        for one in site.sensors or (site,):
            name = getattr(one, "name", "sensor")
            view = _entity(f"view of {name}", name)
            outline = view_outline(one.fov_centre, one.fov_half_angle, one.max_range)
            view["lines"] = [_line(outline, 0.0, _LOOP, colour("accent", 1.0))]
            view["frame_locked"] = True
            entities.append(view)
        for entity in entities:
            entity["timestamp"] = _time(stamp)
        return {"deletions": [], "entities": entities}

    def _metrics(self) -> Iterator[Message]:
        for name, series in self.replay.series.items():
            for step, tracks in enumerate(self.replay.tracks[name]):
                stamp = self.clock(tracks.time)
                defined = {
                    metric: float(values[step])
                    for metric, values in series.items()
                    if np.isfinite(values[step])
                }
                value = {"timestamp": _time(stamp), **defined}
                yield stamp, f"/metrics/{name}", "pmbm.Metrics", value

    def _unseen(self) -> Iterator[Message]:
        """Expected undetected objects per m^2, cell by cell."""
        truth = self.replay.recording.truth
        for name, grid in grids(self.replay, self.origin):
            n = grid.code.shape[1]
            for frame, corner, code in zip(
                grid.frame.tolist(), grid.corner, grid.code, strict=True
            ):
                stamp = self.clock(truth[frame].time)
                content = decoded(code).astype("<f4").tobytes()
                yield (
                    stamp,
                    f"/unseen/{name}",
                    "foxglove.Grid",
                    {
                        "timestamp": _time(stamp),
                        "frame_id": _SCENE,
                        "pose": _pose(np.append(corner * grid.cell, 0.0), 0.0),
                        "column_count": n,
                        "cell_size": {"x": grid.cell, "y": grid.cell},
                        "row_stride": 4 * n,
                        "cell_stride": 4,
                        "fields": [{"name": "intensity", "offset": 0, "type": _FLOAT32}],
                        "data": base64.b64encode(content).decode(),
                    },
                )


def _entity(identity: str, frame: str) -> dict[str, Any]:
    """An entity that shows nothing yet; it stays until it is replaced or deleted."""
    primitives = (
        "arrows",
        "cubes",
        "spheres",
        "cylinders",
        "lines",
        "triangles",
        "texts",
        "models",
    )
    entity: dict[str, Any] = {
        "timestamp": _time(0),
        "frame_id": frame,
        "id": identity,
        "lifetime": _time(0),
        "frame_locked": False,
        "metadata": [],
    }
    return entity | {name: [] for name in primitives}


def _line(corners: Any, height: float, kind: int, own: Colour) -> dict[str, Any]:
    return {
        "type": kind,
        "pose": _pose(np.zeros(3), 0.0),
        "thickness": _THIN,
        "scale_invariant": False,
        "points": [{"x": float(x), "y": float(y), "z": float(height)} for x, y in corners],
        "color": _rgba((*own[:3], 1.0)),
        "colors": [],
        "indices": [],
    }


def _transform(
    stamp: int, parent: str, child: str, place: FloatArray, yaw: float
) -> dict[str, Any]:
    return {
        "timestamp": _time(stamp),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": _vector(place),
        "rotation": _turn(yaw),
    }


def _time(stamp: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def _pose(place: FloatArray, yaw: float) -> dict[str, Any]:
    return {"position": _vector(place), "orientation": _turn(yaw)}


def _vector(values: FloatArray) -> dict[str, float]:
    x, y, z = (float(value) for value in values)
    return {"x": x, "y": y, "z": z}


def _turn(yaw: float) -> dict[str, float]:
    """About the vertical; never the zero quaternion, which is no turn."""
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}


def _rgba(own: Colour) -> dict[str, float]:
    return dict(zip("rgba", own, strict=True))
