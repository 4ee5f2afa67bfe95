"""A reported object keeps its id when another track proves to be what it was."""

from dataclasses import replace

import numpy as np
import pytest
from filter_problems import bernoullis
from hypothesis import given
from hypothesis import strategies as st
from mark_builders import frame

from pmbm.filter import PMBMConfig, PMBMTracker
from pmbm.filter.density import MISSED, Density, Mixture, RecycledFrom
from pmbm.filter.estimation import Marginals
from pmbm.filter.identity.inheritance import IdInheritance

ROAD = {
    "sensor.position_sd": 0.2,
    "motion.acceleration_density": 2.0,
    "sensor.clutter_rate": 5.0,
    "birth.rate": 2.0,
}


def run(places):
    """The tracks over frames a tenth of a second apart, of one detection or none each."""
    tracker = PMBMTracker(PMBMConfig.textbook().changed(ROAD))
    return [tracker.step(frame(0.1 * k, place)) for k, place in enumerate(places)]


def reported_as(inheritance):
    return dict(zip(inheritance.candidate.tolist(), inheritance.reported_as.tolist(), strict=True))


def step(inheritance, *tracks, recycled=()):
    """After a step with these tracks: (id, existence, measurement taken, whether reported)."""
    ids, existence, taken, reported = zip(*tracks, strict=True)
    n = len(tracks)
    k = len(recycled)
    origin = RecycledFrom.of(np.array(recycled, np.int64))
    undetected = Mixture(np.zeros(k), np.zeros((k, 4)), np.zeros((k, 4, 4)), origin)
    history = np.array(taken, np.int32)[:, None]
    local = bernoullis(
        np.arange(n), existence, np.zeros((n, 4)), np.zeros((n, 4, 4)), history=history
    )
    density = replace(Density.initial(undetected), local=local, track_id=np.array(ids, np.int64))
    marginal = Marginals(np.array(existence), np.array(existence)[:, None], np.arange(n))
    inheritance, density = inheritance.after(
        density, marginal, np.array(existence), np.flatnonzero(reported)
    )
    return inheritance, density.track_id.tolist(), density.undetected.recycled_from.track.tolist()


def test_an_object_keeps_its_id_when_its_first_detection_proves_to_be_clutter():
    """One false detection two metres beside where an object then stands: the track that began with
    it is believed at first, the one that began with the object later."""
    shown = run([[[0.0, 0.0]]] + [[[2.0, 0.0]]] * 6)
    assert [one.id.tolist() for one in shown] == [[], [0], [0], [0], [0], [0], [0]]
    # It is the other track: it stands, and the first one was on its way.
    speed = [float(np.hypot(*one.velocity[0])) for one in shown[1:]]
    assert speed[0] > 10
    assert speed[2] < 2


def test_the_likelier_explanation_of_what_was_reported_goes_by_its_id():
    first, ids, _ = step(IdInheritance(), (3, 0.9, 0, True), (5, 0.1, 0, False))
    assert (reported_as(first), ids) == ({5: 3}, [3, 5])
    after, ids, _ = step(first, (3, 0.2, MISSED, False), (5, 0.8, 0, True))
    assert ids == [5, 3]
    # Each goes on under its new id, and the first may win back what was reported.
    _, ids, _ = step(after, (5, 0.7, 1, True), (3, 0.9, 0, True))
    assert ids == [5, 3]
    _, ids, _ = step(after, (5, 0.8, 0, True), (3, 0.1, MISSED, False))
    assert ids == [3, 5]


def test_also_where_the_elder_is_gone_and_wherever_its_id_is_kept():
    first, _, _ = step(IdInheritance(), (3, 0.9, 0, True), (5, 0.1, 0, False))
    _, ids, recycled = step(first, (5, 0.8, 0, True), recycled=[3, 9])
    assert (ids, recycled) == ([3], [5, 9])
    waiting, _, _ = step(first, (8, 0.4, 1, False), recycled=[5])
    _, ids, _ = step(waiting, (5, 0.8, 0, True))
    assert ids == [3]


