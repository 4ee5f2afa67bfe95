"""Ctrl-C: what a command has is kept and printed, and no worker has anything to say."""

import os
import re
import signal
import subprocess
import sys
import threading
import time

import psutil
import pytest

from pmbm.cli import INTERRUPTED
from pmbm.study.parallel import workers
from pmbm.tune import Range, tune

SCENE = """
name = "short"
stresses = "one car that goes straight, quickly made"
duration = 1.0
[scene]
kind = "scripted"
[scene.tracks.car]
start = [20.0, 0.0]
"""
SLOW = """
import time
from pmbm import Tracks
class Slow:
    def step(self, detections):
        time.sleep(0.05)
        with open("steps", "a") as file:
            file.write(".")
        return Tracks.empty(detections.time)
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "short.toml").write_text(SCENE)
    (tmp_path / "slow.py").write_text(SLOW)
    return tmp_path


def interrupted(folder, *arguments):
    """Exit code and output of a command that is interrupted after a few trials, with all its
    processes, as a terminal does it."""
    steps = folder / "steps"
    process = subprocess.Popen(
        [sys.executable, "-m", "pmbm", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    killer = threading.Timer(120, lambda: os.killpg(process.pid, signal.SIGKILL))
    killer.start()
    while process.poll() is None and len(steps.read_text() if steps.exists() else "") < 60:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    said, _ = process.communicate()
    killer.cancel()
    return process.returncode, said


def test_workers_are_ended_where_there_is_no_pgrep(monkeypatch):
    """Which is what loky ends them by without psutil (findings/loky_kill_without_psutil.sh)."""
    monkeypatch.setenv("PATH", "/nonexistent")
    found = []

    def interrupted_run():
        with workers(1) as pool:
            found.append(pool.submit(os.getpid).result())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted_run()
    assert not psutil.pid_exists(found[0])


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_run_prints_the_trials_that_are_done(folder, jobs):
    names = ("--tracker", "slow:Slow", "--trials", "500", "--jobs", jobs)
    code, said = interrupted(folder, "run", "short.toml", *names)
    assert code == INTERRUPTED, said
    done = int(re.search(r"stopped: short has (\d+) of 500", said)[1])
    assert 0 < done < 500
    assert f"short: {done} trial" in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_a_gate_shows_no_traceback_of_a_worker(folder):
    names = ("--tracker", "slow:Slow", "--against", "slow:Slow", "--margin", "0.001", "--jobs", "2")
    (folder / "study.toml").write_text('scenarios = ["short.toml"]\ntrackers = ["slow:Slow"]\n')
    code, said = interrupted(folder, "gate", "study.toml", *names)
    assert code == INTERRUPTED, said
    assert "Traceback" not in said


def test_tuning_gives_the_best_of_what_it_tried():
    pytest.importorskip("optuna")
    tried = []

    def objective(parameters):
        if len(tried) == 5:
            raise KeyboardInterrupt
        tried.append(dict(parameters))
        return abs(parameters.get("x", 3.0) - 1.0)

    found = tune(objective, {"x": Range(0.0, 4.0)}, trials=40, seed=1)
    assert found.interrupted
    assert len(found.attempts) == 5
    assert found.value == min(one.value for one in found.attempts)
