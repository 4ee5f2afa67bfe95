"""`pmbm compare`, and the jackknife under its intervals."""

import dataclasses
import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.metrics.benchmarks import evaluate_argoverse1
from pmbm.metrics.core.scene import make_scene
from pmbm.sim import load_scenario
from pmbm.study import jackknife_difference
from pmbm.tracking import make_tracker, run, tracker_factory

SAMPLE = Path(__file__).parents[1] / "data" / "kitti"


@pytest.fixture(scope="module")
def scored():
    """Two trackers over six short recordings of unequal length."""
    found = {"pmbm": [], "argoverse": []}
    for trial in range(6):
        recording = load_scenario("crossing").record(1, trial)
        n = 10 + 8 * trial
        short = dataclasses.replace(
            recording,
            truth=recording.truth[:n],
            stamp=recording.stamp[:n],
            detections=recording.detections[:n],
            origin=None,
            frame=recording.frame[:n],
        )
        for name, each in found.items():
            tracks = run(make_tracker(tracker_factory(name), short.site), short)
            each.append(evaluate_argoverse1([make_scene(short.truth, tracks)]))
    return found


def mota(one, rows):
    """By hand: errors and objects of these sequences, summed."""
    counts = [one[row]["mota"].counts for row in rows]
    errors = ("misses", "false_positives", "switches")
    return 1 - sum(c[e] for c in counts for e in errors) / sum(c["truths"] for c in counts)


def test_the_interval_is_that_of_the_jackknife(scored):
    """Worked out by hand: what each sequence changes, and the degrees that its objects leave."""
    a, b = scored["pmbm"], scored["argoverse"]
    found = jackknife_difference(a, b, "mota")
    assert found.value == pytest.approx(mota(a, range(6)) - mota(b, range(6)))
    rows = [[row for row in range(6) if row != left] for left in range(6)]
    without = np.array([mota(a, each) - mota(b, each) for each in rows])
    error = math.sqrt(5 / 6 * ((without - without.mean()) ** 2).sum())
    length = np.array([one["truths"].value for one in a])
    kish = length.sum() ** 2 / (length**2).sum() - 1
    degrees = min(kish, (length**2).sum() ** 2 / (length**4).sum() + 0.5)
    assert degrees < 5
    reach = stats.t.ppf(0.975, degrees) * error
    assert (found.low, found.high) == pytest.approx((found.value - reach, found.value + reach))
    back = jackknife_difference(b, a, "mota")
    assert (back.low, back.high) == pytest.approx((-found.high, -found.low))


def test_a_total_is_that_of_so_many_objects(scored):
    """Errors in proportion to the objects vary in nothing, however long the sequences."""
    found = jackknife_difference(scored["pmbm"], scored["argoverse"], "misses")
    assert found.low < found.value < found.high
    same = jackknife_difference(scored["pmbm"], scored["pmbm"], "misses")
    assert (same.value, same.low, same.reason) == (
        *(0.0, None),
        "equal without any one sequence: no interval",
    )


def test_fewer_than_five_sequences_have_no_interval(scored):
    a, b = scored["pmbm"], scored["argoverse"]
    four = jackknife_difference(a[:4], b[:4], "mota")
    assert four.value == pytest.approx(mota(a, range(4)) - mota(b, range(4)))
    assert (four.low, four.high) == (None, None)
    assert four.reason == "objects in 4 of 4 sequences, fewer than 5: no interval"
    assert jackknife_difference(a[:5], b[:5], "mota").low is not None


def test_other_sequences_are_refused(scored):
    with pytest.raises(InputError, match="the same sequences"):
        jackknife_difference(scored["pmbm"], scored["pmbm"][:2], "mota")


