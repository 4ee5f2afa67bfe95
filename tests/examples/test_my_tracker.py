"""A user's repository in small: every command of its README, as written there."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from pmbm.cli import main

EXAMPLE = Path(__file__).parent / "my_tracker"


def git(folder, *arguments):
    settings = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *settings, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    """The example as a repository with a branch main and a change on top."""
    folder = tmp_path_factory.mktemp("my_tracker") / "repository"
    init(folder)
    git(folder, "init", "-q", "-b", "main")
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "the tracker")
    git(folder, "checkout", "-q", "-b", "patience")
    file = folder / "nearest.py"
    file.write_text(file.read_text().replace("PATIENCE = 1.0", "PATIENCE = 0.9"))
    return folder


def init(folder):
    with pytest.raises(SystemExit) as stop:
        main(["init", str(folder)])
    assert stop.value.code == 0


def test_init_writes_a_repository_and_touches_nothing(tmp_path, capsys):
    init(tmp_path / "mine")
    written = {str(f.relative_to(tmp_path / "mine")) for f in (tmp_path / "mine").rglob("*.*")}
    assert written >= {
        "nearest.py",
        "gate.toml",
        "study.toml",
        "README.md",
        "tests/parking.toml",
        "tests/test_nearest.py",
        ".github/workflows/tracking.yml",
        ".gitignore",
    }
    assert "ci.yml" not in written
    assert "sqlite" in (tmp_path / "mine" / ".gitignore").read_text()
    (tmp_path / "mine" / "nearest.py").write_text("mine alone\n")
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(["init", str(tmp_path / "mine")])
    assert stop.value.code == 2
    assert "it is there already" in capsys.readouterr().err
    assert (tmp_path / "mine" / "nearest.py").read_text() == "mine alone\n"


def test_the_suite_of_a_new_repository_passes(repository):
    assert "3 passed" in run(repository, "pytest", "-q", "-p", "no:cacheprovider")


def commands():
    """The indented commands of the README, without their comments."""
    text = (EXAMPLE / "README.md").read_text()
    found = re.findall(r"^    (\S.*?)(?:\s+#.*)?$", text, re.MULTILINE)
    return [command for command in found if not command.startswith("pip ")]


def run(folder, *command, expect=0):
    tool = Path(sys.executable).parent / command[0]
    done = subprocess.run(
        [str(tool), *command[1:]], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == expect, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_the_readme_and_the_ci_file_say_the_same():
    ci = (EXAMPLE / "ci.yml").read_text()
    assert "run: pytest" in ci
    assert "run: pmbm gate gate.toml --against origin/main" in ci
    assert len(commands()) == 4


@pytest.mark.parametrize(
    "command",
    [pytest.param(c, marks=pytest.mark.slow) for c in commands()],
)
def test_every_command_works(repository, command):
    said = run(repository, *shlex.split(command))
    wanted = {
        "pytest": "3 passed",
        "pmbm gate": "pass: 1 pass",
        "pmbm study": "12 trials, 0 failed",
        "pmbm run": ".html",
    }
    name = next(name for name in wanted if command.startswith(name))
    assert wanted[name] in said


@pytest.mark.slow
def test_a_worse_tracker_does_not_get_in(repository):
    file = repository / "nearest.py"
    before = file.read_text()
    assert '[*t["position"]' in before
    file.write_text(before.replace('[*t["position"]', '[*(t["position"] + 3.0)'))
    try:
        said = run(repository, "pmbm", "gate", "gate.toml", "--against", "main", expect=1)
    finally:
        file.write_text(before)
    assert "fail: 1 fail" in said
    assert "replay" in said


def test_a_stone_soup_tracker_runs_behind_the_protocol(repository):
    pytest.importorskip("stonesoup", reason="Stone Soup is not installed")
    said = run(
        repository,
        *("pmbm", "run", "tests/parking.toml", "--tracker", "stone_soup:StoneSoupTracker"),
    )
    assert "id_switches" in said
