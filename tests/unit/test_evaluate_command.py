"""`pmbm evaluate`: the KITTI rules by hand, and on the real files where they are."""

import copy
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from pmbm.cli import main
from pmbm.datasets import open_dataset
from pmbm.datasets.waymo_files import OBJECTS, decoded
from pmbm.datasets.wire import encode
from pmbm.types import Tracks, TrackSequence

SAMPLE = Path(__file__).parents[1] / "data" / "kitti"


def pmbm(*arguments):
    """The exit code."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return stop.value.code


def evaluate(capsys, root, results, *options):
    code = pmbm("evaluate", "kitti", "--root", root, "--results", results, "--json", "-", *options)
    assert code == 0
    return json.loads(capsys.readouterr().out)["scores"]


def row(frame, object_id, kind, x, *, score=None, truncated=0, occluded=0, box="0 0 50 50"):
    """A unit cube at (x, 1, 20), with its image box."""
    line = f"{frame} {object_id} {kind} {truncated} {occluded} 0 {box} 1 1 1 {x} 1 20 0"
    return line if score is None else f"{line} {score}"


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(SAMPLE / "training", tmp_path / "kitti")
    (tmp_path / "results").mkdir()
    return tmp_path


def write(folder, truth, results):
    for place, lines in (("kitti/label_02", truth), ("results", results)):
        (folder / place / "0000.txt").write_text("".join(f"{line}\n" for line in lines))
    return folder / "kitti", folder / "results"


def test_the_sample_is_tracked_nearly_perfectly(capsys):
    scores = evaluate(capsys, SAMPLE / "training", SAMPLE / "tracks", "--classes", "Car")
    assert scores["Car"]["all"]["MOTA"] == 1.0
    assert scores["Car"]["all"]["GT"] == 3
    assert 0.5 < scores["Car"]["all"]["HOTA"] < 1.0


def test_counts_by_hand(folder, capsys):
    """Two cars over four frames: one keeps its track but for a miss, the other changes it; and one
    false box.  MOTA = 1 - (1 + 1 + 1) / 8."""
    truth = [row(k, i, "Car", 10 * i) for k in range(4) for i in (0, 1)]
    results = [row(k, 5, "Car", 0.1, score=1) for k in (0, 1, 3)]
    results += [row(k, 6 + k // 2, "Car", 10, score=1) for k in range(4)]
    results += [row(2, 9, "Car", -20, score=1)]
    places = write(folder, truth, results)
    scores = evaluate(capsys, *places, "--classes", "Car", "--each")["Car"]
    assert scores["all"] == scores["0000"]
    assert {key: scores["all"][key] for key in ("FP", "FN", "IDS", "GT")} == {
        "FP": 1, "FN": 1, "IDS": 1, "GT": 8
    }  # fmt: skip
    np.testing.assert_allclose(scores["all"]["MOTA"], 1 - 3 / 8)
    # IDTP: 3 of track 5, 2 of 6 or 7; rows 8 + 8.
    np.testing.assert_allclose(scores["all"]["IDF1"], 2 * 5 / 16)
    np.testing.assert_allclose(scores["all"]["MOTP"], (3 * 0.9 / 1.1 + 4) / 7)


@pytest.mark.parametrize(
    ("line", "counts"),
    [
        (row(0, 1, "Car", 0), (0, 0, 1)),
        (row(0, 1, "Van", 0), (0, 0, 0)),
        (row(0, 1, "Car", 0, occluded=2), (0, 0, 1)),
        (row(0, 1, "Car", 0, occluded=3), (0, 0, 0)),
        (row(0, 1, "Car", 0, truncated=1), (0, 0, 0)),
        (row(0, 1, "Truck", 0), (1, 0, 0)),
        (row(0, 1, "Van", 30), (1, 0, 0)),
        ("0 -1 DontCare -1 -1 -10 0 0 40 40 -1 -1 -1 -1000 -1000 -1000 -10", (0, 0, 0)),
        ("0 -1 DontCare -1 -1 -10 0 0 30 40 -1 -1 -1 -1000 -1000 -1000 -10", (1, 0, 0)),
        ("1 -1 DontCare -1 -1 -10 0 0 50 50 -1 -1 -1 -1000 -1000 -1000 -10", (1, 0, 0)),
    ],
)
def test_what_counts_neither_way(folder, capsys, line, counts):
    """One box at (0, 1, 20), 50 x 50 pixels, against one truth: (FP, FN, GT)."""
    places = write(folder, [line], [row(0, 7, "Car", 0, score=1)])
    scores = evaluate(capsys, *places, "--classes", "Car")["Car"]["all"]
    assert (scores["FP"], scores["FN"], scores["GT"]) == counts


@pytest.mark.parametrize(("bottom", "false"), [(25, 0), (26, 1)])
def test_boxes_of_25_pixels_are_excused(folder, capsys, bottom, false):
    places = write(folder, [], [row(0, 7, "Car", 0, score=1, box=f"0 0 50 {bottom}")])
    assert evaluate(capsys, *places, "--classes", "Car")["Car"]["all"]["FP"] == false


def test_rules_differ_in_what_they_compare(folder, capsys):
    """1.5 m apart, the same image box: another place by volume, the same from above and in the
    image; a class without truth or tracks has no ratios."""
    places = write(folder, [row(0, 1, "Car", 0)], [row(0, 7, "Car", 1.5, score=1)])
    found = {
        rule: evaluate(capsys, *places, "--rule", rule)["Car"]["all"]["FN"]
        for rule in ("iou3d", "bev", "iou2d")
    }
    assert found == {"iou3d": 1, "bev": 0, "iou2d": 0}
    assert evaluate(capsys, *places)["Cyclist"]["all"]["HOTA"] is None


def test_the_devkit_s_own_counting(folder, capsys):
    """Its average over recall, and no switch after a gap."""
    truth = [row(k, 1, "Car", 0) for k in range(3)]
    results = [row(0, 7, "Car", 0, score=1), row(2, 8, "Car", 0, score=1)]
    places = write(folder, truth, results)
    by = {
        rule: evaluate(capsys, *places, "--rule", rule)["Car"]["all"]
        for rule in ("iou3d", "devkit")
    }
    assert by["iou3d"]["IDS"] == 1
    assert by["devkit"]["IDS"] == 0
    assert 0 < by["devkit"]["sAMOTA"] < 1


def test_averages_over_recall_take_the_scores_as_written(folder, capsys):
    """The surer track alone has MOTA 1/2, all that a recall up to 1/2 allows; with both it is 1."""
    truth = [row(k, i, "Car", 20 * i) for k in range(200) for i in (0, 1)]
    results = [row(k, 7 + i, "Car", 20 * i, score=12 - 9 * i) for k in range(200) for i in (0, 1)]
    places = write(folder, truth, results)
    scores = evaluate(capsys, *places, "--rule", "devkit", "--classes", "Car")["Car"]["all"]
    assert scores["sAMOTA"] == pytest.approx(1.0)
    assert scores["AMOTA"] == pytest.approx(0.75)


def test_two_metres_are_too_far(folder, capsys):
    for away, missed in ((1.999, 0), (2.0, 1)):
        places = write(folder, [row(0, 1, "Car", 0)], [row(0, 7, "Car", away, score=1)])
        assert evaluate(capsys, *places, "--rule", "bev")["Car"]["all"]["FN"] == missed


def test_fails_closed(folder, capsys):
    root, results = write(folder, [row(0, 1, "Car", 0)], [row(0, 7, "Car", 0, score=1)])
    options = ("evaluate", "kitti", "--root", root, "--results", results)
    assert pmbm(*options, "--rule", "iou") == 2
    assert "did you mean 'iou3d'" in capsys.readouterr().err
    (results / "0000.txt").unlink()
    assert pmbm(*options) == 2
    assert "no such file" in capsys.readouterr().err


def test_the_table(folder, capsys):
    root, results = write(folder, [row(0, 1, "Car", 0)], [row(0, 7, "Car", 0, score=1)])
    assert pmbm("evaluate", "kitti", "--root", root, "--results", results, "--each") == 0
    text = capsys.readouterr().out
    assert "3D IoU of at least .25" in text
    assert any("Car" in line and "1.0000" in line for line in text.splitlines())
    assert "0000" in text


@pytest.mark.slow
@pytest.mark.skipif("PMBM_DATA" not in os.environ, reason="PMBM_DATA is unset: no real KITTI")
@pytest.mark.parametrize(
    ("rule", "kind", "figures"),
    [
        ("iou3d", "Car", (0.8728, 74, 435, 5, 0.8877, 0.6784)),
        ("bev", "Car", (0.8733, 73, 434, 5, 0.8880, 0.8445)),
        ("iou3d", "Pedestrian", (0.6722, 110, 832, 11, 0.7722, 0.5018)),
        ("bev", "Pedestrian", (0.6773, 102, 823, 13, 0.7764, 0.7373)),
        ("iou3d", "Cyclist", (0.8534, 51, 70, 2, 0.7064, 0.6001)),
        ("bev", "Cyclist", (0.8582, 49, 68, 2, 0.7089, 0.7624)),
    ],
)
def test_the_peer_gets_its_known_figures(capsys, rule, kind, figures):
    """AB3DMOT's own output on the seven sequences, scored elsewhere by another program."""
    root = Path(os.environ["PMBM_DATA"]) / "kitti"
    names = ("0006", "0008", "0010", "0012", "0014", "0015", "0016")
    scores = evaluate(
        capsys, root, root / "peers" / "ab3dmot", "--rule", rule, "--classes", kind,
        "--sequences", *names,
    )  # fmt: skip
    keys = ("MOTA", "FP", "FN", "IDS", "IDF1", "HOTA")
    assert [round(scores[kind]["all"][key], 4) for key in keys] == list(figures)


