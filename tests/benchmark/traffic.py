"""How much faster our traffic is than stock highway-env, and the cache than simulating anew.

Each bar's function gives its figure, a ratio of CPU time, the median over seeds with rivals
interleaved, and the details.
"""

from __future__ import annotations

import contextlib
import gc
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

from pmbm.sim import schema
from pmbm.sim.streams import Streams
from pmbm.sim.world import traffic

SEEDS = range(5)
RATE = 15
"""highway-env's own steps a second."""


def g50() -> tuple[float, dict[str, Any]]:
    """Stock time over ours, 50 IDM cars."""
    return _road(cars=50, ticks=60)


def g200() -> tuple[float, dict[str, Any]]:
    """Stock time over ours, 200 IDM cars."""
    return _road(cars=200, ticks=15)


def _road(cars: int, ticks: int) -> tuple[float, dict[str, Any]]:
    """Stock time over ours for the same steps of IDM traffic, states compared to the bit."""
    ratios = []
    for seed in SEEDS:
        with stock():
            slow_seconds, slow_state = _timed(cars, seed, ticks)
        fast_seconds, fast_state = _timed(cars, seed, ticks)
        if slow_state != fast_state:
            raise AssertionError(f"{cars} cars, seed {seed}: our road differs from stock")
        ratios.append(slow_seconds / fast_seconds)
    return statistics.median(ratios), {"seeds": ratios}


def h() -> tuple[float, dict[str, Any]]:
    """Recordings of one scenario for ten detector configurations: each simulated anew (on our fast
    road), over each from the cache, which begins empty."""
    from pmbm.sim import load_scenario
    from pmbm.sim.scenario import scenario as scenarios

    source = load_scenario("highway_dense")
    ratios = []
    for seed in SEEDS:
        with tempfile.TemporaryDirectory() as folder, _environment("PMBM_CACHE", folder):
            levels = [
                type(source)(
                    {
                        **source.document,
                        "detector": {
                            "profile": "nominal",
                            "objects": {"detection_probability": 0.9 - 0.03 * k},
                        },
                    }
                )
                for k in range(10)
            ]

            def anew(level: Any, seed: int = seed) -> None:
                level.detector().detect(scenarios.simulate(level.form, seed), seed)

            def kept(level: Any, seed: int = seed) -> None:
                # As a fresh process would: nothing is left in memory.
                scenarios.simulated_scene.cache_clear()
                level.record(seed)

            totals = [0.0, 0.0]
            for level in levels:
                totals[0] += _seconds(lambda level=level: anew(level))
                totals[1] += _seconds(lambda level=level: kept(level))
            ratios.append(totals[0] / totals[1])
    return statistics.median(ratios), {"seeds": ratios}


@contextlib.contextmanager
def stock() -> Iterator[None]:
    """Within it, traffic is driven by stock roads."""
    adopt = traffic.adopt
    traffic.adopt = lambda road: road
    try:
        yield
    finally:
        traffic.adopt = adopt


def _timed(cars: int, seed: int, ticks: int) -> tuple[float, list[Any]]:
    opened = traffic.open_roads(_dense(cars), RATE, Streams(seed))
    for hook in opened.hooks:
        hook(0)

    def steps() -> None:
        for _ in range(ticks):
            opened.step()

    seconds = _seconds(steps)
    return seconds, [
        (v.position.tobytes(), float(v.heading), float(v.speed), v.crashed)
        for v in opened.road.vehicles
    ]


def _dense(cars: int) -> schema.RoadScene:
    """Four lanes of IDM cars with lane changes, as in highway-env's own highway."""
    lanes = {
        f"lane{lane}": {
            "road": "main",
            "lane": lane,
            "position": 5000.0 + 5.0 * lane,
            "speed": 24.0,
            "count": (cars + lane) // 4,
            "spacing": -22.0 * 4 / 2,
            "lane_changes": True,
            "jitter": {"position": 6.0, "speed": 2.0},
        }
        for lane in range(4)
    }
    return schema.RoadScene.model_validate(
        {
            "kind": "road",
            "roads": {
                "main": {
                    "start": [0.0, 0.0],
                    "end": [10000.0, 0.0],
                    "lanes": 4,
                    "speed_limit": 30.0,
                }
            },
            "actors": lanes,
            "crashes": "allowed",
        }
    )


def _seconds(work: Callable[[], None]) -> float:
    gc.collect()
    start = time.process_time()
    work()
    return time.process_time() - start


@contextlib.contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
