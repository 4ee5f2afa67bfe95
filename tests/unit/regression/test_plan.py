"""What a gate is said to take, against what it then takes."""

import numpy as np
import pytest
from gate_worlds_small import Breaks, OneCar, exact, metre_off

from pmbm.errors import InputError
from pmbm.regression import (
    GateEntry,
    Pairs,
    Rules,
    Verdict,
    gated_metric,
    judge,
    least_trials,
    run_pilot,
    trials_with_spread,
)

METRIC = gated_metric("ospa", [0.0, 2.0])


def pairs(loss, baseline=0.5):
    start = np.full(len(loss), baseline)
    return Pairs(baseline=start, candidate=start + loss, value_range=1.0)


@pytest.mark.parametrize("scenarios", [1, 3])
@pytest.mark.parametrize(
    "rules", [Rules(margin=0.02), Rules(margin=0.2), Rules(relative_margin=0.1)]
)
def test_the_least_is_what_equal_values_take(rules, scenarios):
    margin = rules.margin or 0.05
    least = least_trials(margin, 1.0, rules, scenarios)
    same = {f"s{k}": pairs(np.zeros(1000)) for k in range(scenarios)}
    assert {d.trials for d in judge(same, rules).values()} == {least}


def test_the_spread_of_a_few_trials_foretells_many():
    rules = Rules(margin=0.05)
    rng = np.random.default_rng(2)
    pilot = rng.normal(0.0, 0.2, 200).clip(-1, 1)
    foretold = trials_with_spread(pairs(pilot), rules, 1)
    taken = [
        judge({"s": pairs(rng.normal(0.0, pilot.std(), 1500).clip(-1, 1))}, rules)["s"].trials
        for _ in range(40)
    ]
    assert foretold == pytest.approx(np.median(taken), rel=0.25)
    # What the pilot's mean is does not matter: the plan is for no change.
    assert trials_with_spread(pairs(pilot + 0.001), rules, 1) == pytest.approx(foretold, rel=0.02)
    assert trials_with_spread(pairs(np.zeros(10)), rules, 1) == least_trials(0.05, 1.0, rules, 1)


def test_a_hopeless_spread_is_said():
    coins = np.tile([1.0, -1.0], 5)
    assert trials_with_spread(pairs(coins, baseline=0.0), Rules(margin=0.001), 1) is None


def test_a_pilot_holds_the_first_trials_of_both():
    pilot = run_pilot("scene", GateEntry(OneCar(), exact, metre_off), METRIC, seed=0, trials=6)
    assert pilot.pairs.loss == pytest.approx(np.ones(6), abs=0.1)
    assert 0.0 < pilot.spread < 0.1
    assert pilot.seconds > 0
    with pytest.raises(InputError, match=r"the candidate raised in trial \d+.*of 'scene'"):
        run_pilot("scene", GateEntry(OneCar(), exact, Breaks), METRIC, seed=0, trials=20)


def test_verdicts_of_the_plan_are_undecided_one_trial_before():
    rules = Rules(margin=0.03)
    least = least_trials(0.03, 1.0, rules, 1)
    found = judge({"s": pairs(np.zeros(least - 1))}, rules)["s"]
    assert found.verdict is Verdict.UNDECIDED
    assert found.needs == least
