"""`pmbm fit-tracker` on a small folder in KITTI's layout: its preset is one to
track with, and knows the detector that it is of."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from pmbm.cli import main
from pmbm.sim.toml_tables import toml_text

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
    for name in ("0000", "0001", "0002", "0003"):
        labels, found = [], []
        for k in range(60):
            for i, (x, z) in enumerate(place):
                box = f"1.5 1.7 4.0 {x} 1.6 {z} 0.0"
                if i < 3:
                    labels.append(f"{k} {i} Car 0 0 0 500 150 600 250 {box}")
                if rng.random() < 0.85 or k in (0, 59):
                    score = rng.normal(5 if i < 3 else -1, 0.7)
                    found.append(
                        f"{k},2,500,150,600,250,{score:.3f},1.5,1.7,4.0,"
                        f"{x + rng.normal(0, 0.1):.3f},1.6,{z + rng.normal(0, 0.1):.3f},0.0,0.0"
                    )
        (root / "calib" / f"{name}.txt").write_text(calibration)
        (root / "label_02" / f"{name}.txt").write_text("\n".join(labels) + "\n")
        (root / "dets_Car" / f"{name}.txt").write_text("\n".join(found) + "\n")
        (root / "pose" / f"{name}.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 60)
    return root


def fit(root, *options, out="mine.toml"):
    return pmbm(
        *("fit-tracker", "kitti", "--root", root, "--detections", root / "dets_{class}"),
        *("--poses", root / "pose", "--classes", "Car", "--out", root / out),
        *options,
    )


def track(root, *options):
    return pmbm(
        *("track", "kitti", "--root", root, "--detections", root / "dets_{class}"),
        *("--poses", root / "pose", "--classes", "Car", "--out", root / "out"),
        *options,
    )


def rescaled(root, factor, shift):
    """The same detections with other scores."""
    for path in (root / "dets_Car").iterdir():
        lines = [line.split(",") for line in path.read_text().splitlines()]
        for line in lines:
            line[6] = f"{factor * float(line[6]) + shift:.4f}"
        path.write_text("\n".join(map(",".join, lines)) + "\n")


def reported(root, name="0003"):
    """Distances ahead of what is reported in the last frame."""
    rows = [row.split() for row in (root / "out" / f"{name}.txt").read_text().splitlines()]
    return sorted(float(row[15]) for row in rows if row[0] == "59")


def test_the_preset_is_one_to_track_with(folder, capsys):
    assert fit(folder, "--sequences", "0000", "0001", "0002", "--folds", "3") == 0
    told = capsys.readouterr()
    said = told.out
    # What ships has seen KITTI's own sequences, and these may be some.
    assert "--beside" in told.err
    made = tomllib.loads((folder / "mine.toml").read_text())
    assert made["Car"]["scores"]["kind"] == "record"
    assert len(made["detector"]["Car"]["scores"]) == 5
    # Each sequence was tracked by a fit to the other two: three cars, and none of the poles.
    row = next(line for line in said.splitlines() if line.startswith("| Car"))
    cells = [cell.strip() for cell in row.split("|")]
    assert float(cells[2]) > 0.9
    assert float(cells[7]) < 0.05
    assert "Car is true:" in said
    assert track(folder, "--config", folder / "mine.toml", "--sequences", "0003") == 0
    assert reported(folder) == pytest.approx([15, 20, 26], abs=0.5)
    assert "another detector" not in capsys.readouterr().err


def test_another_detectors_scores_are_told_and_rescaled(folder, capsys):
    assert fit(folder, "--folds", "0") == 0
    rescaled(folder, 0.5, 2.0)
    assert track(folder, "--config", folder / "mine.toml") == 0
    assert "preset is of another detector" in capsys.readouterr().err
    again = ("--unlabelled", "--config", folder / "mine.toml")
    for path in (folder / "label_02").iterdir():
        path.unlink()
    assert fit(folder, *again, out="other.toml") == 0
    assert track(folder, "--config", folder / "other.toml") == 0
    assert "another detector" not in capsys.readouterr().err
    assert reported(folder) == pytest.approx([15, 20, 26], abs=0.5)


@pytest.mark.parametrize("tracker", ["argoverse", "waymo", "probabilistic_kf"])
def test_a_baseline_is_fitted_to_the_same_data(folder, tracker, capsys):
    """Its thresholds part the cars from the poles, on any scale of the scores; and the preset says
    what it was fitted to."""
    rescaled(folder, 0.2, -3.0)
    two = ("--sequences", "0000", "0001", "--folds", "2")
    assert fit(folder, "--tracker", tracker, *two) == 0
    said = capsys.readouterr().out
    row = next(line for line in said.splitlines() if line.startswith("| Car"))
    mota, _, idf1, hota = (cell.strip() for cell in row.split("|")[2:6])
    assert float(mota) > 0.75
    assert min(float(idf1), float(hota)) > 0.7
    made = tomllib.loads((folder / "mine.toml").read_text())
    low, middle, high = (made["detector"]["Car"]["scores"][k] for k in (0, 2, 4))
    assert low < -3.0 < middle < high
    assert ("noise" in made["Car"]) == (tracker == "probabilistic_kf")
    on = ("--config", folder / "mine.toml", "--sequences", "0003")
    assert track(folder, "--tracker", tracker, *on) == 0
    found = reported(folder)
    assert len(found) >= 2
    assert all(min(abs(car - one) for car in (15, 20, 26)) < 0.5 for one in found)


def test_what_is_not_fitted_is_refused(folder, capsys):
    for options, message in [
        (("--tracker", "pmbm-paper"), "nothing of the tracker 'pmbm-paper' is fitted"),
        (("--tracker", "waymo", "--mode", "batch"), "--mode batch is of the tracker 'pmbm'"),
        (("--tracker", "waymo", "--unlabelled"), "--unlabelled is of the tracker 'pmbm'"),
    ]:
        assert fit(folder, *options) == 2
        assert message in capsys.readouterr().err


def test_trackers_fitted_to_the_same_folds_are_compared(folder, capsys):
    """Each row of the comparison is what the tracker's own fit tells of sequences left out."""
    options = (
        *("compare", "kitti", "--root", folder, "--detections", folder / "dets_{class}"),
        *("--poses", folder / "pose", "--classes", "Car"),
    )
    two = ("--sequences", "0000", "0001")
    fitted = ("--fit", "2", "--metric", "MOTA", "HOTA", *two)
    assert pmbm(*options, *fitted, "--trackers", "pmbm", "waymo", "clairvoyant") == 0
    said = capsys.readouterr().out
    assert "in 2 folds, each tracked by fits to the others" in said
    rows = {line.split(" | ")[0]: line.split(" | ") for line in said.splitlines() if "|" in line}
    assert rows["| Car"][-2:] == ["MOTA of pmbm less it", "HOTA of pmbm less it |"]
    for tracker in ("pmbm", "waymo"):
        assert fit(folder, "--tracker", tracker, *two, "--folds", "2") == 0
        alone = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("| Car"))
        assert rows[f"| {tracker}"][1] == alone.split(" | ")[1]
    assert pmbm(*options, "--fit", "2", "--published") == 2
    assert "not as published" in capsys.readouterr().err


