"""What the tracker must be able to do, and that it does not get worse."""

import pytest
from nearest import NearestTracker

OFFLINE = "parking.toml"


@pytest.mark.scenario(OFFLINE, trials=5)
@pytest.mark.tracker(NearestTracker, "kalman:KalmanTracker")
def test_follows_what_is_in_plain_sight(outcome):
    assert outcome.mean("recall") >= 0.9
    assert outcome.mean("id_switches") <= 0.5
    assert outcome.max("ospa") <= 5.0


def test_is_no_worse_than_without_a_filter(tracking_gate):
    tracking_gate.check(
        "kalman:KalmanTracker",
        against=NearestTracker,
        scenario=OFFLINE,
        metric="ospa",
        margin=2.0,
        alpha=0.05,
        rarest=0.2,
    )
