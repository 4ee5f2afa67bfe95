"""The adapters of driving logs: the samples by hand, round trips, and files that are not there."""

import json
import math
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from pmbm.cli import main
from pmbm.datasets import load, open_dataset
from pmbm.datasets.argoverse2 import Argoverse2
from pmbm.datasets.waymo_files import OBJECTS, decoded
from pmbm.datasets.wire import encode
from pmbm.errors import InputError
from pmbm.types import Label, Tracks, TrackSequence

DATA = Path(__file__).parents[1] / "data"
LOG = "00000000-1111-2222-3333-444444444444"
SEGMENT = "1234567890123456789_100_000_120_000"
SAMPLES = {
    "argoverse1": ("val", "detections/validation", LOG),
    "argoverse2": ("val", "detections.feather", LOG),
    "nuscenes": ("v1.0-mini", "detections.json", "scene-0001"),
    "waymo": ("v2", "detections.bin", SEGMENT),
}


@pytest.fixture
def folder(tmp_path):
    for name in SAMPLES:
        shutil.copytree(DATA / name, tmp_path / name)
    return tmp_path


def opened(folder, name, **changes):
    root, detections, _ = SAMPLES[name]
    values = {"root": folder / name / root, "detections": str(folder / name / detections)}
    return open_dataset(name, **{**values, **changes})


def sample(folder, name):
    dataset = opened(folder, name)
    (made,) = load(dataset)
    return made


def test_argoverse1_by_hand(folder):
    made = sample(folder, "argoverse1")
    assert made.stamp.tolist() == [315970000000000000 + k * 10**8 for k in range(3)]
    np.testing.assert_allclose([f.time for f in made.truth], [0, 0.1, 0.2], atol=1e-12)
    first = made.truth[0]
    assert first.label.tolist() == [Label.CAR, Label.PEDESTRIAN]
    assert made.object_name[0] == "00000000-0000-0000-0000-000000000001"
    # The vehicle at (1500, 250, 16.2) heads 0.1 rad; the box (12, -3.2, .8) heads .02 in its frame.
    c, s = math.cos(0.1), math.sin(0.1)
    np.testing.assert_allclose(
        first.position[0], [1500 + 12 * c + 3.2 * s, 250 + 12 * s - 3.2 * c, 17.0]
    )
    np.testing.assert_allclose(first.yaw[0], 0.12)
    np.testing.assert_allclose(first.size[0], [4.6, 1.9, 1.6])
    assert made.detections[0].score.tolist() == [0.93, 0.31, 0.71]
    np.testing.assert_allclose(made.detections[0].sensor_pose, [1500, 250, 0.1])
    assert made.provenance["class"]["00000000-0000-0000-0000-000000000001"] == "VEHICLE"


def test_argoverse2_by_hand(folder):
    made = sample(folder, "argoverse2")
    assert made.stamp.tolist() == [315969904000000000 + k * 10**8 for k in range(3)]
    second = made.truth[1]
    yaw = 2 * math.atan2(0.3428978074554514, 0.9393727128473789)
    np.testing.assert_allclose(made.detections[1].sensor_pose, [701, 300, yaw])
    c, s = math.cos(yaw), math.sin(yaw)
    np.testing.assert_allclose(
        second.position[0], [701 + 12.4 * c + 3 * s, 300 + 12.4 * s - 3 * c, 5.3]
    )
    np.testing.assert_allclose(second.yaw[0], yaw + 0.05)
    np.testing.assert_allclose(second.size[1], [0.7, 0.7, 1.75])
    assert made.detections[1].score.tolist() == [0.9, 0.5]


def test_nuscenes_by_hand(folder):
    made = sample(folder, "nuscenes")
    np.testing.assert_allclose([f.time for f in made.truth], [0, 0.5, 1.0])
    np.testing.assert_allclose(made.truth[1].position, [[404, 1100, 0.9]])
    np.testing.assert_allclose(made.truth[1].size, [[4.6, 1.9, 1.6]])
    np.testing.assert_allclose(made.truth[1].yaw, [0.3], atol=1e-6)
    np.testing.assert_allclose(made.truth[1].velocity, [[8.0, 0.0]])
    np.testing.assert_allclose(made.detections[2].position, [[408.1, 1100.05, 0.9]])
    np.testing.assert_allclose(made.detections[2].sensor_pose, [396, 1098, 0.3], atol=1e-6)
    assert made.truth[0].observable.tolist() == [True]
    assert made.object_name == {0: "633f1abb879c5e33ab694b27002e28f8"}


