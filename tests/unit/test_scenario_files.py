"""Scenario files: what they may say, and what is said of one with a mistake."""

import json
import pickle

import numpy as np
import pytest

import pmbm.sim
from pmbm.errors import InputError, InputWarning
from pmbm.sim import schema
from pmbm.sim.scenario.scenario import Scenario, catalogue_folder, load_scenario, scenario_names
from pmbm.sim.toml_tables import read_toml

SMALL = """
name = "small"
stresses = "two objects, for the tests of the files"
duration = 2.0

[scene]
kind = "scripted"
sensor = { max_range = 60.0 }

[scene.tracks.walker]
label = "pedestrian"
start = [10.0, 2.0]
yaw_deg = 90.0
speed = 1.5
jitter = { x = 0.5 }

[scene.tracks.car]
start = [-20.0, -5.0]
speed = 10.0

[detector]
profile = "nominal"

[sweep]
parameter = "scene.tracks.walker.speed"
levels = [1.5, 3.0]
"""


def write(tmp_path, text, name="small.toml"):
    file = tmp_path / name
    file.write_text(text)
    return file


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("duration", "durration", ["durration", "unknown key", "'duration'"]),
        ("yaw_deg = 90.0", "yaw = 1.57", ["scene.tracks.walker.yaw", "'yaw_deg'"]),
        ("max_range", "max_rnage", ["scene.sensor.max_rnage", "'max_range'"]),
        ("start = [10.0, 2.0]", "strat = [10.0, 2.0]", ["scene.tracks.walker.strat", "'start'"]),
        ("duration = 2.0", "duration = -2.0", ["duration", "above 0", "-2.0"]),
        ("duration = 2.0", 'duration = "long"', ["duration", "number", "'long'"]),
        ("duration = 2.0", "duration = nan", ["duration", "finite"]),
        ("duration = 2.0", "duration = 2.0\nrate = 7", ["rate", "one of 1, 2, 4, 5, 10, 20", "7"]),
        ("duration = 2.0", "duration = 0.01", ["duration", "shorter than one frame"]),
        ('"pedestrian"', '"pedestrain"', ["scene.tracks.walker.label", "'pedestrian'"]),
        ("speed = 1.5", "speed = true", ["scene.tracks.walker.speed", "number"]),
        ("[10.0, 2.0]", "[10.0]", ["scene.tracks.walker.start", "a list of at least 2"]),
        ('"scripted"', '"scriptd"', ["scene.kind", "'scripted'"]),
        ('kind = "scripted"', "", ["scene.kind", "missing"]),
        ('name = "small"', "", ["'name' is missing"]),
        ('name = "small"', 'name = "Small one"', ["name", "pattern"]),
        ("speed = 10.0", "speed = 10.0 10", ["not TOML", "line 19"]),
        ("levels = [1.5, 3.0]", "levels = [1.5, -3.0]", ["scene.tracks.walker.speed", "-3.0"]),
        ("levels = [1.5, 3.0]", "levels = [1.5]", ["sweep.levels", "a list of at least 2"]),
        ("levels = [1.5, 3.0]", "levels = [3.0, 3.0]", ["sweep.levels", "once"]),
        ("levels = [1.5, 3.0]", "levels = [1.5, 3.0]\ndefault = 2.0", ["sweep.default", "2.0"]),
        ("walker.speed", "walker.speeed", ["scene.tracks.walker.speeed", "'speed'"]),
        ('parameter = "scene.', 'parameter = "scnee.', ["sweep.parameter", "'scene'"]),
        ('profile = "nominal"', 'profile = "nomnal"', ["detector.profile", "nomnal", "'nominal'"]),
        ('profile = "nominal"', "objects = { detection_probability = 1.3 }", ["1.3"]),
        ('profile = "nominal"', "clutter = { rate = -1.0 }", ["detector.clutter.rate", "-1"]),
    ],
)  # fmt: skip
def test_a_mistake_is_one_error_that_names_it(tmp_path, old, new, words):
    assert old in SMALL
    file = write(tmp_path, SMALL.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_scenario(file)
    for word in (*words, "small.toml"):
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("[scene.ego]\nspeed = 1.0", ["scene.sensor.pose"]),
        ("[scene.occluders.wall]", ["scene.occluders.wall", "exactly one of box and polygon"]),
    ],
)
def test_contradictions_are_refused(tmp_path, extra, words):
    text = SMALL.replace("max_range = 60.0", "max_range = 60.0, pose = [0.0, 0.0, 0.0]")
    with pytest.raises(InputError) as caught:
        load_scenario(write(tmp_path, text + "\n" + extra))
    for word in words:
        assert word in str(caught.value)


