"""What occlusion costs: its share of a step."""

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pmbm.filter import PMBMTracker
from pmbm.filter.models.occlusion import Shadows
from pmbm.filter.models.sensor import ObservationModel

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmark"))
from world import World

MOST = 0.3
"""Of a step at 50 objects."""


@pytest.mark.slow
@pytest.mark.parametrize(("objects", "promised"), [(50, True), (200, False), (1000, False)])
def test_occlusion_takes_a_small_share_of_a_step(objects, promised, monkeypatch, verified):
    spent = [0.0]

    def timed(function):
        def inside(*args):
            start = time.thread_time()
            try:
                return function(*args)
            finally:
                spent[0] += time.thread_time() - start

        return inside

    world = World(objects, spacing=15.0, seed=1)
    with_it = PMBMTracker(world.config(occlusion=True), world.site)
    monkeypatch.setattr(Shadows, "of", staticmethod(timed(Shadows.of)))
    monkeypatch.setattr(
        ObservationModel,
        "of_hidden_tracks",
        staticmethod(timed(ObservationModel.of_hidden_tracks)),
    )
    shares = []
    for number, (_, detections) in enumerate(world.frames(60)):
        spent[0], start = 0.0, time.thread_time()
        with_it.step(detections)
        if number >= 10:
            shares.append(spent[0] / (time.thread_time() - start))
    share = float(np.median(shares))
    what = f"share of a step's time that occlusion takes, {objects} objects 15 m apart"
    verdict = share <= MOST if promised else "report"
    verified("occlusion_cost", what, share, MOST if promised else None, verdict)
    assert share <= MOST or not promised