def test_waymo_by_hand(folder):
    made = sample(folder, "waymo")
    assert made.stamp[0] == 1550000000000000
    first = made.truth[0]
    row = [made.object_name[i] for i in first.id.tolist()].index("Aa0_veh")
    c, s = 0.995004165278026, 0.09983341664682815
    np.testing.assert_allclose(
        first.position[row, :2] - made.detections[0].sensor_pose[:2],
        [15 * c + 3.5 * s, 15 * s - 3.5 * c],
    )
    np.testing.assert_allclose(first.size[row], [4.7, 2.1, 1.7])
    np.testing.assert_allclose(first.yaw[row], 0.13)
    assert first.label[row] == Label.CAR
    assert len(made.detections) == len(made.truth)


def as_tracks(made, frames=None):
    """The truth as a tracker would report it."""
    steps = [
        Tracks(
            time=frame.time,
            id=frame.id + 3,
            position=frame.position,
            size=frame.size,
            yaw=frame.yaw,
            velocity=frame.velocity,
            score=np.full(len(frame), 0.5),
            label=frame.label,
        )
        for frame in made.truth
    ]
    frames = range(len(steps)) if frames is None else frames
    return TrackSequence(steps=[steps[k] for k in frames], frame=list(frames))


@pytest.mark.parametrize("name", SAMPLES)
def test_round_trip_dataset_world_dataset(folder, name):
    dataset, sequence = opened(folder, name), SAMPLES[name][2]
    made = dataset.recording(sequence)
    dataset.write(sequence, as_tracks(made), folder / "out")
    back = dataset.read(sequence, folder / "out")
    for before, after in zip(as_tracks(made), back, strict=True):
        assert after.id.tolist() == before.id.tolist()
        assert after.label.tolist() == before.label.tolist()
        for field in ("position", "size", "yaw", "score"):
            np.testing.assert_allclose(
                getattr(after, field), getattr(before, field), rtol=0, atol=1e-9
            )
    for kind in dataset.classes:
        compared = dataset.compared(sequence, kind, folder / "out")
        for frame, tracks in zip(compared.truth, compared.tracks, strict=True):
            assert (frame.label == dataset.labels[dataset.classes.index(kind)]).all()
            np.testing.assert_allclose(tracks.position, frame.position, rtol=0, atol=1e-9)
            np.testing.assert_allclose(tracks.yaw, frame.yaw, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", SAMPLES)
def test_frames_without_reports_are_written_empty(folder, name):
    dataset, sequence = opened(folder, name), SAMPLES[name][2]
    made = dataset.recording(sequence)
    dataset.write(sequence, as_tracks(made, frames=[1]), folder / "out")
    back = dataset.read(sequence, folder / "out")
    assert [len(step) for step in back] == [
        len(frame) if k == 1 else 0 for k, frame in enumerate(made.truth)
    ]
    kind = dataset.classes[0]
    compared = dataset.compared(sequence, kind, folder / "out")
    assert len(compared.truth) == len(compared.tracks) == len(made.truth)
    assert len(compared.truth[0]) > 0


@pytest.mark.parametrize("name", SAMPLES)
def test_without_truth_no_label_is_read(folder, name):
    dataset, sequence = opened(folder, name), SAMPLES[name][2]
    full = dataset.recording(sequence)
    labels = {
        "argoverse1": f"val/{LOG}/per_sweep_annotations_amodal",
        "argoverse2": f"val/{LOG}/annotations.feather",
        "nuscenes": "v1.0-mini/sample_annotation.json",
        "waymo": "v2/lidar_box",
    }[name]
    path = folder / name / labels
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    made = opened(folder, name).recording(sequence, truth=False)
    assert made.detections_digest() == full.detections_digest()
    assert all(len(frame) == 0 for frame in made.truth)
    with pytest.raises(InputError):
        opened(folder, name).recording(sequence)


@pytest.mark.parametrize("name", SAMPLES)
def test_names_are_checked(folder, name):
    sequence = SAMPLES[name][2]
    for bad in ("../" + sequence, sequence[:-1] + "x", ".."):
        with pytest.raises(InputError):
            opened(folder, name).recording(bad)
    with pytest.raises(InputError, match="no class 'Carr'"):
        opened(folder, name, classes=["Carr"])


def test_classes_that_share_a_label_are_refused(folder):
    with pytest.raises(InputError, match=r"cannot be tracked together.*BUS, SCHOOL_BUS"):
        opened(folder, "argoverse1", classes=["BUS", "SCHOOL_BUS"])


def remove(folder, path):
    (folder / path).unlink()


def edit(path, change):
    """Change a JSON file's value in place."""
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))


