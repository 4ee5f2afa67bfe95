"""What the store promises: nothing lost, nothing altered, one driver, one line for what fails."""

import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_worlds import Convoy

from pmbm.errors import InputError
from pmbm.study import export, load_results, read_store, run_study, store
from pmbm.study.file import load_study

TEXT = """
scenarios = ["convoy"]
trackers = ["study_worlds:Echo", "study_worlds:Blind"]
metrics = ["ospa", "motp"]
trials = 4
[sweep.grid]
noise = [0.1, 0.5]
"""


@pytest.fixture
def study(tmp_path):
    file = tmp_path / "night.toml"
    file.write_text(TEXT)
    return load_study(file, lambda name, overrides: Convoy(frames=3, **overrides))


@pytest.fixture
def whole(study, tmp_path):
    """The store of an uninterrupted run."""
    file = tmp_path / "whole.sqlite"
    run_study(study, file, jobs=0)
    return file


def digest(file):
    return read_store(file).digest()


def test_the_digest_is_of_results_alone(study, whole, tmp_path):
    again = tmp_path / "again.sqlite"
    run_study(study, again, jobs=0)
    times = [[row.time for row in read_store(f).rows.values()] for f in (whole, again)]
    assert times[0] != times[1]
    assert digest(whole) == digest(again)
    more = tmp_path / "more.sqlite"
    run_study(replace(study, trials=5), more, jobs=0)
    assert digest(more) != digest(whole)


def test_a_study_grows(study, whole, tmp_path):
    bigger = replace(study, trials=6)
    done = run_study(bigger, whole, jobs=0)
    assert (done.total, done.done) == (12, 12)
    fresh = tmp_path / "fresh.sqlite"
    run_study(bigger, fresh, jobs=0)
    assert digest(fresh) == digest(whole)


def test_running_again_computes_nothing(study, whole, monkeypatch):
    monkeypatch.setattr("pmbm.study.runner.compute", lambda task: pytest.fail("computed"))
    assert run_study(study, whole, jobs=0).done == 8


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": 1}, "seed differs"),
        ({"metrics": ("ospa",)}, "metrics differs"),
    ],
)
def test_another_study_is_refused(study, whole, change, words):
    with pytest.raises(InputError, match=words):
        run_study(replace(study, **change), whole, jobs=0)


def test_other_code_is_refused(study, whole, monkeypatch):
    other = {**study.document, "code": {**study.document["code"], "platform": "abacus"}}
    changed = replace(study)
    changed.__dict__["document"] = other
    with pytest.raises(InputError, match=r"code\.platform differs.*the code it was begun with"):
        run_study(changed, whole, jobs=0)


def test_two_drivers_the_second_refuses(study, whole):
    with store.open_store(whole, study), pytest.raises(InputError, match="another driver"):
        run_study(study, whole, jobs=0)
    assert run_study(study, whole, jobs=0).done == 8


def test_a_store_is_read_while_the_study_runs(study, tmp_path):
    file = tmp_path / "live.sqlite"
    seen = []

    def look(progress):
        if progress.done:
            results = load_results(file)
            seen.append((progress.done, results.done, len(results.outcomes), results.total))

    run_study(study, file, jobs=0, tell=look)
    assert seen == [(n, n, n, 8) for n in range(1, 9)]


@pytest.mark.parametrize("how", ["error", "kill"])
def test_whatever_store_call_fails_the_next_run_completes(study, tmp_path, how):
    """Fail at the first, second, third ... call to the database, until a run gets through."""
    small = replace(study, trials=1)
    calls = 0
    reference = tmp_path / "reference.sqlite"
    run_study(small, reference, jobs=0)
    while True:
        calls += 1
        file = tmp_path / f"fail{calls}.sqlite"
        died = _run_and_fail_at(calls, small, file, how)
        if not died:
            break
        done = run_study(small, file, jobs=0)
        assert (done.done, done.failed) == (2, 0)
        assert digest(file) == digest(reference), f"after failing at call {calls}"
    assert calls > 20


