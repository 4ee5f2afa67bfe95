"""A large scene in a process of its own: `python large.py OBJECTS SEED` prints what it took."""

from __future__ import annotations

import json
import resource
import sys
import time
from typing import Any

import numpy as np
from world import World

from pmbm import PMBMTracker

MILLION = 1_000_000


def large(objects: int, seed: int) -> dict[str, Any]:
    """Seconds a frame, seconds of the first five, and the peak memory of the process, MB."""
    world = World(objects, 15.0, seed)
    # As many tracks as there are objects, and no limit that makes the last ones cheap.
    config = world.config().changed(
        {"reduction.max_tracks": 20 * objects, "reduction.max_undetected": 20 * objects}
    )
    tracker = PMBMTracker(config, world.site)
    warm_up, frames = (0, 5) if objects == MILLION else (6, 10)
    seconds = []
    for detections in world.each_scan(frames):
        begin = time.process_time()
        tracker.step(detections)
        seconds.append(time.process_time() - begin)
    unit = 1 if sys.platform == "darwin" else 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    median = float(np.median(seconds[warm_up:]))
    return {
        "objects": objects,
        "seed": seed,
        "seconds": median,
        "first_five": sum(seconds[:5]),
        "megabytes": peak,
    }


if __name__ == "__main__":
    print(json.dumps(large(int(sys.argv[1]), int(sys.argv[2]))))
