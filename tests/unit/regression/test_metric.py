"""Which metrics a gate takes, and the bounded form of GOSPA by hand."""

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.regression.metric import gated_metric
from pmbm.types import Detections, GroundTruth, Recording, Tracks, TrackSequence


def boxes(x):
    n = len(x)
    return {
        "position": np.column_stack([x, np.zeros(n), np.ones(n)]).reshape(n, 3),
        "size": np.ones((n, 3)),
        "yaw": np.zeros(n),
        "label": np.zeros(n),
    }


def world(truth, tracks, hidden=()):
    """One frame per pair of lists of x; objects with an index in `hidden` are not observable."""
    frames = range(len(truth))
    recording = Recording(
        name="hand",
        truth=[
            GroundTruth(
                time=0.1 * k,
                **boxes(x),
                id=np.arange(len(x)),
                velocity=np.zeros((len(x), 2)),
                visibility=np.ones(len(x)),
                observable=[i not in hidden for i in range(len(x))],
                crashed=np.zeros(len(x)),
            )
            for k, x in enumerate(truth)
        ],
        detections=[Detections.empty(0.1 * k) for k in frames],
        frame=np.arange(len(truth)),
        stamp=np.arange(len(truth)),
    )
    reports = [
        Tracks(
            time=0.1 * k,
            **boxes(x),
            id=np.arange(len(x)),
            velocity=np.zeros((len(x), 2)),
            score=np.ones(len(x)),
        )
        for k, x in enumerate(tracks)
    ]
    return recording, TrackSequence(steps=reports, frame=np.arange(len(truth)))


def test_gospa_per_object_by_hand():
    # c = 4, p = 2.  Frame 0: two objects, one 1 m off, one missed: (1 + 8) / (16 * 2).
    # Frame 1: no object, one false track: 8 / 16.  Frame 2: one object, three false: cut at 1.
    recording, tracks = world([[0.0, 50.0], [], [0.0]], [[1.0], [5.0], [30.0, 40.0, 50.0]])
    found = gated_metric("gospa")(recording, tracks)
    assert found["gated"] == pytest.approx((9 / 32 + 0.5 + 1.0) / 3)
    assert found["gospa"] == pytest.approx((3.0 + np.sqrt(8) + np.sqrt(32)) / 3)
    assert {"mota", "id_switches"} < set(found)


def test_gospa_of_observable_objects_counts_those():
    recording, tracks = world([[0.0, 50.0]], [[1.0]], hidden={1})
    assert gated_metric("gospa_observable")(recording, tracks)["gated"] == pytest.approx(1 / 16)


def test_ospa_is_gated_as_it_is():
    recording, tracks = world([[0.0]], [[3.0]])
    metric = gated_metric("ospa")
    assert (metric.bounds, metric.lower_is_better) == ((0.0, 10.0), True)
    assert metric(recording, tracks)["gated"] == pytest.approx(3.0)


def test_what_is_better_higher_is_turned_into_a_loss():
    recording, tracks = world([[0.0, 50.0]], [[0.0]])
    metric = gated_metric("recall")
    assert metric(recording, tracks)["gated"] == pytest.approx(-0.5)
    assert metric.value_range == 1.0


def test_given_bounds_cut():
    recording, tracks = world([[0.0]], [[30.0, 40.0, 50.0]])
    metric = gated_metric("false_positives", [0, 2])
    assert metric(recording, tracks)["gated"] == 2.0
    assert metric.value_range == 2.0


@pytest.mark.parametrize(
    ("name", "bounds", "words"),
    [
        ("opsa", None, "did you mean 'ospa'"),
        ("mota", None, "no bounds in a trial.*gate gospa, ospa"),
        ("nees", None, "no better and worse"),
        ("mota", [1.0, 0.0], "low < high"),
        ("mota", [0.0], "two numbers"),
        ("mota", [0.0, float("inf")], "two numbers"),
    ],
)
def test_other_metrics_are_refused(name, bounds, words):
    with pytest.raises(InputError, match=words):
        gated_metric(name, bounds)


def test_an_undefined_value_is_refused_not_left_out():
    recording, tracks = world([[]], [[]])
    with pytest.raises(InputError, match="'recall' is undefined in a trial"):
        gated_metric("recall")(recording, tracks)
