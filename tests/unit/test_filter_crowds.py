"""No frame stalls and nothing grows, however crowded one frame is and however long a run takes."""

from __future__ import annotations

import gc
import multiprocessing
import re
import resource
import time
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from pmbm import Detections, PMBMConfig, PMBMTracker, Site, kernels

needs_kernels = pytest.mark.skipif(
    kernels.native is None, reason="the plain filter is for reading, not for crowds"
)


def frame(when, z):
    """Boxes so small that none is in another's place."""
    n = len(z)
    return Detections(
        time=when,
        position=np.column_stack([z, np.zeros(n)]),
        size=np.full((n, 3), 0.02),
        yaw=np.zeros(n),
        score=np.full(n, 0.5),
        label=np.zeros(n, np.int8),
    )


@needs_kernels
def test_ten_thousand_detections_on_fifty_tracks_do_not_stall_a_frame():
    """All in one cluster, in each other's gates; what is known survives it."""
    random = np.random.default_rng(1)
    place = random.normal(0, 0.5, (50, 2))
    tracker = PMBMTracker(PMBMConfig(), Site(max_range=80.0))
    slowest, reported = 0.0, 0
    for k in range(10):
        crowd = random.normal(0, 2, (10_000, 2))
        z = crowd if k == 6 else place + random.normal(0, 0.3, place.shape)
        begin = time.process_time()
        reported = len(tracker.step(frame(0.1 * k, z)))
        slowest = max(slowest, time.process_time() - begin)
    assert reported >= 40
    # It takes a fifth of a second; without the limits it takes a minute.
    assert slowest < 4.0


SOAK_FRAMES = 100_000


def coming_and_going(frames, random):
    """Up to five objects at a time, each for some seconds, in a little clutter."""
    objects = np.zeros((0, 4))
    for k in range(frames):
        objects[:, :2] += 0.1 * objects[:, 2:]
        objects = objects[random.random(len(objects)) < 0.98]
        if len(objects) < 5 and random.random() < 0.1:
            born = np.concatenate([random.uniform(-40, 40, 2), random.normal(0, 5, 2)])
            objects = np.concatenate([objects, born[None]])
        seen = objects[random.random(len(objects)) < 0.9, :2]
        clutter = random.uniform(-50, 50, (random.poisson(1), 2))
        yield frame(0.1 * k, np.concatenate([seen + random.normal(0, 0.3, seen.shape), clutter]))


def tables(tracker):
    density = tracker.density
    return len(density.local) + len(density.undetected) + len(density.track_id)


def test_a_run_leaves_nothing_behind():
    """What is allocated after 1000 frames beside 400, where what a frame leaves would add up."""
    tracker = PMBMTracker(PMBMConfig(), Site(max_range=60.0))
    allocated = []
    tracemalloc.start()
    for k, detections in enumerate(coming_and_going(1000, np.random.default_rng(2)), 1):
        tracker.step(detections)
        if k in (400, 1000):
            del detections
            gc.collect()
            allocated.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert allocated[-1] - allocated[0] < 40e3
    assert tables(tracker) < 2000


def peak_memory():
    """MB that this process has held at most."""
    status = Path("/proc/self/status")
    if status.is_file():
        # Linux's ru_maxrss starts at what the process held that started this one.
        return int(re.search(r"VmHWM:\s*(\d+) kB", status.read_text())[1]) / 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def soak():
    """Per tenth of a long run: s that a frame takes, peak memory so far, rows of the tables."""
    tracker = PMBMTracker(PMBMConfig(), Site(max_range=60.0))
    tenth = SOAK_FRAMES // 10
    seconds, megabytes, sizes = [], [], []
    for k, detections in enumerate(coming_and_going(SOAK_FRAMES, np.random.default_rng(1))):
        begin = time.process_time()
        tracker.step(detections)
        seconds.append(time.process_time() - begin)
        if (k + 1) % tenth == 0:
            gc.collect()
            megabytes.append(peak_memory())
            sizes.append(tables(tracker))
    return np.median(np.reshape(seconds, (10, tenth)), axis=1), megabytes, sizes


@pytest.mark.slow
@needs_kernels
def test_a_day_long_run_stays_as_small_and_as_fast_as_it_was(verified):
    """Memory and time per frame of the last tenth beside those of the second, in a process of its
    own: in this one, the peak may be that of another test."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as alone:
        seconds, megabytes, sizes = alone.submit(soak).result()
    slower = float(seconds[-1] / seconds[1])
    grown = megabytes[-1] - megabytes[1]
    verified(
        "soak",
        f"{SOAK_FRAMES} frames with births and deaths: peak memory gained after a fifth, MB",
        round(grown, 2),
        10,
        grown < 10,
    )
    verified(
        "soak_time",
        "the same: time per frame in the last tenth / in the second",
        round(slower, 2),
        1.3,
        slower < 1.3,
    )
    assert grown < 10, megabytes
    assert slower < 1.3
    assert max(sizes[1:]) < 2000, sizes
