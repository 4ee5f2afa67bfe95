"""Every spoiled file of a driving log ends in one InputError that names a file, or in what the file
says."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoiled import NASTY, spoiled_bytes, spoiled_json

from pmbm.datasets import open_dataset
from pmbm.errors import InputError
from pmbm.types import Tracks, TrackSequence

DATA = Path(__file__).parents[1] / "data"
LOG = "00000000-1111-2222-3333-444444444444"
SEGMENT = "1234567890123456789_100_000_120_000"
SAMPLES = {
    "argoverse1": ("val", "detections/validation", LOG),
    "argoverse2": ("val", "detections.feather", LOG),
    "nuscenes": ("v1.0-mini", "detections.json", "scene-0001"),
    "waymo": ("v2", "detections.bin", SEGMENT),
}
SWEEP = "per_sweep_annotations_amodal/tracked_object_labels_315970000100000000.json"
JSON_FILES = [
    f"argoverse1/val/{LOG}/{SWEEP}",
    f"argoverse1/detections/validation/{LOG}/{SWEEP}",
    f"argoverse1/out/{LOG}/{SWEEP}",
    f"argoverse1/val/{LOG}/poses/city_SE3_egovehicle_315970000100000000.json",
    "nuscenes/detections.json",
    "nuscenes/out/scene-0001.json",
    *[
        f"nuscenes/v1.0-mini/{name}.json"
        for name in ("sample", "scene", "sample_annotation", "instance", "category")
    ],
    *[
        f"nuscenes/v1.0-mini/{name}.json"
        for name in ("ego_pose", "sample_data", "calibrated_sensor", "sensor")
    ],
]
TABLES = [
    "argoverse2/detections.feather",
    f"argoverse2/val/{LOG}/annotations.feather",
    f"argoverse2/val/{LOG}/city_SE3_egovehicle.feather",
    f"argoverse2/out/{LOG}.feather",
    f"waymo/v2/lidar_box/{SEGMENT}.parquet",
    f"waymo/v2/vehicle_pose/{SEGMENT}.parquet",
]
FEWER = settings(max_examples=settings.default.max_examples // 2)
"""Many files share their readers."""
MESSAGES = ["waymo/detections.bin", "waymo/gt.bin", f"waymo/out/{SEGMENT}.bin"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("logs")
    for name in SAMPLES:
        shutil.copytree(DATA / name, place / name)
        (place / name / "out").mkdir()
    shutil.copy(DATA / "nuscenes" / "tracks.json", place / "nuscenes/out/scene-0001.json")
    shutil.copy(DATA / "waymo" / "tracks.bin", place / f"waymo/out/{SEGMENT}.bin")
    for name in ("argoverse1", "argoverse2"):
        _, _, log = SAMPLES[name]
        dataset = opened(place, name)
        dataset.write(log, as_seen(dataset.recording(log)), place / name / "out")
    return place


def opened(folder, name, root=None):
    place, detections, _ = SAMPLES[name]
    return open_dataset(
        name, root=folder / name / (root or place), detections=str(folder / name / detections)
    )


def as_seen(made):
    """The detections as tracks, so that there is a result to spoil."""
    steps = [
        Tracks(
            time=seen.time,
            id=np.arange(len(seen)),
            position=seen.position,
            size=seen.size,
            yaw=seen.yaw,
            velocity=np.zeros((len(seen), 2)),
            score=seen.score,
            label=seen.label,
        )
        for seen in made.detections
    ]
    return TrackSequence(steps=steps, frame=made.frame)


def outcome(folder, path, content):
    """What reading gives with this content in place of the file's, or the error."""
    name = path.split("/")[0]
    _, _, sequence = SAMPLES[name]
    file = folder / path
    good = file.read_bytes()
    file.write_bytes(content)
    try:
        # A metrics.Objects file stands for a whole split, without poses.
        dataset = opened(folder, name, "gt.bin" if path == "waymo/gt.bin" else None)
        if "/out/" in path:
            return dataset.read(sequence, folder / name / "out")
        return dataset.recording(sequence)
    except InputError as error:
        return error
    finally:
        file.write_bytes(good)


def check(folder, path, result):
    """One named error, or finite boxes; gives whether it was accepted."""
    if isinstance(result, InputError):
        assert "\n" not in str(result)
        assert result.file is not None
        assert Path(result.file).is_relative_to(folder)
        # A file that lacks what another needs may make the other one speak.
        same = Path(result.file) == folder / path
        assert same or any(
            word in result.problem
            for word in ("no record", "no such", "missing", "without", "than the scene", "unknown")
        ), str(result)
        return False
    return True


