"""Tables of a user's own: by hand, by file, by command; and what is said of bad ones."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_track_command import pmbm

from pmbm.cli.track import tracked
from pmbm.datasets import open_dataset, with_origins
from pmbm.datasets.source import dataset_source, named_dataset
from pmbm.errors import InputError, InputWarning
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.sim import load_scenario
from pmbm.study import ConfiguredTracker
from pmbm.study.file import load_study
from pmbm.tables.columns import COLUMNS
from pmbm.types import CLUTTER, Label, Recording, Tracks, TrackSequence

TRUTH = """time,id,x,y
0.0,a,10,0
0.1,a,11,0
0.1,b,5,5
0.2,b,5,6
0.4,b,5,8
"""
DETECTIONS = """time,x,y,score
0.0,10.1,0,0.9
0.2,5.1,6,0.8
0.1,11.1,0,0.7
"""


@pytest.fixture
def folder(tmp_path):
    """One sequence, s, of the tables above."""
    put(tmp_path / "truth" / "s.csv", TRUTH)
    put(tmp_path / "detections" / "s.csv", DETECTIONS)
    return tmp_path


def put(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def opened(folder, **options):
    return open_dataset(
        "table", root=folder, **{"detections": str(folder / "detections"), **options}
    )


def problem(folder, **options):
    with pytest.raises(InputError) as error:
        opened(folder, **options).recording("s")
    return error.value


class TestByHand:
    def test_what_is_left_out_has_its_default(self, folder):
        made = opened(folder).recording("s")
        assert [frame.time for frame in made.truth] == [0.0, 0.1, 0.2, 0.4]
        assert made.stamp.tolist() == [0, 100_000_000, 200_000_000, 400_000_000]
        assert [frame.id.tolist() for frame in made.truth] == [[0], [0, 1], [1], [1]]
        assert dict(made.object_name) == {0: "a", 1: "b"}
        first = made.truth[0]
        assert first.label.tolist() == [Label.OTHER]
        assert first.size.tolist() == [[5.0, 2.0, 1.6]]
        assert first.position.tolist() == [[10.0, 0.0, 0.8]]
        assert (first.yaw.tolist(), first.visibility.tolist()) == ([0.0], [1.0])
        assert (first.observable.tolist(), first.crashed.tolist()) == ([True], [False])
        assert [len(seen) for seen in made.detections] == [1, 1, 1, 0]
        assert made.detections[1].position[0].tolist() == [11.1, 0.0, 0.8]
        assert made.detections[1].score.tolist() == [0.7]
        assert made.origin is None

    def test_velocities_are_differences_of_positions(self, folder):
        made = opened(folder).recording("s")
        np.testing.assert_allclose(made.truth[0].velocity, [[10, 0]])
        np.testing.assert_allclose(made.truth[1].velocity, [[10, 0], [0, 10]])
        # Central over .1 to .4 s: 3 m in .3 s; then one-sided.
        np.testing.assert_allclose(made.truth[2].velocity, [[0, 10]])
        np.testing.assert_allclose(made.truth[3].velocity, [[0, 10]])

    def test_an_absent_frame_ends_what_is_differenced(self, folder):
        put(folder / "truth" / "s.csv", "frame,id,x,y\n0,1,0,0\n1,1,1,0\n2,2,9,9\n3,1,7,0\n")
        put(folder / "detections" / "s.csv", "frame,x,y\n2,0,0\n")
        made = opened(folder).recording("s")
        assert [frame.time for frame in made.truth] == [0.0, 0.1, 0.2, 0.3]
        assert [frame.velocity[:, 0].tolist() for frame in made.truth] == [[10], [10], [0], [0]]
        assert [frame.id.tolist() for frame in made.truth] == [[1], [1], [2], [1]]
        assert dict(made.object_name) == {}

    def test_ids_with_leading_zeros_stay_apart(self, folder):
        put(folder / "truth" / "s.csv", "frame,id,x,y\n0,7,0,0\n0,007,1,0\n1,7,0,0\n1,007,1,0\n")
        put(folder / "detections" / "s.csv", "frame,x,y\n0,0,0\n")
        made = opened(folder).recording("s")
        assert dict(made.object_name) == {0: "7", 1: "007"}

    def test_large_ids_and_stamps_keep_their_last_digit(self, folder):
        put(folder / "truth" / "s.csv", f"frame,id,x,y\n0,{2**53 + 1},0,0\n1,{2**53 + 1},1,0\n")
        put(folder / "poses" / "s.csv", f"frame,stamp\n0,{2**53 + 1}\n1,{2**53 + 3}\n")
        put(folder / "detections" / "s.csv", "frame,x,y\n0,0,0\n")
        made = opened(folder).recording("s")
        assert made.truth[0].id.tolist() == [2**53 + 1]
        assert made.stamp.tolist() == [2**53 + 1, 2**53 + 3]

    def test_the_classes_of_table_toml(self, folder):
        put(folder / "table.toml", '[classes]\nsedan = "car"\ncone = "ignored"\n')
        put(
            folder / "truth" / "s.csv",
            "time,id,x,y,class\n0,1,0,0,sedan\n0,2,5,0,truck\n0,3,7,0,cone\n1,1,1,0,sedan\n",
        )
        put(folder / "detections" / "s.csv", "time,x,y,class\n0,0,0,cone\n1,1,0,sedan\n")
        dataset = opened(folder)
        assert dataset.classes == ("car", "truck")
        made = dataset.recording("s")
        assert [frame.label.tolist() for frame in made.truth] == [[0, 1], [0]]
        assert made.truth[0].size[1].tolist() == [14.0, 2.6, 3.5]
        assert [len(seen) for seen in made.detections] == [0, 1]
        only = opened(folder, classes=("truck",)).recording("s")
        assert [frame.id.tolist() for frame in only.truth] == [[2], []]

    def test_boxes_in_the_frame_of_the_ego(self, folder):
        put(folder / "table.toml", 'frame = "ego"\n')
        head = "time,id,x,y,z,yaw,vx,vy\n"
        put(folder / "truth" / "s.csv", head + "0,1,10,1,0.5,0.2,3,0\n1,1,10,1,0.5,0.2,3,0\n")
        put(folder / "detections" / "s.csv", "time,x,y,yaw\n0,10,0,0\n")
        quarter = math.pi / 2
        put(folder / "poses" / "s.csv", f"time,x,y,z,yaw\n0,100,50,2,{quarter}\n1,100,53,2,0\n")
        made = opened(folder).recording("s")
        np.testing.assert_allclose(made.truth[0].position, [[99, 60, 2.5]])
        np.testing.assert_allclose(made.truth[0].yaw, [quarter + 0.2])
        np.testing.assert_allclose(made.truth[0].velocity, [[0, 3]], atol=1e-12)
        np.testing.assert_allclose(made.truth[1].position, [[110, 54, 2.5]])
        np.testing.assert_allclose(made.detections[0].position[0, :2], [100, 60])
        np.testing.assert_allclose(made.detections[0].sensor_pose, [100, 50, quarter])

    def test_a_pose_is_yaw_then_pitch_then_roll(self, folder):
        from scipy.spatial.transform import Rotation

        put(folder / "table.toml", 'frame = "ego"\n')
        put(folder / "truth" / "s.csv", "time,id,x,y,z\n0,1,10,-4,1\n")
        put(folder / "poses" / "s.csv", "time,x,y,z,yaw,pitch,roll\n0,1,2,3,0.7,0.3,-0.2\n")
        put(folder / "detections" / "s.csv", "time,x,y\n0,1,1\n")
        made = opened(folder).recording("s")
        turn = Rotation.from_euler("ZYX", [0.7, 0.3, -0.2]).as_matrix()
        np.testing.assert_allclose(made.truth[0].position[0], turn @ [10, -4, 1] + [1, 2, 3])

    def test_poses_say_what_was_delivered(self, folder):
        put(folder / "poses" / "s.csv", "time,x,delivered\n0,1,1\n0.1,2,0\n0.2,3,true\n0.4,4,\n")
        put(folder / "detections" / "s.csv", "time,x,y\n0,9,9\n")
        made = opened(folder).recording("s")
        assert made.frame.tolist() == [0, 2, 3]
        assert [seen.sensor_pose[0] for seen in made.detections] == [1.0, 3.0, 4.0]

    def test_a_late_delivery_stands_where_it_arrived(self, folder):
        put(folder / "poses" / "s.csv", "time\n0\n0.2\n0.1\n0.4\n")
        made = opened(folder).recording("s")
        assert made.frame.tolist() == [0, 2, 1, 3]
        assert [len(seen) for seen in made.detections] == [1, 1, 1, 0]
        assert made.detections[1].score.tolist() == [0.8]

    def test_the_origin_is_the_row_of_the_named_object(self, folder):
        put(folder / "detections" / "s.csv", "time,x,y,truth_id\n0.1,5,5,b\n0.1,99,0,\n0.4,5,8,b\n")
        made = opened(folder).recording("s")
        assert [rows.tolist() for rows in made.origin] == [[], [1, CLUTTER], [], [0]]


def exported(tmp_path, name, *options, form="csv"):
    assert pmbm("export", name, "--format", form, "--out", tmp_path / "logs", *options) == 0
    return tmp_path / "logs"


@pytest.mark.parametrize("form", ["csv", "parquet"])
@pytest.mark.parametrize("name", ["frames_late", "frames_dropped", "ego_motion", "empty_clutter"])
def test_an_exported_scenario_comes_back_bit_for_bit(tmp_path, name, form):
    scenario = load_scenario(name)
    level = scenario.levels[-1]
    logs = exported(tmp_path, name, "--seed", 5, "--level", level, form=form)
    (sequence,) = open_dataset("table", root=logs).sequences()
    there = [path.relative_to(logs).parts[0] for path in sorted(logs.glob(f"*/*.{form}"))]
    assert there == ["detections", "poses", "truth"]
    made = opened(logs).recording(sequence)
    assert made.digest() == scenario.record(5, level=level).digest()


def test_a_frame_that_two_deliveries_are_of(tmp_path):
    made = load_scenario("crossing").record(1)
    import dataclasses

    twice = dataclasses.replace(
        made,
        detections=(*made.detections[:3], made.detections[1].take([0]), *made.detections[3:]),
        frame=np.insert(made.frame, 3, 1),
        origin=(*made.origin[:3], made.origin[1][:1], *made.origin[3:]),
    )
    tables = twice.to_tables()
    assert "delivery" in tables["detections"]
    assert Recording.from_tables(tables, site=made.site).digest() == twice.digest()
    without = {**tables, "detections": tables["detections"].drop(columns="delivery")}
    with pytest.raises(InputError, match="one of several") as error:
        Recording.from_tables(without)
    assert error.value.rows == (len(made.detections[0]),)


def scored(made, tracker, rule, trial):
    """The cars of a recording by a rule, its tracks made and judged in memory."""
    tracks = tracked(f"crossing-3-{trial}", made, {Label.CAR: tracker}, "online")
    compared = ComparedSequence(
        truth=tuple(frame.take(np.argsort(frame.id)) for frame in made.truth),
        tracks=tuple(step.take(np.argsort(step.id)) for step in tracks),
        excused=np.zeros(sum(map(len, tracks)), bool),
    )
    return rule.score(compared, "car")


TWO_SENSORS = """
name = "two_sensors"
stresses = "a lidar and a radar on a mast, of two rates"
duration = 2.0
[scene]
kind = "scripted"
tracks.a = { start = [10.0, 3.0], speed = 5.0 }
tracks.b = { start = [30.0, -3.0], speed = 8.0, yaw_deg = 180.0 }
[sensors.lidar]
mount = [1.0, 0.0, 0.0]
[sensors.radar]
rate = 5
latency = 0.1
fov_deg = 90.0
detector = { profile = "radar" }
"""


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_several_sensors_come_back_bit_for_bit(tmp_path, form):
    put(tmp_path / "two.toml", TWO_SENSORS)
    made = load_scenario(tmp_path / "two.toml").record(1)
    assert {delivery.sensor for delivery in made.detections} == {"lidar", "radar"}
    assert any(delivery.radial_velocity is not None for delivery in made.detections)
    logs = exported(tmp_path, tmp_path / "two.toml", "--seed", 1, form=form)
    back = opened(logs).recording("two_sensors-1-0")
    assert back.digest() == made.digest()
    assert dict(back.site.sensor("radar").__dict__).keys() == made.site.sensors[0].__dict__.keys()
    for name in ("lidar", "radar"):
        for own, other in zip(made.observable_by[name], back.observable_by[name], strict=True):
            assert own.tolist() == other.tolist()
    # What a table of detections without numbers of deliveries means.
    tables = made.to_tables()
    assert "delivery" not in tables["detections"]
    assert Recording.from_tables(tables, site=made.site).digest() == made.digest()


class TestCommands:
    @pytest.mark.parametrize("form", ["csv", "parquet"])
    def test_track_and_evaluate(self, tmp_path, form, capsys):
        logs = exported(tmp_path, "crossing", "--seed", 3, "--trials", 2, form=form)
        dets, out = ("--detections", logs / "detections"), tmp_path / "out"
        assert pmbm("track", "table", "--root", logs, *dets, "--out", out) == 0
        assert sorted(p.name for p in out.iterdir()) == [f"crossing-3-{t}.{form}" for t in (0, 1)]
        capsys.readouterr()
        assert pmbm("evaluate", "table", "--root", logs, "--results", out, "--json", "-") == 0
        import json

        figures = json.loads(capsys.readouterr().out)["scores"]["car"]["all"]
        assert figures["MOTA"] > 0.9
        # By another road: nothing written, nothing read.
        rule = opened(logs).rules["bev"]
        car = ConfiguredTracker("pmbm", ())
        alone = [scored(load_scenario("crossing").record(3, t), car, rule, t) for t in (0, 1)]
        assert rule.figures(alone) == figures

    def test_compare_tune_and_fits(self, tmp_path, capsys):
        logs = exported(tmp_path, "crossing", "--trials", 2)
        given = ("--root", logs, "--detections", logs / "detections")
        trackers = ("--trackers", "pmbm", "argoverse", "clairvoyant")
        assert pmbm("compare", "table", *given, *trackers) == 0
        assert "| clairvoyant |" in capsys.readouterr().out
        space = tmp_path / "space.toml"
        space.write_text('"reduction.gate" = [10.0, 20.0]\n')
        search = ("--tracker", "pmbm", "--class", "car", "--space", space, "--trials", 2, "--fit")
        options = (*given, *search, "--out", tmp_path / "car.toml")
        assert pmbm("tune", "--dataset", "table", *options) == 0
        assert "[car" in (tmp_path / "car.toml").read_text()
        fit = ("--trials", 1, "--refits", 1, "--no-realism", "--out", tmp_path / "fit")
        assert pmbm("fit-detector", "table", *given, *fit) == 0
        assert (tmp_path / "fit" / "fitted.toml").exists()

    def test_a_study_over_logs(self, tmp_path):
        exported(tmp_path, "crossing", "--seed", 3, "--trials", 2)
        put(tmp_path / "own.toml", 'dataset = "table"\nroot = "logs"\n'
            'detections = "logs/detections"\n')  # fmt: skip
        put(tmp_path / "study.toml", 'scenarios = ["own.toml"]\ntrials = 2\nmetrics = ["gospa"]\n')
        store = tmp_path / "study.sqlite"
        assert pmbm("study", tmp_path / "study.toml", "--store", store) == 0
        source = named_dataset(str(tmp_path / "own.toml"))
        assert source.record(0, 1).digest() == load_scenario("crossing").record(3, 1).digest()
        with pytest.raises(InputError, match="a sequence a trial"):
            source.record(0, 2)
        assert with_origins(source.record(0)).origin is not None

    def test_logs_that_are_swept_or_unknown_are_refused(self, tmp_path):
        from pmbm.cli.sources import resolve

        logs = exported(tmp_path, "crossing")
        own = tmp_path / "own.toml"
        put(own, 'dataset = "table"\nroot = "logs"\n')
        put(tmp_path / "s.toml", 'scenarios = ["own.toml"]\n[sweep.grid]\nlevel = [1, 2]\n')
        with pytest.raises(InputError, match="neither be swept"):
            load_study(tmp_path / "s.toml", resolve)
        for text, said in (
            ('dataset = "table"\nroots = "logs"\n', "did you mean 'root'?"),
            ('dataset = "tabel"\nroot = "logs"\n', "did you mean 'table'?"),
            ('dataset = "table"\nroot = "logs"\nsequences = ["x"]\n', "no sequence 'x'"),
            ('dataset = "table"\nroot = 3\n', "expected a text, got 3"),
        ):
            put(own, text)
            with pytest.raises(InputError, match=said.replace("?", "\\?")) as error:
                named_dataset(str(own))
            assert error.value.file == str(own)
        assert dataset_source(own, {"dataset": "table", "root": str(logs)}).trials

    def test_export_of_a_dataset(self, tmp_path):
        sample = Path(__file__).parents[1] / "data" / "kitti"
        given = ("--root", sample / "training", "--detections", sample / "detections_ab3dmot")
        logs = exported(tmp_path, "kitti", *given, "--sequences", "0000")
        real = open_dataset("kitti", root=given[1], detections=str(given[3])).recording("0000")
        back = opened(logs).recording("0000")
        assert back.digest() == real.digest()

    def test_options_that_do_not_concern_the_source(self, tmp_path, capsys):
        out = ("--out", tmp_path)
        assert pmbm("export", "crossing", "--root", tmp_path, *out) == 2
        assert "takes no such option (field --root)" in capsys.readouterr().err
        assert pmbm("export", "kitti", "--root", tmp_path, "--seed", 1, *out) == 2
        assert "takes no such option (field --seed)" in capsys.readouterr().err
        exported(tmp_path, "crossing")
        assert pmbm("export", "ego_motion", "--out", tmp_path / "logs") == 2
        assert "tables of another site" in capsys.readouterr().err

    def test_submit_says_that_there_is_nothing_to_hand_in(self, folder, capsys):
        assert pmbm("submit", "table", "--root", folder, "--results", folder) == 2
        assert "of no benchmark" in capsys.readouterr().err


def tracks_of(made, *frames):
    """A track on the first detection of each of these frames."""
    steps = []
    for frame in frames:
        seen = made.detections[frame].take([0])
        steps.append(
            Tracks(time=seen.time, id=[4], position=seen.position, size=seen.size, yaw=seen.yaw,
                   velocity=np.zeros((1, 2)), score=seen.score, label=seen.label)
        )  # fmt: skip
    return TrackSequence(steps=steps, frame=np.array(frames))


class TestResults:
    @pytest.mark.parametrize("frame", ["world", "ego"])
    def test_what_was_written_is_read(self, folder, tmp_path, frame):
        put(folder / "table.toml", f'frame = "{frame}"\n')
        put(
            folder / "poses" / "s.csv",
            "time,x,y,yaw\n0,5,1,2\n0.1,6,1,2.1\n0.2,7,2,3\n0.4,7,3,-3\n",
        )
        dataset = opened(folder)
        tracks = tracks_of(dataset.recording("s"), 0, 2)
        assert dataset.write("s", tracks, tmp_path / "out") == tmp_path / "out" / "s.csv"
        back = dataset.read("s", tmp_path / "out")
        assert [step.id.tolist() for step in back] == [[4], [], [4], []]
        for step, own in ((0, tracks[0]), (2, tracks[1])):
            np.testing.assert_allclose(back[step].position, own.position, rtol=1e-14)
            np.testing.assert_allclose(back[step].yaw, own.yaw, atol=1e-14)
            np.testing.assert_allclose(back[step].velocity, own.velocity, atol=1e-14)
            assert back[step].score.tolist() == own.score.tolist()

    def test_tracks_in_frames_without_truth_count_as_false(self, folder, tmp_path):
        put(tmp_path / "out" / "s.csv", "time,id,x,y\n0,1,10,0\n0.1,1,11,0\n0.3,1,12,0\n")
        dataset = open_dataset("table", root=folder)
        compared = dataset.compared("s", "other", tmp_path / "out")
        assert [len(step) for step in compared.tracks] == [1, 1, 0, 1, 0]
        assert [len(frame) for frame in compared.truth] == [1, 2, 1, 0, 1]
        rule = dataset.rules["bev"]
        figures = rule.figures([rule.score(compared, "other")])
        assert (figures["FP"], figures["FN"]) == (1, 3)

    @pytest.mark.parametrize(
        ("text", "said", "lines"),
        [
            ("time,id,x,y\n0,-1,1,1\n", "negative ids", (2,)),
            (
                "time,id,x,y,score\n0,1,1,1,1.5\n",
                "expected a number at least 0 and at most 1",
                (2,),
            ),
            ("time,id,x,y\n0,1,1,1\n\n0,1,2,2\n", "the same id twice", (2, 4)),
            ("time,x,y\n0,1,1\n", "a column is missing", ()),
        ],
    )
    def test_bad_results(self, folder, tmp_path, text, said, lines):
        put(tmp_path / "out" / "s.csv", text)
        with pytest.raises(InputError, match=said) as error:
            opened(folder).compared("s", "other", tmp_path / "out")
        assert error.value.file == str(tmp_path / "out" / "s.csv")
        assert error.value.rows == lines

    def test_a_track_of_another_class(self, folder, tmp_path):
        dataset = opened(folder, classes=("car",))
        with pytest.raises(InputError, match="not asked for"):
            dataset.write("s", tracks_of(opened(folder).recording("s"), 0), tmp_path)


BAD = [
    # file, text, field, lines, what is said
    ("truth", "time,id,x,y\n0,1,1,1\n1,1,abc,1\n", "x", [3], "got 'abc'"),
    ("truth", "time,id,x,y\n0,1,1,1\n\n1,1,,1\n", "x", [4], "an empty cell"),
    ("truth", "time,id,x,y\n0,1,1,nan\n", "y", [2], "expected a number"),
    ("truth", "time,id,x,y\n0,1,1,inf\n", "y", [2], "got inf"),
    ("truth", "time,id,x,y\n0,1,1,NA\n", "y", [2], "got 'NA'"),
    ("truth", "time,id,x,y\n0,1,1,2e8\n", "y", [2], "at most 1e+08"),
    ("truth", "time,id,x,y,width\n0,1,1,2,0\n", "width", [2], "above 0 and at most 1000, m"),
    ("truth", "time,id,x,y,lenght\n0,1,1,2,4\n", "lenght", [], "did you mean 'length'?"),
    ("truth", "time,id,x,x\n0,1,1,2\n", "x", [], "given twice"),
    ("truth", "time,id,x\n0,1,1\n", "y", [], "a column is missing"),
    ("truth", "id,x,y\n1,1,1\n", "time", [], "time or frame"),
    ("truth", "time,id,x,y\n0,1,1\n", None, [2], "expected 4, as there are columns, got 3"),
    ("truth", "time;id;x;y\n0;1;1;1\n", None, [], "set apart by commas"),
    ("truth", "time,id,x,y\n0,1,1,1\n0,2,1,1\n0,1,2,2\n", "id", [2, 4], "twice in a frame"),
    ("truth", "time,id,x,y\n0,,1,1\n", "id", [2], "an empty cell"),
    ("truth", "time,id,x,y,class\n0,1,1,1,carr\n", "class", [2], "did you mean 'car'?"),
    ("truth", "time,id,x,y,visibility\n0,1,1,1,1.1\n", "visibility", [2], "at most 1"),
    ("truth", "time,id,x,y,crashed\n0,1,1,1,yes\n", "crashed", [2], "true, false, 1 or 0"),
    ("truth", "time,id,x,y,crashed\n0,1,1,1,2\n", "crashed", [2], "true, false, 1 or 0"),
    ("truth", "frame,id,x,y\n0.5,1,1,1\n", "frame", [2], "a whole number"),
    ("truth", "frame,id,x,y\nx,1,1,1\n", "frame", [2], "a whole number"),
    ("truth", "frame,id,x,y\n1,1,1,1\n,1,1,1\n", "frame", [3], "every row's frame"),
    ("truth", "frame,id,x,y\n99999999999999999999,1,1,1\n", "frame", [2], "a whole number"),
    ("truth", "time,id,x,y\n1766000000000000000,1,1,1\n", "time", [2], "at most 9e+09, s"),
    ("truth", "", None, [], "an empty file"),
    ("truth", "\x00\xff\n", "\x00\xff", [], "unknown column"),
    ("detections", "time,x,y,score\n0,1,1,-.1\n", "score", [2], "at least 0 and at most 1"),
    ("detections", "time,x,y,sensor\n0,1,1,a\n0,1,1,b\n", "sensor", [3], "poses that name none"),
    ("detections", "time,x,y,radial_velocity\n0,1,1,3\n", "radial_velocity", [2], "vx, vy in"),
    ("detections", "time,x,y,raw_score\n0,1,1,3\n0,1,1,\n", "raw_score", [3], "or in none"),
    ("detections", "time,x,y,truth_id\n0,1,1,zz\n", "truth_id", [2], "no such object"),
    ("detections", "frame,x,y\n0,1,1\n", "time", [], "cannot be joined"),
    ("poses", "time\n0\n0.1\n0.2\n", "time", [6], "a time that is no frame's"),
    ("poses", "time,delivered\n0,1\n0.1,0\n0.2,1\n0.4,1\n", "delivery", [4], "of no delivery"),
    ("poses", "time,delivered\n0,1\n0,0\n0.1,1\n0.2,1\n0.4,1\n", "delivered", [3], "and is not"),
    ("poses", "time,roll\n0,3\n", "roll", [2], "at most 1.4"),
]


@pytest.mark.parametrize(("what", "text", "field", "lines", "said"), BAD)
def test_bad_tables(folder, what, text, field, lines, said):
    put(folder / what / "s.csv", text)
    error = problem(folder, **({"detections": None} if text.startswith("frame,id") else {}))
    assert said in str(error)
    assert "\n" not in str(error)
    where = {"detections": "detections", "truth": "truth", "poses": "poses"}[what]
    if field != "time" or what != "poses" or lines != [6]:
        if said not in ("cannot be joined", "of no delivery"):
            assert error.file == str(folder / where / "s.csv")
        assert list(error.rows) == lines
    else:
        # It is the row of truth that belongs to no frame.
        assert error.file == str(folder / "truth" / "s.csv")
        assert list(error.rows) == lines
    assert error.field == field


def test_times_that_nearly_agree_are_no_frames_of_their_own(folder):
    text = DETECTIONS.replace("0.2,5.1", "0.2004,5.1")
    put(folder / "detections" / "s.csv", text)
    assert "nearly agree" in str(problem(folder))
    # Numbers of frames settle it; then a time that fits another frame is refused.
    put(folder / "truth" / "s.csv", "frame,time,id,x,y\n0,0,1,0,0\n1,.1,1,1,0\n2,.2,1,2,0\n")
    put(folder / "detections" / "s.csv", "frame,time,x,y\n0,0,0,0\n2,.2004,2,0\n")
    made = opened(folder).recording("s")
    assert [seen.time for seen in made.detections] == [0.0, 0.1, 0.2004]
    put(folder / "detections" / "s.csv", "frame,time,x,y\n0,0,0,0\n1,.2,2,0\n")
    assert "the time of another frame" in str(problem(folder))


def test_a_file_that_is_not_ended_is_warned_of(folder):
    put(folder / "truth" / "s.csv", TRUTH.rstrip("\n"))
    with pytest.warns(InputWarning, match="cut short"):
        opened(folder).recording("s")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('frame = "body"', '"world" or "ego"'),
        ("rate = 0", "frames a second"),
        ("rates = 1", "did you mean 'rate'?"),
        ('[classes]\nx = "carr"', "did you mean 'car'?"),
        ("[site]\nmax_rnge = 1", "did you mean 'max_range'?"),
        ("[site]\nmax_range = -1", "above 0"),
        ("[site", "not valid TOML"),
        ('frame = "ego"', "need poses"),
        ("ignored_columns = 3", "a list of names"),
    ],
)
def test_bad_settings(folder, text, said):
    put(folder / "table.toml", text + "\n")
    assert said in str(problem(folder))


def test_ignored_columns_and_missing_tables(folder):
    rows = [line.split(",") for line in TRUTH.split()]
    put(folder / "truth" / "s.csv", "".join(",".join([*r, "note"]) + "\n" for r in rows))
    assert problem(folder).field == "note"
    put(folder / "table.toml", 'ignored_columns = ["note"]\n')
    assert len(opened(folder).recording("s")) == 4
    with pytest.raises(InputError, match="did you mean 's'"):
        opened(folder).recording("ss")
    (folder / "detections" / "s.csv").unlink()
    with pytest.raises(InputError, match="no such table"):
        opened(folder).recording("s")
    (folder / "truth" / "s.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="two tables of one sequence"):
        opened(folder).recording("s")
    (folder / "truth" / "s.csv").unlink()
    with pytest.raises(InputError, match="not a readable table"):
        open_dataset("table", root=folder).recording("s")


def test_rows_of_parquet_count_from_0(folder):
    (folder / "truth" / "s.csv").unlink()
    table = pd.DataFrame({"time": [0.0, 0.1], "id": [1, 1], "x": [0.0, np.inf], "y": [0.0, 0.0]})
    table.to_parquet(folder / "truth" / "s.parquet")
    error = problem(folder)
    assert (error.rows, error.field) == ((1,), "x")


def test_a_folder_named_like_a_column_adds_none(folder):
    """Datasets of many files may have folders such as class=car for columns; a table has not."""
    logs = folder / "class=truck"
    put(logs / "truth" / "none", "")
    table = pd.DataFrame({"time": [0.0], "id": [1], "x": [0.0], "y": [0.0]})
    table.to_parquet(logs / "truth" / "s.parquet")
    made = open_dataset("table", root=logs).recording("s")
    assert made.truth[0].label.tolist() == [Label.OTHER]


class TestFrames:
    """`Recording.from_tables`: DataFrames of a user's own."""

    def test_cells_of_several_kinds(self):
        truth = pd.DataFrame({"time": [0.0, 1.0], "id": [1, 1], "x": [0.0, "a"], "y": [0.0, 0.0]})
        with pytest.raises(InputError, match="truth: ") as error:
            Recording.from_tables({"truth": truth})
        assert error.value.field == "x"

    def test_an_unknown_table(self):
        with pytest.raises(InputError, match="did you mean 'truth'"):
            Recording.from_tables({"trth": pd.DataFrame()})

    def test_ids_beside_empty_cells(self):
        """pandas turns whole numbers into floats where a cell is empty."""
        truth = pd.DataFrame({"frame": [0, 1], "id": [3, 3], "x": [0.0, 1.0], "y": [0.0, 0.0]})
        seen = pd.DataFrame(
            {"frame": [0, 1], "x": [0.0, 1.0], "y": [0.0, 0.0], "truth_id": [3, None]}
        )
        made = Recording.from_tables({"truth": truth, "detections": seen}, rate=2.0)
        assert [rows.tolist() for rows in made.origin] == [[0], [CLUTTER]]
        assert made.truth[1].time == 0.5

    def test_half_precision(self):
        truth = pd.DataFrame({"time": [0.0], "id": [3], "x": np.float16([0]), "y": [0.0]})
        with pytest.raises(InputError, match="half precision"):
            Recording.from_tables({"truth": truth})


def test_the_page_names_every_column():
    page = (Path(__file__).parents[2] / "docs" / "guide" / "tables.md").read_text()
    for what, columns in COLUMNS.items():
        part = page.partition(f"### {what}\n")[2].partition("\n### ")[0]
        rows = [
            [cell.strip() for cell in line.strip("|").replace(f"`{name}`", name, 1).split("|")]
            for line in part.splitlines()
            if (name := line.removeprefix("| `").partition("`")[0]) != line
            and line.startswith("| `")
        ]
        expected = [[c.name, c.unit, c.default, c.meaning] for c in columns]
        assert rows == expected, what
