"""Files that were scored wrongly, or refused though the benchmark's own tools take them, and the
right value of each: tests/data/cases."""

import copy
import json
import re
import shutil
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from pmbm.cli import main
from pmbm.cli.sources import resolve
from pmbm.cli.track import read_toml
from pmbm.datasets import open_dataset
from pmbm.datasets.waymo_files import OBJECTS, decoded
from pmbm.datasets.wire import encode, message, numbered
from pmbm.errors import InputError, InputWarning
from pmbm.score import ScoreModel
from pmbm.sim import load_scenario
from pmbm.study.file import load_study
from pmbm.types import Label, Tracks, TrackSequence

DATA = Path(__file__).parents[1] / "data"
CASES = DATA / "cases"
LOG = "00000000-1111-2222-3333-444444444444"
SEGMENT = "1234567890123456789_100_000_120_000"
MARK = b"\xef\xbb\xbf"


def pmbm(*arguments):
    """The exit code."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return stop.value.code


def evaluate(capsys, dataset, root, results, kind, *options):
    """What `pmbm evaluate` says of one class: its JSON and the table's text."""
    words = ("evaluate", dataset, "--root", root, "--results", results, "--classes", kind, *options)
    assert pmbm(*words, "--json", "-") == 0, capsys.readouterr().err
    document = json.loads(capsys.readouterr().out)
    assert pmbm(*words) == 0
    return document, capsys.readouterr().out


def figures(capsys, dataset, root, results, kind, *options):
    document, _ = evaluate(capsys, dataset, root, results, kind, *options)
    return document["scores"][kind]["all"]


def refused(capsys, *arguments):
    """The one line."""
    assert pmbm(*arguments) == 2
    text = capsys.readouterr().err
    (line,) = [line for line in text.splitlines() if line.startswith("pmbm: ")]
    return line


def has(scores, **expected):
    assert {key: scores[key] for key in expected} == {
        key: pytest.approx(value, abs=1e-4) for key, value in expected.items()
    }


class TestWaymoWithoutPoints:
    """The first of two cars has no lidar point in any frame."""

    ROOT = CASES / "waymo_zero_points"

    def test_is_not_considered(self, capsys):
        document, text = evaluate(
            capsys, "waymo", self.ROOT / "v2", self.ROOT / "results", "VEHICLE"
        )
        has(document["scores"]["VEHICLE"]["all"], MOTA=1.0, GT=3, FP=0.0, misses=0.0)
        assert "-0.0" not in text

    def test_is_not_observable(self):
        dataset = open_dataset("waymo", root=self.ROOT / "v2", classes=("VEHICLE",))
        made = dataset.recording(SEGMENT)
        assert [sorted(f.observable.tolist()) for f in made.truth] == [[False, True]] * 3

    def test_a_metrics_objects_file_is_taken_as_it_is(self, tmp_path, capsys):
        """As the official tool takes it, whatever its number of points."""
        source = DATA / "waymo" / "gt.bin"
        scores = figures(capsys, "waymo", source, DATA / "waymo" / "tracks.bin", "VEHICLE")
        content = decoded(source)
        for one in content["objects"]:
            one["object"]["num_lidar_points_in_box"] = 0
        (tmp_path / "gt.bin").write_bytes(encode(content, _with_points()))
        again = figures(
            capsys, "waymo", tmp_path / "gt.bin", DATA / "waymo" / "tracks.bin", "VEHICLE"
        )
        assert again == scores
        assert scores["GT"] > 0


def _with_points():
    """metrics.Objects with the field of a label that holds its number of lidar points."""
    item = OBJECTS[1].fields
    label = {**item[1].fields, **numbered(num_lidar_points_in_box=(7, "int"))}
    return {1: message("objects", {**item, 1: message("object", label)}, repeated=True)}