def _run_and_fail_at(call, study, file, how):
    """Run until the `call`-th call to the database fails; whether it did."""
    real, count = store.execute, 0

    def failing(connection, sql, values=()):
        nonlocal count
        count += 1
        if count == call:
            if how == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            raise sqlite3.OperationalError("disk I/O error")
        return real(connection, sql, values)

    if how == "error":
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(store, "execute", failing)
            try:
                run_study(study, file, jobs=0)
            except InputError as error:
                said = str(error)
            else:
                return False
        assert "disk I/O error" in said
        assert str(file) in said
        return True
    child = os.fork()
    if child == 0:
        store.execute = failing
        try:
            run_study(study, file, jobs=0)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def test_a_full_disk_is_one_line_and_loses_nothing(study, tmp_path, monkeypatch):
    file = tmp_path / "full.sqlite"
    run_study(replace(study, trials=1), file, jobs=0)
    real = store.execute

    def small(connection, sql, values=()):
        if sql.startswith("PRAGMA synchronous"):
            pages = real(connection, "PRAGMA page_count")[0][0]
            real(connection, f"PRAGMA max_page_count = {pages}")
        return real(connection, sql, values)

    many = replace(study, trials=100)
    with monkeypatch.context() as patch:
        patch.setattr(store, "execute", small)
        with pytest.raises(InputError, match=r"is full .*full\.sqlite.*make room"):
            run_study(many, file, jobs=0)
    kept = read_store(file)
    assert 2 < len(kept.rows) < 200
    assert not kept.damaged
    assert run_study(replace(study, trials=4), file, jobs=0).failed == 0


def killed_after(trials, study, file):
    """Run a study whose driver is killed with -9 once so many trials are done."""

    def tell(progress):
        if progress.done == trials:
            os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if child == 0:
        try:
            run_study(study, file, jobs=0, tell=tell)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status)


@pytest.mark.parametrize("trials", [0, 1, 5, 8, 21])
def test_a_copy_without_its_log_is_a_store(study, tmp_path, trials):
    """After a kill the file alone has its tables, and all but the last few trials."""
    many = replace(study, trials=12)
    file, copy = tmp_path / "killed.sqlite", tmp_path / "copy.sqlite"
    killed_after(trials, many, file)
    assert Path(f"{file}-wal").exists()
    copy.write_bytes(file.read_bytes())
    assert trials - len(read_store(copy).rows) < 8
    assert run_study(many, copy, jobs=0).done == 24
    assert run_study(many, file, jobs=0).done == 24
    assert digest(copy) == digest(file)


def test_a_store_without_tables_names_its_log(study, tmp_path):
    """What a copy of a store was whose tables were in its log alone."""
    file = tmp_path / "copy.sqlite"
    connection = sqlite3.connect(file, isolation_level=None)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.close()
    before = file.read_bytes()
    assert before
    for use in (read_store, load_results, lambda f: run_study(study, f, jobs=0)):
        with pytest.raises(InputError, match=r"no tables.*copy\.sqlite-wal"):
            use(file)
    assert file.read_bytes() == before


@pytest.mark.parametrize("read_meanwhile", [False, True])
def test_a_store_that_moves_while_it_runs_is_named_and_whole(study, tmp_path, read_meanwhile):
    file, moved = tmp_path / "night.sqlite", tmp_path / "moved.sqlite"
    readers = []

    def move(progress):
        if progress.done == 3:
            if read_meanwhile:
                readers.append(sqlite3.connect(f"file:{file}?mode=ro", uri=True))
                readers[0].execute("BEGIN")
                readers[0].execute("SELECT * FROM trial").fetchone()
            file.rename(moved)

    with pytest.raises(InputError, match=r"moved.*night\.sqlite.*--store") as refused:
        run_study(study, file, jobs=0, tell=move)
    log = Path(f"{file}-wal")
    if read_meanwhile:
        readers[0].close()
        assert f"move {log} too" in str(refused.value)
        log.rename(f"{moved}-wal")
    else:
        assert "it holds what is done" in str(refused.value)
    assert len(read_store(moved).rows) == 4
    assert run_study(study, moved, jobs=0).done == 8