SWEEPS = f"argoverse1/val/{LOG}/per_sweep_annotations_amodal"
DETECTED = f"argoverse1/detections/validation/{LOG}/per_sweep_annotations_amodal"
STAMP = "315970000100000000"


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (f"argoverse1/val/{LOG}/poses/city_SE3_egovehicle_{STAMP}.json", "no such file"),
        (f"{SWEEPS}/tracked_object_labels_{STAMP}.json", "file of an unknown sweep"),
        (f"{DETECTED}/tracked_object_labels_{STAMP}.json", "no file for a sweep.*known from"),
        (f"argoverse2/val/{LOG}/city_SE3_egovehicle.feather", "no such file"),
        ("argoverse2/detections.feather", "no such file"),
        ("nuscenes/v1.0-mini/ego_pose.json", "no such file"),
        (f"waymo/v2/vehicle_pose/{SEGMENT}.parquet", "no such file"),
    ],
)
def test_missing_files(folder, path, message):
    name = path.split("/")[0]
    remove(folder, path)
    with pytest.raises(InputError, match=message) as caught:
        opened(folder, name).recording(SAMPLES[name][2])
    assert caught.value.file is not None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[0].pop("center"), "field is missing.*object .*0001, field center"),
        (lambda rows: rows[0]["rotation"].update(w=0.0, z=0.0), "not a unit quaternion"),
        (lambda rows: rows[0].update(length=0.0), "field length.*above 0"),
        (lambda rows: rows[0]["center"].update(x=float("nan")), r"center\.x.*got nan"),
        (lambda rows: rows[0].update(label_class="VEHICEL"), "did you mean 'VEHICLE'"),
        (lambda rows: rows[0].update(timestamp=3.1597e17), "timestamp.*an integer"),
        (lambda rows: rows[1].update(rows[0]), "same id twice.*object .*0001"),
        (lambda rows: rows[0].update(track_label_uuid=None), "track_label_uuid"),
        (lambda rows: rows.append([]), "not an object"),
    ],
)
def test_bad_labels_of_argoverse1(folder, change, message):
    path = folder / SWEEPS / f"tracked_object_labels_{STAMP}.json"
    edit(path, change)
    with pytest.raises(InputError, match=message) as caught:
        sample(folder, "argoverse1")
    assert caught.value.file == str(path)
    assert caught.value.frame == int(STAMP)


def test_the_name_of_the_file_is_the_time(folder):
    """The field may say another one, as in published files."""
    path = folder / SWEEPS / f"tracked_object_labels_{STAMP}.json"
    edit(path, lambda rows: [row.update(timestamp=1) for row in rows])
    assert sample(folder, "argoverse1").stamp[1] == int(STAMP)


def test_class_as_an_object(folder):
    path = folder / SWEEPS / f"tracked_object_labels_{STAMP}.json"
    edit(path, lambda rows: rows[0].update(label_class={"name": "VEHICLE"}))
    assert sample(folder, "argoverse1").truth[1].label.tolist() == [Label.CAR, Label.PEDESTRIAN]


def test_results_of_argoverse1_fail_closed(folder):
    dataset = opened(folder, "argoverse1")
    dataset.write(LOG, as_tracks(dataset.recording(LOG)), folder / "out")
    remove(folder, f"out/{LOG}/per_sweep_annotations_amodal/tracked_object_labels_{STAMP}.json")
    with pytest.raises(InputError, match=f"no file for a sweep.*frame {STAMP}"):
        dataset.compared(LOG, "VEHICLE", folder / "out")