@pytest.fixture
def folder(tmp_path):
    """The KITTI sample over eight frames with poses of a standing car, and car detections."""
    root = tmp_path / "kitti"
    shutil.copytree(SAMPLE / "training", root)
    (root / "pose").mkdir()
    (root / "pose" / "0000.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 8)
    row = (SAMPLE / "detections_ab3dmot" / "0000.txt").read_text().splitlines()[0].split(",")
    (root / "dets").mkdir()
    rows = [",".join([str(k), "2", *row[2:]]) for k in range(8)]
    (root / "dets" / "0000.txt").write_text("\n".join(rows) + "\n")
    return root


def compare(folder, *arguments):
    given = ("--root", folder, "--detections", folder / "dets", "--poses", folder / "pose")
    with pytest.raises(SystemExit) as stop:
        main(["compare", *map(str, ("kitti", *given, "--classes", "Car", *arguments))])
    return stop.value.code


def test_the_table_and_its_figures(folder, tmp_path, capsys):
    out, page = tmp_path / "figures.json", tmp_path / "page.md"
    options = ("--trackers", "argoverse", "pmbm", "clairvoyant", "--ego-motion")
    assert compare(folder, *options, "--json", out, "--markdown", page) == 0
    text = capsys.readouterr().out
    assert page.read_text() == text
    rows = [line.split("|")[1].strip() for line in text.splitlines() if line.startswith("| ")][2:]
    three = ["argoverse", "pmbm", "clairvoyant"]
    assert rows == [*three, *(f"{name}, no poses" for name in three)]
    assert "3D IoU of at least .25, online, sequences 0000" in text
    car = json.loads(out.read_text())["compared"]["Car"]
    assert set(car["scores"]) == set(rows)
    assert car["scores"]["clairvoyant"]["IDS"] == 0
    less = car["less it"]
    assert less["pmbm"]["MOTA"]["difference"] == pytest.approx(
        car["scores"]["argoverse"]["MOTA"] - car["scores"]["pmbm"]["MOTA"]
    )
    # Standing, the poses are worth nothing.
    assert less["clairvoyant, no poses"]["MOTA"]["difference"] == 0
    # One sequence says nothing of others.
    assert (less["pmbm"]["MOTA"]["low"], less["pmbm"]["MOTA"]["reason"]) == (
        *(None, "objects in 1 of 1 sequences, fewer than 5: no interval"),
    )
    assert "(objects in 1 of 1 sequences, fewer than 5: no interval) |" in text


def test_without_origins_no_object_is_the_clairvoyants(folder, capsys):
    """Detections that overlap no label start no track, however long they last."""
    dets = folder / "dets" / "0000.txt"
    rows = [line.split(",") for line in dets.read_text().splitlines()]
    dets.write_text(
        "".join(",".join([*r[:10], str(float(r[10]) + 9), *r[11:]]) + "\n" for r in rows)
    )
    page = folder / "page.md"
    assert compare(folder, "--trackers", "clairvoyant", "--json", "-", "--markdown", page) == 0
    car = json.loads(capsys.readouterr().out)["compared"]["Car"]
    found = car["scores"]["clairvoyant"]
    assert (found["FP"], found["FN"]) == (0, found["GT"])
    # Its dash is explained, in the figures and under the table.
    assert found["MOTP"] is None
    assert car["reasons"]["clairvoyant"]["MOTP"] == "nothing is matched"
    assert "\nclairvoyant: no MOTP" in page.read_text()


def test_ego_motion_needs_poses(capsys):
    given = ("--root", SAMPLE / "training", "--detections", SAMPLE / "detections_ab3dmot")
    with pytest.raises(SystemExit) as stop:
        main([*map(str, ("compare", "kitti", *given, "--classes", "Car", "--ego-motion"))])
    assert stop.value.code == 2
    assert "--poses" in capsys.readouterr().err


def test_a_truth_in_one_file_is_a_root(capsys):
    waymo = SAMPLE.parent / "waymo"
    given = ("--root", waymo / "gt.bin", "--detections", waymo / "detections.bin")
    with pytest.raises(SystemExit) as stop:
        main(
            [*map(str, ("compare", "waymo", *given, "--trackers", "pmbm", "--classes", "VEHICLE"))]
        )
    assert stop.value.code == 0
    assert "| pmbm |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--metric", "MOTTA"), "did you mean 'MOTA'"),
        (("--trackers", "pmbn"), "did you mean 'pmbm'"),
        (("--rule", "iou4d"), "did you mean 'iou"),
        (("--poses", "nowhere"), "nowhere"),
    ],
)
def test_bad_arguments(folder, capsys, arguments, message):
    assert compare(folder, *arguments) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()[-1:]
    assert re.search(message, line), line
