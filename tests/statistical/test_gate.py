"""The gate's promises, by simulated studies.

Each is a probability, judged by the Clopper-Pearson 99 % bound: a share promised to be at most
alpha is broken where the lower bound exceeds alpha.
"""

import gate_methods
import numpy as np
import pytest
from gate_worlds import (
    ALPHA,
    BENIGN,
    ELSEWHERE,
    FAIL,
    PASS,
    RAREST,
    TABLE,
    UNDECIDED,
    decided,
    normal,
    verdicts,
)
from scipy.stats import binomtest

from pmbm.regression import Pairs, Rules, Verdict, judge
from pmbm.regression.sequence import fewest_trials
from pmbm.regression.verdicts import first_verdicts

WORLDS = TABLE + BENIGN + ELSEWHERE
NAMES = [f"{world.name}; margin {world.margin:.3g}" for world in WORLDS]
PROMISED = dict(
    zip(
        NAMES[len(TABLE) : len(TABLE) + len(BENIGN)],
        [id for id in ("gate_no_change", "gate_margin", "gate_disaster") for _ in range(2)],
        strict=True,
    )
)
"""Worlds that have a row of their own in the record."""
EVERY_DAY = 300
LONG = 4000
NUMBER = {Verdict.PASS: PASS, Verdict.FAIL: FAIL, Verdict.UNDECIDED: UNDECIDED}
COSTS = [("pass", margin, 0.0) for margin in (0.05, 0.02)]
COSTS += [("fail", margin, 2 * margin) for margin in (0.05, 0.02)]


def lower_bound(count, studies):
    return binomtest(count, studies).proportion_ci(0.99, method="exact").low


def wrong(world, studies, seed):
    """How many studies end in the verdict that is wrong in this world."""
    found, _ = verdicts(world, studies, seed)
    return int((found == world.wrong).sum())


@pytest.mark.parametrize("world", WORLDS, ids=NAMES)
def test_a_worlds_mean_is_what_it_says(world):
    drawn = world.draw(np.random.default_rng(5), (400, world.trials))
    assert np.abs(drawn).max() <= 1.0
    error = drawn.mean() - world.mean
    assert abs(error) <= 5 * drawn.std() / np.sqrt(drawn.size) + 1e-12
    assert world.wrong in (PASS, FAIL)


@pytest.mark.parametrize("world", [*TABLE, *BENIGN[:4]], ids=NAMES[:10])
def test_wrong_verdicts_are_rare(world):
    assert lower_bound(wrong(world, EVERY_DAY, seed=1), EVERY_DAY) <= ALPHA


@pytest.mark.slow
@pytest.mark.parametrize(("name", "world"), [*zip(NAMES, WORLDS, strict=True)], ids=NAMES)
def test_wrong_verdicts_are_rare_over_4000_studies(name, world, verified):
    count = wrong(world, LONG, seed=2)
    low = lower_bound(count, LONG)
    kind = {PASS: "passes", FAIL: "failures"}[world.wrong]
    what = f"wrong {kind} of {LONG} studies of at most {world.trials} trials: {world.name}"
    what += f"; mean {round(world.mean, 12) + 0.0:.3g}, margin {world.margin:.3g} of the range"
    for id in ("gate_worlds", PROMISED.get(name)):
        if id is not None:
            bound = f"99 % lower bound <= {ALPHA}"
            verified(id, what, count / LONG, bound, bool(low <= ALPHA))
    assert low <= ALPHA


def suite(rng, trials):
    """Scenarios whose losses are nothing or the margin: of each only one verdict is wrong."""
    loss = {
        "nothing, calm": rng.normal(0.0, 0.03, trials).clip(-1, 1),
        "nothing, coins": rng.choice([-1.0, 1.0], trials),
        "nothing, rare gains": np.where(rng.random(trials) < 0.05, -1.0, 0.05 / 0.95),
        "margin, rare": np.where(rng.random(trials) < 0.1, 1.0, 0.0),
        "margin, coins": rng.choice([1.0, -1.0], trials, p=[0.55, 0.45]),
    }
    kinds = {name: FAIL if name.startswith("nothing") else PASS for name in loss}
    zero = np.zeros(trials)
    return {n: Pairs(baseline=zero, candidate=x, value_range=1.0) for n, x in loss.items()}, kinds


def mixed_suite(rng):
    """Whether any scenario of a suite got its wrong verdict."""
    pairs, kinds = suite(rng, 300)
    found = first_verdicts(pairs, Rules(margin=0.1, alpha=ALPHA))
    return any(NUMBER[first.verdict] == kinds[name] for name, first in found.items())


def share_of_the_baseline(rng):
    """A loss that is the tolerated share of the baseline in the mean, and wild."""
    baseline = rng.beta(0.5, 1.5, 600)
    # Of a baseline b: a loss of 1 - b with a probability that makes the mean a tenth of b.
    struck = rng.random(600) < 0.1 * baseline / np.maximum(1.0 - baseline, 1e-9)
    tenth = 0.1 * baseline <= 1.0 - baseline
    loss = np.where(tenth, struck * (1.0 - baseline), 0.1 * baseline)
    pairs = Pairs(baseline=baseline, candidate=baseline + loss, value_range=1.0)
    found = first_verdicts({"scene": pairs}, Rules(relative_margin=0.1, alpha=ALPHA))
    return found["scene"].verdict is Verdict.PASS