def test_where_nothing_could_be_reported_it_is_refused(folder, capsys):
    assert fit(folder, "--folds", "0") == 0
    rescaled(folder, 0.1, -6.0)
    assert track(folder, "--config", folder / "mine.toml") == 2
    said = capsys.readouterr().err
    assert "would report nothing" in said
    assert "pmbm fit-tracker" in said


def test_a_run_without_poses_or_reports_says_so(folder, capsys):
    assert fit(folder, "--folds", "0") == 0
    config = folder / "deaf.toml"
    deaf = tomllib.loads((folder / "mine.toml").read_text())
    del deaf["detector"]
    deaf["Car"]["scores"]["online"]["offset"] = -30.0
    config.write_text(toml_text(deaf))
    code = pmbm(
        *("track", "kitti", "--root", folder, "--detections", folder / "dets_{class}"),
        *("--classes", "Car", "--out", folder / "out", "--config", config),
    )
    assert code == 0
    said = capsys.readouterr().err
    assert "no track was reported among" in said
    assert "no --poses" in said


def test_levels_cannot_be_put_on_another_scale(folder, capsys):
    config = folder / "plain.toml"
    config.write_text('[scores]\nkind = "ignore"\n')
    assert fit(folder, "--unlabelled", "--config", config) == 2
    assert "only a score record" in capsys.readouterr().err


def test_a_fit_is_held_to_detectors_beside(folder, capsys):
    """Without labels of one's own, what is known is theirs: a detector's preset is the same
    whether its labels are read or those of its double."""
    beside = ("--beside", folder / "dets_{class}")
    assert fit(folder, *beside, "--unlabelled", "--folds", "2", out="held.toml") == 0
    told = capsys.readouterr()
    assert "| Car" in told.out
    assert "--beside" not in told.err
    assert fit(folder, *beside, "--folds", "0", out="own.toml") == 0
    held, own = (tomllib.loads((folder / f"{name}.toml").read_text()) for name in ("held", "own"))
    assert held["Car"]["scores"]["middle"] == own["Car"]["scores"]["middle"]
    for name, value in held["Car"]["scores"]["online"].items():
        assert own["Car"]["scores"]["online"][name] == pytest.approx(value, abs=1.0), name
