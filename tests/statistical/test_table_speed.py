"""Reading a table of 10^6 boxes, in units of the time that pandas takes for the file alone."""

import gc
import time

import numpy as np
import pandas as pd
import pytest

from pmbm.datasets import open_dataset
from pmbm.datasets.table_files import write_table

pytestmark = pytest.mark.slow

FRAMES, OBJECTS = 20_000, 50


@pytest.fixture(scope="module")
def columns():
    rng = np.random.default_rng(1)
    rows = FRAMES * OBJECTS
    names = np.array(["car", "truck", "pedestrian"], dtype=object)
    return {
        "time": np.repeat(np.arange(FRAMES) * 0.1, OBJECTS),
        "id": np.tile(np.arange(OBJECTS), FRAMES),
        **{name: 50 * rng.standard_normal(rows) for name in ("x", "y", "z", "vx", "vy")},
        **{name: 1 + rng.random(rows) for name in ("length", "width", "height")},
        "yaw": rng.uniform(-3, 3, rows),
        "class": names[rng.integers(0, 3, rows)],
    }


def cpu_seconds(work):
    """The least CPU time of three."""
    found = []
    for _ in range(3):
        gc.collect()
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return min(found)


@pytest.mark.parametrize(("form", "bound"), [("csv", 3.0), ("parquet", 4.0)])
def test_reading_takes_few_times_what_pandas_takes(columns, tmp_path, verified, form, bound):
    file = tmp_path / "truth" / f"s.{form}"
    file.parent.mkdir()
    write_table(file, columns)
    dataset = open_dataset("table", root=tmp_path)
    assert sum(map(len, dataset.recording("s").truth)) == FRAMES * OBJECTS
    own = cpu_seconds(lambda: dataset.recording("s"))
    alone = cpu_seconds(lambda: (pd.read_csv if form == "csv" else pd.read_parquet)(file))
    verified(
        f"table_read_{form}",
        f"CPU time to read 10^6 boxes in 20,000 frames from {form}, in pandas' own time",
        round(own / alone, 2),
        bound,
        own / alone <= bound,
    )
    assert own <= bound * alone
