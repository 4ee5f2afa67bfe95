"""`pmbm fit-marks` on a small folder in KITTI's layout: its file is one that `pmbm track` takes."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from pmbm.cli import main

CALIBRATION = Path(__file__).parents[1] / "data" / "kitti" / "training" / "calib" / "0000.txt"


def pmbm(*arguments):
    """The exit code."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return stop.value.code


@pytest.fixture
def folder(tmp_path):
    """Three standing cars and three poles before a camera that stands, in three sequences."""
    root = tmp_path / "kitti"
    for part in ("calib", "label_02", "pose", "dets_Car"):
        (root / part).mkdir(parents=True)
    calibration = CALIBRATION.read_text()
    rng = np.random.default_rng(0)
    place = [(-6, 15), (0, 20), (6, 26), (-8, 30), (3, 34), (9, 18)]
    for name in ("0000", "0001", "0006"):
        labels, found = [], []
        for k in range(40):
            for i, (x, z) in enumerate(place):
                box = f"1.5 1.7 4.0 {x} 1.6 {z} 0.0"
                if i < 3:
                    labels.append(f"{k} {i} Car 0 0 0 500 150 600 250 {box}")
                if rng.random() < 0.85 or k in (0, 39):
                    score = rng.normal(5 if i < 3 else -1, 0.7)
                    found.append(
                        f"{k},2,500,150,600,250,{score:.3f},1.5,1.7,4.0,"
                        f"{x + rng.normal(0, 0.1):.3f},1.6,{z + rng.normal(0, 0.1):.3f},0.0,0.0"
                    )
        (root / "calib" / f"{name}.txt").write_text(calibration)
        (root / "label_02" / f"{name}.txt").write_text("\n".join(labels) + "\n")
        (root / "dets_Car" / f"{name}.txt").write_text("\n".join(found) + "\n")
        (root / "pose" / f"{name}.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 40)
    return root


def fit(root, *options):
    return pmbm(
        *("fit-marks", "kitti", "--root", root, "--detections", root / "dets_{class}"),
        *("--poses", root / "pose", "--classes", "Car", "--out", root / "marks.toml"),
        *options,
    )


def test_the_file_is_one_to_track_with(folder):
    assert fit(folder, "--sequences", "0000") == 0
    made = tomllib.loads((folder / "marks.toml").read_text())["Car"]
    level, share = np.array(made["scores"]["level"]), np.array(made["scores"]["object"])
    assert (np.diff(level) > 0).all()
    assert share[0] < 0.2 < 0.8 < share[-1]
    assert sum(made["scores"]["birth"]) == pytest.approx(1)
    assert 0.8 < made["sensor"]["detection"]["base"]["probability"] <= 1
    code = pmbm(
        *("track", "kitti", "--root", folder, "--detections", folder / "dets_{class}"),
        *("--poses", folder / "pose", "--classes", "Car", "--sequences", "0001"),
        *("--config", folder / "marks.toml", "--out", folder / "out"),
    )
    assert code == 0
    rows = [row.split() for row in (folder / "out" / "0001.txt").read_text().splitlines()]
    last = [float(row[15]) for row in rows if row[0] == "39"]
    assert sorted(last) == pytest.approx([15, 20, 26], abs=0.5)


def test_what_is_for_tuning_stays_as_it_was_given(folder):
    assert fit(folder, "--sequences", "0000") == 0
    first = (folder / "marks.toml").read_text()
    assert "drift = 0.0" in first
    given = folder / "given.toml"
    given.write_text(first.replace("drift = 0.0", "drift = 0.4"))
    assert fit(folder, "--sequences", "0000", "--config", given) == 0
    assert (folder / "marks.toml").read_text() == given.read_text()


def test_sequences_for_reporting_are_refused(folder, capsys):
    assert fit(folder, "--sequences", "0000", "0006") == 2
    assert "kept for reporting" in capsys.readouterr().err
    assert not (folder / "marks.toml").exists()


def test_classes_to_share_are_checked(folder, capsys):
    assert fit(folder, "--sequences", "0000", "--together", "Car", "Cart") == 2
    assert "did you mean 'Car'" in capsys.readouterr().err
