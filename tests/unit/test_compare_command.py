"""`pmbm compare`, and the bootstrap under its intervals."""

import dataclasses
import itertools
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.metrics import evaluate
from pmbm.study import bootstrap_difference
from pmbm.tracking import make_tracker, run, tracker_factory
from sim import load_scenario

SAMPLE = Path(__file__).parents[1] / "data" / "kitti"


@pytest.fixture(scope="module")
def scored():
    """Two trackers over four short recordings of unequal length."""
    found = {"pmbm": [], "argoverse": []}
    for trial in range(4):
        recording = load_scenario("crossing").record(1, trial)
        n = 10 + 12 * trial
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
            each.append(evaluate(short, tracks, ["mota", "misses"]))
    return found


def mota(one, rows):
    """By hand: errors and objects of these sequences, summed."""
    counts = [one[row]["mota"].counts for row in rows]
    errors = ("misses", "false_positives", "switches")
    return 1 - sum(c[e] for c in counts for e in errors) / sum(c["truths"] for c in counts)


def test_the_interval_is_that_of_all_paired_resamples(scored):
    a, b = scored["pmbm"], scored["argoverse"]
    every = [mota(a, rows) - mota(b, rows) for rows in itertools.product(range(4), repeat=4)]
    found = bootstrap_difference(a, b, "mota", resamples=40_000)
    assert found.value == pytest.approx(mota(a, range(4)) - mota(b, range(4)))
    for end, share in ((found.low, 0.025), (found.high, 0.975)):
        # Resamples are few values with weights: between those of neighbouring shares.
        near = np.quantile(every, [share - 0.003, share + 0.003])
        assert near[0] - 1e-12 <= end <= near[1] + 1e-12
    assert found.low < found.value < found.high
    assert bootstrap_difference(a, a, "mota").high == 0.0
    assert bootstrap_difference(b, a, "mota", seed=3).low == pytest.approx(
        -bootstrap_difference(a, b, "mota", seed=3).high
    )


def test_a_bootstrap_of_other_sequences_is_refused(scored):
    with pytest.raises(InputError, match="the same sequences"):
        bootstrap_difference(scored["pmbm"], scored["pmbm"][:2], "mota")


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
    assert less["pmbm"]["difference"] == pytest.approx(
        car["scores"]["argoverse"]["MOTA"] - car["scores"]["pmbm"]["MOTA"]
    )
    # Standing, the poses are worth nothing.
    assert less["clairvoyant, no poses"]["difference"] == 0


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
