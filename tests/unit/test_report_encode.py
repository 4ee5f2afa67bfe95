"""Packed replays, read back by a decoder written here from the format's description alone."""

import base64
import json
import zlib
from dataclasses import replace

import numpy as np
import pytest
from traffic import recording, tracks

from pmbm.errors import InputError
from pmbm.metrics import evaluate
from pmbm.reports.encode import encode_replay
from pmbm.reports.matching import identity_switches, matched
from pmbm.reports.values import ReplayPage
from pmbm.types import (
    CLUTTER,
    Detections,
    GroundTruth,
    Label,
    Recording,
    Tracks,
    TrackSequence,
)


def unpack(data, table):
    raw = zlib.decompress(base64.b64decode(data["blob"]))
    columns = {}
    for name, (offset, resolution) in table["columns"].items():
        planes = np.frombuffer(raw, np.uint8, 4 * table["rows"], offset)
        code = sum(planes.reshape(4, -1)[k].astype(np.int64) << (8 * k) for k in range(4))
        steps = np.where(code % 2, -(code + 1) // 2, code // 2)
        columns[name] = np.cumsum(steps) * resolution
    return columns


def encoded(scene, by_tracker, **changes):
    return encode_replay(ReplayPage(recording=scene, tracks=by_tracker, **changes))


def test_truth_comes_back():
    scene = recording(frames=30)
    data = encoded(scene, {"a": tracks(scene)})
    truth = unpack(data, data["truth"])
    assert len(truth["frame"]) == 30 * 5
    for frame, object_, x, y, yaw, vx, length, flags in zip(
        *(truth[k] for k in ("frame", "object", "x", "y", "yaw", "vx", "length", "flags")),
        strict=True,
    ):
        there = scene.truth[int(frame)]
        row = there.id.tolist().index(int(data["truth"]["ids"][int(object_)]))
        assert x + data["centre"][0] == pytest.approx(there.position[row, 0], abs=0.0051)
        assert y + data["centre"][1] == pytest.approx(there.position[row, 1], abs=0.0051)
        assert yaw == pytest.approx(there.yaw[row], abs=0.00051)
        assert vx == pytest.approx(there.velocity[row, 0], abs=0.0251)
        assert length == pytest.approx(there.size[row, 0], abs=0.0051)
        assert bool(int(flags) & 1) == there.observable[row]
    names = dict(zip(data["truth"]["ids"], data["truth"]["names"], strict=True))
    assert names == {"11": "truck", "22": "overtaker", "33": "", "44": "", "55": ""}


def test_detections_keep_their_origin():
    scene = recording(frames=30)
    data = encoded(scene, {})
    packed = unpack(data, data["detections"])
    got = sorted(
        (int(f), round(x + data["centre"][0], 2), origin if origin < 0 else data_id(data, origin))
        for f, x, origin in zip(packed["frame"], packed["x"], packed["origin"], strict=True)
    )
    want = []
    for d, (detections, origin) in enumerate(zip(scene.detections, scene.origin, strict=True)):
        ids = scene.truth[d].id
        for x, row in zip(detections.position[:, 0], origin, strict=True):
            want.append((d, round(x, 2), CLUTTER if row == CLUTTER else int(ids[row])))
    assert [(f, o) for f, _, o in got] == [(f, o) for f, _, o in sorted(want)]
    assert [x for _, x, _ in got] == pytest.approx([x for _, x, _ in sorted(want)], abs=0.011)


def data_id(data, index):
    return int(data["detections"]["origins"][int(index)])


def test_tracks_missed_and_false():
    scene = recording(frames=60)
    data = encoded(scene, {"sloppy": tracks(scene, sloppy=True)})
    table = data["trackers"][0]
    packed = unpack(data, table)
    false = packed["frame"][packed["false"] == 1]
    assert false.tolist() == list(range(21, 50))
    missed = unpack(data, table["missed"])
    assert np.bincount(missed["frame"].astype(int))[:3].tolist() == [5, 5, 5]
    # The hidden car has no track then, but is not observable: no miss.
    assert missed["frame"].max() == 2


def test_switches_are_those_that_clear_counts():
    scene = recording()
    sloppy = tracks(scene, sloppy=True)
    switches = encoded(scene, {"a": sloppy})["trackers"][0]["switches"]
    # Hidden until frame 48, followed as 22 from there, as 122 from frame 61.
    assert switches == [[61, "22", "22", "122"]]
    assert len(switches) == evaluate(scene, sloppy)["id_switches"].value


def test_a_switch_names_the_last_id_and_the_new_one():
    scene = recording(frames=9)
    steps = []
    for index, step in enumerate(tracks(scene)):
        ids = step.id.copy()
        ids[ids == 11] = [11, 11, 11, 11, 70, 70, 11, 80, 80][index]
        steps.append(replace(step, id=ids))
    found = identity_switches(scene, TrackSequence(steps=tuple(steps), frame=np.arange(9)))
    assert [(s.frame, s.object, s.old, s.new) for s in found] == [
        (4, 11, 11, 70),
        (6, 11, 70, 11),
        (7, 11, 11, 80),
    ]


def test_ids_beyond_what_a_float_holds():
    scene = recording(frames=3)
    huge = 2**62 + 1
    steps = tuple(
        Tracks(
            time=truth.time,
            id=[huge],
            position=truth.position[:1],
            size=truth.size[:1],
            yaw=truth.yaw[:1],
            velocity=truth.velocity[:1],
            score=[1.0],
            label=truth.label[:1],
        )
        for truth in scene.truth
    )
    data = encoded(scene, {"a": TrackSequence(steps=steps, frame=[0, 1, 2])})
    assert data["trackers"][0]["ids"] == [str(huge)]


def test_far_coordinates_keep_their_centimetres():
    scene = recording(frames=5)
    shift = np.array([674_000.0, 1_234_567.0, 0.0])
    far = Recording(
        name="far",
        truth=tuple(
            GroundTruth(**{**vars(t), "position": t.position + shift}) for t in scene.truth
        ),
        detections=(),
        frame=[],
        stamp=scene.stamp,
    )
    data = encoded(far, {})
    x = unpack(data, data["truth"])["x"] + data["centre"][0]
    ids = np.array(data["truth"]["ids"])[unpack(data, data["truth"])["object"].astype(int)]
    first = x[ids == "11"]
    want = [t.position[0, 0] for t in far.truth]
    assert first == pytest.approx(want, abs=0.0051)


def crowd(frames, count):
    """A recording as large as a report promises to hold: `count` cars, each detected."""
    rng = np.random.default_rng(0)
    start = rng.uniform(-90, 90, (count, 2))
    speed = rng.uniform(5, 20, count)
    turn = rng.normal(0, 0.05, count)
    heading = rng.uniform(-3, 3, count)
    truth, detections, steps = [], [], []
    xy, yaw = start, heading
    shared = {"size": np.tile([4.5, 1.9, 1.6], (count, 1)), "label": np.zeros(count, np.int8)}
    for k in range(frames):
        velocity = speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
        xy = xy + 0.1 * velocity
        yaw = (yaw + 0.1 * turn + np.pi) % (2 * np.pi) - np.pi
        position = np.column_stack([xy, np.full(count, 0.8)])
        truth.append(
            GroundTruth(
                time=k / 10,
                id=np.arange(count),
                position=position,
                yaw=yaw,
                velocity=velocity,
                visibility=rng.uniform(0.3, 1, count),
                observable=np.ones(count, bool),
                crashed=np.zeros(count, bool),
                **shared,
            )
        )
        noise = np.column_stack([rng.normal(0, 0.3, (count, 2)), np.zeros(count)])
        detections.append(
            Detections(
                time=k / 10,
                position=position + noise,
                yaw=yaw + rng.normal(0, 0.05, count),
                score=rng.beta(8, 2, count),
                **shared,
            )
        )
        steps.append(
            Tracks(
                time=k / 10,
                id=np.arange(count) + 100,
                position=position + noise / 2,
                yaw=yaw,
                velocity=velocity + rng.normal(0, 0.3, (count, 2)),
                score=rng.beta(50, 1, count),
                **shared,
            )
        )
    scene = Recording(
        name="crowd",
        truth=tuple(truth),
        detections=tuple(detections),
        frame=np.arange(frames),
        stamp=np.arange(frames),
        origin=tuple(np.arange(count) for _ in range(frames)),
    )
    return scene, TrackSequence(steps=tuple(steps), frame=np.arange(frames))


def test_a_large_replay_is_small():
    """300 frames of 50 boxes, each with a noisy detection and a noisy track."""
    scene, sequence = crowd(300, 50)
    size = len(json.dumps(encoded(scene, {"pmbm": sequence})))
    print(f"{size / 1e6:.3f} MB for 300 frames x 50 objects, detections and tracks")
    assert size < 300_000


def test_matching_by_hand():
    """Tracks 1 m and 3 m from one object: the nearer stands for it, the other is false; an object
    whose nearest track is exactly at the cut-off is missed."""

    def boxes(points):
        return {
            "position": [[x, y, 0.8] for x, y in points],
            "size": [[4, 2, 1.6]] * len(points),
            "yaw": [0.0] * len(points),
            "velocity": [[0.0, 0.0]] * len(points),
            "label": [Label.CAR] * len(points),
        }

    truth = GroundTruth(
        time=0,
        id=[1, 2],
        visibility=[1, 1],
        observable=[True, True],
        crashed=[False, False],
        **boxes([(0, 0), (20, 0)]),
    )
    report = Tracks(time=0, id=[5, 6], score=[1, 1], **boxes([(3, 0), (1, 0)]))
    is_track, is_object = matched(truth, report)
    assert is_track.tolist() == [False, True]
    assert is_object.tolist() == [True, False]
    for y, near in ((3.999, True), (4.0, False)):
        lone = Tracks(time=0, id=[7], score=[1], **boxes([(20, y)]))
        is_track, is_object = matched(truth.take([1]), lone)
        assert is_track.tolist() == is_object.tolist() == [near]


def test_series_are_for_each_step():
    scene = recording(frames=4)
    with pytest.raises(InputError, match="one value per step"):
        ReplayPage(
            recording=scene, tracks={"a": tracks(scene)}, series={"a": {"gospa": np.zeros(3)}}
        )
    with pytest.raises(InputError, match="one value per step"):
        ReplayPage(recording=scene, tracks={}, series={"b": {"gospa": np.zeros(4)}})


def test_nothing_is_no_replay():
    with pytest.raises(InputError, match="no frames"):
        ReplayPage(
            recording=Recording(name="n", truth=(), detections=(), frame=[], stamp=[]), tracks={}
        )


def test_undefined_values_stay_undefined_and_observable_series_come_first():
    scene = recording(frames=4)
    series = {
        "gospa": np.array([1.0, np.nan, 3.0, 4.0]),
        "gospa_missed": np.zeros(4),
        "gospa_missed_observable": np.ones(4),
        "ospa": np.ones(4),
    }
    data = encoded(scene, {"a": tracks(scene)}, series={"a": series})
    assert data["trackers"][0]["series"] == {
        "gospa": [1.0, None, 3.0, 4.0],
        "gospa_missed": [1.0] * 4,
    }


def test_dropped_frames_keep_the_last_pose():
    scene = recording(frames=6)
    kept = [0, 1, 4, 5]
    moved = Recording(
        name="gap",
        truth=scene.truth,
        detections=tuple(Detections.empty(scene.truth[k].time, (10.0 * k, 0.0, 3.0)) for k in kept),
        frame=kept,
        stamp=scene.stamp,
    )
    data = encoded(moved, {})
    x = unpack(data, data["poses"])["x"] + data["centre"][0]
    assert x.tolist() == pytest.approx([0, 10, 10, 10, 40, 50])
