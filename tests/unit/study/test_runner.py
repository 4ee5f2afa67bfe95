"""What a study survives: trials that fail, workers and drivers that are killed, interrupts."""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from study_driver import slow_study
from study_worlds import Convoy, Trouble

from pmbm.seeding import tracker_seed
from pmbm.study import Cell, ConfiguredTracker, Study, load_results, read_store, run_study, runner
from pmbm.study import study as study_module

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _one_version_of_the_code(monkeypatch):
    """Sources may be edited while the tests run; whose code it is is tested elsewhere."""
    monkeypatch.setattr(study_module, "code_version", lambda modules: {})


def study(source=None, trials=4, **changes):
    source = source or Convoy(frames=3)
    trackers = {"echo": ConfiguredTracker("study_worlds:Echo")}
    cells = (Cell("scene", {}, source, trackers),)
    return Study(name="s", cells=cells, trials=trials, metrics=("ospa",), **changes)


def digest(file):
    return read_store(file).digest()


def outcomes(file):
    return load_results(file).outcomes.set_index("index")["outcome"].to_dict()


def test_the_digest_does_not_depend_on_processes(tmp_path):
    found = {}
    for jobs in (0, 2):
        run_study(study(trials=7), tmp_path / f"{jobs}.sqlite", jobs=jobs)
        found[jobs] = digest(tmp_path / f"{jobs}.sqlite")
    assert len(set(found.values())) == 1


def test_every_trial_is_a_world_of_its_own_whoever_computes_it(tmp_path):
    """Workers share no seeds: each index has the recording that its number alone stands for."""
    source = Convoy(frames=3)
    for jobs in (0, 2):
        run_study(study(source, trials=5), tmp_path / f"{jobs}.sqlite", jobs=jobs)
        table = load_results(tmp_path / f"{jobs}.sqlite").outcomes.sort_values("index")
        found = table["recording"].tolist()
        assert found == [source.record(0, trial).digest() for trial in range(5)]
        assert len(set(found)) == 5


def test_a_trial_that_raises_is_an_outcome(tmp_path):
    source = Trouble(frames=3, how=((1, "raises"),))
    done = run_study(study(source), tmp_path / "a.sqlite", jobs=0)
    assert (done.done, done.failed) == (4, 1)
    results = load_results(tmp_path / "a.sqlite")
    assert outcomes(tmp_path / "a.sqlite") == {0: "ok", 1: "raised", 2: "ok", 3: "ok"}
    failure = results.failures.iloc[0]
    assert failure["error"].startswith("RuntimeError: trial 1 at <object object at 0x...> went")
    assert "Traceback" in failure["note"]
    assert results.summary(0).trials == 3
    run_study(study(source), tmp_path / "b.sqlite", jobs=2)
    assert digest(tmp_path / "a.sqlite") == digest(tmp_path / "b.sqlite")


def test_a_tracker_that_raises_leaves_the_others_their_trial(tmp_path):
    """The failure names it and what it raised, and the other's four trials count."""
    raises = [tracker_seed(0, trial) % 2 == 1 for trial in range(4)]
    bad = sum(raises)
    assert 0 < bad < 4
    trackers = {
        "echo": ConfiguredTracker("study_worlds:Echo"),
        "picky": ConfiguredTracker("study_worlds:Picky"),
    }
    cell = Cell("scene", {}, Convoy(frames=3), trackers)
    one = Study(name="s", cells=(cell,), trials=4, metrics=("ospa",))
    for jobs in (0, 2):
        done = run_study(one, tmp_path / f"{jobs}.sqlite", jobs=jobs)
        assert (done.done, done.failed) == (4, bad)
    assert digest(tmp_path / "0.sqlite") == digest(tmp_path / "2.sqlite")
    results = load_results(tmp_path / "0.sqlite")
    assert results.failures["trial"].tolist() == [t for t in range(4) if raises[t]]
    assert set(results.failures["outcome"]) == {"tracker raised"}
    assert results.failures["error"].iloc[0].startswith("tracker 'picky' raised ValueError: ")
    assert "Traceback" in results.failures["note"].iloc[0]
    summary = results.summary(0)
    assert (summary.trials, summary.estimates["echo"]["ospa"].n) == (4, 4)
    assert summary.estimates["picky"]["ospa"].n == 4 - bad
    assert summary.differences["picky"]["ospa"].n == 4 - bad


@pytest.mark.parametrize("jobs", [0, 1])
def test_a_trial_that_takes_too_long_is_an_outcome(tmp_path, jobs):
    source = Trouble(frames=3, how=((1, "hangs"),))
    start = time.monotonic()
    run_study(study(source, trials=3, time_limit=3.0), tmp_path / "s.sqlite", jobs=jobs)
    assert outcomes(tmp_path / "s.sqlite") == {0: "ok", 1: "timeout", 2: "ok"}
    assert time.monotonic() - start < 60


def test_a_trial_that_runs_out_of_memory_is_an_outcome(tmp_path):
    source = Trouble(frames=3, how=((1, "eats"),))
    run_study(study(source, trials=3, memory_limit=2000.0), tmp_path / "s.sqlite", jobs=1)
    assert outcomes(tmp_path / "s.sqlite") == {0: "ok", 1: "memory", 2: "ok"}


@pytest.mark.slow
def test_a_trial_that_hangs_where_no_alarm_reaches_is_an_outcome(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "_GRACE", 1.0)
    source = Trouble(frames=3, how=((1, "hangs deaf"),))
    one = study(source, trials=2, time_limit=3.0)
    run_study(one, tmp_path / "s.sqlite", jobs=1)
    assert outcomes(tmp_path / "s.sqlite") == {0: "ok", 1: "timeout"}