class TestKittiWithoutImageBoxes:
    ROOT = CASES / "kitti_no_image_box"
    TRUTH = ROOT / "training"

    @pytest.mark.parametrize("rule", ["iou3d", "bev", "devkit"])
    @pytest.mark.parametrize("filler", ["nobox_ghost", "zero_ghost"])
    def test_a_filler_excuses_nothing(self, capsys, rule, filler):
        """As with image boxes: three ghosts are false, and the one object is found."""
        options = ("Car", "--rule", rule)
        boxed = figures(capsys, "kitti", self.TRUTH, self.ROOT / "results_box_ghost", *options)
        bare = figures(capsys, "kitti", self.TRUTH, self.ROOT / f"results_{filler}", *options)
        has(boxed, MOTA=0.0, FP=3, FN=0)
        assert bare == boxed

    def test_the_image_box_is_that_of_the_3d_box(self):
        dataset = open_dataset("kitti", root=self.TRUTH)
        compared = dataset.compared("0000", "Car", self.ROOT / "results_nobox")
        # Written out: the corners of 4.0 x 1.62 x 1.53 m at (1.22, 1.71, 22.1), turned -1.56 rad,
        # through f = 700, centre (600, 180).
        along = np.array([1, 1, -1, -1]) * 2.0
        across = np.array([1, -1, -1, 1]) * 0.81
        x = 1.22 + along * np.cos(-1.56) + across * np.sin(-1.56)
        z = 22.1 - along * np.sin(-1.56) + across * np.cos(-1.56)
        left, right = (600 + 700 * x / z).min(), (600 + 700 * x / z).max()
        top, bottom = 180 + 700 * (1.71 - 1.53) / z.min(), 180 + 700 * 1.71 / z.min()
        top = min(top, 180 + 700 * (1.71 - 1.53) / z.max())
        np.testing.assert_allclose(compared.tracks_image[0], [left, top, right, bottom])

    def test_what_the_image_does_not_show_is_excused(self, tmp_path, capsys):
        """No label is there to tell whether it is false."""
        shutil.copytree(self.ROOT / "results_nobox_ghost", tmp_path / "results")
        path = tmp_path / "results" / "0000.txt"
        path.write_text(re.sub(r"-6\.0 1\.71 \d\S*", "-6.0 1.71 -9.0", path.read_text()))
        has(figures(capsys, "kitti", self.TRUTH, path.parent, "Car"), MOTA=1.0, FP=0)

    def test_a_fit_sees_the_clutter(self):
        dataset = open_dataset("kitti", root=self.TRUTH, detections=str(self.ROOT / "detections"))
        assert [flags.tolist() for flags in dataset.unjudged("0000")] == [[False, False]] * 3

    def test_submit_refuses_them(self, tmp_path, capsys):
        shutil.copytree(self.ROOT / "results_nobox", tmp_path / "results")
        line = refused(capsys, "submit", "kitti", "--root", self.TRUTH,
                       "--results", tmp_path / "results")  # fmt: skip
        assert "without an image box" in line
        assert "frame 0, object 3" in line
        assert not (tmp_path / "results" / "submission.zip").exists()

    def test_image_boxes_alone_are_for_the_rule_that_compares_them(self, tmp_path, capsys):
        flat, zeros = self.ROOT / "results_2d_only", self.ROOT / "results_2d_zeros"
        found = figures(capsys, "kitti", self.TRUTH, flat, "Car", "--rule", "iou2d")
        has(found, MOTA=1.0, GT=3, FP=0, FN=0)
        found = figures(capsys, "kitti", self.TRUTH, zeros, "Car", "--rule", "iou2d")
        has(found, MOTA=1 / 3, GT=3, FP=0, FN=2)
        for rule in ("iou3d", "bev", "devkit"):
            line = refused(capsys, "evaluate", "kitti", "--root", self.TRUTH, "--results", flat,
                           "--rule", rule, "--classes", "Car")  # fmt: skip
            assert "without a 3D box" in line
            assert "--rule iou2d" in line
        with pytest.raises(InputError, match=r"without a 3D box.*frame 0, object 3"):
            open_dataset("kitti", root=self.TRUTH).read("0000", flat)
        shutil.copytree(flat, tmp_path / "results")
        assert pmbm("submit", "kitti", "--root", self.TRUTH, "--results", tmp_path / "results") == 0

    def test_neither_box_is_nothing(self, tmp_path):
        (tmp_path / "0000.txt").write_text("0 3 Car -1 -1 -10 -1 -1 -1 -1 -1 -1 -1 0 0 0 0 0.9\n")
        with pytest.raises(InputError, match="neither an image box nor a 3D box"):
            open_dataset("kitti", root=self.TRUTH).results("0000", tmp_path)


