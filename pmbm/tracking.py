"""What a tracker is, and how one is run over a recording."""

from __future__ import annotations

import time
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pmbm.errors import InputError
from pmbm.types import Detections, Recording, Tracks, TrackSequence


@runtime_checkable
class Tracker(Protocol):
    """Anything with `step`: called once per delivery of detections, empty ones too, in order of
    time.  A fresh tracker is made for every recording, so there is nothing to reset."""

    def step(self, detections: Detections, /) -> Tracks: ...


def run(tracker: Tracker, recording: Recording, *, record: bool = False) -> TrackSequence:
    """Step `tracker` through the deliveries of `recording`.

    A delivery older than the last step (a late frame) is dropped and counted.  The tracker is
    handed `Detections` alone: truth and origins are out of its reach.  With `record=True` what its
    `inspect()` gives after each step is kept.

    Raises InputError where the tracker has no `step` or gives something that is not `Tracks`.
    """
    if not callable(getattr(tracker, "step", None)):
        raise InputError(
            "not a tracker",
            expected="an object with step(detections) -> Tracks",
            got=type(tracker).__name__,
        )
    steps: list[Tracks] = []
    frames: list[int] = []
    seconds: list[float] = []
    inspections: list[Any] = []
    last_time = -np.inf
    for detections, frame in zip(recording.detections, recording.frame.tolist(), strict=True):
        if detections.time < last_time or (frames and frame <= frames[-1]):
            continue
        start = time.process_time()
        tracks = tracker.step(detections)
        seconds.append(time.process_time() - start)
        if not isinstance(tracks, Tracks):
            raise InputError(
                f"{type(tracker).__name__}.step returned something else than Tracks",
                frame=frame,
                expected="pmbm.Tracks",
                got=type(tracks).__name__,
            )
        steps.append(tracks)
        frames.append(frame)
        if record and hasattr(tracker, "inspect"):
            inspections.append(tracker.inspect())
        last_time = detections.time
    return TrackSequence(
        steps=tuple(steps),
        frame=np.array(frames, dtype=np.int64),
        seconds=np.array(seconds),
        dropped=len(recording.detections) - len(steps),
        inspections=tuple(inspections) if inspections else None,
    )
