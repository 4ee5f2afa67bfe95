"""The benchmarks' rules on situations small enough to work out by hand."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from metric_builders import run_of, tracks_frame, truth_frame

from pmbm.errors import InputError
from pmbm.metrics.benchmarks import (
    evaluate_argoverse1,
    evaluate_kitti,
    evaluate_nuscenes,
    evaluate_trackeval,
    evaluate_waymo,
)
from pmbm.metrics.benchmarks.argoverse1 import argoverse1_counts
from pmbm.metrics.benchmarks.kitti import KittiCounts, KittiScene, kitti_scores
from pmbm.metrics.benchmarks.trackeval import SimilarScene
from pmbm.metrics.benchmarks.waymo import WaymoScene, waymo_overlap
from pmbm.metrics.core.gaps import fill_gaps
from pmbm.metrics.core.result import combine
from pmbm.metrics.core.scene import ScoredScene, make_scene, pair_overlap, scene_of


def scene(truth, tracks, scores=None) -> ScoredScene:
    """A scene from points; `scores`: track id -> score."""
    recording, reports = run_of(truth, tracks)
    made = scene_of(recording, reports)
    if scores is not None:
        made.tracks.score[:] = [scores[int(name)] for name in made.tracks.id]
    return made


def waymo(made: ScoredScene, level=None, zone=None) -> WaymoScene:
    return WaymoScene(
        scene=made,
        overlap=waymo_overlap(made),
        level=np.ones(len(made.truth), np.int64) if level is None else np.array(level),
        in_no_label_zone=np.zeros(len(made.tracks), bool) if zone is None else np.array(zone),
    )


def kitti(made: ScoredScene, ignored_truth=(), ignored_tracks=()) -> KittiScene:
    """Rows of truth and tracks that are ignored, by number."""
    one = KittiScene.plain(made, pair_overlap(made))
    one.ignored_truth[list(ignored_truth)] = True
    one.ignored_tracks[list(ignored_tracks)] = True
    return one


def alike(made: ScoredScene) -> SimilarScene:
    return SimilarScene(scene=made, similarity=pair_overlap(made))


class TestKitti:
    def test_ignored_truth_is_neither_missed_nor_a_truth(self):
        made = scene([{1: (0, 0), 2: (20, 0)}], [{7: (0, 0)}])
        scores = evaluate_kitti([kitti(made, ignored_truth=[1])], 0.25).scalars()
        assert scores["mota"] == 1.0
        assert scores["misses"] == 0

    def test_a_match_with_ignored_truth_is_no_false_box(self):
        made = scene([{1: (0, 0), 2: (20, 0)}], [{7: (0, 0), 8: (20, 0)}])
        scores = evaluate_kitti([kitti(made, ignored_truth=[1])], 0.25).scalars()
        assert scores["mota"] == 1.0
        assert scores["false_positives"] == 0

    def test_an_ignored_box_counts_only_where_it_matches(self):
        made = scene([{1: (0, 0)}], [{7: (0, 0), 8: (50, 0)}])
        scores = evaluate_kitti([kitti(made, ignored_tracks=[0, 1])], 0.25).scalars()
        assert scores["mota"] == 1.0

    def test_a_switch_after_a_gap_is_none(self):
        made = scene([{1: (0, 0)}] * 3, [{7: (0, 0)}, {}, {8: (0, 0)}])
        assert evaluate_kitti([kitti(made)], 0.25)["id_switches"].value == 0
        made = scene([{1: (0, 0)}] * 2, [{7: (0, 0)}, {8: (0, 0)}])
        assert evaluate_kitti([kitti(made)], 0.25)["id_switches"].value == 1

    def test_averages_of_a_perfect_tracker_are_one(self):
        made = scene([{1: (k, 0)} for k in range(400)], [{7: (k, 0)} for k in range(400)])
        scores = evaluate_kitti([kitti(made)], 0.25).scalars()
        assert scores["samota"] == pytest.approx(1.0)
        assert scores["amota"] == pytest.approx(1.0)
        assert scores["amotp"] == pytest.approx(1.0)

    def test_averages_over_recall(self):
        # The surer track alone has MOTA 1/2, which is all that a recall up to 1/2 allows.
        truth = [{1: (0, 0), 2: (20, 0)}] * 200
        made = scene(truth, [{7: (0, 0), 8: (20, 0)}] * 200, {7: 0.9, 8: 0.5})
        scores = evaluate_kitti([kitti(made)], 0.25).scalars()
        assert scores["samota"] == pytest.approx(1.0)
        assert scores["amota"] == pytest.approx((20 * 0.5 + 20 * 1.0) / 40)

    @pytest.mark.parametrize(("false", "expected"), [(0, 1.0), (2, 0.6), (20, 0.0)])
    def test_accuracy_scaled_by_recall(self, false, expected):
        # Half of ten objects found is all that a recall of 1/2 asks for: 1 - false / 5.
        counts = KittiCounts(frames=10, truths=10, matches=5, misses=5, false_positives=false)
        assert kitti_scores(counts, 0.5)["sMOTA"] == pytest.approx(expected)

    def test_without_truth_nothing_is_defined(self):
        value = evaluate_kitti([kitti(scene([{}], [{7: (0, 0)}]))], 0.25)
        assert value["mota"].value is None
        assert value["samota"].value is None
        assert value["false_positives"].value == 1


class TestWaymo:
    def test_missed_hard_truth_counts_at_level_2_alone(self):
        sequence = waymo(scene([{1: (0, 0), 2: (20, 0)}], [{7: (0, 0)}]), level=[1, 2])
        assert evaluate_waymo([sequence], 0.7, level=1)["mota"].value == 1.0
        assert evaluate_waymo([sequence], 0.7, level=2)["mota"].value == 0.5

    def test_matched_hard_truth_counts_at_level_1_as_well(self):
        truth = [{1: (0, 0), 2: (20, 0)}, {1: (0, 0), 2: (20, 0)}]
        sequence = waymo(scene(truth, [{7: (0, 0), 8: (20, 0)}, {}]), level=[1, 2, 1, 2])
        # Matched 2 of 3: in the second frame the hard one is not missed.
        assert evaluate_waymo([sequence], 0.7, level=1)["mota"].value == pytest.approx(2 / 3)

    def test_a_box_in_a_no_label_zone_is_not_false(self):
        made = scene([{1: (0, 0)}], [{7: (0, 0), 8: (50, 0)}])
        assert evaluate_waymo([waymo(made, zone=[0, 1])], 0.7)["false_positives"].value == 0
        # Left in, it is false at every cutoff: MOTA 0, which is reported with all errors 0.
        assert evaluate_waymo([waymo(made)], 0.7)["mota"].value == 0

    def test_the_best_cutoff_is_reported(self):
        made = scene([{1: (0, 0)}] * 2, [{7: (0, 0), 8: (50, 0)}, {7: (0, 0)}], {7: 0.8, 8: 0.3})
        scores = evaluate_waymo([waymo(made)], 0.7).scalars()
        assert scores["mota"] == 1.0
        assert scores["score_cutoff"] == pytest.approx(0.31)

    def test_negative_accuracy_is_reported_as_zero_under_this_name(self):
        made = scene([{1: (0, 0)}], [{7: (50, 0), 8: (60, 0)}])
        value = evaluate_waymo([waymo(made)], 0.7)
        assert value["mota"].value == 0.0
        assert value["score_cutoff"].value is None

    def test_boxes_fall_into_ranges_by_their_own_centre(self):
        sequence = waymo(scene([{1: (29.9, 0)}], [{7: (30.1, 0)}]))
        near = evaluate_waymo([sequence.within(0, 30)], 0.7)
        assert near["mota"].value == 0.0
        assert near["misses"].counts["truths"][0] == 1
        assert evaluate_waymo([sequence.within(30, 50)], 0.7)["mota"].value is None

    def test_a_track_that_leaves_a_departed_object_is_a_mismatch(self):
        truth = [{1: (0, 0), 2: (20, 0)}, {1: (0, 0)}]
        made = scene(truth, [{7: (0, 0), 8: (20, 0)}, {8: (0, 0)}])
        # One for object 1's new track, one for object 2, which left while its track moved on.
        assert evaluate_waymo([waymo(made)], 0.7)["mota"].counts["mismatches"][0] == 2

    @pytest.mark.parametrize(("height", "overlap"), [(0.01, 0.0), (0.011, 1.0)])
    def test_flat_boxes_overlap_nothing(self, height, overlap):
        flat = np.array([[4.5, 1.9, height]])
        made = make_scene(
            [truth_frame({1: (0, 0)}, size=flat)], [tracks_frame({7: (0, 0)}, size=flat)]
        )
        assert waymo_overlap(made) == pytest.approx([overlap])


class TestArgoverse1:
    def test_only_boxes_in_range_take_part(self):
        made = scene([{1: (10, 0), 2: (120, 0)}], [{7: (10.5, 0), 8: (130, 0)}])
        scores = evaluate_argoverse1([made]).scalars()
        assert scores["mota"] == 1.0
        assert scores["motp_c"] == pytest.approx(0.5)
        assert evaluate_argoverse1([made], farthest=200)["mota"].value == 0.0

    def test_ranges_are_counted_from_the_sensor(self):
        made = scene([{1: (210, 0), 2: (-90, 0)}] * 2, [{7: (210, 0)}] * 2)
        counts = argoverse1_counts(made, sensor=[(200, 0, 0), (0, 0, 0)])
        # Only car 1 is near in the first frame, only car 2 in the second.
        assert (counts.clear.matches, counts.clear.misses) == (1, 1)

    def test_logs_are_counted_together(self):
        found = scene([{1: (10, 0)}] * 3, [{7: (10, 0)}] * 3)
        missed = scene([{1: (10, 0)}], [{7: (50, 0)}])
        scores = evaluate_argoverse1([found, missed]).scalars()
        assert scores["mota"] == pytest.approx(1 - 2 / 4)
        assert (scores["misses"], scores["false_positives"], scores["truths"]) == (1, 1, 4)
        assert scores["idf1"] == pytest.approx(2 * 3 / 8)

    @pytest.mark.parametrize(("x", "truths"), [(0.0, 0), (0.001, 1), (99.999, 1), (100.0, 0)])
    def test_the_range_is_strict_on_both_sides(self, x, truths):
        assert evaluate_argoverse1([scene([{1: (x, 0)}], [{}])])["truths"].value == truths

    def test_orientation_and_size_of_matched_boxes(self):
        truth = truth_frame({1: (10, 0)}, yaw=[3.0], size=[[4.0, 2.0, 1.5]])
        tracks = tracks_frame({7: (10, 0)}, yaw=[-3.0], size=[[5.0, 2.0, 1.5]])
        scores = evaluate_argoverse1([make_scene([truth], [tracks])]).scalars()
        assert scores["motp_o"] == pytest.approx(np.degrees(2 * np.pi - 6.0))
        assert scores["motp_i"] == pytest.approx(1 - 4 / 5)


class TestNuscenes:
    def test_a_perfect_tracker(self):
        made = scene([{1: (k, 0)} for k in range(50)], [{7: (k, 0)} for k in range(50)])
        scores = evaluate_nuscenes([made]).scalars()
        assert scores["amota"] == pytest.approx(1.0)
        assert scores["amotp"] == pytest.approx(0.0)

    def test_recall_that_is_not_reached_costs_the_worst_value(self):
        # Half of the truth is found: of 40 levels from .1 to 1 the 18 up to .4923 are reached.
        truth = [{1: (k, 0), 2: (k, 20)} for k in range(50)]
        made = scene(truth, [{7: (k, 0)} for k in range(50)])
        scores = evaluate_nuscenes([made]).scalars()
        assert scores["amota"] == pytest.approx(18 / 40)
        assert scores["amotp"] == pytest.approx(2.0 * 22 / 40)

    @pytest.mark.parametrize(
        ("gaps", "x", "missed"), [("filled", [1, 2], 0), ("devkit", [2, 1], 0), ("left", [], 2)]
    )
    def test_gaps(self, gaps, x, missed):
        """A car passes x = 0 to 3; its track lacks the two frames between."""
        truth = [{1: (k, 0)} for k in range(4)]
        made = scene(truth, [{7: (0, 0)}, {}, {}, {7: (3, 0)}])
        evaluation = evaluate_nuscenes([made], gaps=gaps)
        assert evaluation["misses"].value == missed
        (scored,) = evaluation["amota"].counts["scenes"].items
        assert scored.tracks.position[1:-1, 0].tolist() == pytest.approx(x)
        assert evaluation["motp"].value == pytest.approx(0.5 if gaps == "devkit" else 0)

    def test_gaps_are_filled_the_short_way_round_and_with_the_time_between(self):
        truth = [
            truth_frame({1: (0, 0)}, 1.0, yaw=[3.0]),
            truth_frame({}, 1.3),
            truth_frame({1: (1, 0)}, 2.0, yaw=[-3.0]),
        ]
        made = make_scene(truth, [tracks_frame({}, frame.time) for frame in truth])
        filled = fill_gaps(made).truth
        assert filled.frame.tolist() == [0, 1, 2]
        assert filled.position[1, 0] == pytest.approx(0.3)
        turned = 3.0 + 0.3 * (2 * np.pi - 6.0)
        assert filled.yaw[1] == pytest.approx(turned)

    def test_scenes_are_pooled_not_averaged(self):
        good = scene([{1: (k, 0)} for k in range(50)], [{7: (k, 0)} for k in range(50)])
        bad = scene([{1: (k, 0)} for k in range(50)], [{}] * 50)
        together = evaluate_nuscenes([good, bad])
        assert together["amota"].value == pytest.approx(18 / 40)
        apart = combine([evaluate_nuscenes([good]), evaluate_nuscenes([bad])])
        assert apart.scalars() == together.scalars()


class TestTrackEval:
    @pytest.mark.parametrize(
        ("tracks", "excused", "false"),
        [
            # Matched to the hidden car 2, a track is left out; matched to nothing it is false,
            # unless it is excused.
            ({7: (0, 0), 8: (20, 0)}, [False, False], 0),
            ({7: (0, 0), 8: (50, 0)}, [False, False], 1),
            ({7: (0, 0), 8: (50, 0)}, [True, True], 0),
        ],
    )
    def test_what_counts_neither_way_is_taken_out(self, tracks, excused, false):
        recording, reports = run_of([{1: (0, 0), 2: (20, 0)}], [tracks], hidden={0: [2]})
        made = alike(scene_of(recording, reports)).counted(0.5, np.array(excused))
        scores = evaluate_trackeval([made]).scalars()
        assert scores["truths"] == 1
        assert scores["misses"] == 0
        assert scores["false_positives"] == false

    def test_without_truth_nothing_is_defined_but_the_false_boxes(self):
        evaluation = evaluate_trackeval([alike(scene([{}], [{7: (0, 0)}]))])
        assert evaluation["mota"].value is None
        assert evaluation["false_positives"].value == 1


def test_trackeval_combines_by_counts():
    good = alike(scene([{1: (0, 0)}] * 3, [{7: (0, 0)}] * 3))
    bad = alike(scene([{1: (0, 0)}], [{}]))
    together = evaluate_trackeval([good, bad])
    assert together["mota"].value == pytest.approx(3 / 4)
    apart = combine([evaluate_trackeval([good]), evaluate_trackeval([bad])])
    assert apart.scalars() == together.scalars()


@pytest.mark.parametrize(
    "evaluate",
    [
        lambda made: evaluate_argoverse1([made]),
        lambda made: evaluate_waymo([waymo(made)], 0.7),
        lambda made: evaluate_kitti([kitti(made)], 0.25),
        lambda made: evaluate_nuscenes([made]),
        lambda made: evaluate_trackeval([alike(made)]),
    ],
)
def test_benchmark_evaluations_pickle_print_and_name_their_variant(evaluate):
    made = scene([{1: (0, 0)}] * 3, [{7: (0.2, 0)}] * 3)
    evaluation = evaluate(made)
    copy = pickle.loads(pickle.dumps(evaluation))
    assert copy.scalars() == evaluation.scalars()
    assert {value.variant for value in evaluation.values()} != {"standard"}
    assert "mota" in str(evaluation)


def test_benchmarks_refuse_what_they_cannot_use():
    with pytest.raises(InputError, match="nothing to evaluate"):
        evaluate_nuscenes([])
    with pytest.raises(InputError, match="level"):
        evaluate_waymo([], 0.7, level=3)