class TestKittiRows:
    ROOT = CASES / "kitti_odd_rows"

    @pytest.mark.parametrize(
        "variant", ["plain", "float_id_frame_occluded", "no_score", "lower_case", "dontcare_rows"]
    )
    def test_what_the_benchmark_s_readers_take(self, capsys, variant):
        found = figures(capsys, "kitti", self.ROOT / "training", self.ROOT / variant, "Car")
        plain = figures(capsys, "kitti", self.ROOT / "training", self.ROOT / "plain", "Car")
        has(found, MOTA=1.0, FP=0)
        assert found == plain

    def test_a_row_of_no_track_is_passed_over(self, tmp_path, capsys):
        text = (self.ROOT / "plain" / "0000.txt").read_text()
        extra = text.splitlines()[1].replace("1 3 Car", "1 -1 Car")
        (tmp_path / "0000.txt").write_text(f"{text}{extra}\n")
        has(figures(capsys, "kitti", self.ROOT / "training", tmp_path, "Car"), MOTA=1.0, FP=0)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("1 3 Car", "1 -2 Car", "track_id.*at least -1"),
            ("1 3 Car", "1 3.5 Car", "not an integer.*track_id"),
            ("1 3 Car", "1 1e300 Car", "not an integer.*track_id"),
            (" 21.8 -1.56 9.8", " 21.8 -1.56", "wrong length.*expected 18, got 17"),
            (" 21.8 -1.56 9.8", " 21.8", "wrong length.*expected 18, got 16"),
        ],
    )
    def test_what_means_nothing_is_refused(self, tmp_path, old, new, message):
        text = (self.ROOT / "plain" / "0000.txt").read_text()
        assert old in text
        (tmp_path / "0000.txt").write_text(text.replace(old, new))
        with pytest.raises(InputError, match=message):
            open_dataset("kitti", root=self.ROOT / "training").results("0000", tmp_path)

    def test_a_file_without_its_last_line_end_is_doubted(self, tmp_path, capsys):
        """Cut inside its last number, 9.8, or just behind it, it is a right table."""
        good = (self.ROOT / "plain" / "0000.txt").read_bytes()
        words = ("evaluate", "kitti", "--root", self.ROOT / "training", "--results", tmp_path)
        for cut, doubted in ((0, False), (1, True), (3, True)):
            (tmp_path / "0000.txt").write_bytes(good[: len(good) - cut])
            with warnings.catch_warnings():
                warnings.simplefilter("default")
                assert pmbm(*words, "--classes", "Car") == 0
            said = capsys.readouterr().err
            assert ("pmbm: warning: no line end at the end of the file" in said) == doubted
        # Read already, it is not doubted again.
        (tmp_path / "0000.txt").write_bytes(good[:-1])
        with pytest.warns(InputWarning, match=r"cut short.*0000\.txt"):
            open_dataset("kitti", root=self.ROOT / "training").results("0000", tmp_path)

    def test_the_devkit_looks_at_the_last_frame_afterwards(self, capsys):
        """Matched in its last frame alone, an object has a fragmentation by the devkit."""
        options = ("kitti", self.ROOT / "training", self.ROOT / "last_frame_only", "Car")
        has(figures(capsys, *options, "--rule", "devkit"), FRAG=1, FN=2)
        has(figures(capsys, *options), FRAG=0)


@pytest.mark.parametrize("numbers", ["decimal", "integer"])
def test_half_an_overlap_is_enough_for_ignored_truth(capsys, numbers):
    """IoU of 1/2 in real numbers, of .49999999999999983 in doubles where they are decimal."""
    root = CASES / "kitti_half_iou" / numbers
    found = figures(capsys, "kitti", root / "training", root / "results", "Car", "--rule", "iou2d")
    has(found, MOTA=1.0, FP=0, GT=3)


def test_a_table_of_rows_says_empty_by_no_row(tmp_path, capsys):
    root = DATA / "argoverse2" / "val"
    found = figures(capsys, "argoverse2", root, CASES / "av2_empty_frame", "REGULAR_VEHICLE")
    has(found, GT=3, FN=1, FP=0, MOTA=2 / 3)
    tracks = open_dataset("argoverse2", root=root).read(LOG, CASES / "av2_empty_frame")
    assert sorted(len(step) for step in tracks) == [0, 2, 2]
    assert tracks.frame.tolist() == [0, 1, 2]
    _stamped(tmp_path, lambda stamp: stamp + 1)
    line = refused(capsys, "evaluate", "argoverse2", "--root", root, "--results", tmp_path)
    assert "not annotated" in line


