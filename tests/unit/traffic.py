"""Hand-made traffic for the tests of reports: two lanes, a truck, a hidden car, clutter."""

import numpy as np

from pmbm.types import (
    CLUTTER,
    Detections,
    GaussianMixture,
    GroundTruth,
    Label,
    Recording,
    Site,
    Tracks,
    TrackSequence,
)

LABELS = np.array([Label.TRUCK, Label.CAR, Label.CAR, Label.CYCLIST, Label.PEDESTRIAN], np.int8)
SIZES = np.array(
    [[14.0, 2.6, 3.5], [4.6, 1.9, 1.6], [4.4, 1.8, 1.5], [1.8, 0.6, 1.7], [0.6, 0.6, 1.75]]
)
START = np.array([[18.0, 6.0], [5.0, 10.5], [-40.0, -3.5], [-25.0, -9.0], [30.0, -14.0]])
VELOCITY = np.array([[2.0, 0.0], [8.0, 0.0], [11.0, 0.4], [4.0, -0.5], [-0.6, 1.1]])


def recording(frames=100, name="hand-made traffic", **changes):
    """Five objects for `frames` tenths of a second past a standing sensor; the second one
    overtakes behind the truck and is not observable while hidden."""
    rng = np.random.default_rng(3)
    truth, detections, origin = [], [], []
    n = len(LABELS)
    for frame in range(frames):
        time = frame / 10
        position = np.column_stack([START + VELOCITY * time, SIZES[:, 2] / 2])
        yaw = np.arctan2(VELOCITY[:, 1], VELOCITY[:, 0])
        ahead = position[1, 0] - position[0, 0]
        visibility = np.ones(n)
        visibility[1] = np.clip((abs(ahead - 9) - 5) / 6, 0, 1)
        truth.append(
            GroundTruth(
                time=time,
                id=np.arange(1, n + 1) * 11,
                position=position,
                size=SIZES,
                yaw=yaw,
                velocity=VELOCITY,
                label=LABELS,
                visibility=visibility,
                observable=visibility >= 0.1,
                crashed=np.zeros(n, bool),
            )
        )
        seen = np.flatnonzero((rng.random(n) < 0.93) & (visibility >= 0.1))
        clutter = rng.poisson(1.5)
        rows = np.concatenate([seen, np.full(clutter, CLUTTER)])
        noisy = position[rows] + np.column_stack([rng.normal(0, 0.3, (len(rows), 2)), rows * 0.0])
        noisy[len(seen) :, :2] = rng.uniform(-55, 55, (clutter, 2))
        detections.append(
            Detections(
                time=time,
                position=noisy,
                size=SIZES[rows],
                yaw=yaw[rows] + rng.normal(0, 0.05, len(rows)),
                score=np.where(rows == CLUTTER, 0.3, 0.85) + rng.uniform(-0.1, 0.1, len(rows)),
                label=LABELS[rows],
            )
        )
        origin.append(rows)
    values = {
        "name": name,
        "truth": tuple(truth),
        "detections": tuple(detections),
        "frame": np.arange(frames),
        "stamp": np.arange(frames) * 100,
        "origin": tuple(origin),
        "object_name": {11: "truck", 22: "overtaker"},
        "provenance": {"seed": 7, "scenario": "hand-made"},
        "site": Site(
            occluders=(np.array([[-20.0, 14.0], [-4.0, 14.0], [-4.0, 24.0], [-20.0, 24.0]]),),
            max_range=60.0,
        ),
    }
    return Recording(**{**values, **changes})


def tracks(recording, *, sloppy=False, undetected=False):
    """A tracker's report made from the truth: late by three frames; a sloppy one loses the hidden
    car, changes its id and reports a ghost."""
    rng = np.random.default_rng(5 + sloppy)
    steps = []
    for index, frame in enumerate(recording.truth):
        keep = np.ones(len(frame), bool) if index > 2 else np.zeros(len(frame), bool)
        ids = frame.id.copy()
        if sloppy:
            keep &= frame.observable
            ids[1] += 100 * (index > 60)
        spread = 0.25 if not sloppy else 0.6
        shift = rng.normal(0, spread, (len(frame), 2))
        position = frame.position + np.column_stack([shift, np.zeros(len(frame))])
        fields = {
            "id": ids[keep],
            "position": position[keep],
            "size": frame.size[keep],
            "yaw": frame.yaw[keep],
            "velocity": frame.velocity[keep],
            "score": np.where(frame.observable, 0.97, 0.6)[keep],
            "label": frame.label[keep],
        }
        if sloppy and 20 < index < 50:
            ghost = {
                "id": [999],
                "position": [[-30.0, 8.0, 0.8]],
                "size": [[4.0, 1.8, 1.6]],
                "yaw": [0.3],
                "velocity": [[1.0, 2.0]],
                "score": [0.55],
                "label": [Label.CAR],
            }
            fields = {key: np.concatenate([fields[key], np.asarray(ghost[key])]) for key in fields}
        count = len(fields["id"])
        covariance = np.tile(np.diag([0.3, 0.1, 0.5, 0.5]), (count, 1, 1))
        covariance[:, 0, 1] = covariance[:, 1, 0] = 0.08
        steps.append(
            Tracks(
                time=frame.time,
                **fields,
                covariance=covariance,
                undetected=hidden_mixture() if undetected else None,
            )
        )
    return TrackSequence(steps=tuple(steps), frame=np.arange(len(recording)))


def hidden_mixture():
    """Half an object behind the truck (x and y correlated), a fifth at the edge of the view."""
    behind = np.diag([40.0, 25.0, 4.0, 4.0])
    behind[0, 1] = behind[1, 0] = -18.0
    return GaussianMixture(
        log_weight=np.log([0.5, 0.2]),
        mean=[[48.0, 13.0, 0.0, 0.0], [-50.0, 0.0, 5.0, 0.0]],
        cov=[behind, np.diag([25.0, 60.0, 4.0, 4.0])],
    )
