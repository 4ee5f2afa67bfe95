"""The values check themselves once, where they are made."""

import dataclasses
import pickle
import sys

import numpy as np
import pytest

from pmbm.datasets.columns import read_columns
from pmbm.errors import BaselineMismatch, InputError, nearest_hint
from pmbm.tracking import run
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


def detections(**changes):
    values = {
        "time": 0.5,
        "position": [[10.0, 2.0, 0.8], [20.0, -2.0, 0.8]],
        "size": [[4.5, 1.9, 1.6], [4.4, 1.8, 1.5]],
        "yaw": [0.1, -3.0],
        "score": [0.9, 0.4],
        "label": [Label.CAR, Label.TRUCK],
    }
    return Detections(**{**values, **changes})


def truth(time=0.0, ids=(3, 8)):
    n = len(ids)
    return GroundTruth(
        time=time,
        id=list(ids),
        position=np.arange(3.0 * n).reshape(n, 3),
        size=np.ones((n, 3)),
        yaw=np.zeros(n),
        velocity=np.zeros((n, 2)),
        label=np.zeros(n),
        visibility=np.ones(n),
        observable=np.ones(n),
        crashed=np.zeros(n),
    )


def recording(**changes):
    values = {
        "name": "two",
        "truth": (truth(0.0), truth(0.1)),
        "detections": (detections(time=0.0), detections(time=0.1)),
        "frame": [0, 1],
        "stamp": [0, 100],
        "origin": ([0, CLUTTER], [1, 0]),
        "object_name": {3: "a", 8: "b"},
        "provenance": {"seed": 1},
    }
    return Recording(**{**values, **changes})


def test_arrays_are_converted_frozen_and_unshared():
    given = np.array([0.9, 0.4])
    value = detections(score=given)
    given[0] = 0.0
    assert value.score[0] == 0.9
    assert value.label.dtype == np.int8
    assert value.position.flags.c_contiguous
    for name in ("position", "size", "yaw", "score", "label", "sensor_pose"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(value, name)[...] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        value.time = 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"position": [[np.nan, 0, 0], [0, 0, 0]]}, ["position", "rows 0", "finite"]),
        ({"position": [[0, 0], [1, 1]]}, ["position", "(N, 3)", "(2, 2)"]),
        ({"size": [[4, 2, 1], [4, 0, 1]]}, ["size", "rows 1", "> 0"]),
        ({"score": [0.2, 1.3]}, ["score", "rows 1", "[0, 1]", "1.3"]),
        ({"score": [0.2]}, ["score", "shape (2,)", "shape (1,)"]),
        ({"label": [0, 9]}, ["label", "rows 1", "9"]),
        ({"label": ["car", "bus"]}, ["label", "Label values", "'car'", "pmbm.Label.CAR"]),
        ({"label": [None, 1]}, ["label", "array of int64"]),
        ({"yaw": [0.0, np.inf]}, ["yaw", "rows 1"]),
        ({"time": np.nan}, ["time", "finite number"]),
        ({"time": "soon"}, ["time", "a number", "'soon'"]),
        ({"sensor_pose": [0, 0]}, ["sensor_pose", "shape (3,)"]),
        ({"raw_score": [1.0]}, ["raw_score", "shape (2,)"]),
    ],
)
def test_bad_detections_are_refused_by_name(changes, words):
    with pytest.raises(InputError) as caught:
        detections(**changes)
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_yaw_is_wrapped_at_the_door_and_keeps_its_bits_inside():
    value = detections(yaw=[np.pi, 0.1])
    assert value.yaw[0] == -np.pi
    assert value.yaw[1] == 0.1


def test_an_id_may_stand_once_in_a_frame():
    with pytest.raises(InputError, match="rows 0, 2"):
        truth(ids=(3, 8, 3))


def test_empty_frames_have_the_same_shapes_and_can_be_taken_from():
    for empty in (Detections.empty(1.0), Tracks.empty(1.0)):
        assert len(empty) == 0
        assert empty.position.shape == (0, 3)
        assert len(empty.take([])) == 0
    assert len(GaussianMixture.empty()) == 0