def _stamped(folder, change):
    """The case's results with other time stamps."""
    import pyarrow
    import pyarrow.feather

    name = f"{LOG}.feather"
    table = pyarrow.feather.read_table(str(CASES / "av2_empty_frame" / name))
    columns = table.to_pydict()
    columns["timestamp_ns"] = [change(stamp) for stamp in columns["timestamp_ns"]]
    pyarrow.feather.write_feather(pyarrow.table(columns), str(folder / name))


def test_a_sweep_without_detections_is_a_frame(tmp_path, capsys):
    """Tracked without truth and written, it is there, and the results are scored."""
    import pyarrow.feather

    root = DATA / "argoverse2" / "val"
    table = pyarrow.feather.read_table(str(DATA / "argoverse2" / "detections.feather"))
    stamps = np.array(table.column("timestamp_ns").to_pylist())
    second = np.unique(stamps)[1]
    file = tmp_path / "detections.feather"
    pyarrow.feather.write_feather(table.filter((stamps != second).tolist()), str(file))
    dataset = open_dataset("argoverse2", root=root, detections=str(file))
    made = dataset.recording(LOG, truth=False)
    assert [len(seen) for seen in made.detections] == [2, 0, 2]
    assert made.stamp.tolist() == dataset.recording(LOG).stamp.tolist()
    nothing = TrackSequence(
        steps=[Tracks.empty(frame.time) for frame in made.truth], frame=np.arange(3)
    )
    dataset.write(LOG, nothing, tmp_path / "out")
    found = figures(capsys, "argoverse2", root, tmp_path / "out", "PEDESTRIAN")
    has(found, GT=3, FN=3, FP=0)


def test_columns_of_half_precision_are_refused(tmp_path):
    import pyarrow
    import pyarrow.feather

    name = f"{LOG}.feather"
    table = pyarrow.feather.read_table(str(CASES / "av2_empty_frame" / name))
    for dtype, good in ((pyarrow.float32(), True), (pyarrow.float16(), False)):
        place = table.schema.get_field_index("tx_m")
        values = pyarrow.array(np.array(table.column("tx_m"), dtype.to_pandas_dtype()), type=dtype)
        pyarrow.feather.write_feather(table.set_column(place, "tx_m", values), str(tmp_path / name))
        dataset = open_dataset("argoverse2", root=DATA / "argoverse2" / "val")
        if good:
            assert len(dataset.read(LOG, tmp_path)) == 3
        else:
            message = "half precision.*tx_m.*expected float32 or float64, got float16"
            with pytest.raises(InputError, match=message):
                dataset.read(LOG, tmp_path)


