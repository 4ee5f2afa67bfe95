"""The paper's comparison on KITTI: every tracker with a preset for it, with paired intervals."""

import json
import os
from pathlib import Path

import pytest

from pmbm.cli import main

REPORTING = ("0006", "0008", "0010", "0012", "0014", "0015", "0016")
DATA = os.environ.get("PMBM_DATA")
NEEDS_DATA = pytest.mark.skipif(not DATA, reason="PMBM_DATA is unset: no real KITTI")
CLASSES = ("Car", "Pedestrian", "Cyclist")
BASELINES = ("argoverse", "waymo", "probabilistic_kf")


def compared(tmp_path, capsys, sequences, *options):
    """Class -> the figures of `pmbm compare`."""
    root, file = Path(DATA) / "kitti", tmp_path / "figures.json"
    where = ("--root", root, "--poses", root / "pose", "--json", file, "--sequences", *sequences)
    detections = root / "detections" / "pointrcnn_{class}"
    with pytest.raises(SystemExit) as stop:
        main([*map(str, ("compare", "kitti", *where, "--detections", detections, *options))])
    assert stop.value.code == 0
    with capsys.disabled():
        print("\n" + capsys.readouterr().out)
    return json.loads(file.read_text())["compared"]


@pytest.mark.slow
@NEEDS_DATA
def test_every_tracker_on_the_reporting_sequences(tmp_path, capsys, verified):
    figures = compared(tmp_path, capsys, REPORTING)
    for kind in CLASSES:
        scores, less = figures[kind]["scores"], figures[kind]["less it"]
        for name in BASELINES:
            one = less[name]
            verified(
                f"kitti_versus_{name}_{kind.lower()}",
                "MOTA of PMBM, online, less that of the tuned baseline, "
                f"95 % interval {one['low']:+.4f} to {one['high']:+.4f}",
                round(one["difference"], 4),
                0,
                one["difference"] > 0,
            )
        # The bound is one.
        assert all(scores["clairvoyant"]["MOTA"] > scores[name]["MOTA"] for name in BASELINES)
        assert scores["clairvoyant"]["MOTA"] > scores["pmbm"]["MOTA"]
    assert all(figures["Car"]["less it"][name]["difference"] > 0 for name in BASELINES)


@pytest.mark.slow
@NEEDS_DATA
def test_what_the_poses_are_worth(tmp_path, capsys, verified):
    """On the sequences for tuning: nothing is chosen by it."""
    tuning = [
        path.stem
        for path in sorted((Path(DATA) / "kitti" / "calib").glob("*.txt"))
        if path.stem not in REPORTING
    ]
    assert len(tuning) == 9
    figures = compared(tmp_path, capsys, tuning, "--trackers", "pmbm", "argoverse", "--ego-motion")
    for kind in CLASSES:
        for name in ("pmbm", "argoverse"):
            one = figures[kind]["less it"][f"{name}, no poses"]
            verified(
                f"kitti_poses_{name}_{kind.lower()}",
                "MOTA with ego motion less MOTA without, tuning sequences, "
                f"95 % interval {one['low']:+.4f} to {one['high']:+.4f}",
                round(one["difference"], 4),
            )