def test_take_picks_rows_and_leaves_the_rest():
    one = detections(sensor_pose=[1, 2, 3], raw_score=[5.0, 6.0]).take([1])
    assert one.position[0, 0] == 20.0
    assert one.raw_score.tolist() == [6.0]
    assert one.sensor_pose.tolist() == [1, 2, 3]


def test_a_mixture_takes_zero_weights_but_no_nan():
    GaussianMixture(log_weight=[-np.inf], mean=np.zeros((1, 4)), cov=np.eye(4)[None])
    with pytest.raises(InputError, match="log_weight"):
        GaussianMixture(log_weight=[np.nan], mean=np.zeros((1, 4)), cov=np.eye(4)[None])
    with pytest.raises(InputError, match="log_weight"):
        GaussianMixture(log_weight=[np.inf], mean=np.zeros((1, 4)), cov=np.eye(4)[None])


def test_site_refuses_impossible_views():
    with pytest.raises(InputError, match="max_range"):
        Site(max_range=0)
    with pytest.raises(InputError, match="fov_half_angle"):
        Site(fov_half_angle=4)
    with pytest.raises(InputError, match="occluders"):
        Site(occluders=([[0, 0], [1, 1]],))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame": [0, 2]}, ["frame", "0 to 1"]),
        ({"frame": [0]}, ["frame", "shape (2,)"]),
        ({"truth": (truth(0.1), truth(0.1))}, ["increase", "frame 1"]),
        ({"origin": ([0, 5], [1, 0])}, ["origin", "frame 0"]),
        ({"origin": ([0, 1],)}, ["origin", "one origin per delivery"]),
    ],
)
def test_bad_recordings_are_refused_by_name(changes, words):
    with pytest.raises(InputError) as caught:
        recording(**changes)
    for word in words:
        assert word in str(caught.value)


def test_a_recording_survives_pickling_and_keeps_its_digest():
    first = recording()
    second = pickle.loads(pickle.dumps(first))
    assert second.digest() == first.digest()
    assert second.provenance == {"seed": 1}
    assert second.object_name[8] == "b"


def test_digests_see_what_they_are_about():
    base = recording()
    other_boxes = recording(detections=(detections(time=0.0, score=[0.9, 0.5]), detections()))
    assert other_boxes.truth_digest() == base.truth_digest()
    assert other_boxes.detections_digest() != base.detections_digest()
    assert recording(origin=([0, 0], [1, 0])).digest() != base.digest()
    assert recording(site=Site(max_range=50)).truth_digest() != base.truth_digest()
    assert recording(name="other", provenance={}).digest() == base.digest()


def test_a_track_sequence_has_increasing_frames():
    steps = (Tracks.empty(0.0), Tracks.empty(0.1))
    sequence = TrackSequence(steps=steps, frame=[0, 3])
    assert len(sequence) == 2
    assert list(sequence) == list(steps)
    assert sequence[1] is steps[1]
    with pytest.raises(InputError, match="increase"):
        TrackSequence(steps=steps, frame=[3, 3])


def test_errors_pickle_locate_and_hint():
    error = InputError("bad row", field="score", rows=[4], got=1.3, hint="scale it")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert str(error.located(file="a.txt", frame=7)) == (
        "bad row (file a.txt, frame 7, field score, rows 4): got 1.3; scale it"
    )
    assert type(pickle.loads(pickle.dumps(BaselineMismatch("other bits")))) is BaselineMismatch
    assert nearest_hint("crosing", ["crossing", "merge"]) == "did you mean 'crossing'?"
    assert nearest_hint("zzz", ["crossing", "merge"]) == "valid names: crossing, merge"
    # Far from all of them.
    assert nearest_hint("nope", ["compare", "run"]) == "valid names: compare, run"


class Late:
    """Reports what it was given, as of another time."""

    def step(self, detections):
        return Tracks.empty(detections.time + 0.1)


def test_reports_of_another_time_are_refused():
    with pytest.raises(InputError) as caught:
        run(Late(), recording())
    for word in ("Late.step", "frame 0", "expected that of the detections, 0 s", "got 0.1 s"):
        assert word in str(caught.value)


def test_who_lacks_pyarrow_is_told_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pip install pyarrow; .*pmbm\[waymo\]"):
        read_columns(tmp_path / "x.parquet", ["a"], parquet=True)
