"""Does the tracker do what the road asks of it?  Each test isolates one thing.

Run it with a tracker of your own:  pytest tests/scenarios --pmbm-tracker my_module:MyTracker
"""

import pytest
from trackers import sound

pytestmark = pytest.mark.tracker(sound)


@pytest.mark.scenario("birth_ring", trials=3)
def test_births_are_found_soon(outcome):
    """Objects that arrive at the edge of the range are tracked, and within half a second."""
    assert outcome.mean("mostly_lost") <= 0.1
    assert outcome.mean("initiation_delay") <= 0.5


@pytest.mark.scenario("death_exit", trials=3)
def test_deaths_leave_no_ghosts(outcome):
    """Tracks of objects that leave or vanish end within half a second."""
    assert outcome.mean("ghost_time") <= 0.5


@pytest.mark.scenario("truck_occlusion", trials=3)
def test_hidden_objects_are_remembered(outcome):
    """Behind a truck for seconds, a car keeps its id, and is expected near where it is."""
    assert outcome.mean("id_kept") >= 0.6
    assert outcome.mean("coasting_error") <= 2.5


@pytest.mark.scenario("empty_clutter", trials=3)
def test_clutter_is_not_believed(outcome):
    """On an empty road with ten false boxes a frame, few tracks are born in 20 s."""
    assert outcome.mean("false_tracks") <= 12


@pytest.mark.scenario("one_in_ten_missed.toml", trials=3)
def test_misses_cost_no_identity(outcome):
    """One box in ten is missing, of cars that nothing hides; ids survive that."""
    assert outcome.mean("id_switches") <= 1.0


@pytest.mark.scenario("crossing", trials=3)
def test_crossing_objects_keep_their_ids(outcome):
    """Cars whose paths cross a metre apart come out as who they were."""
    assert outcome.mean("id_switches") <= 0.5
