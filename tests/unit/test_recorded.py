"""Recorded traffic as a scene: tables, CommonRoad, SUMO; each trap of their files has a test."""

import itertools
import json
import math
import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from test_track_command import pmbm

from pmbm.errors import InputError, InputWarning
from pmbm.sim import load_scenario
from pmbm.sim.world.recorded_files import read
from pmbm.types import Label

TESTS = Path(__file__).parents[1]
HEAD = """
name = "own_log"
stresses = "what a file recorded"
duration = {duration}
rate = {rate}
[scene]
kind = "recorded"
file = "{file}"
"""


def scenario(tmp_path, file, text=None, more="", duration=1.0, rate=10):
    if text is not None:
        (tmp_path / file).write_text(text)
    path = tmp_path / "own_log.toml"
    if not re.search(r"^(ego|sensor)\b", more, re.MULTILINE):
        more = "sensor = { pose = [0.0, 0.0, 0.0] }\n" + more
    path.write_text(HEAD.format(file=file, duration=duration, rate=rate) + more)
    return load_scenario(path)


def scene(*given, **options):
    return scenario(*given, **options).scene(0)


def objects(tmp_path, file, text, types=None):
    (tmp_path / file).write_text(text)
    if types is not None:
        (tmp_path / "types.xml").write_text(types)
    files = [] if types is None else [tmp_path / "types.xml"]
    return {one.name: one for one in read(tmp_path / file, files, {})}


def fcd(*moments):
    """Floating car data of (time, [(id, x, y, angle, type), ...])."""
    lines = ["<fcd-export>"]
    for time, vehicles in moments:
        lines.append(f'<timestep time="{time}">')
        lines += [
            f'<vehicle id="{i}" x="{x}" y="{y}" angle="{a}" type="{t}" speed="0"/>'
            for i, x, y, a, t in vehicles
        ]
        lines.append("</timestep>")
    return "\n".join([*lines, "</fcd-export>"])


TYPES = (
    '<routes><vType id="lorry" vClass="truck" length="10" width="2.5" height="3"/>'
    '<vTypeDistribution id="d"><vType id="short" length="4"/></vTypeDistribution></routes>'
)
TABLE = "time,id,x,y,yaw\n0,1,10,0,0\n0.5,1,15,0,0\n1,1,20,5,0\n1.5,1,20,10,1\n"


class TestResampling:
    def test_at_the_samples_exact_between_them_linear(self, tmp_path):
        made = scene(tmp_path, "log.csv", TABLE, duration=1.3)
        x = [frame.position[0, 0] for frame in made.truth]
        np.testing.assert_allclose(x[:6], [10, 11, 12, 13, 14, 15], rtol=1e-15)
        assert [x[0], x[5], x[10]] == [10.0, 15.0, 20.0]
        np.testing.assert_allclose(made.truth[7].position[0], [17, 2, 0.8])
        np.testing.assert_allclose(made.truth[12].yaw[0], 0.4)
        np.testing.assert_allclose(made.truth[2].velocity, [[10, 0]])
        # Two legs meet: the mean of their velocities.
        np.testing.assert_allclose(made.truth[5].velocity, [[10, 5]])

    @settings(phases=(Phase.explicit, Phase.generate))
    @given(st.data())
    def test_every_sample_keeps_its_bits(self, data):
        """Whatever the file's clock: 3 * .1 is not .3, and both are the same tick."""
        import tempfile

        count = data.draw(st.integers(4, 30))
        step = data.draw(st.sampled_from([0.1, 0.2, 0.05]))
        start = data.draw(st.sampled_from([0.0, 0.3, 1.7e9]))
        times = [start + k * step for k in range(count)]
        place = st.floats(-50, 50)
        angle = st.floats(-np.pi, np.pi, exclude_max=True)
        rows = [(data.draw(place), data.draw(place), data.draw(angle)) for _ in times]
        with tempfile.TemporaryDirectory() as folder:
            text = "time,id,x,y,yaw\n" + "".join(
                f"{t!r},1,{x!r},{y!r},{a!r}\n" for t, (x, y, a) in zip(times, rows, strict=True)
            )
            rate = round(1 / min(step, 0.1))
            duration = (count - 1) * step
            sensor = "sensor = { pose = [0.0, 0.0, 0.0], max_range = 1000.0 }\n"
            made = scene(Path(folder), "log.csv", text, more=sensor, duration=duration, rate=rate)
        every = max(round(step * rate), 1)
        for k, (x, y, a) in enumerate(rows):
            if k * every < len(made):
                assert made.truth[k * every].position[0, :2].tolist() == [x, y]
                assert made.truth[k * every].yaw.tolist() == [a]

    def test_an_object_that_is_away_is_not_drawn_through(self, tmp_path):
        text = "time,id,x,y\n" + "".join(
            f"{k / 10:g},{i},{10 * i + k},0\n"
            for k in range(12)
            for i in (1, 2)
            if i == 1 or not 3 < k < 8
        )
        made = scene(tmp_path, "log.csv", text)
        assert [len(frame) for frame in made.truth] == [2, 2, 2, 2, 1, 1, 1, 1, 2, 2]
        assert {frame.id[-1] for frame in made.truth if len(frame) > 1} == {1}
        # Velocities stop at the gap, too.
        np.testing.assert_allclose(made.truth[3].velocity, [[10, 0], [10, 0]])


