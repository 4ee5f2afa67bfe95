"""The filter against a reference PMBM, hypothesis by hypothesis, running free for whole runs.

The reference posteriors come from A. F. Garcia-Fernandez's MATLAB PMBM; `PMBM_FILTER_CASES` names
a folder with other cases of the same format:

    params_scenario.json   models, thresholds and caps of the scenario files
    scenario_RUN.npz       measurements z{kk}, estimates est1_{kk} to est3_{kk}, gospa2
    posterior_RUN*.npz     densities pred{kk}_, upd{kk}_, pruned{kk}_ over (a prefix of) that run
    tiny_exact.npz         a small problem without gate, caps or pruning, parameters inside

The functions called here are those that `PMBMTracker.step` calls.  Nothing is taken back from the
reference: each step's posterior is the next step's prior.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filter_problems import KEEP_ALL, plain_sensor, scan_of
from scipy.optimize import linear_sum_assignment

from pmbm.filter.association import associate
from pmbm.filter.density import BEFORE, Density, Locals, Mixture
from pmbm.filter.estimators import best_hypothesis, map_cardinality, most_certain_hypothesis
from pmbm.filter.prediction import Transition, predict
from pmbm.filter.reduction import reduce
from pmbm.filter.update import update

FOLDER = Path(os.environ.get("PMBM_FILTER_CASES") or Path(__file__).parent / "filter")
SCENARIOS = sorted(FOLDER.glob("scenario_*.npz"))
POSTERIORS = sorted(FOLDER.glob("posterior_*.npz"))
TINY = sorted(FOLDER.glob("tiny_exact*.npz"))


class Comparison:
    """Counts what it asserts, and names the step where something differs."""

    def __init__(self, rtol, atol):
        self.rtol, self.atol, self.count = rtol, atol, 0

    def close(self, got, expected, what):
        got, expected = np.asarray(got, float), np.asarray(expected, float)
        assert got.shape == expected.shape, f"{what}: shape {got.shape}, not {expected.shape}"
        np.testing.assert_allclose(got, expected, rtol=self.rtol, atol=self.atol, err_msg=what)
        self.count += expected.size

    def same_rows(self, got, expected, what):
        """Equal as sets of rows."""
        got, expected = np.reshape(got, (-1, 4)), np.reshape(expected, (-1, 4))
        assert got.shape == expected.shape, f"{what}: {len(got)} states, not {len(expected)}"
        distance = ((got[:, None] - expected) ** 2).sum(axis=-1)
        i, j = linear_sum_assignment(distance)
        self.close(got[i], expected[j], what)


class Case:
    """Models and limits of a case, turned into the filter's state order [x, y, vx, vy].

    murty : most children of a step's parents, before `limits` are applied.
    """

    def __init__(self, values, state, limits, murty):
        names = [name.strip() for name in state.strip("[] ").split(",")]
        order = [names.index(name) for name in ("px", "py", "vx", "vy")]
        self.order = order
        square = np.ix_(order, order)
        H = np.asarray(values["H"])[:, order]
        assert np.array_equal(H, np.eye(2, 4)), "the filter measures positions alone"
        self.transition = Transition(
            np.asarray(values["F"])[square], np.asarray(values["Q"])[square], float(values["p_S"])
        )
        self.sensor = plain_sensor(
            np.asarray(values["R"]), float(values["p_D"]), float(values["clutter_intensity"])
        )
        self.birth = self.mixture(values["birth_w"], values["birth_mean"], values["birth_cov"])
        self.limits = limits
        self.branching = replace(limits, max_hypotheses=murty, prune_hypothesis=0.0)

    def mixture(self, weight, mean, cov):
        square = np.ix_(self.order, self.order)
        return Mixture(
            np.log(np.asarray(weight, float).reshape(-1)),
            np.asarray(mean, float).reshape(-1, 4)[:, self.order],
            np.asarray(cov, float).reshape(-1, 4, 4)[(slice(None), *square)],
        )

    def initial(self, undetected, steps):
        return Density.initial(undetected, clustering=False, local=Locals.empty(steps))

    def step(self, density, z, first):
        """One step of the filter: predicted, association, updated, reduced."""
        predicted = density if first else predict(density, self.transition, self.birth)
        scan = scan_of(z)
        association = associate(predicted, scan, self.sensor, self.branching)
        updated = update(predicted, scan, association, self.sensor)
        return predicted, association, updated, reduce(updated, self.limits)[0]

    def check(self, density, values, name, first_ids, compare):
        """Undetected objects in order; local and global hypotheses as sets, keyed by the track's
        first detection and the measurements it took since."""
        square = (slice(None), *np.ix_(self.order, self.order))
        ppp = density.undetected
        compare.close(np.exp(ppp.log_weight), values[f"{name}_ppp_w"], f"{name} PPP weights")
        compare.close(ppp.mean, values[f"{name}_ppp_mean"][:, self.order], f"{name} PPP means")
        compare.close(ppp.cov, values[f"{name}_ppp_cov"][square], f"{name} PPP covariances")

        keys = local_keys(density, first_ids)
        table = density.hypotheses
        ours = {
            frozenset(keys[row] for row in table.member[first:last].tolist()): weight
            for first, last, weight in zip(
                table.start[:-1], table.start[1:], np.exp(table.log_weight), strict=True
            )
        }
        their_keys = reference_keys(values, name)
        rows, weight = values[f"{name}_glob_rows"], values[f"{name}_glob_w"]
        if not len(weight):
            rows, weight = np.zeros((1, 0), int), np.ones(1)
        theirs = {
            frozenset(their_keys[i] for i in row[row >= 0]): w
            for row, w in zip(rows, weight, strict=True)
        }
        assert len(ours) == len(table), f"{name}: equal global hypotheses"
        assert ours.keys() == theirs.keys(), (
            f"{name}: {len(ours.keys() - theirs.keys())} global hypotheses too many, "
            f"{len(theirs.keys() - ours.keys())} missing, of {len(theirs)}"
        )
        compare.close(
            [ours[key] for key in theirs], list(theirs.values()), f"{name} global weights"
        )

        # The reference keeps rows that none of its best global hypotheses uses.
        used = sorted({int(i) for i in rows[rows >= 0]})
        row_of = {key: row for row, key in enumerate(keys)}
        assert row_of.keys() == {their_keys[i] for i in used}, f"{name}: local hypotheses"
        mine = [row_of[their_keys[i]] for i in used]
        local = density.local
        compare.close(local.existence[mine], values[f"{name}_hyp_r"][used], f"{name} existence")
        compare.close(
            local.mean[mine], values[f"{name}_hyp_mean"][used][:, self.order], f"{name} means"
        )
        compare.close(
            local.cov[mine], values[f"{name}_hyp_cov"][used][square], f"{name} covariances"
        )

    def check_weights(self, prior, association, values, name, first_ids, compare):
        """The weight factor of every local hypothesis, also of those that no global one uses."""
        ours = {
            (track, (*history, -1)): weight
            for (track, history), weight in zip(
                local_keys(prior, first_ids), association.log_missed, strict=True
            )
        }
        known = association.known
        before = local_keys(prior, first_ids)
        for row, z, weight in zip(known.row, known.measurement, known.log_weight, strict=True):
            track, history = before[row]
            ours[track, (*history, int(z))] = weight
        for z, weight in enumerate(association.log_new):
            ours[(len(first_ids), z), (z,)] = weight
        their = dict(
            zip(reference_keys(values, name), values[f"{name}_hyp_logw"].tolist(), strict=True)
        )
        assert ours.keys() == their.keys(), f"{name}: gated pairs"
        compare.close(
            [ours[key] for key in their], list(their.values()), f"{name} local log weights"
        )


def local_keys(density, first_ids):
    """((step of first detection, measurement), (measurements since)) of each local hypothesis."""
    keys = []
    for track, history in zip(density.local.track, density.local.history, strict=True):
        number = int(density.track_id[track])
        step = int(np.searchsorted(first_ids, number, side="right"))
        since = tuple(int(z) for z in history if z != BEFORE)
        keys.append(((step, number - first_ids[step - 1]), since))
    return keys


def reference_keys(values, name):
    return [
        ((int(t), int(z)), tuple(int(a) for a in row if a != -2))
        for t, z, row in zip(
            values[f"{name}_hyp_t_ini"],
            values[f"{name}_hyp_meas0"],
            values[f"{name}_hyp_assoc"],
            strict=True,
        )
    ]


def estimates(density, threshold):
    rows = (
        best_hypothesis(density, threshold),
        map_cardinality(density),
        most_certain_hypothesis(density),
    )
    return [density.local.mean[chosen] for chosen in rows]


def gospa_squared(truth, estimate, p, c):
    """[total, localisation, missed, false] of GOSPA^p with alpha = 2, by optimal assignment."""
    n, m = len(truth), len(estimate)
    cost = np.linalg.norm(truth[:, None] - estimate, axis=-1) ** p
    padded = np.full((n + m, n + m), c**p / 2)
    padded[:n, :m] = cost
    padded[n:, m:] = 0.0
    i, j = linear_sum_assignment(padded)
    matched = (i < n) & (j < m)
    localisation = padded[i[matched], j[matched]].sum()
    missed, false = (np.array([n, m]) - matched.sum()) * c**p / 2
    return [localisation + missed + false, localisation, missed, false]


def scenario_case():
    params = json.loads((FOLDER / "params_scenario.json").read_text())
    assert params["recycling"] == "none"
    limits = replace(
        KEEP_ALL,
        gate=params["gate_mahalanobis_sq"],
        prune_hypothesis=params["T_pruning_global"],
        max_hypotheses=params["N_hyp_max"],
        recycle_below=params["existence_threshold"],
        recycle=False,
        prune_undetected=params["T_pruning_ppp"],
    )
    found = re.search(r"ceil\((\d+)\s*\*", str(params["murty_k"]))
    murty = int(found.group(1)) if found else params["N_hyp_max"]
    case = Case(params, params["state"], limits, murty)

    def given(name):
        value = params[f"initial_ppp_{name}"]
        return params[value[1:].strip()] if isinstance(value, str) else value

    initial = case.mixture(params["initial_ppp_w"], given("mean"), given("cov"))
    return case, initial, params


def scans(values):
    names = sorted(name for name in values if re.fullmatch(r"z\d+", name))
    return [np.reshape(values[name], (-1, 2)) for name in names], [name[1:] for name in names]


def load(path):
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def test_the_folder_holds_cases():
    assert SCENARIOS or POSTERIORS or TINY, f"no oracle files in {FOLDER}"
    runs = [path.stem.removeprefix("scenario_") for path in SCENARIOS]
    for path in POSTERIORS:
        assert any(path.stem.removeprefix("posterior_").startswith(run) for run in runs), (
            f"{path.name} has no scenario file, which holds the measurements"
        )


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_hypothesis_of_every_step(path):
    run = path.stem.removeprefix("scenario_")
    values = load(path)
    references = {
        other.stem: load(other)
        for other in POSTERIORS
        if other.stem.removeprefix("posterior_").startswith(run)
    }
    case, initial, params = scenario_case()
    compare = Comparison(rtol=1e-8, atol=1e-9)
    gospa = params["gospa"]
    truth, birth, death = values["X_truth"], values["t_birth"], values["t_death"]
    measurements, names = scans(values)
    density = case.initial(initial, len(measurements))
    first_ids: list[int] = []
    steps_checked = 0
    for k, (z, name) in enumerate(zip(measurements, names, strict=True), start=1):
        first_ids.append(density.detections_seen)
        predicted, association, updated, density = case.step(density, z, first=k == 1)
        for reference in references.values():
            if f"upd{name}_ppp_w" not in reference:
                continue
            steps_checked += 1
            case.check(predicted, reference, f"pred{name}", first_ids, compare)
            case.check_weights(predicted, association, reference, f"upd{name}", first_ids, compare)
            case.check(updated, reference, f"upd{name}", first_ids, compare)
            case.check(density, reference, f"pruned{name}", first_ids, compare)
        alive = truth[k - 1][(birth <= k) & (k < death)][:, case.order][:, :2]
        for number, state in enumerate(
            estimates(updated, params["estimator1_existence_threshold"]), start=1
        ):
            compare.same_rows(
                state, values[f"est{number}_{name}"][:, case.order], f"est{number} at {name}"
            )
            compare.close(
                gospa_squared(alive, state[:, :2], gospa["p"], gospa["c"]),
                values["gospa2"][number - 1, k - 1],
                f"GOSPA of est{number} at {name}",
            )
    for reference in references.values():
        expected = sum(1 for key in reference if re.fullmatch(r"upd\d+_ppp_w", key))
        assert expected
        steps_checked -= expected
    assert steps_checked == 0, "a posterior file holds steps that the scenario does not"
    print(f"\n{path.name} with {sorted(references) or 'no posteriors'}: {compare.count} values")
    assert compare.count


@pytest.mark.parametrize("path", TINY, ids=lambda path: path.stem)
def test_a_tiny_problem_solved_exactly(path):
    values = load(path)
    case = Case(values, "[px, vx, py, vy]", replace(KEEP_ALL, recycle=False), 10**9)
    compare = Comparison(rtol=1e-9, atol=1e-9)
    density = case.initial(
        case.mixture(values["init_w"], values["birth_mean"], values["birth_cov"]), 99
    )
    first_ids: list[int] = []
    for k, (z, name) in enumerate(zip(*scans(values), strict=True), start=1):
        first_ids.append(density.detections_seen)
        predicted, association, updated, density = case.step(density, z, first=k == 1)
        case.check(predicted, values, f"pred{name}", first_ids, compare)
        case.check_weights(predicted, association, values, f"upd{name}", first_ids, compare)
        case.check(updated, values, f"upd{name}", first_ids, compare)
        case.check(density, values, f"upd{name}", first_ids, compare)
        for number, state in enumerate(estimates(updated, 0.4), start=1):
            compare.same_rows(
                state, values[f"est{number}_{name}"][:, case.order], f"est{number} at {name}"
            )
    print(f"\n{path.name}: {compare.count} values")
    assert compare.count
