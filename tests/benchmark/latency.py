"""The slowest steps of whole runs, on simulated and on real detections."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from world import World

from pmbm import PMBMTracker, Recording, kernels

SEEDS = range(5)
FRAMES = 100

Figure = tuple[float, dict[str, Any]]


def l_compiled() -> Figure:
    """Milliseconds, 99th percentile of a step: 100 objects at 10 Hz through the nominal detector
    model, and KITTI's detections where they are at hand; the worse of the two."""
    return _worst(kernels.native)


def l_reference() -> Figure:
    """The same without anything compiled."""
    return _worst(None)


def _worst(kernel: Any) -> Figure:
    chosen = kernels.native
    kernels.native = kernel
    try:
        scenes = {"simulated": _simulated(), **_kitti()}
        p99 = {name: 1e3 * _p99(recordings) for name, recordings in scenes.items()}
    finally:
        kernels.native = chosen
    return max(p99.values()), {f"{name}_p99_ms": value for name, value in p99.items()}


def _p99(recordings: Iterable[Recording]) -> float:
    """Seconds: the quantile over all steps of all recordings."""
    taken = []
    for recording in recordings:
        tracker = PMBMTracker(site=recording.site)
        for detections in recording.detections:
            begin = time.process_time()
            tracker.step(detections)
            taken.append(time.process_time() - begin)
    return float(np.quantile(taken, 0.99))


def _simulated() -> Iterable[Recording]:
    from pmbm.sim.detector.model import load_profile
    from pmbm.sim.detector.replay import replay

    detector = load_profile("nominal")
    for seed in SEEDS:
        yield detector.detect(replay(World(100, 15.0, seed).recording(FRAMES)), seed)


def _kitti() -> dict[str, Iterable[Recording]]:
    data = os.environ.get("PMBM_DATA")
    if not data:
        return {}
    from pmbm.datasets import load, open_dataset

    root = Path(data) / "kitti"
    detections = str(root / "detections" / "pointrcnn_{class}")
    dataset = open_dataset("kitti", root=root, detections=detections, poses=root / "pose")
    return {"kitti": load(dataset)}
