"""A trial as an .rrd file for Rerun; equal trials read back equal.

Rerun keeps what a later frame leaves out, labels of boxes that are gone among it: every frame
logs every component of what it shows, as many rows of each.  Nothing timed lies on the path of
something static, which would hide it.  Track ids stand in labels, since class ids are 16 bits.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr

from pmbm.durable import replace_bytes
from pmbm.reports.hidden_grid import decoded
from pmbm.reports.values import ReplayPage
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

_TIMELINE: Final = "time"
_THIN: Final = 0.05


def write_rrd(replay: ReplayPage, file: Path) -> None:
    """Write a trial as .rrd, whole or not at all."""
    identity = hashlib.sha256(f"{replay.recording.digest()} {replay.title}".encode()).hexdigest()
    # A stream of its own: nothing of what else is logged in this process is in it.
    stream = rr.RecordingStream("pmbm", recording_id=identity[:32], send_properties=False)
    sink = stream.binary_stream()
    _Log(replay, stream).write()
    content = sink.read(flush=True)
    stream.disconnect()
    replace_bytes(file, content or b"")


class _Log:
    """One trial, written to a stream.  Rerun's positions are float32: they are told from an origin
    near the scene, which "origin" records in double precision."""

    def __init__(self, replay: ReplayPage, stream: Any) -> None:
        self.replay = replay
        self.stream = stream
        self.clock = Clock(replay.recording)
        self.origin = origin_of(replay.recording)

    def write(self) -> None:
        recording = self.replay.recording
        self._log_static()
        for truth in recording.truth:
            texts = [f"{i} {label_name(k)}" for i, k in zip(truth.id, truth.label, strict=True)]
            self._boxes("scene/truth", truth, texts, colour("truth"))
        for detections in recording.detections:
            name = detections.sensor or "sensor"
            texts = [f"{score:.2f}" for score in detections.score]
            topic = f"scene/detections/{name}"
            self._boxes(topic, detections, texts, colour("detection"))
            x, y, yaw = detections.sensor_pose
            mounted = np.array([x, y, 0.0]) - self.origin
            self._log(
                f"scene/{name}",
                rr.Transform3D(translation=mounted, quaternion=rr.Quaternion(xyzw=_turn(yaw))),
            )
        for place, (name, sequence) in enumerate(self.replay.tracks.items()):
            for tracks in sequence:
                self._tracks(f"scene/tracks/{_part(name)}", tracks, colour_of_tracker(place))
        self._metrics()
        self._unseen()

    def _log(self, path: str, value: Any) -> None:
        self.stream.log(path, value)

    def _at(self, time: float) -> None:
        # Whole nanoseconds: floats of seconds would be cut.
        self.stream.set_time(_TIMELINE, duration=np.timedelta64(self.clock(time), "ns"))

    def _log_static(self) -> None:
        recording = self.replay.recording
        site = recording.site
        facts = rr.AnyValues(
            metres=self.origin, recording=recording.name, time_offset=self.clock.offset
        )
        self.stream.log("origin", facts, static=True)
        for polygons, name in ((site.occluders, "building"), (site.drivable_area or (), "line")):
            if polygons:
                lines = [_closed(polygon - self.origin[:2], 0.0) for polygon in polygons]
                self.stream.log(f"scene/site/{name}", _lines(lines, colour(name, 1.0)), static=True)
        for one in site.sensors or (site,):
            name = getattr(one, "name", "sensor")
            outline = view_outline(one.fov_centre, one.fov_half_angle, one.max_range)
            view = _lines([_closed(outline, 0.0)], colour("accent", 1.0))
            self.stream.log(f"scene/{name}/view", view, static=True)

    def _boxes(
        self,
        path: str,
        boxes: GroundTruth | Detections | Tracks,
        texts: Sequence[str],
        own: Colour,
    ) -> None:
        self._at(boxes.time)
        n = len(boxes)
        turns = np.zeros((n, 4))
        turns[:, 2], turns[:, 3] = np.sin(boxes.yaw / 2), np.cos(boxes.yaw / 2)
        self._log(
            path,
            rr.Boxes3D(
                centers=boxes.position - self.origin,
                half_sizes=boxes.size / 2,
                quaternions=turns,
                colors=np.tile(_bytes(own), (n, 1)),
                labels=list(texts),
                show_labels=True,
                radii=np.full(n, _THIN),
            ),
        )

    def _tracks(self, path: str, tracks: Tracks, own: Colour) -> None:
        texts = [track_text(tracks, row) for row in range(len(tracks))]
        self._boxes(path, tracks, texts, own)
        lines, moves = [], []
        for row in range(len(tracks)):
            place = tracks.position[row] - self.origin
            moves.append(np.stack([place, place + np.array([*tracks.velocity[row], 0.0])]))
            ellipse = spread(tracks, row)
            if ellipse is not None:
                lines.append(_closed(ellipse - self.origin[:2], float(place[2])))
        self._log(f"{path}/velocity", _lines(moves, own))
        self._log(f"{path}/spread", _lines(lines, own))

    def _metrics(self) -> None:
        for name, series in self.replay.series.items():
            for step, tracks in enumerate(self.replay.tracks[name]):
                self._at(tracks.time)
                for metric, values in series.items():
                    defined = values[step : step + 1][np.isfinite(values[step : step + 1])]
                    self._log(f"metrics/{metric}/{_part(name)}", rr.Scalars(defined))

    def _unseen(self) -> None:
        truth = self.replay.recording.truth
        for name, grid in grids(self.replay, self.origin):
            n = grid.code.shape[1]
            picture = rr.components.ImageFormat(
                width=n, height=n, color_model="L", channel_datatype="F32"
            )
            for frame, corner, code in zip(
                grid.frame.tolist(), grid.corner, grid.code, strict=True
            ):
                self._at(truth[frame].time)
                self._log(
                    f"scene/unseen/{_part(name)}",
                    rr.GridMap(
                        data=decoded(code).astype("<f4").tobytes(),
                        format=picture,
                        cell_size=grid.cell,
                        translation=[*(corner * grid.cell), 0.0],
                        opacity=0.5,
                    ),
                )


def _lines(strips: Sequence[FloatArray], own: Colour) -> Any:
    n = len(strips)
    return rr.LineStrips3D(
        strips, colors=np.tile(_bytes((*own[:3], 1.0)), (n, 1)), radii=np.full(n, _THIN)
    )


def _closed(corners: FloatArray, height: float) -> FloatArray:
    """(V+1,3) of an outline (V,2)."""
    round_about = np.concatenate([corners, corners[:1]])
    return np.column_stack([round_about, np.full(len(round_about), height)])


def _part(name: str) -> str:
    """A name as one part of a path."""
    return name.replace("/", "_")


def _turn(yaw: float) -> list[float]:
    return [0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))]


def _bytes(own: Colour) -> Any:
    return np.rint(255 * np.array(own)).astype(np.uint8)
