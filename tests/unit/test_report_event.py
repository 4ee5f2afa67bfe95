"""Where a replay begins: at the event that its metric is worst by."""

import numpy as np
import pytest
from traffic import recording, tracks

from pmbm.metrics import evaluate
from pmbm.reports.replays import at_event
from pmbm.reports.values import ReplayPage


@pytest.fixture(scope="module")
def replay():
    """A tracker that reports nothing in the first three frames, a false track in 21 to 49, and
    changes an id at 61."""
    scene = recording()
    said = tracks(scene, sloppy=True)
    series = {k: v.series for k, v in evaluate(scene, said).items() if v.series is not None}
    return ReplayPage(recording=scene, tracks={"sloppy": said}, series={"sloppy": series})


def test_metrics_of_ids_begin_at_the_first_switch(replay):
    for metric in ("id_switches", "idf1_observable", "fragmentations"):
        assert at_event(replay, metric).start == 61


def test_metrics_with_a_series_begin_where_it_is_worst_after_the_first_second(replay):
    for metric in ("gospa", "ospa", "gospa_false_observable"):
        values = replay.series["sloppy"][metric]
        assert at_event(replay, metric).start == 11 + int(np.argmax(values[11:]))
    assert 21 <= at_event(replay, "false_positives").start < 50


def test_others_begin_at_the_worst_of_gospa(replay):
    assert at_event(replay, "mota").start == at_event(replay, "gospa_observable").start
    assert at_event(replay, "measured by hand").start == at_event(replay, "mota").start


def test_nothing_tracked_begins_at_the_start():
    assert at_event(ReplayPage(recording=recording(frames=5), tracks={}), "gospa").start == 0
