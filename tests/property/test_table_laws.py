"""Recordings come back from their tables bit for bit, whatever is in them."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pmbm.datasets import open_dataset
from pmbm.datasets.table_files import read_table, write_table
from pmbm.tables.reading import parts
from pmbm.tables.writing import recording_columns
from pmbm.types import Detections, GroundTruth, Label, Recording, Site

COORDINATE = st.floats(-1e8, 1e8)
SIDE = st.floats(0, 1000, exclude_min=True)
SHARE = st.floats(0, 1)
NAME = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Zl", "Zp")), max_size=6)


def columns(draw, n):
    def table(elements, *shape):
        return draw(arrays(np.float64, (n, *shape), elements=elements))

    return {
        "position": table(COORDINATE, 3),
        "size": table(SIDE, 3),
        "yaw": table(st.floats(-np.pi, np.pi, exclude_max=True)),
        "label": draw(arrays(np.int64, n, elements=st.integers(0, max(Label)))),
    }


@st.composite
def recordings(draw):
    times = sorted(draw(st.sets(st.integers(-(10**6), 10**6), min_size=1, max_size=5)))
    scale = draw(st.sampled_from([0.1, 1 / 3, 1.0, 977.0]))
    truth = []
    for time in times:
        ids = sorted(draw(st.sets(st.integers(-5, 10**18 - 1), max_size=3)))
        ids = draw(st.permutations(ids))
        n = len(ids)
        truth.append(
            GroundTruth(
                time=time * scale,
                id=np.array(ids, np.int64),
                **columns(draw, n),
                velocity=draw(arrays(np.float64, (n, 2), elements=COORDINATE)),
                visibility=draw(arrays(np.float64, n, elements=SHARE)),
                observable=draw(arrays(bool, n)),
                crashed=draw(arrays(bool, n)),
            )
        )
    frame = draw(st.lists(st.integers(0, len(times) - 1), max_size=6))
    raw, known = draw(st.booleans()), draw(st.booleans())
    detections, origin = [], []
    for f in frame:
        n = draw(st.integers(0, 3))
        late = draw(st.sampled_from([0.0, 0.0, 0.25]))
        detections.append(
            Detections(
                time=truth[f].time + late,
                **columns(draw, n),
                score=draw(arrays(np.float64, n, elements=SHARE)),
                sensor_pose=draw(arrays(np.float64, 3, elements=COORDINATE)),
                raw_score=draw(arrays(np.float64, n, elements=COORDINATE)) if raw else None,
            )
        )
        origin.append(draw(arrays(np.int64, n, elements=st.integers(-1, len(truth[f]) - 1))))
    there = sorted({i for f in truth for i in f.id.tolist()})
    named = draw(st.lists(st.sampled_from(there), unique=True)) if there else []
    return Recording(
        name="r",
        site=Site(max_range=draw(st.floats(1, 1e6))),
        truth=truth,
        detections=detections,
        frame=np.array(frame, np.int64),
        origin=origin if known else None,
        stamp=np.array([draw(st.integers(-(2**63), 2**63 - 1)) for _ in times], np.int64),
        object_name={i: draw(NAME) for i in named},
    )


def same(one, other):
    if one.detections and all(d.raw_score is None for d in one.detections):
        assert all(d.raw_score is None for d in other.detections)
    return one.digest() == other.digest()


def origins_told(made):
    """Without a delivery there is no origin to tell."""
    return made if made.detections else None


@given(recordings())
def test_through_frames(made):
    back = Recording.from_tables(made.to_tables(), site=made.site)
    assert same(made, back)


@pytest.mark.parametrize("form", ["csv", "parquet"])
@settings(max_examples=settings.default.max_examples // 2)
@given(made=recordings())
def test_through_files(form, made):
    with tempfile.TemporaryDirectory() as folder:
        cells = {}
        for what, table in recording_columns(made).items():
            path = Path(folder) / f"{what}.{form}"
            write_table(path, table)
            cells[what] = read_table(path, what)
        back = Recording.from_parts(parts(cells), name="r", site=made.site, provenance={})
    assert same(made, back)


@settings(max_examples=settings.default.max_examples // 2)
@given(made=recordings(), seed=st.integers(0, 9))
def test_the_order_of_rows_matters_only_within_a_frame(made, seed):
    """Rows of different frames may stand in any order."""
    tables = made.to_tables()
    truth = tables["truth"]
    shuffled = truth.sample(frac=1, random_state=seed)
    # Stable within frames: rows of one frame in the order that they had.
    place = shuffled.groupby("frame").cumcount()
    ranked = truth.assign(place=truth.groupby("frame").cumcount())
    moved = (
        shuffled[["frame"]]
        .assign(place=place)
        .merge(ranked, on=["frame", "place"])[truth.columns.tolist()]
        .reset_index(drop=True)
    )
    back = Recording.from_tables({**tables, "truth": moved}, site=made.site)
    assert back.truth_digest() == made.truth_digest()


def test_the_dataset_reads_the_same(tmp_path):
    from pmbm.sim import load_scenario

    made = load_scenario("crossing").record(2)
    for what, table in recording_columns(made).items():
        (tmp_path / what).mkdir()
        write_table(tmp_path / what / "s.parquet", table)
    dataset = open_dataset("table", root=tmp_path, detections=str(tmp_path / "detections"))
    assert dataset.recording("s").detections_digest() == made.detections_digest()
