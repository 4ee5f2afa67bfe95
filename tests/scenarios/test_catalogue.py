"""Every scenario of the catalogue keeps what a catalogue promises."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.labels import Label
from pmbm.sim import load_scenario, scenario_names
from pmbm.sim.scenario.scenario import Scenario, catalogue_folder

_spec = importlib.util.spec_from_file_location(
    "scenario_hashes", Path(__file__).with_name("hashes.py")
)
hashes = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(hashes)

PROMISED = {
    "single_straight",
    "empty_clutter",
    "birth_ring",
    "death_exit",
    "misses_iid",
    "misses_burst",
    "truck_occlusion",
    "long_occlusion",
    "occluded_birth",
    "crossing",
    "parallel_convoy",
    "cut_in",
    "turning",
    "density",
    "small_agents",
    "score_calibration",
    "sensor_dropout",
    "frame_rate",
    "range_falloff",
    "heading_flip",
    "size_bias",
    "ego_motion",
    "duplicates",
    "split_trucks",
    "highway_dense",
    "merge",
    "roundabout",
    "intersection",
    "u_turn",
    "two_way",
}
SWEPT = [name for name in scenario_names() if load_scenario(name).levels]
HUGE = {"density": 50, "density_scripted": 100}
"""The largest levels that everyday tests simulate."""
LATE = {
    "birth_popup": 12.0,
    "crossing": 4.0,
    "crossing_count": 8.0,
    "death_exit": 20.0,
    "sensor_dropout": 12.0,
    "sector_loss": 12.0,
    "sensor_failure": 12.0,
}
"""Seconds until a factor shows, where it does not in the first three."""


def brief(name, seconds=1.5):
    """A scenario cut short."""
    scenario = load_scenario(name)
    return Scenario({**scenario.document, "duration": seconds}, scenario.file)


def levels_of(scenario):
    most = HUGE.get(scenario.name, np.inf)
    return [level for level in scenario.levels if level <= most]


def test_the_catalogue_is_complete():
    assert set(scenario_names()) >= PROMISED


@pytest.mark.parametrize("name", SWEPT)
def test_the_null_level_is_the_base_to_the_bit(name):
    scenario = brief(name)
    null = scenario.record(3, level=scenario.levels[0])
    assert null.digest() == scenario.base().record(3).digest()


@pytest.mark.slow
@pytest.mark.parametrize("name", SWEPT)
def test_the_null_level_of_the_whole_scenario_is_the_base_to_the_bit(name):
    scenario = load_scenario(name)
    for seed in (0, 1):
        null = scenario.record(seed, level=scenario.levels[0])
        assert null.digest() == scenario.base().record(seed).digest()


@pytest.mark.parametrize("name", SWEPT)
def test_every_level_makes_a_difference_and_nothing_but_the_factor_moves(name):
    scenario = brief(name, LATE.get(name, 3.0))
    records = [scenario.record(1, level=level) for level in levels_of(scenario)]
    assert len({record.digest() for record in records}) == len(records)
    if scenario.form.sweep.parameter.startswith("detector"):
        assert len({record.truth_digest() for record in records}) == 1


@pytest.mark.parametrize("name", ["single_straight", "crossing", "truck_occlusion", "roundabout"])
def test_recordings_have_their_stored_hashes(name):
    _check_hashes(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_names())
def test_all_recordings_have_their_stored_hashes(name):
    _check_hashes(name)


def _check_hashes(name):
    stored = hashes.stored()
    if name not in stored:
        pytest.skip(f"no hashes for {hashes.bits_key()}: last bits differ between machines")
    assert hashes.digests(name) == stored[name], "run python tests/scenarios/hashes.py if meant"


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_names())
def test_scenes_that_refuse_crashes_have_none(name):
    scenario = load_scenario(name)
    if getattr(scenario.form.scene, "crashes", "allowed") == "allowed":
        pytest.skip("crashes are allowed")
    for level in scenario.levels or (None,):
        for seed in range(10):
            scenario.scene(seed, level=level)


def test_the_example_of_a_users_own_file_runs():
    scenario = load_scenario(catalogue_folder() / "examples" / "my_junction.toml")
    recording = scenario.record(0)
    labels = {Label(label) for truth in recording.truth for label in truth.label}
    assert labels >= {Label.CAR, Label.BUS, Label.PEDESTRIAN}
    assert {name.split(":")[0] for name in recording.object_name.values()} == {
        "bus",
        "cars",
        "from_side",
        "crossing_people",
    }
    assert any((~truth.observable).any() for truth in recording.truth)
    assert scenario.record(0, level=0.7).digest() != recording.digest()


def test_a_file_may_extend_a_scenario_of_the_catalogue(tmp_path):
    file = tmp_path / "mine.toml"
    head = 'name = "mine"\nstresses = "a street of my own"\nextends = '
    file.write_text(head + '"street"\nduration = 2.0\n[scene.sensor]\nmax_range = 40.0\n')
    mine = load_scenario(file)
    assert mine.form.scene.sensor.max_range == 40.0
    assert mine.form.scene.roads.keys() == load_scenario("street").form.scene.roads.keys()
    assert len(mine.record(0)) == 20
    file.write_text(head + '"steet"\n')
    with pytest.raises(InputError, match=r"mine\.toml.*extends.*'street'"):
        load_scenario(file)
    file.write_text(head + '"misses_iid"\n')
    with pytest.raises(InputError, match="extend 'street'"):
        load_scenario(file)


def test_spawned_and_hidden_objects_are_where_the_scenarios_say():
    def hidden_seconds(name, level):
        scene = load_scenario(name).scene(0, level=level)
        return sum((truth.visibility < 0.1).sum() for truth in scene.truth) / scene.rate

    assert hidden_seconds("long_occlusion", 0.0) < 10 < 25 < hidden_seconds("long_occlusion", 5.0)
    scene = load_scenario("occluded_birth").scene(0, level=12.0)
    first_seen = {}
    for frame, truth in enumerate(scene.truth):
        for object_id in truth.id[truth.observable].tolist():
            first_seen.setdefault(object_id, frame)
    assert sum(frame > 10 for frame in first_seen.values()) >= 4
