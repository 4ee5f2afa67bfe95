"""BoxRows where an object or a track is absent for a while, filled in as nuScenes does."""

from __future__ import annotations

from typing import Any

import numpy as np

from pmbm.arrays import FloatArray
from pmbm.geometry import wrap_angle
from pmbm.metrics.core.scene import BoxRows, ScoredScene, sorted_boxes


def fill_gaps(scene: ScoredScene, *, reversed_weights: bool = False) -> ScoredScene:
    """The scene with every id present from its first to its last frame, on both sides.

    Boxes in between are interpolated in time: position, size, velocity and score linearly, yaw the
    short way round.  What else a row holds is that of the row before.

    reversed_weights : as nuscenes-devkit does it, which gives the weight of the later box to the
        earlier one: between x = 0 at t = 0 and x = 3 at t = 3 it puts x = 2 at t = 1.
    """
    return ScoredScene(
        time=scene.time,
        truth=_filled(scene.truth, scene.time, reversed_weights),
        tracks=_filled(scene.tracks, scene.time, reversed_weights),
    )


def _filled(boxes: BoxRows, time: FloatArray, reversed_weights: bool) -> BoxRows:
    order = boxes.by_object
    before, after = order[:-1], order[1:]
    absent = np.where(
        boxes.index[before] == boxes.index[after], boxes.frame[after] - boxes.frame[before] - 1, 0
    )
    a, b = np.repeat(before, absent), np.repeat(after, absent)
    step = np.arange(len(a)) - np.repeat(np.cumsum(absent) - absent, absent) + 1
    frame = boxes.frame[a] + step
    begin, end = time[boxes.frame[a]], time[boxes.frame[b]]
    weight = (time[frame] - begin) / (end - begin)
    if reversed_weights:
        weight = 1.0 - weight

    def between(values: FloatArray) -> FloatArray:
        share = weight.reshape(-1, *(1 for _ in values.shape[1:]))
        return (1.0 - share) * values[a] + share * values[b]

    turn = wrap_angle(boxes.yaw[b] - boxes.yaw[a])
    new: dict[str, Any] = {
        **{name: getattr(boxes, name)[a] for name in boxes.__dataclass_fields__},
        "frame": frame,
        "position": between(boxes.position),
        "size": between(boxes.size),
        "velocity": between(boxes.velocity),
        "score": between(boxes.score),
        "yaw": wrap_angle(boxes.yaw[a] + weight * turn),
    }
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(boxes, name), values]) for name, values in new.items()
    }
    return sorted_boxes(**columns)
