"""Every spoiled KITTI file ends in one InputError that names it, or in what the file says."""

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import event, given
from hypothesis import strategies as st
from spoiled import spoiled_bytes, spoiled_lines

from pmbm.datasets.kitti import Kitti
from pmbm.errors import InputError

SAMPLE = Path(__file__).parents[1] / "data" / "kitti"
FILES = {
    "label_02/0000.txt": None,
    "calib/0000.txt": None,
    "oxts/0000.txt": None,
    "pose/0000.txt": None,
    "detections/0000.txt": ",",
    "tracks/0000.txt": None,
}


@pytest.fixture(scope="module")
def folder():
    with tempfile.TemporaryDirectory() as place:
        root = Path(place) / "kitti"
        shutil.copytree(SAMPLE / "training", root)
        shutil.copytree(SAMPLE / "detections_ab3dmot", root / "detections")
        shutil.copytree(SAMPLE / "tracks", root / "tracks")
        (root / "pose").mkdir()
        lines = [f"1 0 0 {k} 0 1 0 0 0 0 1 {5 * k}" for k in range(3)]
        (root / "pose" / "0000.txt").write_text("\n".join(lines) + "\n")
        yield root


def spoiled(name):
    text = (SAMPLE / "training" / name) if "pose" not in name else None
    if name.startswith("detections"):
        text = SAMPLE / "detections_ab3dmot" / "0000.txt"
    elif name.startswith("tracks"):
        text = SAMPLE / name
    good = "1 0 0 0 0 1 0 0 0 0 1 0\n" * 3 if text is None else text.read_text()
    return st.one_of(spoiled_bytes(good.encode()), spoiled_lines(good, FILES[name]))


def load(root, name):
    poses = root / ("oxts" if name.startswith("oxts") else "pose")
    source = Kitti(root=root, detections=str(root / "detections"), poses=poses)
    if name.startswith("tracks"):
        return source.read("0000", root / "tracks")
    return source.recording("0000")


@pytest.mark.filterwarnings("ignore::pmbm.errors.InputWarning")
@pytest.mark.parametrize("name", FILES)
@given(data=st.data())
def test_one_named_error_or_the_right_result(folder, name, data):
    content = data.draw(spoiled(name))
    path = folder / name
    good = path.read_bytes()
    path.write_bytes(content)
    result, refused = None, None
    try:
        result = load(folder, name)
    except InputError as error:
        refused = error
    finally:
        path.write_bytes(good)
    event("accepted" if refused is None else "refused")
    if refused is None:
        assert_says(content.decode(), name, result)
    else:
        # A frame that has no pose is the fault of either file.
        own = Path(refused.file) == path
        assert own or (refused.frame is not None and "without a pose" in refused.problem)
        assert "\n" not in str(refused)


def assert_says(text, name, result):
    """The accepted text, read by the plainest code there is, holds what came out."""
    rows = [line.replace(",", " ").split() for line in text.split("\n") if line.strip()]
    if name.startswith("label"):
        rows = [row for row in rows if row[2] in ("Car", "Van", "Pedestrian", "Person", "Cyclist")]
        heights, found = [float(row[10]) for row in rows], result.truth
    elif name.startswith("detections"):
        rows = [row for row in rows if row[1] in "123"]
        heights, found = [float(row[7]) for row in rows], result.detections
    elif name.startswith("tracks"):
        heights, found = [float(row[10]) for row in rows], result
    elif name.startswith(("pose", "oxts")):
        assert len(result) == len(rows)
        return
    else:
        return
    frames = [int(row[0]) for row in rows]
    counts = np.bincount(frames, minlength=len(found)) if frames else np.zeros(len(found))
    assert [len(frame) for frame in found] == counts.tolist()
    sizes = np.concatenate([frame.size[:, 2] for frame in found] or [np.zeros(0)])
    assert sorted(sizes.tolist()) == sorted(heights)
