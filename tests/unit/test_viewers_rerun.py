"""Logs for Rerun, read back by its own reader and counted."""

from collections import defaultdict

import numpy as np
import pytest
from test_viewers import UTM, messages, moved, replay_of

from pmbm.reports.viewers import write_log
from pmbm.reports.viewers.layout import nanoseconds

pytest.importorskip("rerun", reason="rerun-sdk is not installed")


def read(file):
    """Path -> rows of component -> value; the time in nanoseconds is "time", None of what is
    static.  The wall clock that Rerun adds is left out."""
    from rerun.chunk import RrdReader

    rows = defaultdict(list)
    for chunk in RrdReader(str(file)).stream():
        batch = chunk.to_record_batch()
        names = [n for n in batch.schema.names if n not in ("rerun.controls.RowId", "log_time")]
        for k in range(batch.num_rows):
            row = {n: batch.column(n)[k].as_py() for n in names if n != "time"}
            row["time"] = batch.column("time")[k].value if "time" in names else None
            rows[str(chunk.entity_path)].append(row)
    return {path: sorted(found, key=lambda row: row["time"] or 0) for path, found in rows.items()}


@pytest.fixture(scope="module")
def replay():
    return replay_of(3)


@pytest.fixture(scope="module")
def logged(replay, tmp_path_factory):
    file = tmp_path_factory.mktemp("logs") / "run.rrd"
    write_log(replay, file)
    return read(file)


BOXES = ("centers", "half_sizes", "quaternions", "colors", "labels", "radii")


def tables_of(replay):
    recording = replay.recording
    tables = {"/scene/truth": recording.truth, "/scene/detections/sensor": recording.detections}
    return tables | {f"/scene/tracks/{name}": steps for name, steps in replay.tracks.items()}


def test_every_frame_is_there_with_every_component(replay, logged):
    empty = 0
    for path, tables in tables_of(replay).items():
        assert len(logged[path]) == len(tables)
        for row, table in zip(logged[path], tables, strict=True):
            assert row["time"] == nanoseconds(table.time)
            # What is left out would stay from the frame before: labels of boxes that are gone.
            assert {len(row[f"Boxes3D:{name}"]) for name in BOXES} == {len(table)}
            empty += not len(table)
            centres = np.array(row["Boxes3D:centers"]).reshape(-1, 3)
            np.testing.assert_array_equal(centres, table.position.astype(np.float32))
            sizes = np.array(row["Boxes3D:half_sizes"]).reshape(-1, 3)
            np.testing.assert_array_equal(sizes, (table.size / 2).astype(np.float32))
    assert empty
    for name, tracks in replay.tracks.items():
        for row, step in zip(logged[f"/scene/tracks/{name}"], tracks, strict=True):
            said = [text.split()[0] for text in row["Boxes3D:labels"]]
            assert said == [str(i) for i in step.id.tolist()]
        for part in ("velocity", "spread"):
            assert len(logged[f"/scene/tracks/{name}/{part}"]) == len(tracks)


def test_nothing_static_hides_what_is_timed(logged):
    static = {path for path, rows in logged.items() if any(row["time"] is None for row in rows)}
    assert static == {"/origin", "/scene/sensor/view"}
    for path in static:
        assert len(logged[path]) == 1


def test_metrics_are_those_of_the_page(replay, logged):
    for name, series in replay.series.items():
        for metric, values in series.items():
            told = [row["Scalars:scalars"] for row in logged[f"/metrics/{metric}/{name}"]]
            assert told == [[v] if np.isfinite(v) else [] for v in values.tolist()]
    assert len(logged["/scene/unseen/pmbm"]) == len(replay.tracks["pmbm"])


def test_far_from_zero_centres_keep_a_millimetre(replay, tmp_path):
    far, file = moved(replay, UTM), tmp_path / "far.rrd"
    write_log(far, file)
    found = read(file)
    origin = np.array(found["/origin"][0]["metres"])
    assert np.abs(origin[:2]).min() > 1e5
    for row, truth in zip(found["/scene/truth"], far.recording.truth, strict=True):
        centres = np.array(row["Boxes3D:centers"]).reshape(-1, 3)
        np.testing.assert_allclose(centres + origin, truth.position, atol=1e-3)


def test_equal_seeds_read_back_equal_and_two_logs_do_not_mix(logged, tmp_path):
    import threading

    replays = replay_of(3), replay_of(4, ("argoverse",))
    files = [tmp_path / "a.rrd", tmp_path / "b.rrd"]
    threads = [
        threading.Thread(target=write_log, args=pair) for pair in zip(replays, files, strict=True)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert read(files[0]) == logged
    assert not any("pmbm" in path for path in read(files[1]))


def test_both_viewers_are_told_the_same(replay, logged, tmp_path):
    file = tmp_path / "run.mcap"
    write_log(replay, file)
    of_foxglove = messages(file)
    for path, topic in (("/scene/truth", "/truth"), ("/scene/tracks/pmbm", "/tracks/pmbm")):
        for row, (*_, stamp, value) in zip(logged[path], of_foxglove[topic], strict=True):
            assert row["time"] == stamp
            texts = [entity["texts"][0]["text"] for entity in value["entities"]]
            assert row["Boxes3D:labels"] == texts
