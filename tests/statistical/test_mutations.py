"""Every planted mistake is noticed by a test."""

import pytest
from mutations import CONTROL, PLANTS, run

pytestmark = pytest.mark.slow


def test_every_planted_mistake_is_noticed(verified):
    assert not run(CONTROL).killed
    outcomes = [run(plant) for plant in PLANTS]
    alive = [outcome.plant.name for outcome in outcomes if not outcome.killed]
    killed = len(outcomes) - len(alive)
    verified(
        "mutation_kill",
        "planted mistakes noticed",
        f"{killed} of {len(outcomes)}",
        "all, of 25 or more",
        not alive and len(outcomes) >= 25,
    )
    assert not alive
    assert len({plant.name for plant in PLANTS}) == len(PLANTS) >= 25
