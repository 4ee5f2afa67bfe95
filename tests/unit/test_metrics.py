"""Metrics on situations small enough to work out by hand."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from metric_builders import recording_of, run_of, tracks_frame, truth_frame

from pmbm.errors import InputError
from pmbm.labels import Label
from pmbm.metrics import MetricParameters, combine, evaluate, gospa, ospa
from pmbm.metrics.catalogue import names
from pmbm.metrics.core.scene import sorted_boxes
from pmbm.types import TrackSequence

CAR, OTHER_CAR, THIRD_CAR = 1, 2, 3


def test_gospa_splits_into_misplacement_misses_and_ghosts():
    # One pair 1 m apart, one object missed, one track of nothing; c = 4: c^2 / 2 = 8 for each.
    result = gospa([[0, 0], [50, 0]], [[1, 0], [0, 90]])
    assert (result.localisation, result.missed, result.false) == (1.0, 8.0, 8.0)
    assert (result.missed_count, result.false_count) == (1, 1)
    assert result.distance == pytest.approx(np.sqrt(17))


def test_gospa_at_the_cutoff_is_one_missed_and_one_false():
    result = gospa([[0, 0]], [[4, 0]])
    assert (result.localisation, result.missed_count, result.false_count) == (0.0, 1, 1)
    assert result.distance == 4.0


def test_gospa_takes_the_best_assignment_not_the_nearest_neighbour():
    # Greedy would take the pair 0.5 m apart and leave 3.5 m: 0.25 + 12.25; the best is 1 + 4.
    result = gospa([[0, 0], [1.5, 0]], [[1.0, 0], [3.5, 0]])
    assert result.localisation == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("truth", "estimates", "distance"),
    [([], [], 0.0), ([[0, 0]], [], np.sqrt(8)), ([], [[0, 0], [9, 9]], 4.0)],
)
def test_gospa_of_empty_sets(truth, estimates, distance):
    assert gospa(truth, estimates).distance == pytest.approx(distance)


def test_ospa_is_per_object():
    # (1^2 + 10^2) / 2 under the root: one pair 1 m apart, one object without a track.
    result = ospa([[0, 0], [50, 0]], [[1, 0]])
    assert result.distance == pytest.approx(np.sqrt(50.5))
    assert result.localisation**2 + result.cardinality**2 == pytest.approx(50.5)


def test_ospa_assigns_squares_of_distances():
    # Sums of distances prefer 0 + 8.54 to 4.5 + 4.61; sums of squares prefer the latter.
    result = ospa([[0, 0], [4.5, 0]], [[4.5, 0], [8, 3]], cutoff=100)
    assert result.distance == pytest.approx(np.sqrt((4.5**2 + 3.5**2 + 3**2) / 2))


def test_ospa_of_infinite_order_is_the_largest_distance_of_the_best_assignment():
    assert ospa([[0, 0], [3, 0]], [[1, 0], [5, 0]], order=np.inf).distance == 2.0
    assert ospa([[0, 0]], [[1, 0], [5, 0]], order=np.inf).distance == 10.0
    assert ospa([], [], order=np.inf).distance == 0.0


def test_ospa_of_empty_sets():
    assert ospa([], []).distance == 0.0
    assert ospa([[1, 2]], []).distance == 10.0


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"cutoff": 0.0}, "cutoff"),
        ({"cutoff": np.nan}, "cutoff"),
        ({"order": 0.5}, "order"),
    ],
)
@pytest.mark.parametrize("distance", [gospa, ospa])
def test_impossible_cutoffs_and_orders_are_refused(distance, arguments, field):
    with pytest.raises(InputError) as caught:
        distance([[0, 0]], [[0, 0]], **arguments)
    assert caught.value.field == field


@pytest.mark.parametrize("distance", [gospa, ospa])
def test_points_that_are_not_finite_are_refused_and_named(distance):
    with pytest.raises(InputError) as caught:
        distance([[0, 0]], [[0, 0], [np.nan, 1]])
    assert caught.value.field == "estimates"
    assert caught.value.rows == (1,)


def values(truth, tracks, **how):
    recording, reports = run_of(truth, tracks, **how)
    return evaluate(recording, reports).scalars()


def test_a_perfect_run():
    points = [{CAR: (k, 0), OTHER_CAR: (k, 8)} for k in range(5)]
    scores = values(points, points)
    for name in ("gospa", "ospa", "ospa2", "id_switches", "misses", "false_positives", "motp"):
        assert scores[name] == 0.0, name
    for name in ("mota", "idf1", "hota", "deta", "assa", "loca", "track_life", "recall"):
        assert scores[name] == pytest.approx(1.0), name
    assert scores["initiation_delay"] == 0.0
    assert scores["ghost_time"] == 0.0
    assert scores["cardinality_error"] == 0.0


def test_continuity_keeps_a_track_that_is_no_longer_the_nearest():
    truth = [{CAR: (0, 0)}] * 4
    tracks = [{7: (0.1, 0)}] + [{7: (1.2, 0), 8: (0.3, 0)}] * 3
    scores = values(truth, tracks)
    assert scores["id_switches"] == 0
    assert scores["false_positives"] == 3
    assert scores["motp"] == pytest.approx((0.1 + 3 * 1.2) / 4)


def test_a_switch_is_counted_across_any_gap():
    scores = values([{CAR: (0, 0)}] * 5, [{7: (0, 0)}, {}, {}, {}, {8: (0, 0)}])
    assert scores["id_switches"] == 1
    assert scores["misses"] == 3
    assert scores["fragmentations"] == 1
    assert scores["mota"] == pytest.approx(1 - 4 / 5)


def test_leading_and_trailing_misses_are_no_fragmentation():
    tracks = [{}, {7: (0, 0)}, {7: (0, 0)}, {}, {7: (0, 0)}, {}]
    assert values([{CAR: (0, 0)}] * 6, tracks)["fragmentations"] == 1


def test_the_gate_is_strict():
    assert values([{CAR: (0, 0)}], [{7: (2, 0)}])["misses"] == 1
    assert values([{CAR: (0, 0)}], [{7: (1.999, 0)}])["misses"] == 0


def test_two_objects_that_remember_one_track_the_lower_id_keeps_it():
    truth = [{CAR: (0, 0)}, {OTHER_CAR: (0, 0)}, {OTHER_CAR: (1, 0), CAR: (0, 0)}]
    tracks = [{7: (0, 0)}, {7: (0, 0)}, {7: (0.9, 0), 8: (0.8, 0)}]
    recording, reports = run_of(truth, tracks)
    scores = evaluate(recording, reports).scalars()
    # In the last frame car 1 keeps track 7, though car 2 is nearer to it, and car 2 switches to 8.
    assert scores["id_switches"] == 1
    assert scores["misses"] == 0


def test_tgospa_adds_up_over_frames_and_charges_for_a_change_of_track():
    # Four frames 1 m off, and one change of track: 4 + 2^2 under the root.
    tracks = [{7: (1, 0)}] * 2 + [{8: (1, 0)}] * 2
    recording, reports = run_of([{CAR: (0, 0)}] * 4, tracks)
    value = evaluate(recording, reports, ["tgospa"])["tgospa"]
    assert value.value == pytest.approx(np.sqrt(8))
    assert value.components["localisation"] == pytest.approx(4)
    assert value.components["switch"] == pytest.approx(4)
    twice = combine([evaluate(recording, reports, ["tgospa"])] * 2)["tgospa"]
    assert twice.value == pytest.approx(np.sqrt(16))


def test_negative_mota_is_shown():
    assert values([{CAR: (0, 0)}] * 2, [{7: (50, 0), 8: (60, 0)}] * 2)["mota"] == -2.0


def test_without_truth_scores_are_undefined_and_say_why():
    recording, reports = run_of([{}, {}], [{7: (0, 0)}, {}])
    evaluation = evaluate(recording, reports)
    for name in ("mota", "motp", "recall", "mostly_tracked"):
        assert evaluation[name].value is None
        assert evaluation[name].reason
    assert evaluation["idf1"].value == 0.0
    assert evaluation["hota"].value == 0.0
    assert evaluation["false_positives"].value == 1.0


def test_an_empty_world_is_no_error_and_no_success():
    recording, reports = run_of([{}], [{}])
    scores = evaluate(recording, reports).scalars()
    assert scores["gospa"] == scores["ospa"] == scores["ospa2"] == 0.0
    assert scores["mota"] is scores["idf1"] is scores["hota"] is None


def test_a_recording_without_frames_has_no_distance():
    recording, reports = run_of([], [])
    assert evaluate(recording, reports)["gospa"].value is None


class TestObservable:
    """Objects that cannot be seen count neither way."""

    def test_missed_they_are_no_miss(self):
        scores = values([{CAR: (0, 0)}] * 2, [{7: (0, 0)}, {}], hidden={1: [CAR]})
        assert scores["misses"] == 1
        assert scores["misses_observable"] == 0
        assert scores["mota_observable"] == 1.0
        assert scores["gospa_observable"] == scores["ospa_observable"] == 0.0
        assert scores["idf1_observable"] == scores["hota_observable"] == pytest.approx(1.0)

    def test_matched_they_count_neither_way(self):
        points = [{CAR: (0, 0)}, {CAR: (0, 0), OTHER_CAR: (20, 0)}]
        tracks = [{7: (0, 0)}, {7: (1, 0), 8: (20, 0)}]
        scores = values(points, tracks, hidden={1: [CAR]})
        assert scores["false_positives_observable"] == 0
        assert scores["recall_observable"] == 1.0
        assert scores["gospa"] == pytest.approx(0.5)
        assert scores["gospa_observable"] == 0.0

    def test_a_track_of_nothing_still_counts(self):
        scores = values([{CAR: (0, 0)}], [{7: (30, 0)}], hidden={0: [CAR]})
        assert scores["false_positives_observable"] == 1
        assert scores["gospa_observable"] == pytest.approx(np.sqrt(8))

    def test_an_identity_lost_in_hiding_is_a_switch(self):
        truth = [{CAR: (0, 0)}] * 4
        tracks = [{7: (0, 0)}, {7: (0, 0)}, {8: (0, 0)}, {8: (0, 0)}]
        assert values(truth, tracks, hidden={1: [CAR], 2: [CAR]})["id_switches_observable"] == 1


class TestTestbedMeasures:
    def test_initiation_delay_counts_from_the_first_visible_frame(self):
        tracks = [{}, {}, {}, {7: (0, 0)}, {7: (0, 0)}]
        scores = values([{CAR: (0, 0)}] * 5, tracks, hidden={0: [CAR]})
        assert scores["initiation_delay"] == pytest.approx(0.2)
        assert scores["track_life"] == pytest.approx(0.5)

    def test_ghost_time(self):
        truth = [{CAR: (0, 0), OTHER_CAR: (50, 0)}] * 2 + [{}] * 3
        tracks = [{7: (0, 0)}] * 4 + [{}]
        ghost = evaluate(*run_of(truth, tracks))["ghost_time"]
        assert ghost.value == pytest.approx(0.2)
        assert ghost.components["never_matched"] == 1

    def test_false_tracks(self):
        recording, reports = run_of([{CAR: (0, 0)}] * 3, [{7: (0, 0), 9: (30, 0)}] * 3)
        false = evaluate(recording, reports)["false_tracks"]
        assert false.value == 1
        assert false.components["life"] == pytest.approx(0.2)

    @pytest.mark.parametrize(("after", "kept"), [(7, 1.0), (8, 0.0)])
    def test_identity_through_an_occlusion(self, after, kept):
        truth = [{CAR: (k, 0)} for k in range(9)]
        tracks = [{7: (k, 0)} if k < 2 else {7: (k, 1.5)} if k < 4 else {} for k in range(7)]
        tracks += [{after: (7, 0)}, {after: (8, 0)}]
        hidden = {k: [CAR] for k in range(2, 7)}
        evaluation = evaluate(*run_of(truth, tracks, hidden=hidden))
        assert evaluation["id_kept"].value == kept
        coasting = evaluation["coasting_error"]
        assert coasting.value == pytest.approx(1.5)
        # Reported in two of the five hidden frames.
        assert (coasting.components["n"], coasting.components["hidden"]) == (2, 5)
        # One frame less is no occlusion.
        assert values(truth, tracks, hidden={k: [CAR] for k in range(2, 6)})["id_kept"] is None

    def test_what_never_happened_is_counted(self):
        recording, reports = run_of([{CAR: (0, 0)}] * 2, [{}] * 2)
        delay = evaluate(recording, reports)["initiation_delay"]
        assert delay.value is None
        assert delay.components == {"n": 0, "never_initiated": 1}

    def test_existence_is_calibrated_where_as_many_are_real_as_the_score_says(self):
        recording, reports = run_of([{CAR: (0, 0)}] * 4, [{7: (0, 0)}] + [{7: (9, 9)}] * 3)
        sure = evaluate(recording, reports, ["existence_brier", "existence_calibration_error"])
        # Scores of 0.9, of which one in four is real.
        assert sure["existence_brier"].value == pytest.approx((0.1**2 + 3 * 0.9**2) / 4)
        assert sure["existence_calibration_error"].value == pytest.approx(0.9 - 0.25)

    def test_cardinality_error(self):
        scores = values([{CAR: (0, 0)}] * 2, [{}, {7: (0, 0), 8: (9, 9), 9: (20, 0)}])
        assert scores["cardinality_error"] == pytest.approx(0.5)
        assert scores["cardinality_error_absolute"] == pytest.approx(1.5)

    def test_velocity_and_yaw_and_flips(self):
        truth = truth_frame({1: (0, 0), 2: (20, 0)}, yaw=[3.1, 0.0], velocity=[[3, 4], [0, 0]])
        tracks = tracks_frame({7: (0, 0), 8: (20, 0)}, yaw=[-3.1, 3.0])
        scores = evaluate(recording_of([truth]), [tracks]).scalars()
        assert scores["velocity_error"] == pytest.approx(2.5)
        assert scores["yaw_error"] == pytest.approx(2 * np.pi - 6.2)
        assert scores["yaw_flips"] == 0.5

    @pytest.mark.parametrize(("yaw", "flips"), [(1.5, 0), (1.6, 1), (-1.6, 1), (-1.5, 0)])
    def test_a_flip_is_more_than_a_quarter_turn(self, yaw, flips):
        tracks = tracks_frame({7: (0, 0)}, yaw=[yaw])
        scores = evaluate(recording_of([truth_frame({1: (0, 0)})]), [tracks]).scalars()
        assert scores["yaw_flips"] == flips

    def test_nees_needs_covariances_and_anees_is_per_dimension(self):
        truth = truth_frame({1: (0, 0)})
        tracks = tracks_frame({7: (1, 0)}, covariance=[np.diag([0.25, 1, 1, 1])])
        evaluation = evaluate(recording_of([truth]), [tracks])
        assert evaluation["nees"].value == pytest.approx(4.0)
        assert evaluation["anees"].value == pytest.approx(1.0)
        without = evaluate(recording_of([truth]), [tracks_frame({7: (1, 0)})])
        assert without["nees"].value is None

    def test_a_singular_covariance_is_refused(self):
        tracks = tracks_frame({7: (1, 0)}, covariance=[np.diag([1.0, 1, 1, 0])])
        with pytest.raises(InputError, match="singular covariance") as caught:
            evaluate(recording_of([truth_frame({1: (0, 0)})]), [tracks])
        assert (caught.value.frame, caught.value.object_id) == (0, 7)


def test_recordings_are_combined_by_counts():
    # 9 of 10 found in one run, 0 of 2 in the other: 9 of 12 together, not the mean of .9 and 0.
    good = evaluate(*run_of([{CAR: (0, 0)}] * 10, [{7: (0, 0)}] * 9 + [{}]))
    bad = evaluate(*run_of([{CAR: (0, 0)}] * 2, [{}] * 2))
    both = combine([good, bad])
    assert both["mota"].value == pytest.approx(9 / 12)
    assert both["misses"].value == 3
    assert both["idf1"].value == pytest.approx(18 / 21)
    assert both["gospa"].value == pytest.approx(3 * np.sqrt(8) / 12)
    assert both["initiation_delay"].components["never_initiated"] == 1
    assert both.recordings == 2


def test_only_like_evaluations_are_combined():
    run = run_of([{CAR: (0, 0)}], [{7: (0, 0)}])
    with pytest.raises(InputError, match="different rules"):
        combine([evaluate(*run), evaluate(*run, parameters=MetricParameters(gospa_cutoff=5))])
    with pytest.raises(InputError, match="different metrics"):
        combine([evaluate(*run), evaluate(*run, ["mota"])])
    with pytest.raises(InputError, match="no evaluations"):
        combine([])


def test_per_class_matches_labels_exactly():
    truth = truth_frame({1: (0, 0), 2: (20, 0)}, label=[Label.CAR, Label.PEDESTRIAN])
    tracks = tracks_frame({7: (0, 0), 8: (20, 0)}, label=[Label.CAR, Label.CYCLIST])
    evaluation = evaluate(
        recording_of([truth]), [tracks], ["misses", "false_positives"], per_class=True
    )
    assert evaluation["misses"].value == 0
    by_label = {label: one.scalars() for label, one in evaluation.per_class.items()}
    assert by_label == {
        Label.CAR: {"misses": 0, "false_positives": 0},
        Label.CYCLIST: {"misses": 0, "false_positives": 1},
        Label.PEDESTRIAN: {"misses": 1, "false_positives": 0},
    }


def test_the_frames_that_were_stepped_are_scored():
    recording, reports = run_of([{CAR: (0, 0)}] * 3, [{7: (0, 0)}] * 3)
    stepped = TrackSequence(steps=(reports[0], reports[2]), frame=np.array([0, 2]))
    evaluation = evaluate(recording, stepped)
    assert evaluation["mota"].value == 1.0
    assert evaluation["gospa"].series.shape == (2,)


def test_an_evaluation_is_a_picklable_mapping_with_a_table():
    evaluation = evaluate(*run_of([{CAR: (0, 0)}] * 2, [{7: (0.5, 0)}, {}]), per_class=True)
    copy = pickle.loads(pickle.dumps(evaluation))
    assert copy.scalars() == evaluation.scalars()
    assert copy.per_class[Label.CAR].scalars() == evaluation.scalars()
    value = copy["gospa"]
    assert value.unit == "m"
    assert value.direction == "lower"
    assert value.parameters["cutoff"] == 4.0
    np.testing.assert_allclose(value.series, [0.5, np.sqrt(8)])
    with pytest.raises(TypeError):
        value.parameters["cutoff"] = 1
    assert "id_switches" in str(evaluation)
    assert "undefined" in str(evaluation)


def test_every_value_travels_and_combines():
    """Formulas pickle and print as values: no function of one's own is behind them."""
    evaluation = evaluate(*run_of([{CAR: (0, 0)}] * 2, [{7: (0.5, 0)}, {}]), names())
    copy = pickle.loads(pickle.dumps(evaluation))
    both, expected = combine([copy, copy]), combine([evaluation, evaluation])
    assert both.scalars() == expected.scalars()
    for name, value in copy.items():
        assert value.definition == evaluation[name].definition
        assert "<" not in str(value.definition), name