class TestOneFileForAll:
    ROOT = DATA / "nuscenes" / "v1.0-mini"
    FOLDER = CASES / "nuscenes_one_file" / "one_file_for_all"

    def test_nuscenes(self, tmp_path, capsys):
        file = self.FOLDER / "tracking_result.json"
        shutil.copy(file, tmp_path / "scene-0001.json")
        each = figures(capsys, "nuscenes", self.ROOT, tmp_path, "car")
        has(each, AMOTA=1.0, GT=3)
        for results in (self.FOLDER, file):
            assert figures(capsys, "nuscenes", self.ROOT, results, "car") == each

    def test_a_result_of_another_scene_is_no_file_for_all(self, tmp_path, capsys):
        """One that is named after a scene is that scene's alone."""
        shutil.copytree(DATA / "nuscenes" / "v1.0-mini", tmp_path / "tables")
        path = tmp_path / "tables" / "scene.json"
        scenes = json.loads(path.read_text())
        scenes.append({**scenes[0], "token": "another", "name": "scene-0002"})
        path.write_text(json.dumps(scenes))
        (tmp_path / "results").mkdir()
        shutil.copy(self.FOLDER / "tracking_result.json", tmp_path / "results" / "scene-0001.json")
        line = refused(capsys, "evaluate", "nuscenes", "--root", tmp_path / "tables",
                       "--results", tmp_path / "results")  # fmt: skip
        assert "no such file" in line
        assert "scene-0002.json" in line

    @pytest.mark.parametrize("name", ["argoverse1", "argoverse2", "kitti", "nuscenes", "waymo"])
    def test_what_submit_writes_reads_back(self, tmp_path, capsys, name):
        place, sequence, kind, packed = {
            "argoverse1": ("val", LOG, "VEHICLE", "submission.zip"),
            "argoverse2": ("val", LOG, "REGULAR_VEHICLE", "submission.feather"),
            "kitti": ("training", "0000", "Car", "submission.zip"),
            "nuscenes": ("v1.0-mini", "scene-0001", "car", "submission.json"),
            "waymo": ("v2", SEGMENT, "VEHICLE", "submission.bin"),
        }[name]
        root = DATA / name / place
        dataset = open_dataset(name, root=root)
        out = tmp_path / "out"
        dataset.write(sequence, _as_tracks(dataset.recording(sequence)), out)
        each = figures(capsys, name, root, out, kind)
        who = ("--method", "m", "--account", "a@b.c") if name == "waymo" else ()
        assert pmbm("submit", name, "--root", root, "--results", out, *who) == 0
        capsys.readouterr()
        assert figures(capsys, name, root, out / packed, kind) == each
        assert figures(capsys, name, root, out, kind) == each
        (tmp_path / "alone").mkdir()
        shutil.copy(out / packed, tmp_path / "alone")
        if not packed.endswith(".zip"):
            assert figures(capsys, name, root, tmp_path / "alone", kind) == each
        again, was = (dataset.read(sequence, at) for at in (out / packed, out))
        assert [step.id.tolist() for step in again] == [step.id.tolist() for step in was]

    def test_a_segment_that_the_file_lacks_is_refused(self, tmp_path, capsys):
        found = decoded(DATA / "waymo" / "tracks.bin")
        other = copy.deepcopy(found)
        for one in other["objects"]:
            one["context_name"] = "another"
        (tmp_path / "all.bin").write_bytes(encode(other, OBJECTS))
        line = refused(capsys, "evaluate", "waymo", "--root", DATA / "waymo" / "v2",
                       "--results", tmp_path)  # fmt: skip
        assert f"no boxes of segment {SEGMENT}" in line

    @pytest.mark.parametrize("content", [b"no archive", b"PK\x03\x04", b""])
    def test_a_bad_archive_is_one_line(self, tmp_path, capsys, content):
        file = tmp_path / "results.zip"
        file.write_bytes(content)
        line = refused(capsys, "evaluate", "kitti", "--root", DATA / "kitti" / "training",
                       "--results", file)  # fmt: skip
        assert "not a folder or a zip archive" in line

    def test_an_archive_that_lacks_a_sequence_or_is_damaged(self, tmp_path, capsys):
        file = tmp_path / "results.zip"
        words = ("evaluate", "kitti", "--root", DATA / "kitti" / "training", "--results", file)
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("0001.txt", "")
        assert "no such file in the archive" in refused(capsys, *words)
        text = (DATA / "kitti" / "tracks" / "0000.txt").read_text()
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("0000.txt", text)
        content = file.read_bytes()
        file.write_bytes(content.replace(b" 9.8", b" 9.9"))
        assert "not a readable archive" in refused(capsys, *words)


def _as_tracks(made):
    steps = [
        Tracks(
            time=frame.time,
            id=frame.id + 3,
            position=frame.position + 0.01,
            size=frame.size,
            yaw=frame.yaw,
            velocity=frame.velocity,
            score=np.full(len(frame), 0.5),
            label=frame.label,
        )
        for frame in made.truth
    ]
    return TrackSequence(steps=steps, frame=np.arange(len(steps)))


def test_zeros_come_with_their_reason(capsys):
    """12 false boxes beside 3 misses: the benchmark reports a row of zeros."""
    root = CASES / "waymo_negative"
    document, text = evaluate(capsys, "waymo", root / "v2", root / "res", "VEHICLE")
    has(document["scores"]["VEHICLE"]["all"], MOTA=0.0, FP=0.0, misses=0.0, GT=3)
    why = "no score cutoff has a MOTA above 0"
    assert document["reasons"]["VEHICLE"]["all"] == {"cutoff": why}
    assert f"VEHICLE, all: no cutoff: {why}" in text


def test_every_dash_has_a_reason(capsys):
    root = DATA / "kitti"
    options = (capsys, "kitti", root / "training", root / "tracks", "Cyclist", "--each")
    document, text = evaluate(*options)
    for part, scores in document["scores"]["Cyclist"].items():
        undefined = [name for name, value in scores.items() if value is None]
        assert undefined
        assert list(document["reasons"]["Cyclist"][part]) == undefined
        assert f"Cyclist, {part}: no MOTA" in text


