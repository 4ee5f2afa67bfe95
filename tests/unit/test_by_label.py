"""A tracker of its own for every label."""

import numpy as np
import pytest

from pmbm.baselines import ArgoverseConfig, ArgoverseTracker
from pmbm.errors import InputError
from pmbm.tracking import ByLabel, Tracker
from pmbm.types import Detections, Label, Site, Tracks


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