@pytest.mark.parametrize("name", ["gopsa", "gopsa_observable"])
def test_an_unknown_metric_names_the_nearest(name):
    run = run_of([{}], [{}])
    with pytest.raises(InputError, match="did you mean 'gospa"):
        evaluate(*run, [name])
    with pytest.raises(InputError, match="did you mean 'gospa"):
        evaluate(*run)[name]


def test_unequal_frames_are_refused():
    recording, reports = run_of([{}, {}], [{}, {}])
    with pytest.raises(InputError, match="unequal frames"):
        evaluate(recording, reports[:1])
    beyond = TrackSequence(steps=tuple(reports), frame=np.array([1, 2]))
    with pytest.raises(InputError, match="unequal frames"):
        evaluate(recording, beyond)


def test_unordered_times_are_refused_and_named():
    recording, reports = run_of([{}, {}, {}], [{}, {}, {}])
    with pytest.raises(InputError, match="must increase") as caught:
        evaluate(recording, [reports[0], reports[2], reports[1]])
    assert caught.value.frame == 2


def boxes(**changes):
    columns = {
        "frame": np.array([1, 0, 1]),
        "id": np.array([5, 5, 4]),
        "position": np.zeros((3, 3)),
        "size": np.ones((3, 3)),
        "yaw": np.zeros(3),
        "velocity": np.zeros((3, 2)),
        "label": np.zeros(3, np.int8),
        "score": np.ones(3),
        "observable": np.ones(3, np.bool_),
        "covariance": np.full((3, 4, 4), np.nan),
    }
    return sorted_boxes("truth", **{**columns, **changes})


