"""No two objects of the catalogue's truth are in one place, unless they have crashed or the
scenario's file says that they may be; by shapely, which the simulation does not ask."""

import json

import numpy as np
import pytest
import shapely

from pmbm.geometry import corners
from pmbm.sim import load_scenario, scenario_names

LARGEST_CONTACT = 1e-6
"""m^2 that rounding may show as an overlap."""
HUGE = {"density": 50, "density_scripted": 100}
"""The largest levels that are simulated here."""


def worlds(levels):
    """Scenarios at levels, each world once: many scenarios change only the detector."""
    known = {}
    for name in scenario_names():
        scenario = load_scenario(name)
        if scenario.form.scene.overlaps == "allowed":
            continue
        for level in levels(scenario):
            document = scenario.base().document if level is None else scenario._document_at(level)
            parts = {k: document.get(k) for k in ("duration", "rate", "simulation_rate", "warmup")}
            known.setdefault(json.dumps([parts, document["scene"]], sort_keys=True), (name, level))
    return sorted(known.values(), key=str)


def all_levels(scenario):
    most = HUGE.get(scenario.name, np.inf)
    return [level for level in scenario.levels if level <= most] or [None]


def overlapping(scene):
    """Frames and names of objects that share ground, neither of them crashed."""
    for number, frame in enumerate(scene.truth):
        outlines = shapely.polygons(corners(frame.position, frame.size, frame.yaw))
        one, two = shapely.STRtree(outlines).query(outlines, predicate="intersects")
        one, two = one[one < two], two[one < two]
        shared = shapely.area(shapely.intersection(outlines[one], outlines[two]))
        wrong = (shared > LARGEST_CONTACT) & ~frame.crashed[one] & ~frame.crashed[two]
        for i, j in zip(frame.id[one[wrong]].tolist(), frame.id[two[wrong]].tolist(), strict=True):
            yield number, scene.object_name[i], scene.object_name[j]


def test_only_small_agents_may_overlap():
    allowed = [
        name for name in scenario_names() if load_scenario(name).form.scene.overlaps == "allowed"
    ]
    assert allowed == ["small_agents"]
    assert any(overlapping(load_scenario("small_agents").scene(0)))


@pytest.mark.parametrize(("name", "level"), worlds(lambda scenario: [scenario.default_level]))
def test_objects_are_solid(name, level):
    for seed in range(2):
        assert not list(overlapping(load_scenario(name).scene(seed, level=level)))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "level"), worlds(all_levels))
def test_objects_are_solid_at_every_level(name, level, verified):
    """In 20 trials of each world; the everyday test looks at two."""
    scenario = load_scenario(name)
    found = {
        (seed, one, two)
        for seed in range(20)
        for _, one, two in overlapping(scenario.scene(seed, level=level))
    }
    where = name if level is None else f"{name}@{level:g}"
    what = f"pairs of objects of {where} that overlap uncrashed, 20 seeds"
    verified("solid_truth", what, len(found), 0, not found)
    assert not found