class TestTable:
    def test_sizes_labels_names_and_classes(self, tmp_path):
        text = (
            "time,id,x,y,length,class\n0,a,10,0,4,sedan\n1,a,12,0,6,sedan\n2,a,14,0,5,sedan\n"
            "0,b,20,0,,cone\n2,b,20,0,,cone\n"
        )
        more = 'classes = { sedan = "car", cone = "ignored" }\n'
        made = scene(tmp_path, "log.csv", text, more=more)
        assert dict(made.object_name) == {0: "a"}
        assert made.truth[0].size.tolist() == [[5.0, 2.0, 1.6]]
        assert made.truth[0].label.tolist() == [Label.CAR]

    def test_a_bad_cell_names_file_line_and_column(self, tmp_path):
        with pytest.raises(InputError, match="got 'abc'") as error:
            scene(tmp_path, "log.csv", TABLE.replace("15,0", "abc,0"))
        assert (error.value.rows, error.value.field) == ((3,), "x")
        assert error.value.file == str(tmp_path / "log.csv")


class TestCommonRoad:
    FILE = TESTS / "data" / "recorded" / "yard.xml"

    def test_boxes_are_where_commonroad_io_puts_them(self):
        """A truck's position is that of its rear axle."""
        oracle = json.loads((TESTS / "oracle" / "recorded" / "commonroad.json").read_text())
        ours = {one.name: one for one in read(self.FILE, [], {})}
        assert ours.keys() == oracle["objects"].keys()
        for name, expected in oracle["objects"].items():
            rows = np.array(expected["rows"])
            one = ours[name]
            assert one.size[0] == expected["length"]
            known = slice(0, len(rows))
            np.testing.assert_allclose(one.position[known], rows[:, 1:3], rtol=1e-15)
            np.testing.assert_allclose(one.time[known], rows[:, 0] * oracle["dt"])
            if expected["type"] != "pedestrian":
                np.testing.assert_allclose(one.yaw[known], rows[:, 3])
        truck = ours["12"]
        away = truck.position[0] - [20, -5]
        np.testing.assert_allclose(np.hypot(*away), 2.5)

    def test_a_state_is_of_its_own_time_and_not_of_its_place_in_the_list(self, tmp_path):
        made = scene(tmp_path, str(self.FILE), duration=1.2)
        car = {
            round(frame.time, 9): frame.position[rows[0], 0]
            for frame in made.truth
            if len(rows := np.flatnonzero(frame.id == made_id(made, "11")))
        }
        # Steps 0, 1, 5 and 6 of .2 s; between 1 and 5 nothing is known.
        assert car == {0.0: 0.0, 0.1: 1.0, 0.2: 2.0, 1.0: 10.0, 1.1: 11.0}

    def test_labels_and_what_stands_still(self, tmp_path):
        made = scene(tmp_path, str(self.FILE))
        labels = {
            made.object_name[i]: int(n)
            for f in made.truth
            for i, n in zip(f.id, f.label, strict=True)
        }
        assert labels["10"] == Label.CAR
        assert labels["12"] == Label.TRUCK
        assert labels["13"] == Label.PEDESTRIAN
        assert all(made_id(made, "10") in frame.id for frame in made.truth)

    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ("<circle><radius>0.3</radius></circle>", "<polygon/>", "no box"),
            ("<x>14.9</x>", "<x>here</x>", "no exact number"),
            ("<time><exact>6</exact></time>", "<time><exact>5</exact></time>", "of one time"),
            ('timeStepSize="0.2"', "", "an attribute is missing"),
            ("</commonRoad>", "", "not a readable XML file"),
            ("commonRoad", "elsewhere", "no recorded traffic"),
        ],
    )
    def test_bad_files(self, tmp_path, old, new, said):
        text = self.FILE.read_text().replace(old, new)
        with pytest.raises(InputError, match=said) as error:
            scene(tmp_path, "bad.xml", text)
        assert error.value.file == str(tmp_path / "bad.xml")