def test_tables_are_sorted_by_frame_and_id():
    assert boxes().frame.tolist() == [0, 1, 1]
    assert boxes().id.tolist() == [5, 4, 5]


def test_an_id_twice_in_a_frame_is_refused_and_named():
    with pytest.raises(InputError, match="twice in a frame") as caught:
        boxes(id=np.array([5, 5, 5]))
    assert (caught.value.frame, caught.value.object_id) == (1, 5)
    assert caught.value.rows == (0, 2)


def test_numbers_that_are_not_finite_are_refused_and_named():
    with pytest.raises(InputError, match="bad yaw") as caught:
        boxes(yaw=np.array([np.nan, 0.0, 0.0]))
    assert (caught.value.frame, caught.value.object_id, caught.value.rows) == (1, 5, (0,))


def test_the_defaults_are_those_of_the_tables():
    parameters = {
        name: value.parameters
        for name, value in evaluate(
            *run_of([{}], [{}]), ["gospa", "ospa", "ospa2", "tgospa"]
        ).items()
    }
    assert parameters["gospa"] == {"cutoff": 4.0, "order": 2.0, "alpha": 2.0, "distance": "xy"}
    assert parameters["ospa"] == {"cutoff": 10.0, "order": 2.0, "distance": "xy"}
    assert parameters["ospa2"] == parameters["ospa"] | {"window": 1.0}
    assert parameters["tgospa"] == {
        "cutoff": 4.0,
        "order": 2.0,
        "switch_cost": 2.0,
        "distance": "xy",
    }
    assert evaluate(*run_of([{}], [{}]), ["mota"])["mota"].parameters["gate"] == 2.0
    assert evaluate(*run_of([{}], [{}]), ["hota"])["hota"].parameters["similarity_zero"] == 4.0
    assert MetricParameters().occlusion_frames == 5


@pytest.mark.parametrize("name", ["gospa_order", "occlusion_frames"])
def test_orders_and_frames_are_at_least_one(name):
    assert getattr(MetricParameters(**{name: 1}), name) == 1
    with pytest.raises(InputError, match="at least 1"):
        MetricParameters(**{name: 0.9})


def test_impossible_parameters_are_refused():
    with pytest.raises(InputError, match="gate"):
        MetricParameters(gate=-1)