class TestIds:
    ROOT = CASES / "int_ids"

    def test_a_number_stands_for_its_digits(self, capsys):
        for kind in ("VEHICLE", "PEDESTRIAN"):
            found = figures(capsys, "argoverse1", self.ROOT / "val", self.ROOT / "results", kind)
            has(found, MOTA=1.0, IDS=0, GT=3)

    @pytest.mark.parametrize(
        ("value", "shown"),
        [(True, "got true"), (None, "got null"), ("", 'got ""'), (7.5, "got 7.5"),
         ([7], "got a list"), (-1, "got -1; negative ids usually mean 'not yet confirmed'")],
    )  # fmt: skip
    def test_what_is_no_id_is_shown_as_it_is(self, tmp_path, value, shown):
        shutil.copytree(self.ROOT, tmp_path / "case")
        path = next((tmp_path / "case" / "results").rglob("*.json"))
        rows = json.loads(path.read_text())
        rows[0]["track_label_uuid"] = value
        path.write_text(json.dumps(rows))
        dataset = open_dataset("argoverse1", root=tmp_path / "case" / "val")
        with pytest.raises(InputError) as caught:
            dataset.read(LOG, tmp_path / "case" / "results")
        assert re.search(re.escape(shown) + "(;|:|$)", str(caught.value))
        assert "track_label_uuid" in str(caught.value)

    def test_of_nuscenes(self, tmp_path):
        document = json.loads((DATA / "nuscenes" / "tracks.json").read_text())
        for boxes in document["results"].values():
            for box in boxes:
                box["tracking_id"] = int(box["tracking_id"])
        (tmp_path / "scene-0001.json").write_text(json.dumps(document))
        dataset = open_dataset("nuscenes", root=DATA / "nuscenes" / "v1.0-mini")
        assert [t.id.tolist() for t in dataset.read("scene-0001", tmp_path)] == [[5], [], [5]]
        kind = json.loads(json.dumps(document))
        first = next(boxes for boxes in kind["results"].values() if boxes)
        first[0]["tracking_name"] = 7
        (tmp_path / "scene-0001.json").write_text(json.dumps(kind))
        with pytest.raises(InputError, match=r"tracking_name.*got 7$"):
            dataset.read("scene-0001", tmp_path)

    def test_of_argoverse2_and_waymo(self, tmp_path):
        import pyarrow
        import pyarrow.feather
        import pyarrow.parquet

        name = f"{LOG}.feather"
        table = pyarrow.feather.read_table(str(CASES / "av2_empty_frame" / name)).to_pydict()
        ids = sorted(set(table["track_uuid"]))
        table["track_uuid"] = [7 + ids.index(one) for one in table["track_uuid"]]
        pyarrow.feather.write_feather(pyarrow.table(table), str(tmp_path / name))
        dataset = open_dataset("argoverse2", root=DATA / "argoverse2" / "val")
        found = {i for step in dataset.read(LOG, tmp_path) for i in step.id.tolist()}
        assert found == {7 + place for place in range(len(ids))}
        shutil.copytree(DATA / "waymo" / "v2", tmp_path / "v2")
        path = tmp_path / "v2" / "lidar_box" / f"{SEGMENT}.parquet"
        table = pyarrow.parquet.read_table(path).to_pydict()
        ids = sorted(set(table["key.laser_object_id"]))
        table["key.laser_object_id"] = [ids.index(one) for one in table["key.laser_object_id"]]
        pyarrow.parquet.write_table(pyarrow.table(table), path)
        made = open_dataset("waymo", root=tmp_path / "v2").recording(SEGMENT)
        assert set(made.object_name.values()) <= {str(i) for i in range(len(ids))}

    def test_a_track_s_is_not_negative(self):
        one = Tracks(time=0.0, id=[0], position=[[0, 0, 0]], size=[[1, 1, 1]], yaw=[0],
                     velocity=[[0, 0]], score=[1], label=[Label.CAR])  # fmt: skip
        values = {**vars(one), "id": np.array([-1])}
        with pytest.raises(InputError, match=r"bad id.*at least 0, got -1.*'not yet confirmed'"):
            Tracks(**values)


