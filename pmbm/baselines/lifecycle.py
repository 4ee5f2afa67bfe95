"""Tracking by detection: predict, associate, correct, and count hits; what differs between the
baselines is handed in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from pmbm.baselines.association import Associate, check_pairs
from pmbm.baselines.box_filter import (
    BOX,
    YAW,
    BoxNoise,
    correct,
    first_state,
    horizontal_covariance,
    measured_boxes,
    predict,
)
from pmbm.errors import InputError
from pmbm.types import Detections, FloatArray, Label, Tracks

_ROUNDING: Final = 1e-6
"""Frames by which a time may miss a whole number of them."""


@dataclass(frozen=True, kw_only=True)
class Lifecycle:
    """When a track is reported, and when it ends.

    min_score : detections below it are not looked at.
    min_hits : reported from this many detections on, its first one counted.
    max_age : frames without a detection after which it ends.
    coasting : reported in frames without a detection of its own, too.
    report_above : reported while its last detection scored at least this.
    frame_rate : frames per second in which ages and velocities are counted, Hz.
    """

    min_score: float
    min_hits: int
    max_age: float
    coasting: bool
    report_above: float
    frame_rate: float


@dataclass
class _Track:
    id: int
    label: int
    noise: BoxNoise
    kalman: Any
    score: float
    last_hit: float
    hits: int = 1


@dataclass
class BoxTracker:
    """The state of one run of a baseline.

    noise : the variances for a label.
    associate : pairs predicted tracks and boxes of one label.
    """

    lifecycle: Lifecycle
    noise: Callable[[Label], BoxNoise]
    associate: Associate
    _tracks: list[_Track] = field(default_factory=list)
    _time: float | None = None
    _next_id: int = 0

    def step(self, detections: Detections) -> Tracks:
        """Take one frame, empty ones too, and report.

        Raises InputError, the tracker untouched, where time runs backwards, and where there are
        more detections of a label than memory is taken for.
        """
        good = detections.score >= self.lifecycle.min_score
        for label, count in zip(
            *np.unique(detections.label[good], return_counts=True), strict=True
        ):
            check_pairs(sum(track.label == label for track in self._tracks), int(count))
        self._advance(detections.time)
        for label in sorted({*detections.label.tolist(), *(t.label for t in self._tracks)}):
            self._match(label, detections.take(good & (detections.label == label)))
        self._tracks = [t for t in self._tracks if self._age(t) < self.lifecycle.max_age]
        return self._report(detections.time)

    def _advance(self, time: float) -> None:
        elapsed = 0.0 if self._time is None else time - self._time
        if elapsed < 0:
            raise InputError(
                "a frame is older than the one before it",
                field="time",
                expected=f"at least {self._time} s",
                got=time,
            )
        self._time = time
        # A track may still be found again in the very frame that would end it.
        self._tracks = [t for t in self._tracks if self._age(t) <= self.lifecycle.max_age]
        for track in self._tracks:
            predict(track.kalman, track.noise, elapsed * self.lifecycle.frame_rate)

    def _age(self, track: _Track) -> float:
        """Frames since the track's last detection, whole numbers free of rounding."""
        assert self._time is not None
        frames = (self._time - track.last_hit) * self.lifecycle.frame_rate
        return round(frames) if abs(frames - round(frames)) < _ROUNDING else frames

    def _match(self, label: int, detections: Detections) -> None:
        boxes = measured_boxes(detections)
        tracks = [track for track in self._tracks if track.label == label]
        pairs = self.associate([track.kalman for track in tracks], boxes)
        for row, column in pairs.tolist():
            track = tracks[row]
            correct(track.kalman, boxes[column])
            track.hits += 1
            track.last_hit = detections.time
            track.score = float(detections.score[column])
        found = {column for _, column in pairs.tolist()}
        for column in (c for c in range(len(boxes)) if c not in found):
            self._begin(label, boxes[column], detections.time, float(detections.score[column]))

    def _begin(self, label: int, box: FloatArray, time: float, score: float) -> None:
        noise = self.noise(Label(label))
        kalman = first_state(box, noise)
        self._tracks.append(_Track(self._next_id, label, noise, kalman, score, time))
        self._next_id += 1

    def _report(self, time: float) -> Tracks:
        shown = [
            track
            for track in self._tracks
            if track.hits >= self.lifecycle.min_hits
            and track.score >= self.lifecycle.report_above
            and (self.lifecycle.coasting or track.last_hit == time)
        ]
        if not shown:
            return Tracks.empty(time)
        state = np.stack([track.kalman.x[:, 0] for track in shown])
        rate = self.lifecycle.frame_rate
        return Tracks(
            time=time,
            id=np.array([track.id for track in shown]),
            position=state[:, :YAW],
            size=state[:, YAW + 1 : BOX],
            yaw=state[:, YAW],
            velocity=state[:, BOX : BOX + 2] * rate,
            score=np.array([track.score for track in shown]),
            label=np.array([track.label for track in shown]),
            covariance=np.stack([horizontal_covariance(track.kalman, rate) for track in shown]),
        )
