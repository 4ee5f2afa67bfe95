"""The gate's four promises, by simulated studies.

Each is a probability, judged by the Clopper-Pearson 99 % bound: a share promised to be at most
alpha is broken where the lower bound exceeds alpha.  Two worlds of a metric in [0, 1]: in CALM two
equal trackers differ by 0.03 on one trial, so the floor of the variance decides; in NOISY by 0.2,
so the sample does.  The margin in CALM is 1/60 of the range, the largest for which a disaster in
5 % of trials can weigh 3 margins.
"""

import pytest
from gate_worlds import World, power_against_unpaired, share, verdicts
from scipy.stats import binomtest

from pmbm.regression.verdicts import Verdict

ALPHA = 0.01
CALM = World(margin=1 / 60, pair_sd=0.03)
NOISY = World(margin=0.05, pair_sd=0.2)
EVERY_DAY = 60
LONG = 2000


def not_above_alpha(count, studies):
    low = binomtest(count, studies).proportion_ci(0.99, method="exact").low
    assert low <= ALPHA, f"{count} of {studies}: at least {low:.4f}"


def at_least(wanted, count, studies):
    high = binomtest(count, studies).proportion_ci(0.99, method="exact").high
    assert high >= wanted, f"{count} of {studies}: at most {high:.4f}"


def no_change(world, studies, seed):
    found, _ = verdicts(world, studies, seed)
    return share(found, Verdict.FAIL)


def loss_of_the_margin(world, studies, seed):
    found, _ = verdicts(world, studies, seed, smooth=world.margin)
    return share(found, Verdict.PASS)


def rare_disasters(world, studies, seed):
    change = {"disaster_rate": 0.05, "disaster_loss": 60 * world.margin}
    found, _ = verdicts(world, studies, seed, **change)
    return share(found, Verdict.PASS)


PROMISES = [
    ("gate_no_change", no_change, CALM),
    ("gate_no_change", no_change, NOISY),
    ("gate_margin", loss_of_the_margin, CALM),
    ("gate_margin", loss_of_the_margin, NOISY),
    ("gate_disaster", rare_disasters, CALM),
    ("gate_disaster", rare_disasters, World(margin=1 / 100, pair_sd=0.005)),
]
NAMES = [f"{name}-margin{world.margin:.3f}" for name, _, world in PROMISES]


@pytest.mark.parametrize(("name", "promise", "world"), PROMISES, ids=NAMES)
def test_wrong_verdicts_are_rare(name, promise, world):
    not_above_alpha(*promise(world, EVERY_DAY, seed=1))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "promise", "world"), PROMISES, ids=NAMES)
def test_wrong_verdicts_are_rare_over_2000_studies(name, promise, world, verified):
    count, studies = promise(world, LONG, seed=2)
    low = binomtest(count, studies).proportion_ci(0.99, method="exact").low
    what = f"wrong verdicts of {studies} simulated studies, margin {world.margin:.3f} of the range"
    verified(name, what, count / studies, f"99 % lower bound <= {ALPHA}", bool(low <= ALPHA))
    not_above_alpha(count, studies)


def test_pairing_finds_a_loss_with_a_quarter_of_the_trials():
    count, studies, _ = power_against_unpaired(
        World(margin=1 / 100, pair_sd=0.03), EVERY_DAY, seed=3
    )
    at_least(0.9, count, studies)


@pytest.mark.slow
def test_pairing_finds_a_loss_with_a_quarter_of_the_trials_over_2000_studies(verified):
    count, studies, needed = power_against_unpaired(
        World(margin=1 / 100, pair_sd=0.03), LONG, seed=4
    )
    verified(
        "gate_power",
        f"a loss of 2 margins found within {needed / 4:.0f} trials, a quarter of the unpaired's",
        count / studies,
        ">= 0.9",
        count >= 0.9 * studies,
    )
    at_least(0.9, count, studies)
    assert count >= 0.9 * studies


def test_without_the_two_rules_disasters_pass():
    """The test sees what it is for: without a floor and a least number, disasters slip through."""
    from pmbm.regression import sequence

    world = World(margin=1 / 100, pair_sd=0.005)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sequence, "_running", lambda x, n, value_range, real=sequence._running: real(x, n, 1e-9)
        )
        rules = type(world.rules)(margin=world.margin, rarest=0.4)
        patch.setattr(World, "rules", rules)
        count, studies = rare_disasters(world, 30, seed=5)
    assert count > 0.05 * studies
