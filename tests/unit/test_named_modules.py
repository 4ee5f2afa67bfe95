"""The current folder is in reach of what it was named for, and of nothing else."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from short_road import short_road

from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.named_modules import find_named, import_named
from pmbm.study.code import code_version
from pmbm.tracking import tracker_factory

SCENARIO = short_road(0.5)
STUDY = """
scenarios = ["short.toml"]
trackers = ["mine_here:Mine"]
trials = 2
"""
MINE = """
import helper_here
from pmbm.filter import PMBMTracker

def Mine(site):
    import later_here
    return PMBMTracker(site=site)
"""
PLANT = """
with open({marks!r}, "a") as marks:
    marks.write(__name__ + "\\n")
raise ImportError("planted")
"""
NOT_NAMED = (
    *("bottleneck", "numexpr", "optuna", "distributed", "ipywidgets", "colorama", "planted_here"),
    *("numpy", "json", "loky", "multiprocessing", "pickle", "click", "rich", "sim", "reports"),
)
"""Modules that the commands import, or would where they were installed; and one nobody does."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder with a tracker of theirs, and modules that nobody names."""
    for name in NOT_NAMED:
        text = PLANT.format(marks=str(tmp_path / "marks"))
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    (tmp_path / "mine_here.py").write_text(MINE, encoding="utf-8")
    for name in ("helper_here", "later_here"):
        (tmp_path / f"{name}.py").write_text("", encoding="utf-8")
    (tmp_path / "short.toml").write_text(SCENARIO, encoding="utf-8")
    (tmp_path / "night.toml").write_text(STUDY, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)
    finders = list(sys.meta_path)
    yield tmp_path
    sys.meta_path[:] = finders
    for name in set(sys.modules) - before:
        if name.endswith("_here"):
            del sys.modules[name]


def run(folder, *command):
    """Run a program in the folder; what it printed."""
    environment = {**os.environ, "PMBM_CACHE": str(folder / "cache")}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not (folder / "marks").exists(), (folder / "marks").read_text()
    return done.stdout


CONSOLE = (sys.executable, "-P", "-c", "from pmbm.cli import main; main()")
"""As the console script does it: the folder of the script is on the path, the current one not."""
MODULE = (sys.executable, "-m", "pmbm")


@pytest.mark.parametrize(
    ("program", "jobs"), [(CONSOLE, "2"), (MODULE, "1")], ids=["script", "module"]
)
def test_commands_import_what_is_named_and_nothing_else(folder, program, jobs):
    tracker = ["--tracker", "mine_here:Mine", "--tracker", "clairvoyant"]
    out = run(
        folder,
        *(*program, "run", "short.toml", *tracker, "--trials", "2", "--jobs", jobs, "--json", "-"),
    )
    assert set(json.loads(out)["trackers"]) == {"mine_here:Mine", "clairvoyant"}


def test_a_study_and_its_export_too(folder):
    out = run(folder, *MODULE, "study", "night.toml", "--jobs", "2", "--export", "scores.csv")
    assert "2 trials, 0 failed" in out


def test_commands_that_name_no_module_import_none(folder):
    run(folder, *MODULE, "metrics")


def test_the_path_stays_as_it_is(folder, capsys):
    before = list(sys.path)
    with pytest.raises(SystemExit):
        main(["run", "short.toml", "--tracker", "mine_here:Mine", "--trials", "1", "--out", "out"])
    capsys.readouterr()
    assert sys.path == before
    assert not (folder / "marks").exists()


def test_what_is_named_imports_its_neighbours_now_and_later(folder):
    assert tracker_factory("mine_here:Mine") is sys.modules["mine_here"].Mine
    assert "later_here" not in sys.modules
    assert callable(sys.modules["mine_here"].Mine(site=None).step)
    assert "later_here" in sys.modules


def test_nobody_else_reaches_the_folder(folder):
    import_named("mine_here")
    with pytest.raises(ModuleNotFoundError, match="No module named 'planted_here'"):
        import planted_here  # noqa: F401
    with pytest.raises(InputError, match="cannot be imported: No module named 'nowhere_here'"):
        tracker_factory("nowhere_here:Mine")
    assert not (folder / "marks").exists()


def test_installed_modules_come_first(folder):
    (folder / "filterpy.py").write_text("Mine = 1", encoding="utf-8")
    with pytest.raises(InputError, match="'filterpy:Mine' cannot be imported"):
        tracker_factory("filterpy:Mine")


def test_a_study_hashes_the_sources_that_it_would_import(folder):
    before = code_version(["mine_here"])["sources"]["mine_here"]
    assert "mine_here" not in sys.modules
    (folder / "mine_here.py").write_text(MINE + "\n", encoding="utf-8")
    assert code_version(["mine_here"])["sources"]["mine_here"] != before
    assert find_named("nowhere_here") is None


def test_packages_are_named_as_modules_are(folder):
    package = folder / "pack_here"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "inner.py").write_text("import helper_here\nMine = dict\n")
    assert tracker_factory("pack_here.inner:Mine") is dict
    assert Path(sys.modules["pack_here.inner"].__file__).parent == package


def test_a_module_that_is_not_there_is_told_from_what_one_imports(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "needs_more.py").write_text("import no_such_package\n")
    for name, hinted in (("no_such_module:Tracker", True), ("needs_more:Tracker", False)):
        with pytest.raises(InputError, match="No module named") as caught:
            tracker_factory(name)
        assert ("in the current folder" in str(caught.value)) == hinted
