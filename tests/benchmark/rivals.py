"""Trackers from the package index, on the same detections as ours.

filterpy runs in this process; Stone Soup, motpy and norfair (its maintained fork, norfair-enough)
bring many packages of their own, so they live in a virtual environment of their own in the cache
folder, made when it is missing; the labelled multi-Bernoulli filters in another, of a later Python.
"""

from __future__ import annotations

import io
import os
import shutil
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment
from world import DT, MEASUREMENT_SD

from pmbm.sim.scenario.cache import cache_folder

PACKAGES = ("stonesoup==1.9.1", "motpy==0.0.10", "norfair-enough==2.4.3")
LMB_PACKAGES = ("numpy", "multisensor-lmb-filters-rs==0.3.2")
"""Of Python 3.12 and later."""
GATE = 3.0


class Filterpy:
    """One filterpy Kalman filter a track, one assignment a frame: what one writes in an afternoon.

    A track is shown from its third hit on, and dropped after five frames without one.
    """

    def __init__(self) -> None:
        self.tracks: list[dict] = []
        self.count = 0

    def step(self, positions: np.ndarray) -> np.ndarray:
        """Rows (id, x, y) of the tracks shown, and before them (CPU seconds of the step, 0, 0)."""
        begin = time.process_time()
        rows = self._step(positions)
        return np.array([(time.process_time() - begin, 0.0, 0.0), *rows])

    def _step(self, positions: np.ndarray) -> list[tuple[int, float, float]]:
        for track in self.tracks:
            track["filter"].predict()
        free = np.ones(len(positions), bool)
        if self.tracks and len(positions):
            expected = np.array([track["filter"].x[:2] for track in self.tracks])
            spread = np.array([track["filter"].P[:2, :2] for track in self.tracks])
            apart = positions[None] - expected[:, None]
            inverse = np.linalg.inv(spread + MEASUREMENT_SD**2 * np.eye(2))
            distance = np.einsum("tmi,tij,tmj->tm", apart, inverse, apart)
            for i, j in zip(*linear_sum_assignment(np.minimum(distance, GATE**2)), strict=True):
                if distance[i, j] < GATE**2:
                    self.tracks[i]["filter"].update(positions[j])
                    self.tracks[i]["hits"] += 1
                    self.tracks[i]["missed"] = -1
                    free[j] = False
        for track in self.tracks:
            track["missed"] += 1
        self.tracks = [track for track in self.tracks if track["missed"] < 5]
        for position in positions[free]:
            self.tracks.append(
                {"id": self.count, "filter": self._new(position), "hits": 1, "missed": 0}
            )
            self.count += 1
        return [
            (track["id"], *track["filter"].x[:2]) for track in self.tracks if track["hits"] >= 3
        ]

    def _new(self, position: np.ndarray):
        from filterpy.common import Q_continuous_white_noise
        from filterpy.kalman import KalmanFilter

        kalman = KalmanFilter(dim_x=4, dim_z=2)
        kalman.x = np.array([*position, 0.0, 0.0])
        kalman.F = np.eye(4) + DT * np.eye(4, k=2)
        kalman.Q = Q_continuous_white_noise(2, DT, 2.0, block_size=2, order_by_dim=False)
        kalman.H = np.eye(2, 4)
        kalman.R = MEASUREMENT_SD**2 * np.eye(2)
        kalman.P = np.diag([MEASUREMENT_SD**2, MEASUREMENT_SD**2, 100.0, 100.0])
        return kalman


class Worker:
    """A rival in its own process; `step` takes and gives what `Filterpy.step` does."""

    def __init__(self, name: str) -> None:
        script = Path(__file__).with_name("rival_worker.py")
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [environment(lmb=name.startswith("lmb")), script, name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads},
        )

    def step(self, positions: np.ndarray) -> np.ndarray:
        frame = io.BytesIO()
        np.save(frame, positions)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(struct.pack("<q", frame.tell()) + frame.getvalue())
        self.process.stdin.flush()
        (length,) = struct.unpack("<q", self.process.stdout.read(8))
        return np.load(io.BytesIO(self.process.stdout.read(length)))

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(timeout=30)


def environment(*, lmb: bool) -> Path:
    """The Python of the rivals, or of those that need a later one; their environment is made on
    first use."""
    folder = cache_folder() / ("rivals_lmb" if lmb else "rivals")
    packages = LMB_PACKAGES if lmb else PACKAGES
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    made = folder / "packages.txt"
    wanted = "\n".join(packages)
    if not made.exists() or made.read_text() != wanted:
        print(f"making the rivals' environment in {folder}", file=sys.stderr)
        base = _python_312() if lmb else sys.executable
        subprocess.run([base, "-m", "venv", "--clear", folder], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *packages], check=True)
        made.write_text(wanted)
    return python


def _python_312() -> str:
    """This Python, or one of the path, of 3.12 or later."""
    if sys.version_info >= (3, 12):
        return sys.executable
    for minor in range(12, 15):
        # What is called so may be a shim of a version that is not there.
        found = shutil.which(f"python3.{minor}")
        if found and not subprocess.run([found, "-c", ""], stderr=subprocess.DEVNULL).returncode:
            return found
    raise LookupError("multisensor-lmb-filters-rs runs on Python 3.12 and later: none on the path")
