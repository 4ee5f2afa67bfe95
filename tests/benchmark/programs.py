"""What it costs that a tracker is a program: the examples of tests/examples/my_program."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from world import World

from pmbm import Detections, Label, Tracks
from pmbm.external.program import close_programs, program_named
from pmbm.sim import load_scenario
from pmbm.study import Cell, ConfiguredTracker, Study, run_study
from pmbm.study.parallel import WORKER_ENVIRONMENT
from pmbm.tracking import SHIPPED_TRACKERS

SEEDS = range(5)
FRAMES = 200
TRIALS = 20
SCENARIOS = ("crossing", "truck_occlusion")
EXAMPLE = Path(__file__).parents[1] / "examples" / "my_program"

Figure = tuple[float, dict[str, Any]]


def m_frame() -> Figure:
    """Milliseconds a frame around the C++ example, median of the seeds' medians: wall time less
    what it reports as its own, its reading and writing of JSON counted as ours.  Beside it the same
    of this process's CPU time and the program's, which other load on the machine changes less.
    """
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "tracker"
        for name in ("Makefile", "tracker.cpp"):
            shutil.copy(EXAMPLE / name, folder)
        subprocess.run(["make", "-s", "-C", folder, f"PYTHON={sys.executable}"], check=True)
        walls, cpus, boxes = [], [], []
        for seed in SEEDS:
            world = World(45, 15.0, seed)
            frames = [detections for _, detections in world.each_frame(FRAMES)]
            boxes += map(len, frames)
            around, own, cpu = [], 0.0, _cpu()
            tracker = program_named(f"exec:{built}")(world.site)
            for detections in frames:
                begin = time.perf_counter()
                tracker.step(detections)
                seconds = tracker.step_seconds or 0.0
                around.append(time.perf_counter() - begin - seconds)
                own += seconds
            del tracker
            close_programs()
            walls.append(1e3 * statistics.median(around))
            cpus.append(1e3 * (_cpu() - cpu - own) / FRAMES)
    details = {
        "boxes": statistics.mean(boxes),
        "min_ms": min(walls),
        "max_ms": max(walls),
        "cpu_ms": statistics.median(cpus),
    }
    return statistics.median(walls), details


def m_study() -> Figure:
    """CPU time of a study with the Python example as a program, both processes', over that with the
    same tracker in this process, median over seeds.  Beside it the ratio of wall times, which tell
    as much of what else the machine does, and both of a second study over scenes that are cached.
    """
    program = f"exec:{shlex.join([sys.executable, str(EXAMPLE / 'tracker.py')])}"
    SHIPPED_TRACKERS["example"] = "programs:in_process"
    os.environ.update(WORKER_ENVIRONMENT)
    ratios = []
    for seed in SEEDS:
        studies = {name: _study(name, seed) for name in ("example", program)}
        order = list(studies) if seed % 2 else list(studies)[::-1]
        taken = {name: _seconds(studies[name]) for name in order}
        ratios.append(np.array(taken[program]) / taken["example"])
    (cpu, wall), (cached_cpu, cached_wall) = np.median(ratios, axis=0)
    return cpu, {
        "ratio_min": min(ratio[0, 0] for ratio in ratios),
        "ratio_max": max(ratio[0, 0] for ratio in ratios),
        "wall": wall,
        "cached_cpu": cached_cpu,
        "cached_wall": cached_wall,
    }


def _study(tracker: str, seed: int) -> Study:
    cells = tuple(
        Cell(name, {}, load_scenario(name), {"t": ConfiguredTracker(tracker)}) for name in SCENARIOS
    )
    return Study(name="cost", cells=cells, trials=TRIALS // len(SCENARIOS), seed=seed)


def _seconds(study: Study) -> list[tuple[float, float]]:
    """CPU and wall time of the study with nothing in the cache, and of the same again."""
    taken = []
    with tempfile.TemporaryDirectory() as folder:
        os.environ["PMBM_CACHE"] = folder
        for name in ("first", "again"):
            cpu, wall = _cpu(), time.perf_counter()
            done = run_study(study, Path(folder) / f"{name}.sqlite", jobs=0)
            # What a program took is known once it has ended.
            close_programs()
            taken.append((_cpu() - cpu, time.perf_counter() - wall))
            assert done.failed == 0
    return taken


def _cpu() -> float:
    """CPU time of this process and of those that it started and that have ended, s."""
    return sum(os.times()[:4])


class in_process:
    """The Python example's tracker behind `step(detections) -> tracks`."""

    def __init__(self) -> None:
        spec = importlib.util.spec_from_file_location("example", EXAMPLE / "tracker.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        self._tracker = module.Nearest()

    def step(self, detections: Detections) -> Tracks:
        x, y, z = detections.position.T.tolist()
        length, width, height = detections.size.T.tolist()
        told = self._tracker.step(
            detections.time,
            {
                "x": x, "y": y, "z": z, "length": length, "width": width, "height": height,
                "yaw": detections.yaw.tolist(), "score": detections.score.tolist(),
                "label": detections.label.tolist(),
            },
        )  # fmt: skip
        if not told["id"]:
            return Tracks.empty(detections.time)

        def beside(*names: str) -> Any:
            return np.array([told[name] for name in names]).T

        return Tracks(
            time=detections.time,
            id=np.array(told["id"]),
            position=beside("x", "y", "z"),
            size=beside("length", "width", "height"),
            yaw=np.array(told["yaw"]),
            velocity=beside("vx", "vy"),
            score=np.array(told["score"]),
            label=np.array([Label(value) for value in told["label"]]),
        )
