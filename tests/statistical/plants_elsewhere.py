"""Mistakes outside the recursion itself: in what the tracker sees and says, in the world, in the
metrics, the studies and the gate."""

from __future__ import annotations

from plants import Plant

OTHER_PLANTS = [
    Plant(
        "y not mirrored",
        "sim/traffic.py",
        "path.rows.append((x, -y, ",
        "path.rows.append((x, y, ",
        by="tests/unit/test_traffic.py::test_our_world_is_right_handed",
        tests=("tests/unit/test_traffic.py",),
    ),
    Plant(
        "a track hides itself",
        "pmbm/filter/occlusion.py",
        "log_open -= self._by_itself(",
        "log_open -= 0.0 * self._by_itself(",
        by="tests/property/test_filter_occlusion.py::test_a_hypothesis_is_never_hidden_by_its_own_track",
        tests=("tests/property/test_filter_occlusion.py",),
    ),
    Plant(
        "what stands behind hides as well",
        "pmbm/filter/rays.py",
        "return bearing + np.minimum(distance, 0.999 * FAR) / FAR",
        "return bearing + 0.5 - np.minimum(distance, 0.4 * FAR) / FAR",
        by="tests/property/test_filter_occlusion.py::test_a_wall_hides_what_stands_behind_it_and_not_what_stands_before_it",
        tests=("tests/property/test_filter_occlusion.py",),
    ),
    Plant(
        "seeds shared between workers",
        "pmbm/study/worker.py",
        "trial=study.trial(index),",
        "trial=0,",
        by="tests/unit/study/test_runner.py::test_every_trial_is_a_world_of_its_own_whoever_computes_it",
        tests=(
            "tests/unit/study/test_runner.py::test_every_trial_is_a_world_of_its_own_whoever_computes_it",
        ),
    ),
    Plant(
        "seeds shared between trials",
        "sim/streams.py",
        "key = (self.trial, int(purpose)",
        "key = (0, int(purpose)",
        by="tests/unit/test_detector_streams.py::test_same_seed_same_bits_other_seed_or_trial_other_bits",
        tests=("tests/unit/test_detector_streams.py",),
    ),
    Plant(
        "streams shared between objects",
        "sim/streams.py",
        "int(object_id) % 2**64)",
        "0)",
        by="tests/unit/test_detector_streams.py::test_streams_are_told_apart_by_every_part_of_their_key",
        tests=("tests/unit/test_detector_streams.py",),
    ),
    Plant(
        "damaged rows are believed",
        "pmbm/study/store.py",
        "whole = row.hash(known_hash) == row_hash",
        "whole = True",
        by="tests/unit/study/test_store.py::test_damaged_rows_are_named_and_run_again",
        tests=("tests/unit/study/test_store.py::test_damaged_rows_are_named_and_run_again",),
    ),
    Plant(
        "the gate's variance without its floor",
        "pmbm/regression/sequence.py",
        "np.maximum(variance, value_range**2 / n)",
        "np.maximum(variance, 1e-300)",
        by="tests/unit/regression/test_sequence.py::test_the_variance_never_falls_below_the_floor",
        tests=("tests/unit/regression/test_sequence.py", "tests/unit/regression/test_verdicts.py"),
    ),
    Plant(
        "GOSPA misses whom it has matched",
        "pmbm/metrics/gospa.py",
        "missed_count = scene.truth.count(frames) - matched",
        "missed_count = scene.truth.count(frames) - 0 * matched",
        by="tests/unit/test_metrics.py::test_a_perfect_run",
        tests=("tests/unit/test_metrics.py",),
    ),
    Plant(
        "a switch to the same track",
        "pmbm/metrics/clear.py",
        "switch[order[1:]] = again & other",
        "switch[order[1:]] = again",
        by="tests/unit/test_metrics.py::test_a_perfect_run",
        tests=("tests/unit/test_metrics.py",),
    ),
    Plant(
        "the partition of the best assignment forgets what it excluded",
        "pmbm/assignment/reference.py",
        "inherited | {node.columns[row]}",
        "frozenset({node.columns[row]})",
        by="tests/unit/test_assignment.py::test_all_equal_costs_give_every_permutation_in_order",
        tests=("tests/unit/test_assignment.py", "tests/property/test_assignment_laws.py"),
    ),
    Plant(
        "an angle of just under zero becomes pi",
        "pmbm/geometry.py",
        "np.where(wrapped >= np.pi, -np.pi, wrapped)",
        "wrapped",
        by="tests/property/test_geometry.py::test_wrapped_angles_are_in_the_interval_and_point_the_same_way",
        tests=("tests/property/test_geometry.py", "tests/unit/test_types.py"),
    ),
    Plant(
        "who is hidden is named for the one that hides it",
        "pmbm/filter/inspection.py",
        "hides = (target != body) & ~around[body]",
        "hides = ~around[body]",
        by="tests/unit/test_filter_inspection.py::test_who_hides_a_part_is_named_and_never_the_track_itself",
        tests=("tests/unit/test_filter_inspection.py",),
    ),
    Plant(
        "a miss told as a detection",
        "pmbm/filter/story.py",
        '"missed" if missing > 0.5 else "detected"',
        '"detected" if missing > 0.5 else "missed"',
        by="tests/unit/test_filter_inspection.py::test_a_life_from_birth_through_a_shadow_to_its_end",
        tests=("tests/unit/test_filter_inspection.py",),
    ),
]
