"""Laws of the metrics: they are metrics, they do not depend on order, they punish errors only."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_builders import run_of

from pmbm.metrics import combine, evaluate, gospa, ospa
from pmbm.metrics.benchmarks.argoverse1 import argoverse1_counts
from pmbm.metrics.benchmarks.kitti import KittiScene, kitti_counts
from pmbm.metrics.benchmarks.nuscenes import nuscenes_scores
from pmbm.metrics.benchmarks.trackeval import trackeval_counts, trackeval_scores
from pmbm.metrics.benchmarks.waymo import WaymoScene, waymo_counts
from pmbm.metrics.catalogue import names
from pmbm.metrics.core.clear_matching import clear_matches
from pmbm.metrics.core.matching import best_matching, most_then_nearest
from pmbm.metrics.core.scene import pair_overlap, scene_of
from pmbm.metrics.families.clear import clear_counts
from pmbm.metrics.families.ospa2 import ospa2_series
from pmbm.metrics.families.tgospa import tgospa

FEWER = settings(max_examples=max(settings().max_examples // 4, 10))
"""For tests whose every example scores whole runs by every metric."""

# Coordinates on a grid make ties and exact hits of a gate common; others make them rare.
coordinates = st.one_of(
    st.integers(-8, 8).map(float), st.floats(-8, 8, allow_nan=False, allow_subnormal=False)
)
points = st.lists(st.tuples(coordinates, coordinates), max_size=5)
orders = st.sampled_from([1.0, 2.0, 3.0])
cutoffs = st.sampled_from([0.5, 2.0, 4.0, 10.0])


@st.composite
def frames(draw, count: int, ids: int):
    """`count` frames of up to `ids` objects that move, come and go."""
    return [
        {
            name: (draw(coordinates), draw(coordinates))
            for name in draw(st.sets(st.integers(1, ids), max_size=ids))
        }
        for _ in range(count)
    ]


@st.composite
def runs(draw):
    """Truth and tracks near it: kept, moved, renamed, dropped, with false ones between."""
    truth = draw(frames(draw(st.integers(1, 5)), 4))
    tracks = []
    for frame in truth:
        reports = {}
        for name, (x, y) in frame.items():
            if draw(st.integers(0, 4)):
                shift = st.sampled_from([0.0, 0.5, 1.0, 2.0])
                track = draw(st.sampled_from([name + 10, name + 10, name + 20, 11]))
                reports[track] = (x + draw(shift), y + draw(shift))
        if draw(st.booleans()):
            reports[99] = (draw(coordinates), draw(coordinates))
        tracks.append(reports)
    hidden = {
        k: [name for name in frame if not draw(st.integers(0, 3))] for k, frame in enumerate(truth)
    }
    return truth, tracks, hidden


def scene(truth, tracks, hidden=None):
    return scene_of(*run_of(truth, tracks, hidden=hidden))


def shuffled(frame, draw):
    return {name: frame[name] for name in draw(st.permutations(list(frame)))}


@pytest.mark.parametrize("distance", [gospa, ospa])
class TestMetricAxioms:
    @given(x=points, cutoff=cutoffs, order=orders)
    def test_identity(self, distance, x, cutoff, order):
        assert distance(x, x, cutoff=cutoff, order=order).distance == 0.0

    @given(x=points, y=points, cutoff=cutoffs, order=orders)
    def test_different_sets_are_apart(self, distance, x, y, cutoff, order):
        value = distance(x, y, cutoff=cutoff, order=order).distance
        if sorted(x) != sorted(y) and value == 0.0:
            # Only what is too close for the p-th power of the distance to be told from zero.
            assert len(x) == len(y)
            assert np.allclose(sorted(x), sorted(y), atol=1e-4)

    @given(x=points, y=points, cutoff=cutoffs, order=orders)
    def test_symmetry(self, distance, x, y, cutoff, order):
        there = distance(x, y, cutoff=cutoff, order=order).distance
        back = distance(y, x, cutoff=cutoff, order=order).distance
        assert there == pytest.approx(back, rel=1e-9, abs=1e-12)

    @given(x=points, y=points, z=points, cutoff=cutoffs, order=orders)
    def test_triangle(self, distance, x, y, z, cutoff, order):
        def d(a, b):
            return distance(a, b, cutoff=cutoff, order=order).distance

        assert d(x, z) <= d(x, y) + d(y, z) + 1e-9

    @given(x=points, y=points, cutoff=cutoffs, order=orders, data=st.data())
    def test_order_of_points_does_not_matter(self, distance, x, y, cutoff, order, data):
        value = distance(x, y, cutoff=cutoff, order=order).distance
        moved = distance(
            data.draw(st.permutations(x)), data.draw(st.permutations(y)), cutoff=cutoff, order=order
        )
        assert moved.distance == pytest.approx(value, rel=1e-9, abs=1e-12)


@given(x=points, y=points, cutoff=cutoffs, order=orders)
def test_gospa_against_every_assignment(x, y, cutoff, order):
    """By enumeration of all partial assignments."""
    d = np.array([[np.hypot(a[0] - b[0], a[1] - b[1]) for b in y] for a in x]).reshape(
        len(x), len(y)
    )
    best = np.inf
    for size in range(min(len(x), len(y)) + 1):
        for rows in itertools.combinations(range(len(x)), size):
            for columns in itertools.permutations(range(len(y)), size):
                cost = sum(d[i, j] ** order for i, j in zip(rows, columns, strict=True))
                best = min(best, cost + cutoff**order / 2 * (len(x) + len(y) - 2 * size))
    result = gospa(x, y, cutoff=cutoff, order=order)
    assert result.distance**order == pytest.approx(best, rel=1e-9, abs=1e-12)
    parts = result.localisation + result.missed + result.false
    assert parts == pytest.approx(best, rel=1e-9, abs=1e-12)


@given(x=points, y=points, cutoff=cutoffs, order=orders)
def test_ospa_against_every_assignment(x, y, cutoff, order):
    if len(x) > len(y):
        x, y = y, x
    best = min(
        sum(
            min(np.hypot(a[0] - b[0], a[1] - b[1]), cutoff) ** order
            for a, b in zip(x, chosen, strict=True)
        )
        for chosen in itertools.permutations(y, len(x))
    )
    size = max(len(y), 1)
    expected = ((best + cutoff**order * (len(y) - len(x))) / size) ** (1 / order)
    assert ospa(x, y, cutoff=cutoff, order=order).distance == pytest.approx(
        expected, rel=1e-9, abs=1e-12
    )


@given(x=points, y=points, cutoff=cutoffs)
def test_ospa_of_infinite_order_is_the_limit_of_large_ones(x, y, cutoff):
    limit = ospa(x, y, cutoff=cutoff, order=np.inf).distance
    size = max(len(x), len(y), 1)
    large = ospa(x, y, cutoff=cutoff, order=60.0).distance
    assert limit * size ** (-1 / 60) - 1e-9 <= large <= limit + 1e-9


@given(x=points, y=points, cutoff=cutoffs, order=orders)
def test_bounds(x, y, cutoff, order):
    assert 0 <= ospa(x, y, cutoff=cutoff, order=order).distance <= cutoff * (1 + 1e-12)
    most = (cutoff**order / 2 * (len(x) + len(y))) ** (1 / order)
    assert 0 <= gospa(x, y, cutoff=cutoff, order=order).distance <= most * (1 + 1e-12)


@given(x=points, y=points, false=st.tuples(coordinates, coordinates), cutoff=cutoffs)
def test_removing_a_false_track_never_hurts_gospa(x, y, false, cutoff):
    if any(np.hypot(a[0] - false[0], a[1] - false[1]) < cutoff for a in x):
        return
    with_it = gospa(x, [*y, false], cutoff=cutoff)
    without = gospa(x, y, cutoff=cutoff)
    assert without.distance <= with_it.distance + 1e-12
    assert with_it.false_count == without.false_count + 1


@st.composite
def graphs(draw):
    """Pairs of a bipartite graph, each once, in order of row, then column, with weights."""
    pairs = sorted(draw(st.sets(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=9)))
    weights = draw(st.lists(st.integers(1, 6).map(float), min_size=len(pairs), max_size=len(pairs)))
    return pairs, weights


def matchings(pairs):
    """Every matching, as tuples of pair numbers."""
    for size in range(len(pairs) + 1):
        for chosen in itertools.combinations(range(len(pairs)), size):
            rows, columns = {pairs[k][0] for k in chosen}, {pairs[k][1] for k in chosen}
            if len(rows) == len(columns) == size:
                yield chosen


@given(graph=graphs())
def test_matchings_against_enumeration(graph):
    pairs, weights = graph
    rows = np.array([i for i, _ in pairs], np.int64)
    columns = np.array([j for _, j in pairs], np.int64)
    weight = np.array(weights)
    every = list(matchings(pairs))

    best = best_matching(rows, columns, weight)
    assert tuple(best) in every
    assert weight[best].sum() == max(sum(weights[k] for k in chosen) for chosen in every)

    nearest = most_then_nearest(rows, columns, weight)
    assert tuple(nearest) in every
    most = max(map(len, every))
    assert len(nearest) == most
    assert weight[nearest].sum() == min(
        sum(weights[k] for k in chosen) for chosen in every if len(chosen) == most
    )


@given(
    run=runs(),
    reach=st.sampled_from([0.5, 1.0, 2.0, 5.0, 30.0]),
    origin=st.sampled_from([(0, 0), (-1e6, 300), (4e5, 5.6e6)]),
)
def test_near_pairs_are_the_near_ones_of_all_pairs(run, reach, origin):
    truth, tracks = (
        [{name: (x + origin[0], y + origin[1]) for name, (x, y) in frame.items()} for frame in side]
        for side in run[:2]
    )
    every = scene(truth, tracks).pairs
    expected = every.take(every.distance < reach)
    made = scene(truth, tracks)
    made.near(2 * reach)
    for near in (scene(truth, tracks).near(reach), made.near(reach)):
        for name, column in vars(expected).items():
            np.testing.assert_array_equal(getattr(near, name), column)


@FEWER
@given(run=runs(), data=st.data())
def test_no_score_depends_on_the_order_of_objects_in_a_frame(run, data):
    truth, tracks, hidden = run
    mixed_truth = [shuffled(frame, data.draw) for frame in truth]
    mixed_tracks = [shuffled(frame, data.draw) for frame in tracks]
    given_order = evaluate(*run_of(truth, tracks, hidden=hidden), names()).scalars()
    other_order = evaluate(*run_of(mixed_truth, mixed_tracks, hidden=hidden), names()).scalars()
    assert given_order == other_order

    results = []
    for made in (scene(truth, tracks), scene(mixed_truth, mixed_tracks)):
        overlap = pair_overlap(made)
        waymo = WaymoScene(
            scene=made,
            overlap=overlap,
            level=np.ones(len(made.truth), np.int64),
            in_no_label_zone=np.zeros(len(made.tracks), np.bool_),
        )
        scores = nuscenes_scores([made])
        results.append(
            str(
                (
                    argoverse1_counts(made),
                    kitti_counts(KittiScene.plain(made, overlap), 0.25),
                    trackeval_scores(trackeval_counts(made, overlap)),
                    vars(waymo_counts(waymo, 0.5)[1]),
                    None if scores is None else (scores.amota, scores.amotp, scores.at_best),
                )
            )
        )
    assert results[0] == results[1]


@FEWER
@given(run=runs())
def test_counts_add_up_and_stay_in_bounds(run):
    truth, tracks, hidden = run
    recording, reports = run_of(truth, tracks, hidden=hidden)
    evaluation = evaluate(recording, reports)
    made = scene_of(recording, reports)
    counts = clear_counts(made, clear_matches(made))
    assert counts.matches + counts.misses == counts.truths == sum(map(len, truth))
    assert counts.matches + counts.false_positives == counts.tracks == sum(map(len, tracks))
    assert counts.switches <= counts.matches
    scores = evaluation.scalars()
    for name in ("idf1", "hota", "deta", "assa", "loca", "precision", "recall", "track_life"):
        for suffix in ("", "_observable"):
            value = scores[name + suffix]
            assert value is None or 0 <= value <= 1 + 1e-12
    assert scores["mota"] is None or scores["mota"] <= 1
    for value in evaluation.values():
        assert (value.value is None) == (value.reason is not None)
        assert value.value is None or np.isfinite(value.value)


@FEWER
@given(run=runs())
def test_a_run_against_itself_is_perfect(run):
    truth, _, hidden = run
    scores = evaluate(*run_of(truth, truth, hidden=hidden), names()).scalars()
    for name in ("gospa", "ospa", "ospa2", "tgospa", "gospa_observable", "ospa_observable"):
        assert scores[name] == 0.0
    if any(truth):
        for name in ("idf1", "hota", "assa"):
            assert scores[name] == pytest.approx(1.0)


@FEWER
@given(run=runs())
def test_objects_that_are_all_observable_score_the_same_in_either_scope(run):
    truth, tracks, _ = run
    scores = evaluate(*run_of(truth, tracks)).scalars()
    for name, value in scores.items():
        assert scores.get(name + "_observable", value) == value


@FEWER
@given(first=runs(), second=runs())
def test_combining_adds_counts(first, second):
    evaluations = [evaluate(*run_of(*run[:2], hidden=run[2])) for run in (first, second)]
    both = combine(evaluations)
    for name in ("misses", "false_positives", "id_switches", "fragmentations", "false_tracks"):
        assert both[name].value == sum(one[name].value for one in evaluations)
    frames = [one["gospa"].counts["frames"] for one in evaluations]
    assert both["gospa"].value == pytest.approx(
        np.average([one["gospa"].value for one in evaluations], weights=frames)
    )
    backwards = combine(evaluations[::-1])
    for name, value in both.scalars().items():
        if value is None:
            assert backwards[name].value is None
        else:
            assert backwards[name].value == pytest.approx(value, rel=1e-12, abs=1e-12)


class TestWholeTracks:
    @FEWER
    @given(data=st.data(), cutoff=cutoffs, order=orders)
    def test_tgospa_is_a_metric(self, data, cutoff, order):
        x, y, z = (data.draw(frames(3, 3)) for _ in range(3))
        switch = data.draw(st.sampled_from([0.5, 2.0, 5.0]))

        def d(a, b):
            return tgospa(scene(a, b), cutoff=cutoff, order=order, switch=switch).distance

        assert d(x, x) == pytest.approx(0.0, abs=1e-6)
        assert d(x, y) == pytest.approx(d(y, x), rel=1e-6, abs=1e-6)
        assert d(x, z) <= d(x, y) + d(y, z) + 1e-6

    @FEWER
    @given(data=st.data(), cutoff=cutoffs)
    def test_tgospa_lies_between_single_frames_and_any_fixed_assignment(self, data, cutoff):
        truth, tracks = data.draw(frames(3, 3)), data.draw(frames(3, 3))
        made = scene(truth, tracks)
        result = tgospa(made, cutoff=cutoff, order=2.0, switch=2.0)
        # Each frame at its best and no cost for switching: the least that it can be.
        least = sum(
            gospa(list(x.values()), list(y.values()), cutoff=cutoff).distance ** 2
            for x, y in zip(truth, tracks, strict=True)
        )
        assert result.distance**2 >= least - 1e-6
        # Ids held together for the whole run, by enumeration: no switch at all.
        ids = [1, 2, 3]
        most = np.inf
        for partners in itertools.permutations([*ids, None, None, None], 3):
            cost = 0.0
            for x, y in zip(truth, tracks, strict=True):
                near = 0
                for i, j in zip(ids, partners, strict=True):
                    if i in x and j in y:
                        d = np.hypot(x[i][0] - y[j][0], x[i][1] - y[j][1])
                        if d < cutoff:
                            near += 1
                            cost += d**2
                cost += cutoff**2 / 2 * (len(x) + len(y) - 2 * near)
            most = min(most, cost)
        assert result.distance**2 <= most + 1e-6

    def test_tgospa_of_a_full_swap(self):
        # Two tracks exchange their objects: each object pays gamma^p for its change.
        truth = [{1: (0, 0), 2: (0, 20)}] * 6
        tracks = [{7: (0, 0), 8: (0, 20)}] * 3 + [{8: (0, 0), 7: (0, 20)}] * 3
        result = tgospa(scene(truth, tracks), cutoff=4.0, order=2.0, switch=2.0)
        assert result.switch == pytest.approx(2 * 2.0**2)
        assert result.distance**2 == pytest.approx(8.0)

    @FEWER
    @given(data=st.data(), cutoff=cutoffs, order=orders, window=st.integers(1, 4))
    def test_ospa2_against_its_definition(self, data, cutoff, order, window):
        truth, tracks = data.draw(frames(4, 3)), data.draw(frames(4, 3))
        series = ospa2_series(scene(truth, tracks), window, cutoff, order).distance
        for k in range(4):
            inside = range(max(0, k - window + 1), k + 1)
            assert series[k] == pytest.approx(
                _ospa2([truth[t] for t in inside], [tracks[t] for t in inside], cutoff, order),
                rel=1e-9,
                abs=1e-9,
            )


def _ospa2(truth, tracks, cutoff, order) -> float:
    """OSPA between sets of tracks, by enumeration."""
    a = sorted({name for frame in truth for name in frame})
    b = sorted({name for frame in tracks for name in frame})

    def base(i, j) -> float:
        terms = []
        for x, y in zip(truth, tracks, strict=True):
            if i in x and j in y:
                d = np.hypot(x[i][0] - y[j][0], x[i][1] - y[j][1])
                terms.append(min(d, cutoff) ** order)
            elif i in x or j in y:
                terms.append(cutoff**order)
        return float(np.mean(terms))

    if len(a) > len(b):
        best = min(
            sum(base(i, j) for i, j in zip(chosen, b, strict=True))
            for chosen in itertools.permutations(a, len(b))
        )
    else:
        best = min(
            sum(base(i, j) for i, j in zip(a, chosen, strict=True))
            for chosen in itertools.permutations(b, len(a))
        )
    size = max(len(a), len(b), 1)
    return ((best + cutoff**order * abs(len(a) - len(b))) / size) ** (1 / order)
