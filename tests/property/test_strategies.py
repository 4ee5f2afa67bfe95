"""How to let hypothesis break a tracker: a planted bug is found and shrinks to next to nothing."""

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, find, given, settings
from hypothesis import strategies as st

from pmbm import run
from pmbm.geometry import iou
from pmbm.sim.search.strategies import Mover, detectors, faulty, recordings, scenes, traffic
from pmbm.sim.world.scene import Scene
from pmbm.types import CLUTTER, Recording, Tracks

QUICK = settings(
    max_examples=200,
    derandomize=True,
    deadline=None,
    database=None,
    phases=[Phase.generate, Phase.shrink],
)


class Nearest:
    """A tracker that gives each detection the id of the nearest one before, if that is near.

    The bug: it looks for the nearest id of each detection alone, so two detections may take one.
    """

    def __init__(self, fixed=False):
        self.fixed = fixed
        self.known = {}
        self.fresh = 1

    def step(self, detections):
        ids = []
        for position in detections.position:
            free = {i: p for i, p in self.known.items() if not (self.fixed and i in ids)}
            near = [i for i, p in free.items() if np.linalg.norm(p - position) < 6.0]
            if near:
                ids.append(min(near, key=lambda i: np.linalg.norm(free[i] - position)))
            else:
                ids.append(self.fresh)
                self.fresh += 1
        self.known = dict(zip(ids, detections.position, strict=True))
        n = len(detections)
        return Tracks(
            time=detections.time,
            id=ids,
            position=detections.position,
            size=detections.size,
            yaw=detections.yaw,
            velocity=np.zeros((n, 2)),
            score=np.ones(n),
            label=detections.label,
        )


def gives_an_id_twice(recording, fixed=False):
    try:
        run(Nearest(fixed), recording)
    except ValueError:
        return True
    return False


def test_a_planted_bug_is_found_and_shrinks_to_two_objects_and_a_perfect_detector():
    worlds = st.tuples(scenes(max_vehicles=4, max_frames=8), detectors(), st.integers(0, 99))
    scene, detector, _ = find(
        worlds, lambda world: gives_an_id_twice(world[1].detect(world[0], world[2])), settings=QUICK
    )
    assert max(len(frame) for frame in scene.truth) <= 3
    faults = [
        detector.objects != faulty().objects,
        detector.clutter != faulty().clutter,
        detector.sensor != faulty().sensor,
    ]
    # Two boxes that close need either a second object or one fault that doubles the first.
    assert sum(faults) <= 1
    assert not gives_an_id_twice(detector.detect(scene, 0), fixed=True)


def test_shrinking_ends_at_one_standing_car_and_a_perfect_detector():
    scene = find(scenes(), lambda scene: True, settings=QUICK)
    assert len(scene) == 2
    assert [len(frame) for frame in scene.truth] == [1, 1]
    assert scene.truth_digest() == traffic([Mover(distance=8)], frames=2).truth_digest()
    assert find(detectors(), lambda detector: True, settings=QUICK) == faulty()
    recording = find(recordings(), lambda recording: True, settings=QUICK)
    assert [origin.tolist() for origin in recording.origin] == [[0], [0]]


@given(scenes())
@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=25)
def test_scenes_are_valid_and_no_bodies_overlap(scene):
    assert isinstance(scene, Scene)
    assert 2 <= len(scene) <= 40
    assert any(len(frame) for frame in scene.truth)
    for frame in scene.truth:
        box = (frame.position, frame.size, frame.yaw)
        overlap = iou(*box, *box, vertical=False) - np.eye(len(frame))
        assert np.abs(overlap).max(initial=0) < 1e-9


@given(recordings(scenes(max_vehicles=3, max_frames=8)))
@settings(suppress_health_check=[HealthCheck.too_slow], max_examples=40)
def test_recordings_are_valid_and_made_by_their_detector(recording):
    assert isinstance(recording, Recording)
    profile = recording.provenance["detector"]["profile"]
    doubles = profile["objects"]["duplicate_probability"] > 0
    for origin in recording.origin:
        true = origin[origin != CLUTTER]
        assert doubles or len(set(true.tolist())) == len(true)
        assert profile["clutter"]["rate"] > 0 or len(true) == len(origin)


def test_a_mover_moves_as_it_says():
    position, yaw = Mover(distance=20, bearing=90, speed=10, heading=180, turn=90).path(11)
    np.testing.assert_allclose(position[0, :2], [0, 20], atol=1e-9)
    assert yaw[-1] == pytest.approx(-np.pi / 2)
    # A quarter of a circle in a second: the chord is about speed times 2 sqrt(2) / pi.
    chord = np.linalg.norm(position[-1] - position[0])
    assert chord == pytest.approx(10 * 2 * np.sqrt(2) / np.pi, rel=0.01)