def test_results_of_argoverse2_fail_closed(folder):
    dataset = opened(folder, "argoverse2")
    made = dataset.recording(LOG)
    path = dataset.write(LOG, as_tracks(made), folder / "out")
    from pmbm.datasets.columns import read_columns, write_columns

    names = ("timestamp_ns", "track_uuid", "category", "score", "length_m", "width_m", "height_m",
             "qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")  # fmt: skip
    table = read_columns(path, names, parquet=False)
    rows = [row for row, stamp in enumerate(table.values["timestamp_ns"]) if stamp != made.stamp[1]]
    kept = {name: [table.values[name][row] for row in rows] for name in names}
    write_columns(path, kept, {"frames": [made.stamp[0].item(), made.stamp[2].item()]})
    with pytest.raises(InputError, match=f"not in the results.*frame {made.stamp[1]}"):
        dataset.compared(LOG, "PEDESTRIAN", folder / "out")


def test_the_vehicle_itself_is_left_out(folder):
    """Some files hold rows of it, under another name of the file."""
    import pyarrow.feather

    path = folder / "argoverse2" / "val" / LOG / "annotations.feather"
    before = sample(folder, "argoverse2")
    table = pyarrow.feather.read_table(str(path)).to_pandas()
    own = table.iloc[[0, 2]].assign(category="EGO_VEHICLE", track_uuid="ego")
    table = type(table)(
        {name: [*table[name].tolist(), *own[name].tolist()] for name in table.columns}
    )
    path.unlink()
    pyarrow.feather.write_feather(table, str(path.with_name("annotations_with_ego.feather")))
    assert sample(folder, "argoverse2").truth_digest() == before.truth_digest()


class TestNuScenes:
    def tables(self, folder):
        return folder / "nuscenes" / "v1.0-mini"

    @pytest.mark.parametrize(
        ("table", "change", "message"),
        [
            ("scene", lambda t: t[0].update(nbr_samples=2), "more samples than the scene"),
            ("sample", lambda t: t[1].update(next=t[0]["token"]), "times must increase"),
            ("sample", lambda t: t[1].update(next=""), "fewer samples than the scene"),
            ("sample", lambda t: t[1].update(timestamp=0), "times must increase"),
            ("sample", lambda t: t[1].update(token=t[0]["token"]), "two records of one token"),
            ("ego_pose", lambda t: t.pop(), "token that no record has.*ego_pose_token"),
            ("ego_pose", lambda t: t[0].update(rotation=[0, 0, 0, 0]), "not a unit quaternion"),
            ("sample_data", lambda t: t[2].update(is_key_frame=False), "without a lidar key frame"),
            ("sensor", lambda t: t[0].update(channel="CAM_FRONT"), "without a lidar key frame"),
            ("sample_annotation", lambda t: t[0].update(size=[1, 1]), "expected 3, got 2"),
            ("sample_annotation", lambda t: t[0].update(visibility_token="5"), "visibility"),
            ("sample_annotation", lambda t: t[0].update(sample_token="x"), "no such sample"),
            ("instance", lambda t: t[0].update(category_token="x"), "category_token.*got 'x'"),
        ],
    )
    def test_bad_tables(self, folder, table, change, message):
        edit(self.tables(folder) / f"{table}.json", change)
        with pytest.raises(InputError, match=message) as caught:
            sample(folder, "nuscenes")
        assert Path(caught.value.file).parent == self.tables(folder)

    def test_what_the_benchmark_does_not_count(self, folder):
        path = self.tables(folder) / "sample_annotation.json"
        edit(path, lambda t: t[0].update(num_lidar_pts=0, num_radar_pts=0))
        edit(path, lambda t: t[1].update(translation=[393.0 + 50.0, 1098.0, 0.9]))
        made = sample(folder, "nuscenes")
        assert [f.observable.tolist() for f in made.truth] == [[False], [False], [True]]
        edit(path, lambda t: t[1].update(translation=[393.0 + 49.99, 1098.0, 0.9]))
        assert sample(folder, "nuscenes").truth[1].observable.all()

    def test_cycles_in_racks_are_not_counted(self, folder):
        root = self.tables(folder)
        edit(root / "category.json", lambda t: t[0].update(name="vehicle.bicycle"))
        assert sample(folder, "nuscenes").truth[0].observable.all()
        rack = {"token": "rack", "name": "static_object.bicycle_rack", "description": ""}
        edit(root / "category.json", lambda t: t.append(rack))
        one = {"token": "one", "category_token": "rack"}
        edit(root / "instance.json", lambda t: t.append({**t[0], **one}))
        box = {"token": "a", "instance_token": "one", "size": [6.0, 2.0, 1.0]}
        edit(root / "sample_annotation.json", lambda t: t.append({**t[0], **box}))
        made = sample(folder, "nuscenes")
        assert [f.observable.tolist() for f in made.truth] == [[False], [True], [True]]

    def test_missing_samples_fail_closed(self, folder):
        token = "ee3a6f0269465243bde881c2bd576ebe"
        path = folder / "nuscenes" / "detections.json"
        edit(path, lambda d: d["results"].pop(token))
        with pytest.raises(InputError, match=f"a sample is missing.*{token}"):
            sample(folder, "nuscenes")

    def test_submission(self, folder):
        dataset = opened(folder, "nuscenes")
        dataset.write("scene-0001", as_tracks(dataset.recording("scene-0001")), folder / "out")
        path = dataset.submit(["scene-0001"], folder / "out")
        document = json.loads(path.read_text())
        sources = ("camera", "lidar", "radar", "map", "external")
        assert set(document["meta"]) == {f"use_{name}" for name in sources}
        assert len(document["results"]) == 3
        (box,) = document["results"]["cc05322a38c350a6ab5fefe588d03811"]
        assert set(box) == {"sample_token", "translation", "size", "rotation", "velocity",
                            "tracking_id", "tracking_name", "tracking_score"}  # fmt: skip
        assert box["size"] == [1.9, 4.6, 1.6]

    def test_a_submission_says_what_its_detections_were_made_from(self, folder):
        edit(folder / "nuscenes" / "detections.json", lambda d: d.update(meta={"use_camera": True}))
        dataset = opened(folder, "nuscenes")
        tracks = as_tracks(dataset.recording("scene-0001"))
        for path in (
            dataset.write("scene-0001", tracks, folder / "out"),
            dataset.submit(["scene-0001"], folder / "out"),
        ):
            meta = json.loads(path.read_text())["meta"]
            assert [name for name, used in meta.items() if used] == ["use_camera"]

    def test_what_detections_were_made_from_is_a_yes_or_no(self, folder):
        edit(folder / "nuscenes" / "detections.json", lambda d: d.update(meta={"use_radar": 1}))
        dataset = opened(folder, "nuscenes")
        tracks = as_tracks(dataset.recording("scene-0001"))
        with pytest.raises(InputError, match=r"not a yes or no.*use_radar"):
            dataset.write("scene-0001", tracks, folder / "out")

    def test_the_sample_of_results_reads(self, folder):
        (folder / "out").mkdir()
        shutil.copy(folder / "nuscenes" / "tracks.json", folder / "out" / "scene-0001.json")
        tracks = opened(folder, "nuscenes").read("scene-0001", folder / "out")
        assert [t.id.tolist() for t in tracks] == [[5], [], [5]]


