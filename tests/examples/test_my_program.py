"""A user's repository with a tracker in C++: every command of its README, as written there."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from pmbm import run
from pmbm.sim import load_scenario
from pmbm.tracking import tracker_factory

EXAMPLE = Path(__file__).parent / "my_program"
KITTI = Path(__file__).parents[1] / "data" / "kitti"
ENVIRONMENT = {
    **os.environ,
    "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    "CXXFLAGS": "-O0 -Wall -Wextra -Werror",
}

pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")


def shell(folder, command, expect=0):
    done = subprocess.run(
        ["sh", "-c", command], cwd=folder, env=ENVIRONMENT, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == expect, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    """The example as a repository with a branch main and a change on top, built."""
    folder = tmp_path_factory.mktemp("my_program") / "repository"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("__pycache__", "tracker"))
    git = "git -c user.name=a -c user.email=a@b -c commit.gpgsign=false"
    shell(folder, f"git init -q -b main && git add . && {git} commit -q -m first")
    shell(folder, "git checkout -q -b patience")
    source = folder / "tracker.cpp"
    source.write_text(source.read_text().replace('"patience", 1.0', '"patience", 0.9'))
    for command in commands()[:1]:
        shell(folder, command)
    return folder


def commands():
    """The indented commands of the README, without their comments."""
    text = (EXAMPLE / "README.md").read_text()
    found = re.findall(r"^    (\S.*?)(?:\s+#.*)?$", text, re.MULTILINE)
    return [command for command in found if not command.startswith("pip ")]


WANTED = {
    "make": "",
    "pytest": "3 passed",
    "pmbm run": "id_switches",
    "pmbm track table": "drive1.csv",
    "pmbm evaluate table": "MOTA",
    "pmbm study": "8 trials, 0 failed",
    "pmbm gate": "pass: 1 pass",
}


@pytest.mark.parametrize("command", commands())
def test_every_command_works(repository, command):
    # The scoring reads what the tracking wrote, and tests may run in any order.
    if command.startswith("pmbm evaluate"):
        (track,) = (other for other in commands() if other.startswith("pmbm track"))
        shell(repository, track)
    name = next(name for name in WANTED if command.startswith(name))
    assert WANTED[name] in shell(repository, command)
    if "--log" in command:
        with (repository / shlex.split(command)[-1]).open("rb") as stream:
            topics = [channel.topic for _, channel, _ in make_reader(stream).iter_messages()]
        assert topics.count("/tracks/exec:./tracker") == topics.count("/truth") == 50


def test_the_readme_and_the_ci_file_say_the_same():
    ci = (EXAMPLE / "ci.yml").read_text()
    for command in commands():
        if command.split()[0] in ("make", "pytest"):
            assert f"run: {command}\n" in ci
    assert "run: pmbm gate gate.toml --against origin/main" in ci


def test_both_languages_follow_alike(repository):
    names = ("tracker", f"{sys.executable} {EXAMPLE / 'tracker.py'}")
    programs = [tracker_factory(f"exec:{name}") for name in (str(repository / names[0]), names[1])]
    recording = load_scenario("crossing").record(seed=3)
    both = [run(program(recording.site, patience=0.7), recording) for program in programs]
    for a, b in zip(*both, strict=True):
        for name in ("id", "label", "position", "size", "yaw", "velocity", "score"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12)
    assert max(map(len, both[0])) >= 2


def test_a_dataset_is_tracked(repository, tmp_path):
    command = [
        *("pmbm", "track", "kitti", "--root", KITTI / "training", "--classes", "Car", "Pedestrian"),
        *("--detections", KITTI / "detections_ab3dmot", "--out", tmp_path / "out"),
        *("--sequences", "0000", "--tracker", "exec:./tracker"),
    ]
    shell(repository, shlex.join(map(str, command)))
    assert (tmp_path / "out" / "0000.txt").exists()
