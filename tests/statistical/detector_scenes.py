"""Scenes in which range, bearing and visibility are what a test says, and how to read them."""

import numpy as np

from pmbm.geometry import wrap_angle
from pmbm.sim.world.scene import Scene
from pmbm.types import CLUTTER, GroundTruth, Label, Site


def still(
    distance,
    bearing=None,
    visibility=1.0,
    label=Label.CAR,
    *,
    yaw=None,
    velocity=(0.0, 0.0),
    frames=100,
    site=None,
    sensor_pose=(3.0, -2.0, 0.7),
):
    """Objects that keep their bearing (N,), visibility (N,) and distance (N,), or have a distance
    (F,N) of every frame."""
    distance = np.asarray(distance, dtype=float)
    count = distance.shape[-1]
    if distance.ndim == 2:
        frames = len(distance)
    distance = np.broadcast_to(distance, (frames, count))
    if bearing is None:
        bearing = np.random.default_rng(0).uniform(-np.pi, np.pi, count)
    pose = np.broadcast_to(np.asarray(sensor_pose, dtype=float), (frames, 3))
    direction = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    frame = {
        "id": np.arange(count),
        "size": np.tile([4.4, 1.8, 1.6], (count, 1)),
        "yaw": np.random.default_rng(1).uniform(-3, 3, count) if yaw is None else yaw,
        "velocity": np.broadcast_to(velocity, (count, 2)),
        "label": np.broadcast_to(label, count),
        "visibility": np.broadcast_to(visibility, count),
        "observable": np.ones(count),
        "crashed": np.zeros(count),
    }
    position = np.full((frames, count, 3), 0.8)
    position[..., :2] = pose[:, None, :2] + distance[..., None] * direction
    return Scene(
        name="still",
        site=site or Site(max_range=100.0),
        truth=tuple(
            GroundTruth(time=0.1 * f, position=position[f], **frame) for f in range(frames)
        ),
        sensor_pose=pose,
        stamp=np.arange(frames) * 10**8,
        rate=10.0,
    )


def detected(recording):
    """Whether object n was reported in frame f: (F, N), over the frames that were delivered."""
    found = np.zeros((len(recording.truth), len(recording.truth[0])), dtype=bool)
    for frame, origin in zip(recording.frame, recording.origin, strict=True):
        found[frame, origin[origin != CLUTTER]] = True
    return found


def pairs(recording):
    """Boxes and the truth they came from, flat: a dict of columns, `true_*` for the truth's."""
    columns = {}

    def add(name, values):
        columns.setdefault(name, []).append(values)

    for detections, frame, origin in zip(
        recording.detections, recording.frame.tolist(), recording.origin, strict=True
    ):
        rows = np.flatnonzero(origin != CLUTTER)
        truth = recording.truth[frame]
        add("frame", np.full(len(rows), frame))
        add("object", truth.id[origin[rows]])
        add("visibility", truth.visibility[origin[rows]])
        for name in ("position", "size", "yaw", "label"):
            add(name, getattr(detections, name)[rows])
            add(f"true_{name}", getattr(truth, name)[origin[rows]])
        add("score", detections.score[rows])
        add("pose", np.tile(detections.sensor_pose, (len(rows), 1)))
    flat = {name: np.concatenate(values) for name, values in columns.items()}
    offset = flat["true_position"][:, :2] - flat["pose"][:, :2]
    flat["distance"] = np.hypot(*offset.T)
    bearing = np.arctan2(offset[:, 1], offset[:, 0])
    error = flat["position"] - flat["true_position"]
    cos, sin = np.cos(bearing), np.sin(bearing)
    flat["error"] = np.stack(
        [
            error[:, 0] * cos + error[:, 1] * sin,
            -error[:, 0] * sin + error[:, 1] * cos,
            error[:, 2],
        ],
        axis=1,
    )
    flat["yaw_error"] = wrap_angle(flat["yaw"] - flat["true_yaw"])
    return flat


def clutter(recording):
    """Clutter boxes, flat: frame, position, yaw, size, score, label."""
    names = ("position", "size", "yaw", "score", "label")
    columns = {name: [] for name in ("frame", *names)}
    for detections, frame, origin in zip(
        recording.detections, recording.frame.tolist(), recording.origin, strict=True
    ):
        rows = np.flatnonzero(origin == CLUTTER)
        columns["frame"].append(np.full(len(rows), frame))
        for name in names:
            columns[name].append(getattr(detections, name)[rows])
    return {name: np.concatenate(values) for name, values in columns.items()}