def test_a_box_on_a_detection_in_a_no_label_zone_is_marked_too(folder):
    """The first frame's car is detected inside one: its track there is no false positive."""
    dataset = opened(folder, "waymo")
    made = dataset.recording(SEGMENT)
    file = folder / "waymo" / "detections.bin"
    message = decoded(file)
    message["objects"][0]["overlap_with_nlz"] = True
    file.write_bytes(encode(message, OBJECTS))
    seen = message["objects"][0]["object"]["box"]
    path = dataset.write(SEGMENT, as_tracks(made), folder / "out")
    marked = [one["object"]["box"] for one in decoded(path)["objects"] if "overlap_with_nlz" in one]
    assert len(marked) == 1
    assert math.hypot(*(marked[0][f"center_{c}"] - seen[f"center_{c}"] for c in "xy")) < 1.0
    kind = dataset.classes[0]
    assert dataset.compared(SEGMENT, kind, folder / "out").excused.sum() == 1


def submit(*arguments):
    with pytest.raises(SystemExit) as stop:
        main(["submit", *map(str, arguments)])
    return stop.value.code


class TestSubmit:
    """Every dataset's results as one file, which holds what the results hold."""

    def written(self, folder, name):
        dataset = opened(folder, name)
        dataset.write(SAMPLES[name][2], as_tracks(sample(folder, name)), folder / "out")
        return dataset, ("--root", folder / name / SAMPLES[name][0], "--results", folder / "out")

    def test_argoverse1(self, folder):
        dataset, options = self.written(folder, "argoverse1")
        assert submit("argoverse1", *options) == 0
        with zipfile.ZipFile(folder / "out" / "submission.zip") as archive:
            archive.extractall(folder / "again")
        before, after = (dataset.read(LOG, folder / place) for place in ("out", "again"))
        assert [t.id.tolist() for t in before] == [t.id.tolist() for t in after]

    def test_argoverse2(self, folder):
        dataset, options = self.written(folder, "argoverse2")
        assert submit("argoverse2", *options) == 0
        found = Argoverse2(
            root=folder / "argoverse2/val", detections=str(folder / "out" / "submission.feather")
        )
        # It has the form of the dataset's detections: they come back where the tracks were.
        for step, seen in zip(
            dataset.read(LOG, folder / "out"), found.recording(LOG).detections, strict=True
        ):
            np.testing.assert_allclose(seen.position, step.position, rtol=0, atol=1e-9)
            np.testing.assert_allclose(seen.score, step.score)
        (folder / "out" / f"{LOG}.feather").unlink()

    def test_waymo_says_who(self, folder, capsys):
        _, options = self.written(folder, "waymo")
        assert submit("waymo", *options, "--method", "pmbm") == 2
        assert "--account" in capsys.readouterr().err
        assert submit("waymo", *options, "--method", "pmbm", "--account", "a@b.c") == 0
        assert (folder / "out" / "submission.bin").stat().st_size > 100

    def test_kitti(self, tmp_path, capsys):
        shutil.copytree(DATA / "kitti", tmp_path / "kitti")
        root, out = tmp_path / "kitti" / "training", tmp_path / "kitti" / "tracks"
        options = ("--root", root, "--results", out, "--sequences", "0000")
        assert submit("kitti", *options) == 0
        with zipfile.ZipFile(out / "submission.zip") as archive:
            assert archive.namelist() == ["0000.txt"]
            assert archive.read("0000.txt") == (out / "0000.txt").read_bytes()
        assert submit("kitti", *options, "--method", "pmbm") == 2
        assert "--method" in capsys.readouterr().err

    @pytest.mark.parametrize("name", ["argoverse1", "argoverse2", "nuscenes", "waymo"])
    def test_a_missing_result_is_refused(self, folder, capsys, name):
        _, options = self.written(folder, name)
        shutil.rmtree(folder / "out")
        (folder / "out").mkdir()
        who = ("--method", "pmbm", "--account", "a@b.c") if name == "waymo" else ()
        assert submit(name, *options, *who) == 2
        assert "pmbm: " in capsys.readouterr().err
        assert not list((folder / "out").iterdir())