@pytest.mark.slow
@pytest.mark.parametrize("study", [mixed_suite, share_of_the_baseline])
def test_suites_and_shares_over_4000_studies(study, verified):
    count = sum(study(np.random.default_rng([3, k])) for k in range(LONG))
    low = lower_bound(count, LONG)
    what = f"wrong verdicts of {LONG} studies: {study.__name__.replace('_', ' ')}"
    verified("gate_worlds", what, count / LONG, f"99 % lower bound <= {ALPHA}", bool(low <= ALPHA))
    assert low <= ALPHA


def test_the_vectorised_verdicts_are_those_of_judge():
    for world in (TABLE[4], BENIGN[1], BENIGN[2], ELSEWHERE[3], normal(0.1, 0.2, 0.05)):
        loss = world.draw(np.random.default_rng(6), (8, world.trials))
        verdict, trials = decided(loss, world.margin)
        for row in range(8):
            pairs = Pairs(baseline=np.zeros(world.trials), candidate=loss[row], value_range=1.0)
            one = judge({"scene": pairs}, Rules(margin=world.margin, alpha=ALPHA))["scene"]
            assert (NUMBER[one.verdict], one.trials) == (verdict[row], trials[row])


def test_the_test_sees_a_sequence_that_does_not_hold():
    """What the worlds are for: by an asymptotic sequence disasters slip through."""
    loss = TABLE[0].draw(np.random.default_rng(7), (200, TABLE[0].trials))
    found, _ = gate_methods.verdicts("asymptotic", loss, TABLE[0].margin)
    assert lower_bound(int((found == PASS).sum()), 200) > 0.2


@pytest.mark.parametrize("margin", [0.3, 0.05, 0.03, 0.02, 0.01])
def test_equal_values_take_at_most_a_quarter_more_than_any_method_could(margin):
    bound = np.log(ALPHA) / np.log1p(-margin)
    _, trials = decided(np.zeros((1, 1500)), margin)
    assert trials[0] <= max(1.25 * bound, fewest_trials(ALPHA, RAREST))


def cost_in_trials(method, kind, margin, mean, studies, seed):
    """Mean trials of this verdict over normal differences, sd 3 % of the range."""
    world = normal(mean, 0.03, margin)
    loss = world.draw(np.random.default_rng(seed), (studies, world.trials))
    found, trials = gate_methods.verdicts(method, loss, margin)
    assert (found == {"pass": PASS, "fail": FAIL}[kind]).mean() > 0.98
    return float(trials.mean())


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "margin", "mean"), COSTS)
def test_validity_costs_at_most_seven_tenths_more(kind, margin, mean, verified):
    ours = cost_in_trials("betting", kind, margin, mean, 1000, seed=8)
    asymptotic = cost_in_trials("asymptotic", kind, margin, mean, 1000, seed=8)
    verified(
        "gate_cost",
        f"trials to {kind} at a margin of {margin:g} of the range, normal differences of sd .03 "
        f"and mean {mean:g}: {ours:.1f}, over those of an asymptotic sequence, {asymptotic:.1f}",
        ours / asymptotic,
        "<= 1.7",
        ours <= 1.7 * asymptotic,
    )
    assert ours <= 1.7 * asymptotic


def power_against_unpaired(studies, seed):
    """How many studies of a loss of two margins fail within half of the trials at which the
    unpaired design has failed nine in ten; and that number."""
    margin, rng = 0.01, np.random.default_rng(seed)
    shape = (studies, 1500)
    candidate, other = rng.normal(0.3, 0.1, (2, *shape)).clip(0.0, 0.9)
    luck = rng.normal(2 * margin, 0.03, shape)
    found, trials = decided((candidate + luck - other).clip(-1, 1), margin)
    needed = np.quantile(np.where(found == FAIL, trials, np.inf), 0.9, method="higher")
    found, trials = decided(luck.clip(-1, 1), margin)
    return int(((found == FAIL) & (trials <= needed / 2)).sum()), needed


def test_pairing_finds_a_loss_with_half_of_the_trials():
    count, _ = power_against_unpaired(60, seed=3)
    assert binomtest(count, 60).proportion_ci(0.99, method="exact").high >= 0.9


@pytest.mark.slow
def test_pairing_finds_a_loss_with_half_of_the_trials_over_2000_studies(verified):
    parts = [power_against_unpaired(200, seed=[4, k]) for k in range(10)]
    share = sum(count for count, _ in parts) / 2000
    needed = np.mean([needed for _, needed in parts])
    verified(
        "gate_power",
        f"a loss of 2 margins found within {needed / 2:.0f} trials, half of the unpaired's",
        share,
        ">= 0.9",
        share >= 0.9,
    )
    assert share >= 0.9