def frames_of(result, path):
    if "/out/" in path:
        return result
    return result.detections if "detections" in path else result.truth


@pytest.mark.parametrize("path", JSON_FILES)
@FEWER
@given(data=st.data())
def test_json(folder, path, data):
    text = (folder / path).read_text()
    content = data.draw(
        st.one_of(
            spoiled_json(json.loads(text)).map(lambda value: json.dumps(value).encode()),
            spoiled_bytes(text.encode()),
        )
    )
    result = outcome(folder, path, content)
    if not check(folder, path, result) or "argoverse1" not in path or "poses" in path:
        return
    rows = json.loads(content)
    frames = frames_of(result, path)
    wanted = [r for r in rows if r["label_class"] in ("VEHICLE", "PEDESTRIAN")]
    assert sorted(frames[1].size[:, 0].tolist()) == sorted(float(r["length"]) for r in wanted)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 100_000, '{"a": 1, "a": 2}', "", "9" * 5000]
)
@pytest.mark.parametrize("path", [JSON_FILES[0], JSON_FILES[3]])
def test_json_that_only_looks_like_it(folder, path, text):
    assert not check(folder, path, outcome(folder, path, text.encode()))


@pytest.mark.parametrize("path", MESSAGES)
@FEWER
@given(data=st.data())
def test_messages(folder, path, data):
    content = data.draw(spoiled_bytes((folder / path).read_bytes()))
    check(folder, path, outcome(folder, path, content))


def written(table, path):
    import io

    import pyarrow.feather
    import pyarrow.parquet

    buffer = io.BytesIO()
    if path.endswith("parquet"):
        pyarrow.parquet.write_table(table, buffer)
    else:
        pyarrow.feather.write_feather(table, buffer)
    return buffer.getvalue()


def loaded(file):
    import pyarrow.feather
    import pyarrow.parquet

    module = pyarrow.parquet if file.suffix == ".parquet" else pyarrow.feather
    return module.read_table(str(file))


@st.composite
def spoiled_table(draw, table):
    """Cells replaced, rows doubled or taken out, columns renamed, retyped or taken out."""
    import pyarrow as pa

    columns = {name: table.column(name).to_pylist() for name in table.column_names}
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(sorted(columns)))
        rows = len(columns[name])
        kind = draw(st.sampled_from(["cell", "cell", "cell", "drop", "double", "remove", "retype"]))
        row = draw(st.integers(0, max(rows - 1, 0)))
        if kind == "drop" and len(columns) > 1:
            del columns[name]
        elif kind == "double" and rows:
            columns = {key: [*values, values[row]] for key, values in columns.items()}
        elif kind == "remove":
            columns = {key: values[:row] + values[row + 1 :] for key, values in columns.items()}
        elif kind == "retype":
            columns[name] = [str(value) for value in columns[name]]
        elif rows:
            values = (None, 0, -1, float("nan"), 1e308, -1e308, 10**18, 0.5, *NASTY[:20])
            columns[name] = [*columns[name]]
            columns[name][row] = draw(st.sampled_from(values))
    arrays = {}
    for name, values in columns.items():
        try:
            arrays[name] = pa.array(values)
        except (pa.ArrowException, OverflowError):
            arrays[name] = pa.array([None if value is None else str(value) for value in values])
    return pa.table(arrays)


@pytest.mark.parametrize("path", TABLES)
@FEWER
@given(data=st.data())
def test_tables(folder, path, data):
    table = data.draw(spoiled_table(loaded(folder / path)))
    result = outcome(folder, path, written(table, path))
    if check(folder, path, result):
        frames = frames_of(result, path)
        assert all(np.isfinite(frame.position).all() for frame in frames)


@pytest.mark.parametrize("path", TABLES)
@FEWER
@given(data=st.data())
def test_table_bytes(folder, path, data):
    content = data.draw(spoiled_bytes((folder / path).read_bytes()))
    check(folder, path, outcome(folder, path, content))


def test_files_of_no_use(folder):
    """Names that are not sweeps, and links out of the folder by way of a name."""
    stray = folder / f"argoverse1/val/{LOG}/per_sweep_annotations_amodal/notes.json"
    stray.write_text("[]")
    dataset = open_dataset("argoverse1", root=folder / "argoverse1" / "val")
    try:
        with pytest.raises(InputError, match=r"another name.*notes.json"):
            dataset.recording(LOG)
    finally:
        stray.unlink()
    for name in ("../val/" + LOG, "/etc", ".", "a/b", "a\\b", ""):
        with pytest.raises(InputError):
            dataset.recording(name)