def test_a_log_without_its_store_is_named(study, tmp_path):
    file = tmp_path / "night.sqlite"
    killed_after(3, study, file)
    file.rename(tmp_path / "moved.sqlite")
    with pytest.raises(InputError, match=r"gone.*night\.sqlite-wal.*move the store back"):
        run_study(study, file, jobs=0)
    (tmp_path / "moved.sqlite").rename(file)
    assert len(read_store(file).rows) == 3
    assert run_study(study, file, jobs=0).done == 8


def test_a_folder_that_cannot_be_written(study, whole, tmp_path):
    if os.geteuid() == 0:
        pytest.skip("root writes everywhere")
    whole.parent.chmod(0o555)
    try:
        with pytest.raises(InputError, match="Permission denied"):
            run_study(study, whole.parent / "new.sqlite", jobs=0)
        assert load_results(whole).done == 8
    finally:
        whole.parent.chmod(0o755)


def test_a_folder_that_is_none(study, tmp_path):
    with pytest.raises(InputError, match="cannot write a store there"):
        run_study(study, tmp_path / "no" / "where.sqlite", jobs=0)
    with pytest.raises(InputError, match="no such store"):
        read_store(tmp_path / "nothing.sqlite")


def test_a_closed_store_is_read_without_writing(whole):
    read_store(whole)
    for name in ("-wal", "-shm"):
        Path(f"{whole}{name}").unlink(missing_ok=True)
    connection = store._reader(whole)
    connection.close()
    text = f"file:{whole}?mode=ro&immutable=1"
    with closing(sqlite3.connect(text, uri=True)) as connection:
        assert connection.execute("SELECT count(*) FROM trial").fetchone() == (8,)


@pytest.mark.parametrize("size", [0, 1, 100, 4096, 6000, 20000])
def test_a_truncated_store_is_named_or_completed(study, whole, tmp_path, size):
    wanted = digest(whole)
    data = whole.read_bytes()
    assert len(data) > 20000
    whole.write_bytes(data[:size])
    for name in ("-wal", "-shm"):
        Path(f"{whole}{name}").unlink(missing_ok=True)
    try:
        run_study(study, whole, jobs=0)
    except InputError as error:
        said = str(error)
    else:
        assert digest(whole) == wanted
        return
    assert str(whole) in said


def test_something_else_is_no_store(study, tmp_path):
    file = tmp_path / "notes.sqlite"
    file.write_text("these are notes, and they are mine" * 100)
    for use in (read_store, lambda f: run_study(study, f, jobs=0), load_results):
        with pytest.raises(InputError, match=r"notes\.sqlite"):
            use(file)
    assert file.read_text().startswith("these are notes")
    other = tmp_path / "other.sqlite"
    connection = sqlite3.connect(other)
    connection.execute("CREATE TABLE mine (x)")
    connection.commit()
    connection.close()
    with pytest.raises(InputError, match=r"other\.sqlite"):
        run_study(study, other, jobs=0)


def altered(file):
    """Whether reading the store reports anything else than what was stored, unnoticed."""
    try:
        return {i: (r.outcome, r.result, r.time) for i, r in read_store(file).rows.items()}
    except InputError:
        return {}