class TestByteOrderMark:
    """Every text door reads a file with the mark as it reads it without."""

    def same(self, tmp_path, name, file, read):
        shutil.copytree(DATA / name, tmp_path / name)
        plain = read(tmp_path / name)
        path = tmp_path / name / file
        path.write_bytes(MARK + path.read_bytes())
        assert read(tmp_path / name) == plain

    @pytest.mark.parametrize(
        "file",
        ["training/label_02/0000.txt", "training/calib/0000.txt", "training/oxts/0000.txt",
         "detections_ab3dmot/0000.txt"],
    )  # fmt: skip
    def test_kitti(self, tmp_path, file):
        def read(root):
            dataset = open_dataset(
                "kitti", root=root / "training", poses=root / "training" / "oxts",
                detections=str(root / "detections_ab3dmot"),
            )  # fmt: skip
            return dataset.recording("0000").digest()

        self.same(tmp_path, "kitti", file, read)

    def test_kitti_results(self, tmp_path, capsys):
        def read(root):
            return figures(capsys, "kitti", root / "training", root / "tracks", "Car")

        self.same(tmp_path, "kitti", "tracks/0000.txt", read)
        words = ("--root", tmp_path / "kitti" / "training", "--results", tmp_path / "kitti/tracks")
        assert pmbm("submit", "kitti", *words) == 0
        with zipfile.ZipFile(tmp_path / "kitti" / "tracks" / "submission.zip") as archive:
            assert not archive.read("0000.txt").startswith(MARK)

    @pytest.mark.parametrize(
        ("name", "place", "detections", "sequence", "file"),
        [
            ("argoverse1", "val", "detections/validation", LOG, f"val/{LOG}/poses/*_0.json"),
            ("argoverse1", "val", "detections/validation", LOG,
             f"detections/validation/{LOG}/*/*_315970000000000000.json"),
            ("nuscenes", "v1.0-mini", "detections.json", "scene-0001", "v1.0-mini/scene.json"),
            ("nuscenes", "v1.0-mini", "detections.json", "scene-0001", "detections.json"),
        ],
    )  # fmt: skip
    def test_json(self, tmp_path, name, place, detections, sequence, file):
        def read(root):
            dataset = open_dataset(name, root=root / place, detections=str(root / detections))
            return dataset.recording(sequence).digest()

        pattern = file.replace("*_0.json", "*_315970000000000000.json")
        (found,) = (DATA / name).glob(pattern)
        self.same(tmp_path, name, found.relative_to(DATA / name), read)

    def test_toml(self, tmp_path):
        scenario = Path(__file__).parents[2] / "scenarios" / "single_straight.toml"
        model = ScoreModel(knot=[0.0, 1.0], log_odds=[-1.0, 1.0], base_rate=0.5)
        study = 'scenarios=["single_straight.toml"]\ntrackers=["argoverse"]\ntrials=1\nseed=1\n'
        model.save(tmp_path / "score.toml")
        texts = {
            "single_straight.toml": scenario.read_text(),
            "study.toml": study,
            "config.toml": "clutter_rate = 1.0\n",
            "score.toml": (tmp_path / "score.toml").read_text(),
        }
        found = []
        for mark in (b"", MARK):
            for name, text in texts.items():
                (tmp_path / name).write_bytes(mark + text.encode())
            found.append(
                (
                    read_toml(tmp_path / "config.toml"),
                    load_scenario(tmp_path / "single_straight.toml").record(1).digest(),
                    load_study(tmp_path / "study.toml", resolve).hash,
                    ScoreModel.load(tmp_path / "score.toml").log_odds.tolist(),
                )
            )
        assert found[0] == found[1]


def test_an_unknown_category_of_nuscenes_is_refused(tmp_path):
    """The dataset has 23; one that is not among them is a word spelt wrongly, not nothing."""
    shutil.copytree(DATA / "nuscenes" / "v1.0-mini", tmp_path / "tables")
    path = tmp_path / "tables" / "category.json"
    table = json.loads(path.read_text())
    for name, says in (
        ("vehicle.cars", "unknown category.*did you mean 'vehicle.car'"),
        ("vehicle.emergency.police", None),
    ):
        table[0]["name"] = name
        path.write_text(json.dumps(table))
        dataset = open_dataset("nuscenes", root=tmp_path / "tables")
        if says is None:
            assert [len(frame) for frame in dataset.recording("scene-0001").truth] == [0, 0, 0]
        else:
            with pytest.raises(InputError, match=says):
                dataset.recording("scene-0001")