@pytest.mark.parametrize(
    ("before", "now"),
    [
        pytest.param(
            ((3, 0.9, 0, True), (5, 0.1, 0, False)),
            ((3, 0.4, MISSED, False), (5, 0.8, 0, True)),
            id="both are there",
        ),
        pytest.param(
            ((3, 0.9, 0, True), (5, 0.1, 0, False)),
            ((3, 0.3, 1, True), (5, 0.6, 0, True)),
            id="both are reported",
        ),
        pytest.param(
            ((3, 0.9, 0, True), (5, 0.1, 1, False)),
            ((3, 0.1, MISSED, False), (5, 0.8, 0, True)),
            id="they never had a detection in common",
        ),
        pytest.param(
            ((3, 0.9, MISSED, True), (5, 0.1, MISSED, False)),
            ((3, 0.1, MISSED, False), (5, 0.8, 0, True)),
            id="a miss is nothing in common",
        ),
    ],
)
def test_two_objects_keep_their_own(before, now):
    first, _, _ = step(IdInheritance(), *before)
    _, ids, _ = step(first, *now)
    assert ids == [3, 5]


def test_who_was_reported_has_a_story_of_its_own():
    alone, _, _ = step(IdInheritance(), (3, 0.9, 0, True))
    first, _, _ = step(alone, (3, 0.9, 0, True), (5, 0.1, 0, False))
    assert reported_as(first) == {}
    _, ids, _ = step(first, (3, 0.1, MISSED, False), (5, 0.8, 0, True))
    assert ids == [3, 5]
    # Nor does one that was reported before, and is in doubt now, go by a new one's id.
    lost, _, _ = step(alone, (3, 0.1, 0, False), (5, 0.9, 0, True))
    assert reported_as(lost) == {}


def test_one_that_is_sure_beside_its_elder_never_takes_over():
    first, _, _ = step(IdInheritance(), (3, 0.9, 0, True), (5, 0.1, 0, False))
    both, _, _ = step(first, (3, 0.9, 0, True), (5, 0.8, 1, True))
    assert reported_as(both) == {}
    _, ids, _ = step(both, (3, 0.1, MISSED, False), (5, 0.8, 0, True))
    assert ids == [3, 5]


def test_what_is_gone_is_forgotten():
    inheritance = IdInheritance()
    for k in range(0, 3000, 3):
        inheritance, _, _ = step(inheritance, (k, 0.9, 0, True), (k + 1, 0.1, 0, False))
    assert len(inheritance.reported_ids) + len(inheritance.candidate) < 80
    # What was given up and may come back is not.
    inheritance, _, _ = step(inheritance, (8000, 0.9, 0, True), (8001, 0.1, 0, False))
    for k in range(9000, 9100):
        inheritance, _, _ = step(inheritance, (k, 0.9, 1, True), recycled=[8001])
    assert reported_as(inheritance)[8001] == 8000
    assert 8000 in inheritance.reported_ids


@given(st.integers(0, 2**32 - 1))
def test_only_ids_change(seed):
    """With and without, everything but the ids is the same, and no id is told of two at a time."""
    rng = np.random.default_rng(seed)
    places = [rng.normal(0, 1.5, (rng.integers(0, 4), 2)) for _ in range(12)]
    shown = run(places)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdInheritance, "after", lambda self, density, *rest: (self, density))
        plain = run(places)
    for one, other in zip(shown, plain, strict=True):
        assert len(set(one.id.tolist())) == len(one)
        assert np.array_equal(one.position, other.position)
        assert np.array_equal(one.score, other.score)
        assert np.array_equal(one.covariance, other.covariance)
    used = [{one for tracks in each for one in tracks.id.tolist()} for each in (shown, plain)]
    assert len(used[0]) <= len(used[1])
