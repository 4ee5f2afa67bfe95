"""An object that was given up and is seen again has its old id, where the evidence says so."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_problems import KEEP_ALL, plain_sensor, scan_of
from hypothesis import given
from hypothesis import strategies as st

from pmbm import Detections, Site
from pmbm.filter import BirthMap, BroadBirth, PMBMConfig, PMBMTracker, Reduction, Sensor
from pmbm.filter.association import associate
from pmbm.filter.density import Density, Mixture, RecycledFrom
from pmbm.filter.models.undetected_map import merged_by_cell, narrowed
from pmbm.filter.reduction import merge_mixture
from pmbm.filter.update import update
from pmbm.types import ABSENT

pytestmark = pytest.mark.usefixtures("assignment_kernel")
SENSOR = plain_sensor(0.25 * np.eye(2), 0.9, 1e-4)
KEPT = replace(KEEP_ALL, gate=30.0, max_hypotheses=9, clustering=True)
WIDE, NARROW = np.diag([900.0, 900.0, 25.0, 25.0]), np.diag([1.0, 1.0, 4.0, 4.0])


def after_scan(parts, z, alive=()):
    """The density after these points, from a PPP of (weight, place, cov, track, share)."""
    weight, place, cov, track, share = zip(*parts, strict=True)
    mean = np.zeros((len(parts), 4))
    mean[:, :2] = place
    share = np.array(share, float)
    origin = RecycledFrom(np.array(track, np.int64), share, share)
    ppp = Mixture(np.log(weight), mean, np.array(cov), origin)
    prior = replace(Density.initial(ppp), detections_seen=100, track_id=np.array(alive, np.int64))
    scan = scan_of(z)
    return update(prior, scan, associate(prior, scan, SENSOR, KEPT), SENSOR)


ANYWHERE = (0.5, (0, 0), WIDE, ABSENT, 0.0)


def ids(density, alive=()):
    return density.track_id[len(alive) :].tolist()


def test_who_is_explained_by_what_a_track_left_behind_is_that_object_again():
    left = (0.01, (10, 0), NARROW, 7, 1.0)
    assert ids(after_scan([ANYWHERE, left], [[10.3, 0.2], [-20, 5]])) == [7, 101]


def test_a_smaller_part_than_half_is_no_evidence():
    # In the middle of what was left the densities are 1 / (2 pi 1.25) and 1 / (2 pi 900.25) a unit.
    equal = 0.5 * 1.25 / 900.25
    for weight, share, want in (
        (1.02, 1.0, 7),
        (0.98, 1.0, 100),
        (10.0, 0.54, 100),
        (10.0, 0.56, 7),
    ):
        left = (weight * equal, (0, 0), NARROW, 7, share)
        assert ids(after_scan([ANYWHERE, left], [[0.0, 0.0]])) == [want]


def test_parts_of_one_track_count_together_and_of_different_ones_apart():
    half = (0.6e-3, (0, 0), NARROW, 7, 1.0)
    assert ids(after_scan([ANYWHERE, half], [[0.0, 0.0]])) == [100]
    assert ids(after_scan([ANYWHERE, half, half], [[0.0, 0.0]])) == [7]
    other = (0.6e-3, (0, 0), NARROW, 8, 1.0)
    assert ids(after_scan([ANYWHERE, half, other], [[0.0, 0.0]])) == [100]


def test_an_id_in_the_filters_mind_is_not_given_to_another():
    left = (0.01, (10, 0), NARROW, 7, 1.0)
    assert ids(after_scan([ANYWHERE, left], [[10.0, 0.0]], alive=[3, 7]), alive=[3, 7]) == [100]


def test_of_two_that_might_be_it_the_likelier_is():
    left = (0.01, (10, 0), NARROW, 7, 1.0)
    assert ids(after_scan([ANYWHERE, left], [[11.5, 0.0], [10.1, 0.0]])) == [100, 7]
    assert ids(after_scan([ANYWHERE, left], [[10.1, 0.0], [11.5, 0.0]])) == [7, 101]


@st.composite
def labelled(draw):
    n = draw(st.integers(1, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    root = rng.normal(0, 1, (n, 4, 4))
    track = rng.integers(ABSENT, 3, n)
    share = np.where(track == ABSENT, 0.0, rng.random(n))
    return Mixture(
        rng.uniform(-8, 0, n),
        rng.uniform(-3, 3, (n, 4)),
        root @ root.transpose(0, 2, 1),
        RecycledFrom(track, share, rng.uniform(share, np.where(track == ABSENT, 0.0, 1.0))),
    )


def owned(mixture):
    """Weight per track."""
    mass = {}
    if mixture.recycled_from is not None:
        own = np.exp(mixture.log_weight) * mixture.recycled_from.share
        for track, part in zip(mixture.recycled_from.track.tolist(), own.tolist(), strict=True):
            mass[track] = mass.get(track, 0.0) + part
    return {track: part for track, part in mass.items() if track != ABSENT and part > 0}


@given(labelled(), st.sampled_from(["near", "cell", "split"]))
def test_merging_neither_adds_to_anybodys_weight_nor_mixes_tracks(mixture, way):
    change = {
        "near": lambda m: merge_mixture(m, 1.0),
        "cell": lambda m: merged_by_cell(m, 3.5, math.inf),
        "split": narrowed,
    }[way]
    after, before = change(mixture), owned(mixture)
    bare = change(replace(mixture, recycled_from=None))
    for name in ("log_weight", "mean", "cov"):
        np.testing.assert_array_equal(getattr(after, name), getattr(bare, name))
    assert after.never_detected().sum() == pytest.approx(mixture.never_detected().sum())
    for track, part in owned(after).items():
        assert part <= before[track] * (1 + 1e-9)
    if way == "split":
        assert owned(after) == pytest.approx(before)
    if after.recycled_from is not None:
        assert ((after.recycled_from.share >= 0) & (after.recycled_from.share <= 1 + 1e-9)).all()


def test_one_group_is_of_the_track_that_most_of_it_is_of():
    place = np.zeros((4, 4))
    share = np.array([1.0, 1.0, 0.5, 0.0])
    origin = RecycledFrom(np.array([5, 6, 5, ABSENT]), share, share)
    weight = np.array([1.0, 1.2, 1.0, 0.8])
    whole = merged_by_cell(
        Mixture(np.log(weight), place, np.tile(NARROW, (4, 1, 1)), origin), 3.5, math.inf
    )
    assert whole.recycled_from.track.tolist() == [5]
    assert whole.recycled_from.share == pytest.approx([1.5 / 4.0])
    assert whole.recycled_from.recycled == pytest.approx([2.7 / 4.0])


def drive(seed, birth, recycle=True):
    """Objects that are missed for a while, and clutter: the tracker and its report, each step."""
    rng = np.random.default_rng(seed)
    config = PMBMConfig(
        birth=birth,
        sensor=Sensor(clutter_rate=2.0),
        reduction=Reduction(recycle_below=0.1, recycle=recycle),
    )
    tracker = PMBMTracker(config, Site(max_range=40.0))
    place, velocity = rng.uniform(-20, 20, (4, 2)), rng.normal(0, 1, (4, 2))
    for frame in range(25):
        seen = rng.random(4) < (0.0 if 10 <= frame < 16 else 0.9)
        z = np.concatenate(
            [(place + 0.1 * frame * velocity)[seen], rng.uniform(-28, 28, (rng.poisson(2), 2))]
        )
        n = len(z)
        report = tracker.step(
            Detections(
                time=0.1 * frame,
                position=np.column_stack([z, np.zeros(n)]),
                size=np.tile([4.0, 2.0, 1.5], (n, 1)),
                yaw=np.zeros(n),
                score=np.full(n, 0.8),
                label=np.ones(n, np.int8),
            )
        )
        yield tracker, report


@pytest.mark.parametrize("birth", [BroadBirth(rate=0.05), BirthMap(rate=0.05, spacing=4.0)])
def test_labels_change_no_number_and_ids_are_unique(birth):
    resumed = 0
    for (with_labels, report), (without, bare) in zip(
        drive(3, birth), drive(3, birth), strict=True
    ):
        a, b = with_labels.density, without.density
        for name in ("log_weight", "mean", "cov"):
            np.testing.assert_array_equal(getattr(a.undetected, name), getattr(b.undetected, name))
        np.testing.assert_array_equal(a.local.existence, b.local.existence)
        np.testing.assert_array_equal(report.position, bare.position)
        np.testing.assert_array_equal(a.local.mean, b.local.mean)
        assert len(np.unique(a.track_id)) == len(a.track_id)
        resumed += int((a.track_id != b.track_id).any())
        bare = b.with_undetected(replace(b.undetected, recycled_from=None))
        without.state = replace(without.state, density=bare)
    assert resumed > 0


def test_a_tracker_that_does_not_recycle_labels_nothing():
    for tracker, _ in drive(3, BroadBirth(rate=0.05), recycle=False):
        assert tracker.density.undetected.recycled_from is None