@pytest.mark.skipif("PMBM_DATA" not in os.environ, reason="PMBM_DATA is unset: no real logs")
@pytest.mark.parametrize(
    ("name", "sensor", "seconds"),
    [
        ("USA_US101-10_1_T-1", [60.0, -60.0, 0.0], 3.0),
        ("USA_Peach-2_1_T-1", [0.0, 0.0, 0.0], 3.0),
        ("DEU_Lohmar-64_1_T-1", [-550.0, -420.0, 0.0], 9.0),
        ("ARG_Carcarana-4_5_T-1", [-290.0, -380.0, 0.0], 3.0),
    ],
)
def test_real_traffic(tmp_path, name, sensor, seconds):
    """NGSIM and SUMO through CommonRoad: no car leaps, and velocities agree with places."""
    file = Path(os.environ["PMBM_DATA"]) / "commonroad" / f"{name}.xml"
    made = scene(tmp_path, str(file), more=f"sensor.pose = {sensor}\n", duration=seconds)
    assert sum(map(len, made.truth)) > 10
    for before, after in itertools.pairwise(made.truth):
        both, old, new = np.intersect1d(before.id, after.id, return_indices=True)
        moved = np.hypot(*(after.position[new] - before.position[old])[:, :2].T) / 0.1
        speed = np.hypot(*before.velocity[old].T)
        assert (np.abs(moved - speed) < 3.0).all(), both
        assert (moved < 50).all()


def made_id(made, name):
    (found,) = [i for i, other in made.object_name.items() if other == name]
    return found


