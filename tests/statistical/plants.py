"""The mistakes in the filter that `mutations.py` plants, one at a time; others are in
`plants_elsewhere.py`.

A plant is a name, a file, a passage that stands in it exactly once, what replaces it, and the test
that noticed it last, which is asked first.  Those from "likelihood at the posterior" to "ids used
again" have all been found in public code.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

FILTER_TESTS = (
    "tests/unit/test_filter_exact.py",
    "tests/unit/test_filter_models.py",
    "tests/unit/test_filter_presets.py",
    "tests/unit/test_filter_marks.py",
    "tests/unit/test_filter_tracker.py",
    "tests/oracle/test_filter_oracle.py::test_a_tiny_problem_solved_exactly",
)


@dataclass(frozen=True)
class Plant:
    """A mistake: in `file`, `old` becomes `new`; one of `tests` should fail, `by` first of all."""

    name: str
    file: str
    old: str
    new: str
    by: str = ""
    tests: tuple[str, ...] = FILTER_TESTS

    def place(self, root: Path) -> Path:
        """The file that holds the passage once: the one named, or else the only one beside it.

        Raises LookupError where the code has moved on, and the plant has to follow.
        """
        named = root / self.file
        beside = [path for path in sorted(named.parent.glob("*.py")) if path != named]
        for files in ([named], beside):
            found = [path for path in files if path.is_file() and self._stands_in(path)]
            if len(found) == 1:
                return found[0]
        raise LookupError(
            f"plant '{self.name}' no longer applies: its passage stands in {len(found)} files "
            f"beside {self.file}, not in one; bring it up to date in tests/statistical"
        )

    def _stands_in(self, path: Path) -> bool:
        return path.read_text(encoding="utf-8").count(self.old) == 1


def _filter(name: str, file: str, old: str, new: str, by: str = "") -> Plant:
    return Plant(name, f"pmbm/filter/{file}.py", old, new, by)


FILTER_PLANTS = [
    _filter(
        "likelihood at the posterior",
        "hypotheses/gating",
        "innovation.log_norm() - 0.5 * distance",
        "innovation.log_norm() - 0.25 * distance",
        by="tests/unit/test_filter_exact.py::test_an_update_is_bayes_rule_over_all_associations[0]",
    ),
    _filter(
        "undetected times P_D",
        "update",
        "ppp.log_weight + np.log1p(-detection)",
        "ppp.log_weight + np.log(detection)",
        by="tests/unit/test_filter_exact.py::test_undetected_intensity_shrinks_by_the_missed_share",
    ),
    _filter(
        "no clutter outside the birth gate",
        "association",
        "np.maximum(np.logaddexp(log_birth_evidence, log_clutter), LOG_TINY)",
        "np.where(log_birth_evidence > -np.inf, "
        "np.logaddexp(log_birth_evidence, log_clutter), LOG_TINY)",
        by="tests/unit/test_filter_exact.py::test_a_measurement_far_from_all_births_may_still_be_clutter",
    ),
    _filter(
        "misses of the parent dropped",
        "hypotheses/branching",
        "        + summed(log_missed[parents.member], row_of_entry, len(parents))\n",
        "",
        by="tests/unit/test_filter_exact.py::test_an_update_is_bayes_rule_over_all_associations[0]",
    ),
    _filter(
        "a lone measurement is no clutter",
        "hypotheses/branching",
        "    best = k_best_choices(\n",
        "    gain = gain + 50.0 * (np.bincount(known.measurement)[known.measurement] == 1)\n"
        "    best = k_best_choices(\n",
        by="tests/unit/test_filter_exact.py::test_clusters_on_and_off_give_the_same_density[0]",
    ),
    _filter(
        "recycled with the hypotheses' weight alone",
        "reduction",
        "np.log(probability * local.existence[rows])",
        "np.log(probability)",
        by="tests/unit/test_filter_exact.py::test_recycling_keeps_the_expected_number_of_objects[True]",
    ),
    _filter(
        "recycled with r alone",
        "reduction",
        "np.log(probability * local.existence[rows])",
        "np.log(local.existence[rows])",
        by="tests/unit/test_filter_exact.py::test_recycling_keeps_the_expected_number_of_objects[True]",
    ),
    _filter(
        "a pruned Bernoulli takes its hypotheses along",
        "reduction",
        "        entries = starts(staying.astype(np.intp))\n",
        "        hit = np.bincount(table.row_of_member(), ~staying, minlength=len(table)) > 0\n"
        "        if not hit.all():\n"
        "            table = _keep(table, ~hit)\n"
        "            staying = np.ones(len(table.member), bool)\n"
        "        entries = starts(staying.astype(np.intp))\n",
        by="tests/unit/test_filter_exact.py::test_a_pruned_bernoulli_leaves_its_global_hypotheses_standing[one]",
    ),
    _filter(
        "no largest of an empty pool",
        "hypotheses/gating",
        "pairs.log_weight.max(initial=-np.inf)",
        "pairs.log_weight.max()",
        by="tests/unit/test_filter_exact.py::test_a_crowd_in_one_cluster_does_bounded_work",
    ),
    _filter(
        "existence overwritten before its weight",
        "models/sensor",
        "        left = 1 - r * P_D\n",
        "        r = r * (1 - P_D) / np.maximum(1 - r * P_D, 1e-300)\n        left = 1 - r * P_D\n",
        by="tests/unit/test_filter_exact.py::test_an_update_is_bayes_rule_over_all_associations[0]",
    ),
    _filter(
        "time stops in empty frames",
        "frame",
        "    dt = 0.0 if last is None else detections.time - last\n",
        "    dt = 0.0 if last is None or not len(detections) else detections.time - last\n",
        by="tests/unit/test_filter_tracker.py::test_time_passes_in_frames_without_detections",
    ),
    _filter(
        "ids used again",
        "update",
        "detections_seen=density.detections_seen + len(scan)",
        "detections_seen=len(density.track_id) + len(scan)",
        by="tests/unit/test_filter_tracker.py::test_ids_are_never_used_again",
    ),
    _filter(
        "Q in the order x, vx, y, vy",
        "models/motion",
        "    Q = np.array([[a, 0, b, 0], [0, a, 0, b], [b, 0, c, 0], [0, b, 0, c]], np.float64)\n",
        "    Q = np.array([[a, b, 0, 0], [b, c, 0, 0], [0, 0, a, b], [0, 0, b, c]], np.float64)\n",
        by="tests/unit/test_filter_models.py::test_process_noise_is_the_continuous_one[0.05]",
    ),
    _filter(
        "Q of the discrete form",
        "models/motion",
        "a, b, c = dt**3 / 3, dt**2 / 2, dt\n",
        "a, b, c = dt**4 / 4, dt**3 / 2, dt**2\n",
        by="tests/unit/test_filter_models.py::test_process_noise_is_the_continuous_one[0.05]",
    ),
    _filter(
        "sign of the log determinant",
        "hypotheses/gaussian",
        "-_LOG_2PI - np.log(self.l11) - np.log(self.l22)",
        "-_LOG_2PI + np.log(self.l11) + np.log(self.l22)",
        by="tests/unit/test_filter_exact.py::test_an_update_is_bayes_rule_over_all_associations[0]",
    ),
    _filter(
        "P_S whatever the interval",
        "models/motion",
        "return self.probability ** (dt / self.interval)",
        "return self.probability",
        by="tests/unit/test_filter_models.py::test_predicting_twice_is_predicting_once",
    ),
    _filter(
        "births whatever the interval",
        "models/motion",
        "rate * (dt if mu == 0 else -math.expm1(-mu * dt) / mu)",
        "rate * self.interval",
        by="tests/unit/test_filter_models.py::test_predicting_twice_is_predicting_once",
    ),
    _filter(
        "merged hypotheses lose weight",
        "hypotheses/clusters",
        "    log_weight[kept] = top + np.log(np.add.reduceat(weight, first))\n",
        "    log_weight[kept] = top\n",
        by="tests/unit/test_filter_exact.py::test_hypotheses_that_become_equal_add_their_weights",
    ),
    _filter(
        "equal rows by a hash that knows no zero",
        "hypotheses/clusters",
        "(table.member + 1).astype(np.uint64)",
        "table.member.astype(np.uint64)",
        by="tests/unit/test_filter_exact.py::test_rows_that_differ_by_any_one_member_are_not_equal",
    ),
    _filter(
        "weights not shared out after pruning",
        "reduction",
        "        normalised(table.log_weight[rows], cluster),\n",
        "        table.log_weight[rows],\n",
        by="tests/unit/test_filter_exact.py::test_pruning_and_capping_share_out_the_weight",
    ),
    _filter(
        "children out of proportion",
        "hypotheses/branching",
        "* np.exp(parents.log_weight) - 1e-9",
        "+ 0 * parents.log_weight - 1e-9",
        by="tests/unit/test_filter_exact.py::test_a_parent_gets_children_in_proportion_to_its_weight",
    ),
    _filter(
        "no survival for undetected objects",
        "prediction",
        "Mixture(ppp.log_weight + log_of(transition.survival), ",
        "Mixture(ppp.log_weight, ",
        by="tests/unit/test_filter_models.py::test_predicting_twice_is_predicting_once",
    ),
    _filter(
        "spread of the fused means forgotten",
        "hypotheses/gaussian",
        "(cov + spread[:, :, None] * spread[:, None, :])",
        "cov",
        by="tests/unit/test_filter_exact.py::test_an_update_is_bayes_rule_over_all_associations[0]",
    ),
    _filter(
        "a split keeps only the first cluster's weights",
        "hypotheses/clusters",
        "np.concatenate([table.log_weight[kept], np.zeros(len(alone))])",
        "np.concatenate([np.zeros(len(kept)), np.zeros(len(alone))])",
        by="tests/unit/test_filter_exact.py::test_clusters_on_and_off_give_the_same_density[0]",
    ),
    _filter(
        "a product of clusters forgets a factor's weight",
        "hypotheses/clusters",
        "        summed(table.log_weight[source], joint, rows),\n",
        "        summed(\n"
        "            table.log_weight[source] * (np.diff(joint, prepend=-1) > 0), joint, rows\n"
        "        ),\n",
        by="tests/unit/test_filter_exact.py::test_joining_large_clusters_keeps_the_best_of_their_product[5]",
    ),
    _filter(
        "a shared measurement joins no clusters",
        "hypotheses/clusters",
        "    if len(ties):\n",
        "    if False:\n",
        by="tests/unit/test_filter_exact.py::test_clusters_on_and_off_give_the_same_density[1]",
    ),
    _filter(
        "dependent groups taken apart",
        "hypotheses/clusters",
        "coo_array(between > tolerance)",
        "coo_array(between > 10.0)",
        by="tests/unit/test_filter_exact.py::test_a_table_that_factors_is_taken_apart_exactly",
    ),
    _filter(
        "detected with the existence it had",
        "update",
        "        np.ones(len(row)),\n",
        "        local.existence[row],\n",
        by="tests/unit/test_filter_exact.py::test_an_update_is_bayes_rule_over_all_associations[0]",
    ),
    _filter(
        "a gate of the wrong root",
        "hypotheses/gating",
        "np.flatnonzero(distance < threshold)",
        "np.flatnonzero(distance < threshold**0.5)",
        by="tests/unit/test_filter_models.py::test_the_gate_holds_whom_it_should",
    ),
    _filter(
        "reaches cut short",
        "hypotheses/gating",
        "query_ball_point(centre, radius,",
        "query_ball_point(centre, 0.7 * radius,",
        by="tests/unit/test_filter_models.py::test_the_gate_holds_whom_it_should",
    ),
    _filter(
        "position noise in place of its square",
        "models/sensor",
        "return self.position_sd**2 * np.eye(2)",
        "return self.position_sd * np.eye(2)",
        by="tests/unit/test_filter_tracker.py::test_a_lone_object_is_a_kalman_filter",
    ),
    _filter(
        "reported from the best hypothesis alone",
        "estimation",
        "    existence = summed(mass, local.track, tracks)\n",
        "    existence = np.zeros(tracks)\n    np.maximum.at(existence, local.track, mass)\n",
        by="tests/unit/test_filter_models.py::test_estimators_over_clusters_are_those_of_the_whole_scene[0]",
    ),
    _filter(
        "cardinality without the rest's absence",
        "estimators",
        "        left = np.concatenate([np.cumsum(np.log1p(-falling[::-1]))[::-1], [0.0]])\n",
        "        left = np.zeros(len(falling) + 1)\n",
        by="tests/unit/test_filter_models.py::test_estimators_over_clusters_are_those_of_the_whole_scene[0]",
    ),
    _filter(
        "a track out of view is still reported",
        "tracker",
        "(inside > 0.5)",
        "(inside > -1)",
        by="tests/unit/test_filter_tracker.py::test_a_track_out_of_view_is_kept_in_mind_and_not_reported",
    ),
    _filter(
        "scores speak the wrong way round",
        "models/scores",
        "np.column_stack([2 * s, 2 * (1 - s)])",
        "np.column_stack([2 * (1 - s), 2 * s])",
        by="tests/unit/test_filter_presets.py::test_a_first_detection_by_the_papers_rule[0.2]",
    ),
    Plant(
        "a certain score settles everything",
        "pmbm/score.py",
        "np.clip(evidence, _LEAST_CONFIDENCE, 1 - _LEAST_CONFIDENCE)",
        "np.round(evidence, 3)",
        by="tests/unit/test_filter_promises.py::test_certain_scores_under_certain_beliefs[usual-everywhere]",
    ),
    _filter(
        "state changed before time is checked",
        "tracker",
        "        frame, state = _next_frame(self.config, self.site, self.state, ",
        "        before = self.state\n"
        "        self.state = replace(before, time=detections.time)\n"
        "        frame, state = _next_frame(self.config, self.site, before, ",
        by="tests/unit/test_filter_tracker.py::test_bad_time_is_refused_and_leaves_the_tracker_as_it_was",
    ),
    _filter(
        "no clutter at all",
        "association",
        "np.maximum(np.logaddexp(log_birth_evidence, log_clutter), LOG_TINY)",
        "np.maximum(log_birth_evidence, LOG_TINY)",
        by="tests/unit/test_filter_exact.py::test_an_update_is_bayes_rule_over_all_associations[0]",
    ),
    _filter(
        "persistent clutter is reported",
        "estimation",
        "np.minimum(of_class @ share, existence)",
        "existence",
        by="tests/unit/test_filter_marks.py::test_classes_follow_bayes_rule",
    ),
    _filter(
        "a low score says nothing of the source",
        "models/score_levels",
        "np.array([0.15, 0.85, 0.97])",
        "np.array([0.85, 0.85, 0.97])",
        by="tests/unit/test_filter_presets.py::test_what_scores_low_again_and_again_is_no_object[0.2-False]",
    ),
    _filter(
        "an empty scene is remembered for good",
        "models/protocols",
        "kept = min(1.0, longest / looked) if looked > 0 else 1.0",
        "kept = 1.0",
        by="tests/unit/test_filter_presets.py::test_the_first_object_after_a_long_empty_time_is_believed[0.95-2]",
    ),
    _filter(
        "as many objects come where few have been",
        "models/score_levels",
        "self.birth_after(scene, None if self.birth_at is None else own.distance)",
        "self.birth",
        by="tests/unit/test_filter_fitting.py::test_the_tracker_expects_fewer_objects_where_few_have_been",
    ),
    _filter(
        "what comes into view is the same near by and far off",
        "scan",
        "birth = self.birth if self.birth.ndim == 1 else self.birth[measurement]",
        "birth = np.atleast_2d(self.birth).mean(axis=0)",
        by="tests/unit/test_filter_fitting.py::test_what_comes_into_view_depends_on_where",
    ),
    _filter(
        "one of two objects goes by the other's id",
        "identity/inheritance",
        "            if at_least_both >= _TWO:\n",
        "            if False:\n",
        by="tests/unit/test_filter_inheritance.py::test_two_objects_keep_their_own[both are there]",
    ),
    _filter(
        "an object's id is that of whoever explains it best at present",
        "identity/inheritance",
        "silent[reported] = False",
        "silent[:] = False",
        by="tests/unit/test_filter_inheritance.py::test_an_object_keeps_its_id_when_its_first_detection_proves_to_be_clutter",
    ),
    _filter(
        "a level lasts though it should drift",
        "prediction",
        "source = transition.scores.predicted(marks.source, transition.dt)",
        "source = marks.source",
        by="tests/unit/test_filter_drift.py::test_a_drifting_level_is_learned_by_bayes_rule",
    ),
    _filter(
        "levels wander off to where they lie close",
        "models/score_levels",
        "up, down = self.drift**2 / (gap * room[:-1]), self.drift**2 / (gap * room[1:])",
        "up = down = self.drift**2 / (2 * gap**2)",
        by="tests/unit/test_filter_drift.py::test_the_walk_is_that_of_its_generator",
    ),
    _filter(
        "a part is reported in place of the whole",
        "estimation",
        "area[b] > whole * area[a]",
        "area[b] > 100 * area[a]",
        by="tests/unit/test_filter_boxes.py::test_the_whole_is_reported_in_place_of_its_parts",
    ),
    _filter(
        "the chain of being detectable never forgets",
        "models/detection",
        "self.stationary + (marks.detectable - self.stationary) * memory",
        "marks.detectable",
        by="tests/unit/test_filter_marks.py::test_visibility_is_a_hidden_markov_model",
    ),
    _filter(
        "a miss says nothing of being detectable",
        "models/detection",
        "missed_if_detectable = 1 - P_D / ",
        "missed_if_detectable = 1 - P_D + 0 * ",
        by="tests/unit/test_filter_marks.py::test_visibility_is_a_hidden_markov_model",
    ),
    _filter(
        "a step writes into the state that it was given",
        "prediction",
        "            existence=local.existence * transition.survival,\n",
        "            existence=np.multiply(local.existence, transition.survival, "
        "out=local.existence),\n",
        by="tests/unit/test_filter_config.py::test_a_step_is_a_pure_function[default]",
    ),
    _filter(
        "a covariance that cancels",
        "hypotheses/gaussian",
        "corrected[:, :2, :2] = R - ",
        "_ = R - ",
        by="tests/unit/test_filter_models.py::test_a_measurement_many_orders_better_than_the_prior_is_believed",
    ),
]
