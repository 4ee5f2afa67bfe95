"""What a trial costs against an earlier commit's, built beside and run in turns with ours.

A figure is the mean over scenarios of the median over seeds of the ratio of CPU times, every trial
on a seed of its own and without a cache.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import statistics
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

EARLIER = "e340b31"
"""The commit that is compared with."""
SCENARIOS = ("truck_occlusion", "crossing", "roundabout", "highway_dense", "density")
SEEDS = range(5)
HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]


def t_record() -> tuple[float, dict[str, Any]]:
    """Recording alone."""
    return _ratio(0, 1)


def t_step() -> tuple[float, dict[str, Any]]:
    """Following alone."""
    return _ratio(1, 2)


def t_trial() -> tuple[float, dict[str, Any]]:
    """Recording, following and evaluating."""
    return _ratio(0, 3)


def m_map() -> tuple[float, dict[str, Any]]:
    """Following with the map of undetected objects, where trucks hide what is behind them."""
    with _built(None) as ours, _built(EARLIER) as earlier:
        pairs = _pairs(ours, earlier, "truck_occlusion", "map")
    ratios = [mine[1] / theirs[1] for mine, theirs in pairs]
    return statistics.median(ratios), {"ratio_min": min(ratios), "ratio_max": max(ratios)}


def s_study() -> tuple[float, dict[str, Any]]:
    """Trials a CPU second of `pmbm study` over the scenarios, with all that it starts, against the
    earlier commit's."""
    with _installed(None) as ours, _installed(EARLIER) as earlier:
        ratios = [_study_seconds(earlier, seed) / _study_seconds(ours, seed) for seed in range(3)]
    return statistics.median(ratios), {"ratio_min": min(ratios), "ratio_max": max(ratios)}


def _study_seconds(build: Path, seed: int) -> float:
    """CPU seconds of a study of a build, its workers included."""
    study = {"trackers": ["pmbm"], "trials": 12, "seed": seed, "scenarios": list(SCENARIOS)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.toml"
        file.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in study.items()))
        # An editable install would be found first: empty modules of the names that it goes by.
        for finder in Path(sysconfig.get_path("purelib")).glob("_editable_*.py"):
            (Path(folder) / finder.name).touch()
        command = [sys.executable, "-c", "from pmbm.cli import main; main()", "study"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [*command, str(file), "--store", str(Path(folder) / "store.sqlite"), "--jobs", "2"],
            check=True,
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{build}", "PMBM_CACHE": folder},
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _ratio(first: int, last: int) -> tuple[float, dict[str, Any]]:
    """Ours over the earlier commit's, of the parts of a trial from `first` to before `last`."""
    each = {
        name: statistics.median(
            sum(ours[first:last]) / sum(earlier[first:last]) for ours, earlier in pairs
        )
        for name, pairs in _trials().items()
    }
    return statistics.mean(each.values()), {"scenarios": each}


@cache
def _trials() -> dict[str, list[tuple[list[float], list[float]]]]:
    """Of each scenario and seed, the seconds of the parts of our trial and of the earlier one."""
    with _built(None) as ours, _built(EARLIER) as earlier:
        return {name: _pairs(ours, earlier, name, "default") for name in SCENARIOS}


def _pairs(
    ours: subprocess.Popen[str], earlier: subprocess.Popen[str], name: str, kind: str
) -> list[tuple[list[float], list[float]]]:
    for worker in (ours, earlier):
        # What is loaded and compiled once.
        _seconds(worker, name, 1_000_000, kind)
    pairs = []
    for seed in SEEDS:
        times = {
            worker: _seconds(worker, name, seed, kind) for worker in _turns(seed, ours, earlier)
        }
        pairs.append((times[ours], times[earlier]))
    return pairs


def _turns(seed: int, *workers: Any) -> tuple[Any, ...]:
    """Who goes first changes from seed to seed."""
    return workers if seed % 2 else workers[::-1]


def _seconds(worker: subprocess.Popen[str], name: str, seed: int, kind: str) -> list[float]:
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write(json.dumps([name, seed, kind]) + "\n")
    worker.stdin.flush()
    answer = worker.stdout.readline()
    if not answer:
        raise RuntimeError(f"the trial of {name}, seed {seed}, failed: see above")
    seconds: list[float] = json.loads(answer)
    return seconds


@contextlib.contextmanager
def _built(commit: str | None) -> Iterator[subprocess.Popen[str]]:
    """A worker that runs a commit, or the project as it stands."""
    with _installed(commit) as target:
        worker = subprocess.Popen(
            [sys.executable, str(HERE / "trial_worker.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=target.parent,
            env={**os.environ, "PYTHONPATH": str(target)},
        )
        try:
            yield worker
        finally:
            worker.kill()
            worker.wait()


@contextlib.contextmanager
def _installed(commit: str | None) -> Iterator[Path]:
    """A commit, or the project as it stands, built into a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = REPOSITORY, Path(folder) / "build"
        if commit is not None:
            source = Path(folder) / "source"
            archive = ["git", "-C", str(REPOSITORY), "archive", commit]
            source.mkdir()
            with subprocess.Popen(archive, stdout=subprocess.PIPE) as packed:
                subprocess.run(["tar", "-x", "-C", str(source)], stdin=packed.stdout, check=True)
            if packed.returncode:
                raise RuntimeError(f"no commit {commit} here: fetch the repository's history")
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
        subprocess.run([*install, "--target", str(target), str(source)], check=True)
        yield target
