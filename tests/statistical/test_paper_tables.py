"""What the poses of the moving sensor are worth on KITTI."""

import json
import os
from pathlib import Path

import pytest

from pmbm.cli import main

DATA = os.environ.get("PMBM_DATA")
NEEDS_DATA = pytest.mark.skipif(not DATA, reason="PMBM_DATA is unset: no real KITTI")
CLASSES = ("Car", "Pedestrian", "Cyclist")


@pytest.mark.slow
@NEEDS_DATA
def test_what_the_poses_are_worth(tmp_path, capsys, verified):
    """With the presets that ship, fitted to these sequences with poses."""
    root, file = Path(DATA) / "kitti", tmp_path / "figures.json"
    where = ("--root", root, "--poses", root / "pose", "--json", file)
    detections = root / "detections" / "pointrcnn_{class}"
    options = ("--trackers", "pmbm", "argoverse", "--ego-motion", "--detections", detections)
    with pytest.raises(SystemExit) as stop:
        main([*map(str, ("compare", "kitti", *where, *options))])
    assert stop.value.code == 0
    with capsys.disabled():
        print("\n" + capsys.readouterr().out)
    figures = json.loads(file.read_text())["compared"]
    for kind in CLASSES:
        for name in ("pmbm", "argoverse"):
            one = figures[kind]["less it"][f"{name}, no poses"]["MOTA"]
            verified(
                f"kitti_poses_{name}_{kind.lower()}",
                "MOTA with ego motion less MOTA without, presets that ship, "
                f"95 % interval {one['low']:+.4f} to {one['high']:+.4f}",
                round(one["difference"], 4),
            )