class TestSumo:
    def test_the_front_bumper_and_a_compass_angle(self, tmp_path):
        """Angle 0 is north, 90 east, clockwise; x and y are of the front; lengths stand with the
        types."""
        vehicles = [("n", 0, 50, 0, "lorry"), ("e", 50, 0, 90, "short"), ("w", -9, 0, 270, "lorry")]
        found = objects(tmp_path, "a.xml", fcd((0, vehicles), (1, vehicles)), TYPES)
        np.testing.assert_allclose(found["n"].position[0], [0, 45], atol=1e-12)
        np.testing.assert_allclose(found["n"].yaw[0], math.pi / 2)
        np.testing.assert_allclose(found["e"].position[0], [48, 0], atol=1e-12)
        np.testing.assert_allclose(found["e"].yaw[0], 0, atol=1e-12)
        np.testing.assert_allclose(found["w"].position[0], [-4, 0], atol=1e-12)
        assert found["n"].label == Label.TRUCK
        assert found["n"].size == (10.0, 2.5, 3.0)
        # What a type does not say is that of SUMO's class.
        assert found["e"].size == (4.0, 1.8, 1.5)

    def test_a_type_without_a_length_anywhere_is_refused(self, tmp_path):
        with pytest.raises(InputError, match="no file of types has") as error:
            objects(tmp_path, "a.xml", fcd((0, [("v", 0, 0, 0, "lorry")])))
        assert (error.value.object_id, error.value.got) == ("v", "lorry")

    def test_types_of_one_vehicle_and_of_sumo_itself(self, tmp_path):
        vehicles = [("v", 0, 0, 0, "lorry@v"), ("u", 9, 0, 0, "DEFAULT_VEHTYPE")]
        found = objects(tmp_path, "a.xml", fcd((0, vehicles)), TYPES)
        assert found["v"].size == (10.0, 2.5, 3.0)
        assert found["u"].size == (5.0, 1.8, 1.5)

    def test_a_car_that_jumps_aside_has_no_path_through_the_jump(self, tmp_path):
        """A parking car is 3.2 m farther to the side in the next step, at a speed of 32 m/s."""
        rows = [(k / 10, [("p", 20, 0 if k < 5 else 3.2, 90, "short")]) for k in range(12)]
        with pytest.warns(InputWarning, match=r"moved aside in one step, first p at 0\.5 s"):
            found = objects(tmp_path, "a.xml", fcd(*rows), TYPES)
        assert np.flatnonzero(found["p"].cut).tolist() == [4]
        more = 'types = ["types.xml"]\n'
        with pytest.warns(InputWarning, match="aside"):
            made = scene(tmp_path, "a.xml", more=more)
        assert [frame.position[0, 1] for frame in made.truth] == [0.0] * 5 + [3.2] * 5
        assert max(np.abs(frame.velocity).max() for frame in made.truth) == 0.0

    def test_a_bend_is_no_jump(self, tmp_path):
        """A quarter of a circle of 8 m radius in three seconds, in steps of a second."""
        turn = np.linspace(0, np.pi / 2, 4)
        rows = [
            (k, [("c", 8 * math.sin(a), 8 - 8 * math.cos(a), 90 - math.degrees(a), "short")])
            for k, a in enumerate(turn)
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = objects(tmp_path, "a.xml", fcd(*rows), TYPES)
        assert not found["c"].cut.any()

    def test_velocities_are_those_of_the_boxes_although_headings_lag(self, tmp_path):
        """SUMO turns a car late: the angle still says east when the way leads north-east."""
        rows = [(k / 10, [("c", k, k, 90 if k < 6 else 45, "short")]) for k in range(14)]
        (tmp_path / "types.xml").write_text(TYPES)
        made = scene(tmp_path, "a.xml", fcd(*rows), more='types = ["types.xml"]\n')
        for k in (2, 3, 8):
            np.testing.assert_allclose(made.truth[k].velocity, [[10, 10]], atol=1e-9)
        for k in range(1, 9):
            before, after = made.truth[k - 1], made.truth[k + 1]
            # From tick to tick, .05 s apart, within a frame of both neighbours.
            reach = np.abs(after.position - before.position)[0, :2].max() / 0.1
            assert np.abs(made.truth[k].velocity).max() <= reach + 1e-9

    @pytest.mark.parametrize(
        ("old", "new", "said"),
        [
            ('x="1"', 'x="one"', "not a number"),
            ('angle="90"', "", "an attribute is missing"),
            ('time="1"', 'time="0"', "times must increase"),
            ("</fcd-export>", "", "not a readable XML file"),
        ],
    )
    def test_bad_files(self, tmp_path, old, new, said):
        text = fcd((0, [("v", 0, 0, 90, "short")]), (1, [("v", 1, 0, 90, "short")]))
        with pytest.raises(InputError, match=said) as error:
            objects(tmp_path, "a.xml", text.replace(old, new, 1), TYPES)
        assert error.value.file == str(tmp_path / "a.xml")


class TestEgo:
    LOG = "time,id,x,y,yaw\n" + "".join(
        f"{k / 10:g},ego,{k},0,0.1\n{k / 10:g},other,{20 + k},3,0\n" for k in range(15)
    )

    def test_the_sensor_is_on_the_vehicle_which_is_not_in_the_truth(self, tmp_path):
        made = scene(tmp_path, "log.csv", self.LOG, more='ego = "ego"\n')
        np.testing.assert_allclose(made.sensor_pose[3], [3, 0, 0.1])
        assert set(made.object_name.values()) == {"other"}

    def test_an_ego_that_is_unknown_or_away(self, tmp_path):
        with pytest.raises(InputError, match="did you mean 'ego'"):
            scene(tmp_path, "log.csv", self.LOG, more='ego = "eggo"\n')
        short = self.LOG.replace("0.3,ego,3,0,0.1\n", "").replace("0.4,ego,4,0,0.1\n", "")
        with pytest.raises(InputError, match="not there all the time"):
            scene(tmp_path, "log.csv", short, more='ego = "ego"\n')

    def test_a_scene_longer_than_the_file(self, tmp_path):
        with pytest.raises(InputError, match=r"at most 1\.4 s, from scene.start = 0 s") as error:
            scene(tmp_path, "log.csv", self.LOG, duration=2.0)
        assert error.value.field == "duration"
        with pytest.raises(InputError, match="longer than"):
            scene(tmp_path, "log.csv", self.LOG, more="start = 1.0\n")
        assert len(scene(tmp_path, "log.csv", self.LOG, more="start = 0.4\n")) == 10


class TestAsAnyScenario:
    def test_occlusion_detector_and_sweep(self, tmp_path):
        """A wall hides what passes behind it; equal seeds, equal bits; a swept detector."""
        more = (
            "occluders = { wall = { box = [10.0, 5.0, 30.0, 0.5, 0.0] } }\n"
            'tracks = { walker = { label = "pedestrian", start = [5.0, 2.0], speed = 1.0 } }\n'
            '[sweep]\nparameter = "detector.clutter.rate"\nlevels = [0.0, 8.0]\n'
        )
        text = "time,id,x,y\n" + "".join(f"{k / 10:g},1,{k},9\n" for k in range(12))
        made = scenario(tmp_path, "log.csv", text, more=more)
        truth = made.scene(0).truth[5]
        assert truth.visibility.tolist() == [0.0, 1.0]
        assert truth.label.tolist() == [Label.OTHER, Label.PEDESTRIAN]
        assert made.record(3).digest() == made.record(3).digest()
        assert made.record(3).truth_digest() == made.record(4).truth_digest()
        boxes = [sum(map(len, made.record(0, level=n).detections)) for n in (0.0, 8.0)]
        assert boxes[1] > boxes[0] + 40

    def test_a_changed_file_is_read_again(self, tmp_path):
        made = scenario(tmp_path, "log.csv", TABLE)
        before = made.scene(0).truth_digest()
        (tmp_path / "log.csv").write_text(TABLE.replace("10,0,0", "11.5,0,0"))
        assert made.scene(0).truth_digest() != before

    def test_study_and_gate(self, tmp_path):
        text = "time,id,x,y\n" + "".join(f"{k / 10:g},1,{k},9\n" for k in range(12))
        scenario(tmp_path, "log.csv", text)
        study = tmp_path / "study.toml"
        study.write_text(
            'scenarios = ["own_log.toml"]\ntrackers = ["pmbm", "argoverse"]\ntrials = 2\n'
            'metrics = ["gospa"]\n'
        )
        assert pmbm("study", study, "--store", tmp_path / "s.sqlite") == 0

    def test_a_file_that_is_not_there(self, tmp_path):
        with pytest.raises(InputError, match="no such file") as error:
            scene(tmp_path, "no.csv")
        assert error.value.file == str(tmp_path / "no.csv")

    def test_unknown_keys(self, tmp_path):
        with pytest.raises(InputError, match="did you mean 'types'"):
            scenario(tmp_path, "log.csv", TABLE, more='type = ["a"]\n')


@pytest.mark.parametrize("name", ["recorded_junction", "recorded_drive", "recorded_yard"])
def test_what_ships(name):
    made = load_scenario(name).scene(0)
    assert len(made) == 200
    assert sum(map(len, made.truth)) > 1000
    hidden = sum(int((frame.visibility < 0.5).sum()) for frame in made.truth)
    assert hidden > 20
    speed = np.concatenate([np.hypot(*frame.velocity.T) for frame in made.truth])
    assert speed.max() < 20


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("log.txt", b"time,id,x,y\n0,1,1,1\n", r"expected .csv or .parquet, .*got '.txt'"),
        ("log.csv", b"time;id;x;y\n0;1;1;1\n", "expected ',', got ';'"),
        ("log.csv", b"time,id,x,y,class\n0,1,1,1,v\xe9lo\n", "UTF-8 .*rows 2.*0xe9"),
    ],
)
def test_a_file_of_another_kind_is_told_in_our_words(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        scene(tmp_path, name)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no such folder \(file .*/logs\)"):
        scene(tmp_path, "logs/log.csv")


def test_somebody_carries_the_sensor(tmp_path):
    (tmp_path / "log.csv").write_text(TABLE)
    path = tmp_path / "own_log.toml"
    path.write_text(HEAD.format(file="log.csv", duration=1.0, rate=10))
    with pytest.raises(InputError, match=r"carries the sensor .*ego.*pose = "):
        load_scenario(path)


def test_a_mast_that_sees_nothing_is_said(tmp_path):
    far = "sensor = { pose = [5000.0, 0.0, 0.0] }\n"
    with pytest.warns(InputWarning, match="no object ever comes within"):
        scene(tmp_path, "log.csv", TABLE, more=far)