def flip_bits(study, whole, tmp_path, count, seed):
    """Flip single bits of copies of a store; how many were seen in a row, in all, or not at all."""
    original = altered(whole)
    data = whole.read_bytes()
    rng = np.random.default_rng(seed)
    named = refused = 0
    for number in range(count):
        place, bit = int(rng.integers(len(data))), int(rng.integers(8))
        flipped = bytearray(data)
        flipped[place] ^= 1 << bit
        file = tmp_path / f"flip{number}.sqlite"
        file.write_bytes(flipped)
        found = altered(file)
        assert all(original.get(i) == values for i, values in found.items()), (place, bit)
        refused += not found
        named += 0 < len(found) < len(original)
        file.unlink()
    return named, refused


def test_a_flipped_bit_is_never_reported(study, whole, tmp_path):
    named, _ = flip_bits(study, whole, tmp_path, 60, seed=1)
    assert named > 2


@pytest.mark.slow
def test_300_flipped_bits_are_never_reported(study, whole, tmp_path, verified):
    named, refused = flip_bits(study, whole, tmp_path, 300, seed=2)
    what = f"of 300 flipped bits, altered values reported ({named} named rows, {refused} refused)"
    verified("bit_flips", what, 0, 0, True)
    assert named > 20


def test_damaged_rows_are_named_and_run_again(study, whole):
    wanted = digest(whole)
    connection = sqlite3.connect(whole)
    connection.execute("UPDATE trial SET result = replace(result, '0', '1') WHERE id IN (2, 5)")
    connection.execute("UPDATE trial SET hash = 'x' WHERE id = 7")
    connection.commit()
    connection.close()
    results = load_results(whole)
    assert results.damaged == (2, 5, 7)
    assert results.digest is None
    assert set(results.outcomes["index"]) == {0, 1, 3, 4, 6}
    with pytest.raises(InputError, match=r"rows 2, 5, 7.*run the study again"):
        digest(whole)
    done = run_study(study, whole, jobs=0)
    assert (done.damaged, done.done) == ((2, 5, 7), 8)
    assert digest(whole) == wanted


def test_a_damaged_head_is_refused(study, whole):
    connection = sqlite3.connect(whole)
    connection.execute("UPDATE study SET document = replace(document, 'convoy', 'convey')")
    connection.commit()
    connection.close()
    with pytest.raises(InputError, match="head is damaged"):
        read_store(whole)
    with pytest.raises(InputError, match="head is damaged"):
        run_study(study, whole, jobs=0)


def test_results_as_tables(study, whole, tmp_path):
    results = load_results(whole)
    assert (results.name, results.total, results.done, results.seed) == ("night", 8, 8, 0)
    assert results.parameters == ("noise",)
    assert results.trackers == ("study_worlds:Echo", "study_worlds:Blind")
    assert results.cells["label"].tolist() == ["convoy [noise = 0.1]", "convoy [noise = 0.5]"]
    assert len(results.scores) == 8 * 2 * 2
    direct = study.run(5)
    here = results.scores[(results.scores["index"] == 5) & (results.scores["metric"] == "ospa")]
    assert here["value"].tolist() == [s["ospa"] for s in direct.scores.values()]
    assert set(here["noise"]) == {0.5}
    blind = results.scores[results.scores["tracker"] == "study_worlds:Blind"]
    assert blind[blind["metric"] == "motp"]["value"].isna().all()
    summary = results.summary(1)
    assert summary.trials == 4
    assert summary.estimates["study_worlds:Blind"]["motp"].undefined == 4
    assert (results.times["mean"] > 0).all()
    import pandas as pd

    export(results, tmp_path / "scores.csv")
    back = pd.read_csv(tmp_path / "scores.csv")
    pd.testing.assert_frame_equal(back, results.scores, check_dtype=False, check_categorical=False)
    export(results, tmp_path / "scores.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "scores.parquet"), results.scores)
    with pytest.raises(InputError, match=r"\.csv or \.parquet"):
        export(results, tmp_path / "scores.xls")


def test_importing_studies_loads_no_pandas():
    code = "import sys, pmbm.study; print([m for m in ('pandas', 'loky') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