DATA = Path(__file__).parents[1] / "data"
LOGS = {
    "argoverse1": ("val", "VEHICLE"),
    "argoverse2": ("val", "REGULAR_VEHICLE"),
    "nuscenes": ("v1.0-mini", "car"),
    "waymo": ("v2", "VEHICLE"),
}


def driven(name, tmp_path, shift=0.0, swap=False):
    """The truth of a sample written as results, shifted along x, or with a new id in the second
    frame; and where."""
    dataset = open_dataset(name, root=DATA / name / LOGS[name][0])
    for sequence in dataset.sequences():
        made = dataset.recording(sequence)
        steps = [
            Tracks(
                time=frame.time,
                id=frame.id + (100 if swap and k == 1 else 0),
                position=frame.position + np.array([shift, 0, 0]),
                size=frame.size,
                yaw=frame.yaw,
                velocity=frame.velocity,
                score=np.full(len(frame), 0.5),
                label=frame.label,
            )
            for k, frame in enumerate(made.truth)
        ]
        tracks = TrackSequence(steps=steps, frame=np.arange(len(steps)))
        dataset.write(sequence, tracks, tmp_path / "out")
    return "--root", DATA / name / LOGS[name][0], "--results", tmp_path / "out"


@pytest.mark.parametrize("name", LOGS)
def test_every_dataset_by_its_own_rule(tmp_path, capsys, name):
    kind = LOGS[name][1]
    options = ("--json", "-", "--classes", kind)
    for shift, key, low, high in ((0.0, "MOTA", 1, 1), (3.0, "MOTA", -1, 0)):
        key = "AMOTA" if name == "nuscenes" else key
        assert pmbm("evaluate", name, *driven(name, tmp_path, shift), *options) == 0
        scores = json.loads(capsys.readouterr().out)["scores"][kind]["all"]
        assert low <= scores[key] <= high


