"""One sensor alone, and tracks of each sensor fused: what the filter of all sensors is held to."""

import numpy as np
import pytest

from pmbm import Detections, InputError, PMBMTracker, Site, Tracks, run
from pmbm.by_sensor import OneSensor, TracksPerSensor, moved_on
from pmbm.study.configured import ConfiguredTracker
from pmbm.types import MountedSensor

SITE = Site(sensors=(MountedSensor(name="a"), MountedSensor(name="b")))


class Given:
    """A tracker that reports what it is told to."""

    def __init__(self, tracks):
        self.tracks = iter(tracks)

    def step(self, detections):
        return next(self.tracks)


def tracks(time, ids, places, cov=None, velocity=(10.0, 0.0), score=0.9):
    n = len(ids)
    return Tracks(
        time=time,
        id=np.array(ids, np.int64),
        position=np.column_stack([np.reshape(places, (n, 2)), np.ones(n)]),
        size=np.ones((n, 3)),
        yaw=np.zeros(n),
        velocity=np.tile(velocity, (n, 1)).reshape(n, 2),
        score=np.full(n, score),
        label=np.zeros(n, np.int8),
        covariance=None if cov is None else np.tile(cov, (n, 1, 1)),
    )


def fusing(**reports):
    fused = TracksPerSensor(site=SITE)
    fused._trackers = {name: Given(given) for name, given in reports.items()}
    return fused


def look(time, sensor):
    return Detections.empty(time, sensor=sensor)


def test_one_sensor_alone_is_the_tracker_on_its_deliveries():
    from pmbm.sim import load_scenario

    recording = load_scenario("blind_spot").record(0)
    mine = run(OneSensor("front", site=recording.site), recording)
    by_hand = PMBMTracker(site=recording.site)
    front = [one for one in recording.detections if one.sensor == "front"]
    for report, delivery in zip(mine.steps[:40], front[:40], strict=True):
        expected = by_hand.step(delivery)
        assert report.id.tolist() == expected.id.tolist()
        np.testing.assert_array_equal(report.position, expected.position)


def test_between_its_deliveries_it_moves_on():
    moved = moved_on(tracks(1.0, [3], [[5.0, 1.0]], np.diag([1.0, 1.0, 4.0, 0.0])), 1.5)
    np.testing.assert_allclose(moved.position[0, :2], [10.0, 1.0])
    np.testing.assert_allclose(moved.covariance[0, 0, 0], 1.0 + 0.25 * 4.0)
    assert moved.time == 1.5


def test_tracks_of_one_object_are_one_and_weighted_by_their_covariances():
    fused = fusing(
        a=[tracks(0.0, [7], [[0.0, 0.0]], np.diag([1.0, 1.0, 1.0, 1.0]))],
        b=[tracks(0.0, [2], [[1.0, 0.0]], np.diag([3.0, 3.0, 3.0, 3.0]))],
    )
    fused.step(look(0.0, "a"))
    found = fused.step(look(0.0, "b"))
    assert len(found) == 1
    np.testing.assert_allclose(found.position[0, :2], [0.25, 0.0])
    np.testing.assert_allclose(found.covariance[0], 0.75 * np.eye(4))


def test_an_object_keeps_its_id_when_it_passes_from_one_sensor_to_the_other():
    fused = fusing(
        a=[tracks(0.0, [7], [[0.0, 0.0]]), tracks(0.1, [7], [[1.0, 0.0]]), tracks(0.2, [], [])],
        b=[tracks(0.0, [], []), tracks(0.1, [0], [[1.2, 0.0]]), tracks(0.2, [0], [[2.0, 0.0]])],
    )
    seen = []
    for k in range(3):
        fused.step(look(0.1 * k, "a"))
        seen.append(fused.step(look(0.1 * k, "b")).id.tolist())
    assert seen == [[0], [0], [0]]


def test_two_objects_farther_apart_than_the_gate_are_two():
    fused = fusing(a=[tracks(0.0, [7], [[0.0, 0.0]])], b=[tracks(0.0, [7], [[3.5, 0.0]])])
    fused.step(look(0.0, "a"))
    assert fused.step(look(0.0, "b")).id.tolist() == [0, 1]


def test_a_sensor_that_has_fallen_silent_is_left_out():
    fused = fusing(
        a=[tracks(0.0, [7], [[0.0, 0.0]])], b=[tracks(0.1 * k, [], []) for k in range(9)]
    )
    fused.step(look(0.0, "a"))
    counts = [len(fused.step(look(0.1 * k, "b"))) for k in range(9)]
    assert counts == [1] * 6 + [0] * 3


def test_they_are_trackers_of_a_study():
    parameters = (("sensor", "b"), ("tracker", "argoverse"))
    made = ConfiguredTracker("pmbm.by_sensor:OneSensor", parameters)(SITE)
    assert isinstance(made, OneSensor)
    with pytest.raises(InputError, match="no sensor 'c'"):
        ConfiguredTracker("pmbm.by_sensor:OneSensor", (("sensor", "c"),))(SITE)
    with pytest.raises(InputError, match="gate"):
        TracksPerSensor(gate=0.0)