def test_a_trial_that_kills_its_process_is_an_outcome(tmp_path):
    source = Trouble(frames=3, how=((2, "dies"),))
    done = run_study(study(source, trials=5), tmp_path / "s.sqlite", jobs=2)
    assert (done.done, done.failed) == (5, 1)
    assert outcomes(tmp_path / "s.sqlite") == {0: "ok", 1: "ok", 2: "died", 3: "ok", 4: "ok"}


@pytest.mark.slow
def test_a_worker_killed_once_costs_no_trial(tmp_path):
    source = Trouble(frames=3, how=((2, "dies once"),), folder=str(tmp_path))
    done = run_study(study(source, trials=5), tmp_path / "s.sqlite", jobs=2)
    assert (done.done, done.failed) == (5, 0)
    assert (tmp_path / "died2").exists()
    clean = replace(source, how=())
    run_study(study(clean, trials=5), tmp_path / "clean.sqlite", jobs=0)
    assert digest(tmp_path / "s.sqlite") == digest(tmp_path / "clean.sqlite")


def start_driver(file, jobs, trials):
    return subprocess.Popen(
        [
            sys.executable,
            str(HERE / "study_driver.py"),
            str(file),
            str(jobs),
            str(trials),
            *sys.path,
        ],
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def descendants(pid):
    """Processes whose ancestor is `pid`."""
    parent = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if fields[0] != "Z":
            parent[int(folder.name)] = int(fields[1])
    found, frontier = set(), {pid}
    while frontier:
        frontier = {child for child, its in parent.items() if its in frontier} - found
        found |= frontier
    return found


def wait_until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def rows(file):
    try:
        return len(read_store(file).rows)
    except Exception:
        return 0


def alive(pids):
    running = {int(f.name) for f in Path("/proc").glob("[0-9]*")}
    return {
        pid
        for pid in pids & running
        if "Z" not in (Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:1])
    }


def survives_kills(tmp_path, kills, seed, trials=12):
    """Kill the driver, a worker, or all at random moments, resume, and compare the digest; gives
    back how often something was killed."""
    killed = 0
    chance = random.Random(seed)
    file = tmp_path / f"killed{seed}.sqlite"
    for _ in range(kills):
        driver = start_driver(file, 2, trials)
        before = rows(file)
        wait_until(lambda driver=driver, before=before: rows(file) > before or driver.poll() == 0)
        time.sleep(chance.uniform(0.0, 0.4))
        family = descendants(driver.pid)
        whom = chance.choice(["driver", "worker", "all"])
        victims = {"driver": [driver.pid], "worker": sorted(family)[:1]}.get(
            whom, [driver.pid, *family]
        )
        for pid in victims:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        killed += bool(victims) and driver.returncode is None
        if whom == "worker":
            assert driver.wait(timeout=120) == 0, driver.stderr.read().decode()[-2000:]
        else:
            driver.wait(timeout=30)
            wait_until(lambda family=family: not alive(family), 20)
        driver.stderr.close()
        if rows(file) == trials:
            break
    done = run_study(slow_study(trials), file, jobs=2)
    assert (done.done, done.failed) == (trials, 0)
    whole = tmp_path / "whole.sqlite"
    if not whole.exists():
        run_study(slow_study(trials), whole, jobs=0)
    assert digest(file) == digest(whole)
    return killed


def test_a_killed_study_resumes_to_the_same_digest(tmp_path):
    survives_kills(tmp_path, kills=1, seed=1, trials=8)


@pytest.mark.slow
def test_the_digest_of_1_and_3_processes(tmp_path):
    for jobs in (0, 1, 3):
        run_study(study(trials=7), tmp_path / f"{jobs}.sqlite", jobs=jobs)
    assert len({digest(tmp_path / f"{jobs}.sqlite") for jobs in (0, 1, 3)}) == 1


@pytest.mark.slow
def test_a_study_killed_at_50_random_moments(tmp_path, verified):
    kills = sum(survives_kills(tmp_path, kills=3, seed=100 + seed) for seed in range(25))
    what = "kill -9 of driver, worker or all at random moments; digests equal after resuming"
    verified("kill_resume", what, kills, ">= 50 kills", kills >= 50)
    assert kills >= 50


@pytest.mark.parametrize(
    "how", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.slow)]
)
def test_no_process_stays_behind(tmp_path, how):
    file = tmp_path / "s.sqlite"
    driver = start_driver(file, 2, 200)
    wait_until(lambda: rows(file) > 1)
    family = descendants(driver.pid)
    assert len(family) >= 2
    if how == signal.SIGINT:
        # A terminal sends it to the whole group.
        os.killpg(driver.pid, signal.SIGINT)
        assert driver.wait(timeout=30) == 130
        assert "Traceback" not in driver.stderr.read().decode()
    else:
        driver.kill()
        driver.wait(timeout=30)
    driver.stderr.close()
    wait_until(lambda: not alive(family), 20)
    assert run_study(slow_study(8), file, jobs=0).failed == 0


def test_what_killed_the_driver_runs_alone(tmp_path):
    """A trial in flight when a driver died may have killed it: serial drivers run it apart."""
    source = Trouble(frames=3, how=((1, "dies"),))
    file = tmp_path / "s.sqlite"
    child = os.fork()
    if child == 0:
        try:
            run_study(study(source, trials=3), file, jobs=0)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status)
    done = run_study(study(source, trials=3), file, jobs=0)
    assert (done.done, done.failed) == (3, 1)
    assert outcomes(file) == {0: "ok", 1: "died", 2: "ok"}