@pytest.mark.skipif("PMBM_DATA" not in os.environ, reason="PMBM_DATA is unset: no real logs")
class TestRealFiles:
    def test_argoverse2(self, tmp_path):
        root = Path(os.environ["PMBM_DATA"]) / "argoverse2"
        dataset = open_dataset("argoverse2", root=root)
        assert len(dataset.sequences()) == 4
        for made in load(dataset):
            assert 150 <= len(made) <= 160
            np.testing.assert_allclose(np.median(np.diff([f.time for f in made.truth])), 0.1, 0.01)
            speed = np.concatenate([np.hypot(*f.velocity.T) for f in made.truth])
            assert np.median(speed) < 2.0
        dataset.write(dataset.sequences()[-1], as_tracks(made), tmp_path)
        back = dataset.read(dataset.sequences()[-1], tmp_path)
        for before, after in zip(as_tracks(made), back, strict=True):
            np.testing.assert_allclose(after.position, before.position, rtol=0, atol=1e-9)

    def test_argoverse2_without_poses_is_refused(self):
        dataset = open_dataset("argoverse2", root=Path(os.environ["PMBM_DATA"]) / "argoverse2")
        with pytest.raises(InputError, match=r"no such file.*city_SE3_egovehicle.feather"):
            dataset.recording("b87683ae-14c5-321f-8af3-623e7bafc3a7")

    def test_waymo_fixture(self):
        root = Path(os.environ["PMBM_DATA"]) / "waymo"
        dataset = open_dataset("waymo", root=root / "fake_ground_truths.bin",
                               detections=str(root / "fake_predictions.bin"))  # fmt: skip
        made = list(load(dataset))
        assert [len(r) for r in made] == [10, 10]
        assert sum(len(d) for r in made for d in r.detections) > 1000