@pytest.mark.parametrize("name", ["argoverse1", "argoverse2", "waymo"])
def test_switches_are_counted(tmp_path, capsys, name):
    kind = LOGS[name][1]
    assert pmbm("evaluate", name, *driven(name, tmp_path, swap=True), "--json", "-",
                "--classes", kind) == 0  # fmt: skip
    scores = json.loads(capsys.readouterr().out)["scores"][kind]["all"]
    assert scores["MOTA"] < 1
    assert scores.get("IDS", scores.get("mismatches")) > 0


def test_waymo_knows_the_thresholds_of_its_types(tmp_path, capsys):
    """A car of 4.7 x 2.1 m headed .13 rad off the shift: 0.6 m leaves 4.105 x 2.022 m of it, IoU
    8.30 / 11.44 = .73; 1 m leaves 3.71 x 1.97 m, .59: enough for a cyclist, not for a car."""
    for shift, found in ((0.6, 1.0), (1.0, 0.0)):
        assert pmbm("evaluate", "waymo", *driven("waymo", tmp_path, shift), "--json", "-",
                    "--classes", "VEHICLE") == 0  # fmt: skip
        scores = json.loads(capsys.readouterr().out)["scores"]["VEHICLE"]["all"]
        assert scores["MOTA"] == found


@pytest.mark.parametrize("zone", [False, True])
def test_a_waymo_box_in_a_no_label_zone_is_not_false(tmp_path, capsys, zone):
    options = driven("waymo", tmp_path)
    (path,) = (tmp_path / "out").glob("*.bin")
    content = decoded(path)
    ghost = copy.deepcopy(content["objects"][0])
    ghost["object"]["id"] = "ghost"
    ghost["object"]["box"]["center_x"] += 50.0
    content["objects"].append(ghost | {"overlap_with_nlz": zone})
    path.write_bytes(encode(content, OBJECTS))
    assert pmbm("evaluate", "waymo", *options, "--json", "-", "--classes", "VEHICLE") == 0
    scores = json.loads(capsys.readouterr().out)["scores"]["VEHICLE"]["all"]
    assert (scores["FP"] == 0) == zone
