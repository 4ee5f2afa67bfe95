"""Every planted mistake is noticed by a test."""

import ast
from pathlib import Path

import pytest
from mutations import PLANTS, ROOT, bench


def test_every_plant_still_applies():
    """The code moves on, and the plants with it: each passage stands where it did, exactly once,
    what replaces it is Python, and the test that noticed it last is still there."""
    assert len({plant.name for plant in PLANTS}) == len(PLANTS) >= 25
    for plant in PLANTS:
        text = plant.place(ROOT).read_text(encoding="utf-8")
        ast.parse(text.replace(plant.old, plant.new))
        file, *_, function = plant.by.split("::")
        assert f"def {function.partition('[')[0]}(" in Path(ROOT / file).read_text(), plant.name


@pytest.mark.slow
def test_every_planted_mistake_is_noticed(verified):
    """Sound code fails no test; each mistake fails one."""
    with bench() as made:
        made.check_sound(plant.by for plant in PLANTS)
        outcomes = [made.run(plant) for plant in PLANTS]
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
