"""What the tracker must do on the road."""

import pytest


@pytest.mark.scenario("../passing.toml", trials=10)
@pytest.mark.tracker("exec:./tracker", "exec:python3 tracker.py")
def test_ids_are_kept(outcome):
    assert outcome.max("id_switches") == 0
    assert outcome.mean("misses") <= 25


def test_it_is_no_worse_in_python(tracking_gate):
    tracking_gate.check(
        "exec:python3 tracker.py",
        against="exec:./tracker",
        scenario="../passing.toml",
        bounds=(0.0, 4.0),
        margin=1.0,
    )
