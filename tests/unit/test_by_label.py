"""A tracker of its own for every label."""

from dataclasses import replace

import numpy as np
import pytest

from pmbm import PMBMTracker
from pmbm.baselines import ArgoverseConfig, ArgoverseTracker
from pmbm.errors import InputError
from pmbm.tracking import ByLabel, Tracker
from pmbm.types import Detections, Label, MountedSensor, Site, Tracks


def frame(k, rows):
    """Detections at frame `k` of rows (x, label)."""
    n = len(rows)
    return Detections(
        time=k / 10,
        position=np.array([(x, 0.0, 0.0) for x, _ in rows]).reshape(-1, 3),
        size=np.ones((n, 3)),
        yaw=np.zeros(n),
        score=np.full(n, 0.9),
        label=np.array([label for _, label in rows], dtype=np.int64),
    )


def quick():
    return ArgoverseTracker(ArgoverseConfig(min_hits=1))


def test_each_label_has_its_tracker_and_each_track_an_id_of_its_own():
    tracker = ByLabel({Label.CAR: quick, Label.PEDESTRIAN: ArgoverseTracker})
    assert isinstance(tracker, Tracker)
    seen = [(0.0, Label.CAR), (0.0, Label.PEDESTRIAN), (9.0, Label.TRUCK)]
    outputs = [tracker.step(frame(k, seen)) for k in range(6)]
    assert [t.label.tolist() for t in outputs] == [[Label.CAR]] * 4 + [
        [Label.CAR, Label.PEDESTRIAN]
    ] * 2
    assert {tuple(t.id.tolist()) for t in outputs} == {(0,), (0, 1)}
    assert outputs[-1].covariance.shape == (2, 4, 4)
    assert len(tracker.step(frame(100, []))) == 0


def test_covariances_only_where_all_give_them():
    class Silent:
        def step(self, detections):
            return Tracks(
                time=detections.time,
                id=[5],
                position=np.zeros((1, 3)),
                size=np.ones((1, 3)),
                yaw=[0.0],
                velocity=np.zeros((1, 2)),
                score=[1.0],
                label=[Label.BUS],
            )

    tracker = ByLabel({Label.CAR: quick, Label.BUS: Silent})
    tracks = tracker.step(frame(0, [(0.0, Label.CAR)]))
    assert tracks.covariance is None
    assert tracks.id.tolist() == [0, 1]


def test_the_site_goes_to_those_that_take_one():
    sites = []

    def factory(site):
        sites.append(site)
        return quick()

    site = Site(max_range=33.0)
    ByLabel({Label.CAR: factory, Label.BUS: quick}, site)
    assert sites == [site]


def test_time_runs_forwards():
    tracker = ByLabel({Label.CAR: quick})
    tracker.step(frame(1, []))
    with pytest.raises(InputError, match="older"):
        tracker.step(frame(0, []))


def of_sensor(name, one):
    return replace(one, sensor=name)


def test_boxes_of_a_sensor_without_classes_go_to_the_nearest_track_of_all():
    """A lidar tells a car from a pedestrian 7 m farther on; a radar that tells nothing is all that
    sees them from then on, and a third thing, which begins no track."""
    site = Site(sensors=(MountedSensor(name="lidar"), MountedSensor(name="radar")))
    tracker = ByLabel({Label.CAR: PMBMTracker, Label.PEDESTRIAN: PMBMTracker}, site)
    both = [(10.0, Label.CAR), (17.0, Label.PEDESTRIAN)]
    for k in range(5):
        known = tracker.step(of_sensor("lidar", frame(k, both)))
    seen = [(10.2, Label.OTHER), (16.9, Label.OTHER), (40.0, Label.OTHER)]
    for k in range(5, 25):
        tracks = tracker.step(of_sensor("radar", frame(k, seen)))
    assert tracks.id.tolist() == known.id.tolist() == [0, 1]
    np.testing.assert_allclose(tracks.position[:, 0], [10.2, 16.9], atol=0.1)
    assert tracks.score.min() > 0.9


def test_other_classes_of_one_sensor_stay_nobodys():
    tracker = ByLabel({Label.CAR: quick})
    for k in range(3):
        tracker.step(frame(k, [(10.0, Label.CAR)]))
    for k in range(3, 30):
        tracks = tracker.step(frame(k, [(10.2, Label.OTHER)]))
    assert len(tracks) == 0