def test_files_that_are_no_files(tmp_path):
    with pytest.raises(InputError, match="crossing"):
        load_scenario("crosing")
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_scenario(tmp_path / "nowhere.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not TOML"):
        load_scenario(tmp_path / "bytes.toml")
    (tmp_path / "deep.toml").write_text("a = " + "[" * 100_000)
    with pytest.raises(InputError, match=r"deep\.toml"):
        load_scenario(tmp_path / "deep.toml")


def test_a_profile_of_ones_own_lies_beside_the_scenario(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "lidar.toml").write_text('name = "lidar"\n[clutter]\nrate = 3.5\n')
    text = SMALL.replace('profile = "nominal"', 'profile = "lidar.toml"')
    assert load_scenario(write(tmp_path / "mine", text)).detector().clutter.rate == 3.5
    monkeypatch.chdir(tmp_path)
    assert load_scenario("mine/small.toml").detector().name == "lidar"
    with pytest.raises(InputError, match=r"lidar\.toml"):
        load_scenario(write(tmp_path, text))


@pytest.mark.parametrize("bad", [{"seed": -1}, {"seed": 1.5}, {"seed": True}, {"trial": -2}])
def test_seeds_and_trials_are_whole_numbers(tmp_path, bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        load_scenario(write(tmp_path, SMALL)).record(**{"seed": 0, **bad})


def test_a_scenario_is_a_picklable_source(tmp_path):
    scenario = load_scenario(write(tmp_path, SMALL)).at(3.0)
    again = pickle.loads(pickle.dumps(scenario))
    assert again.name == scenario.name == "small@3"
    assert again.record(4).digest() == scenario.record(4).digest()


def test_levels_set_the_swept_key_and_the_first_one_changes_nothing(tmp_path):
    scenario = load_scenario(write(tmp_path, SMALL))
    assert scenario.levels == (1.5, 3.0)
    base = scenario.base().record(4)
    assert scenario.record(4, level=1.5).digest() == base.digest()
    fast = scenario.record(4, level=3.0)
    assert fast.digest() == scenario.at(3.0).record(4).digest()
    assert fast.truth[0].velocity[0, 1] == pytest.approx(3.0)
    assert np.array_equal(fast.truth[-1].position[1], base.truth[-1].position[1])
    with pytest.raises(InputError, match=r"1\.5, 3\.0, got 2"):
        scenario.record(4, level=2)


def test_scripted_paths_by_hand():
    def last(**path):
        document = {
            "name": "test",
            "stresses": "a test of its own",
            "duration": 4.1,
            "scene": {"kind": "scripted", "tracks": {"it": path}},
        }
        truth = Scenario(document).scene(0).truth
        return truth[-1]

    truth = last(start=[1.0, 2.0], speed=3.0)
    assert truth.position[0] == pytest.approx([13.0, 2.0, 0.8])
    # Braking from 4 to 0 m/s over 2 s covers 4 m, then it stands.
    truth = last(speed=4.0, moves=[{"seconds": 2.0, "speed": 0.0}])
    assert truth.position[0, :2] == pytest.approx([4.0, 0.0])
    assert truth.velocity[0] == pytest.approx([0.0, 0.0])
    # A quarter turn to the left at 2 m/s over 4 s: radius 16 / pi m ends at (r, r).
    truth = last(speed=2.0, moves=[{"seconds": 4.0, "turn_deg": 90.0}])
    assert truth.position[0, :2] == pytest.approx([16 / np.pi] * 2, abs=1e-4)
    assert truth.yaw[0] == pytest.approx(np.pi / 2)
    truth = last(poses=[[0.0, 0.0, 0.0, 170.0], [8.0, 8.0, 4.0, -170.0]])
    assert truth.position[0, :2] == pytest.approx([4.0, 2.0])
    assert abs(truth.yaw[0]) == pytest.approx(np.pi)


def test_more_births_only_add_objects():
    def born(rate, **changes):
        document = {
            "name": "test",
            "stresses": "a test of its own",
            "rate": 2,
            "scene": {"kind": "scripted", "births": {"any": {"rate": rate, **changes}}},
        }
        scene = Scenario(document).scene(1)
        return {
            (object_id, frame): truth.position[row].tobytes()
            for frame, truth in enumerate(scene.truth)
            for row, object_id in enumerate(truth.id.tolist())
        }

    few, many = born(0.5), born(2.0)
    assert few.items() <= many.items()
    assert len(many) > 2 * len(few) > 0
    assert born(0.0) == {}
    # The share of births in mid-range moves only the objects that it concerns.
    some = born(2.0, popup=0.3)
    same = {key for key in many if some.get(key) == many[key]}
    assert 0.4 * len(many) < len(same) < len(many)


def test_the_birth_rate_is_the_rate():
    document = {
        "name": "test",
        "stresses": "a test of its own",
        "duration": 50.0,
        "rate": 1,
        "simulation_rate": 2,
        "scene": {"kind": "scripted", "births": {"any": {"rate": 2.0}}},
    }
    counts = [len(Scenario(document).scene(seed).object_name) for seed in range(5)]
    assert abs(np.mean(counts) - 100) < 4 * np.sqrt(100 / 5) + 4  # births of the last second


def test_the_catalogue_lies_within_the_package(monkeypatch, tmp_path):
    import importlib.resources

    assert "truck_occlusion" in scenario_names()
    installed = tmp_path / "sim"
    (installed / "scenarios").mkdir(parents=True)
    monkeypatch.setattr(importlib.resources, "files", lambda _: installed)
    with pytest.raises(InputError, match="catalogue of scenarios is missing"):
        scenario_names()
    (installed / "scenarios" / "only.toml").write_text(SMALL)
    assert scenario_names() == ("only",)
    assert catalogue_folder() == installed / "scenarios"


def test_the_package_has_its_names_lazily():
    assert set(pmbm.sim.__all__) <= set(dir(pmbm.sim))
    for name in pmbm.sim.__all__:
        assert getattr(pmbm.sim, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = pmbm.sim.nothing


def test_the_json_schema_knows_every_key_of_the_catalogue():
    described = schema.json_schema()
    text = json.dumps(described)
    for key in ("scene", "sweep", "levels", "popup", "from_deg", "entries", "turn_deg"):
        assert f'"{key}"' in text
    assert described["additionalProperties"] is False
    assert described["required"] == ["name", "stresses"]


def test_an_editor_shows_a_description_of_every_key():
    described = schema.json_schema()
    forms = {"scenario": described, **described["$defs"]}
    silent = [
        f"{name}.{key}"
        for name, form in forms.items()
        for key, one in form.get("properties", {}).items()
        if len(one.get("description", "")) < 2 and "const" not in one
    ]
    assert silent == []


def test_every_file_of_the_catalogue_says_what_it_stresses():
    for name in scenario_names():
        path = catalogue_folder() / f"{name}.toml"
        assert path.read_text().startswith("# ")
        assert read_toml(path)["name"] == name


ROAD = """
name = "road"
stresses = "what a road file may not say"
duration = 2.0
[scene]
kind = "road"
[scene.roads.main]
start = [0.0, 0.0]
end = [200.0, 0.0]
leads_to = "bend"
[scene.roads.bend]
centre = [200.0, 50.0]
radius = 50.0
from_deg = -90.0
to_deg = 0.0
[scene.ego]
road = "main"
position = 20.0
speed = 10.0
[scene.actors.truck]
label = "truck"
road = "main"
position = 120.0
count = 3
spacing = -25.0
speed = 10.0
[scene.entries.in]
road = "main"
rate = 0.2
speed = 10.0
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "centre = [200.0, 50.0]",
            "centre = [200.0, 57.0]",
            ["scene.roads.main.leads_to", "(200, 0)", "(200, 7), 7 m from there"],
        ),
        ("spacing = -25.0", "spacing = -12.0", ["scene.actors.truck.spacing", "14 m", "-12 m"]),
        ("rate = 0.2", "rate = 300.0", ["scene.entries.in.rate", "at most 2 a second", "300"]),
    ],
)
def test_roads_that_cannot_be_are_refused(tmp_path, old, new, words):
    load_scenario(write(tmp_path, ROAD, "road.toml"))
    with pytest.raises(InputError) as caught:
        load_scenario(write(tmp_path, ROAD.replace(old, new), "road.toml"))
    for word in (*words, "road.toml"):
        assert word in str(caught.value)


def test_traffic_that_never_comes_in_range_is_told(tmp_path):
    far = SMALL.replace("[10.0, 2.0]", "[10000.0, 2.0]").replace("[-20.0, -5.0]", "[0.0, 2e4]")
    told = r"'small': no object ever comes within .*range of 60 m.*small\.toml"
    with pytest.warns(InputWarning, match=told):
        load_scenario(write(tmp_path, far)).record(1)
    away = ROAD.replace(
        "[scene.ego]", "[scene.roads.away]\nstart = [0.0, 1e4]\nend = [9.0, 1e4]\n[scene.ego]"
    )
    away = away.replace('road = "main"\nposition = 20.0', 'road = "away"\nposition = 2.0')
    with pytest.warns(InputWarning, match="no object ever comes within"):
        load_scenario(write(tmp_path, away, "road.toml")).record(1)


def test_what_a_scene_refuses_names_the_file(tmp_path):
    crash = ROAD.replace("spacing = -25.0", "spacing = -15.0").replace(
        'road = "main"\nposition = 20.0\nspeed = 10.0',
        'road = "main"\nposition = 60.0\nspeed = 30.0\ndriver = "cruise"',
    )
    with pytest.raises(InputError, match=r"crash.*road.toml"):
        load_scenario(write(tmp_path, crash, "road.toml")).record(1)
