"""A user's repository in small: every command of its README, as written there."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parent / "my_tracker"


def git(folder, *arguments):
    settings = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *settings, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    """The example as a repository with a branch main and a change on top."""
    folder = tmp_path_factory.mktemp("my_tracker") / "repository"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("__pycache__"))
    git(folder, "init", "-q", "-b", "main")
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "the tracker")
    git(folder, "checkout", "-q", "-b", "patience")
    file = folder / "nearest.py"
    file.write_text(file.read_text().replace("PATIENCE = 1.0", "PATIENCE = 0.9"))
    return folder


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
