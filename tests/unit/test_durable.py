"""A file is replaced whole or stays what it was."""

import os
import resource
import subprocess
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pmbm import durable
from pmbm.durable import check_writable, replace_bytes, replace_text
from pmbm.errors import InputError
from pmbm.regression.stored import StoredBaseline
from pmbm.score import ScoreModel
from pmbm.study.results import export


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if not mounted:
        pytest.skip("only root may mount")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@contextmanager
def files_no_longer_than(size):
    """Within it, a write beyond `size` bytes of a file fails, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def baseline(trials):
    values = tuple((f"{trial:016x}", trial / 7) for trial in range(trials))
    return StoredBaseline(
        metric="ospa",
        bounds=(0.0, 20.0),
        seed=0,
        tracker="pmbm",
        code="",
        scenarios={"crossing": values},
    )


def model(knots):
    levels = np.arange(float(knots))
    return ScoreModel(knot=levels, log_odds=levels, base_rate=0.5, scale="score")


class _Scores:
    def __init__(self, rows):
        import pandas as pd

        self.scores = pd.DataFrame({"value": np.arange(rows) / 7})


def picture(path, size):
    from matplotlib.figure import Figure

    from pmbm.reports.drawing import save

    figure = Figure()
    figure.add_axes((0, 0, 1, 1)).plot(np.random.default_rng(1).normal(size=size))
    save(figure, path)


WRITERS = {
    "baseline.json": lambda path, size: baseline(size).write(path),
    "scores.toml": lambda path, size: model(size).save(path),
    "scores.csv": lambda path, size: export(_Scores(size), path),
    "scores.parquet": lambda path, size: export(_Scores(size), path),
    "picture.svg": picture,
    "page.html": lambda path, size: replace_text(path, "x" * 20 * size),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_write_that_fails_leaves_what_was_there(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path, 3)
    before = path.read_bytes()
    with files_no_longer_than(len(before) + 100), pytest.raises(InputError, match=name) as refused:
        WRITERS[name](path, 20000)
    assert "\n" not in str(refused.value)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == [name]


def test_a_full_disk_leaves_what_was_there(small_disk):
    path = small_disk / "night.baseline.json"
    baseline(10).write(path)
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"No space left.*night\.baseline\.json.*as it was"):
        baseline(20000).write(path)
    assert path.read_bytes() == before
    assert os.listdir(small_disk) == [path.name]
    baseline(20).write(path)
    assert len(path.read_bytes()) > len(before)


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_failure_at_any_step_leaves_what_was_there(tmp_path, monkeypatch, step):
    path = tmp_path / "kept.txt"
    replace_text(path, "old")

    def fails(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(durable.os, step, fails)
    with pytest.raises(InputError, match="No space left"):
        replace_text(path, "new")
    monkeypatch.undo()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["kept.txt"]


def test_the_content_and_the_name_reach_the_disk(tmp_path, monkeypatch):
    """Content is flushed before it is renamed, the folder after."""
    calls = []
    real = {name: getattr(os, name) for name in ("fsync", "replace")}

    def fsync(descriptor):
        calls.append("folder" if os.path.isdir(f"/proc/self/fd/{descriptor}") else "file")
        real["fsync"](descriptor)

    def replace(old, new):
        assert Path(old).parent == Path(new).parent
        calls.append("rename")
        real["replace"](old, new)

    monkeypatch.setattr(durable.os, "fsync", fsync)
    monkeypatch.setattr(durable.os, "replace", replace)
    replace_bytes(tmp_path / "file", b"content")
    assert calls == ["file", "rename", "folder"]


def test_writers_at_once_do_not_meet(tmp_path, monkeypatch):
    """Another writes the same file while the first has not renamed yet."""
    path = tmp_path / "shared.txt"
    real, others = os.replace, ["other"]

    def interrupted(old, new):
        if others:
            replace_text(path, others.pop())
            assert path.read_text() == "other"
        real(old, new)

    monkeypatch.setattr(durable.os, "replace", interrupted)
    replace_text(path, "first")
    assert path.read_text() == "first"
    assert os.listdir(tmp_path) == ["shared.txt"]


def test_permissions_links_and_devices_stay(tmp_path):
    path, link = tmp_path / "file", tmp_path / "link"
    replace_text(path, "a")
    umask = os.umask(0)
    os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask
    path.chmod(0o640)
    link.symlink_to(path)
    replace_text(link, "b")
    assert (link.is_symlink(), path.read_text(), path.stat().st_mode & 0o777) == (True, "b", 0o640)
    replace_text(Path(os.devnull), "c")
    assert not Path(os.devnull).is_file()
    with pytest.raises(InputError, match="cannot write"):
        replace_text(tmp_path, "d")
    with pytest.raises(InputError, match="cannot write"):
        replace_text(tmp_path / "no" / "folder", "e")


def test_a_place_is_checked_before_long_work(tmp_path):
    check_writable(tmp_path / "made" / "file")
    assert os.listdir(tmp_path / "made") == []
    check_writable(Path(os.devnull))
    for place in (tmp_path, tmp_path / "made" / "file" / "deeper"):
        (tmp_path / "made" / "file").write_text("no folder")
        with pytest.raises(InputError, match="cannot write there"):
            check_writable(place)
