"""The gate's rules, on losses whose verdict is known."""

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.regression.sequence import trials_without_change
from pmbm.regression.verdicts import Pairs, Rules, Verdict, judge, overall

RULES = Rules(margin=0.05)


def pairs(loss, baseline=0.5, value_range=1.0):
    loss = np.asarray(loss, dtype=float)
    start = np.broadcast_to(np.asarray(baseline, dtype=float), loss.shape)
    return Pairs(baseline=start, candidate=start + loss, value_range=value_range)


def noise(mean, sd, seed=0, n=600):
    return np.random.default_rng(seed).normal(mean, sd, n)


def only(loss, rules=RULES, **options):
    return judge({"scene": pairs(loss, **options)}, rules)["scene"]


def test_equal_values_pass_at_the_first_possible_trial():
    decision = only(np.zeros(600))
    assert (decision.verdict, decision.trials, decision.equal) == (Verdict.PASS, 90, True)
    assert decision.hidden == pytest.approx(1 - 0.01 ** (1 / 90))
    assert not decision.worse_within_margin
    assert only(np.zeros(89)).verdict is Verdict.UNDECIDED


def test_a_loss_of_two_margins_fails():
    decision = only(noise(0.1, 0.02))
    assert decision.verdict is Verdict.FAIL
    assert decision.low > 0
    assert decision.trials < 90
    assert decision.loss == pytest.approx(0.1, abs=0.01)
    assert decision.candidate - decision.baseline == pytest.approx(decision.loss)


def test_a_gain_passes_and_small_noise_is_no_loss():
    assert only(noise(-0.1, 0.02)).verdict is Verdict.PASS
    assert only(noise(0.0, 0.02)).verdict is Verdict.PASS


def test_a_loss_proven_to_lie_inside_the_margin_passes_and_is_said():
    decision = only(noise(0.2, 0.01), rules=Rules(margin=0.5))
    assert (decision.verdict, decision.trials) == (Verdict.PASS, 90)
    assert decision.worse_within_margin
    assert 0 < decision.low < decision.loss < decision.high < 0.5
    assert not only(noise(0.0, 0.01), rules=Rules(margin=0.5)).worse_within_margin
    # Nearer to the margin than to nothing: no loss is excluded first.
    assert only(noise(0.4, 0.01), rules=Rules(margin=0.5)).verdict is Verdict.FAIL


def test_one_trial_too_few_is_undecided():
    least = trials_without_change(0.05, value_range=1.0, alpha=0.01, rarest=0.05)
    decision = only(noise(0.0, 1e-6, n=least - 1))
    assert decision.verdict is Verdict.UNDECIDED
    assert decision.needs == least
    assert only(noise(0.0, 1e-6, n=least)).verdict is Verdict.PASS


def test_a_single_disaster_keeps_a_pass_away():
    # A margin of 1/60 of the range: calm trials pass when the floor lets them.
    rules = Rules(margin=1 / 60)
    calm = noise(0.0, 0.001)
    needed = only(calm, rules).trials
    assert 150 < needed < 250
    struck = calm.copy()
    struck[40] = 1.0
    found = only(struck, rules)
    assert found.verdict is Verdict.PASS
    assert found.trials > 1.2 * needed


def test_a_relative_margin_is_a_share_of_each_trials_baseline():
    baseline = np.random.default_rng(4).uniform(0.2, 0.9, 600)
    loss = 0.05 * baseline + noise(0.0, 0.002, 5)
    assert only(loss, Rules(relative_margin=0.02), baseline=baseline).verdict is Verdict.FAIL
    # The loss is there, but the first trial that may pass comes before it is proven.
    found = only(loss, Rules(relative_margin=0.4), baseline=baseline)
    assert found.verdict is Verdict.PASS
    assert found.margin == pytest.approx(0.4 * baseline[: found.trials].mean())


def test_holm_by_hand():
    # Three scenarios at alpha .01: passes need .0033, then .005, then .01 of the next.
    rules = Rules(margin=0.05, alpha=0.01)
    zeros = np.zeros(600)
    alone = {name: pairs(zeros) for name in "abc"}
    trials = {name: d.trials for name, d in judge(alone, rules).items()}
    # log(.01 / 3) / log(.95) = 111.2: all three reach it together.
    assert trials == {"a": 112, "b": 112, "c": 112}
    short = {"a": pairs(zeros), "b": pairs(zeros[:104]), "c": pairs(zeros[:90])}
    found = judge(short, rules)
    # a at .01 / 3 (112), then b at .01 / 2 (104), then c at .01 (90).
    assert {name: d.trials for name, d in found.items()} == {"a": 112, "b": 104, "c": 90}
    assert all(d.verdict is Verdict.PASS for d in found.values())
    assert [found[n].level for n in "abc"] == pytest.approx([0.01 / 3, 0.01 / 2, 0.01])
    stuck = judge({**short, "b": pairs(zeros[:103])}, rules)
    assert [stuck[n].verdict for n in "abc"] == [
        Verdict.PASS,
        Verdict.UNDECIDED,
        Verdict.UNDECIDED,
    ]


def test_a_pass_makes_no_failure_easier():
    # Failures are a family of their own: many passes must not lower what a failure needs.
    rules = Rules(margin=0.05)
    weak = noise(0.03, 0.1, seed=7, n=60)
    many = {f"same{k}": pairs(np.zeros(600)) for k in range(5)} | {"weak": pairs(weak)}
    few = {"weak": pairs(weak), "weak2": pairs(weak)}
    assert judge(many, rules)["weak"].level == pytest.approx(0.01 / 6)
    assert judge(few, rules)["weak"].level == pytest.approx(0.01 / 2)


def test_the_order_of_scenarios_does_not_matter():
    scenes = {
        f"s{k}": pairs(noise(mean, 0.05, seed=k))
        for k, mean in enumerate((0.0, 0.02, 0.1, -0.1, 0.05))
    }
    forward = judge(scenes, RULES)
    backward = judge(dict(reversed(scenes.items())), RULES)
    assert forward == {name: backward[name] for name in forward}


def test_more_trials_never_change_a_verdict():
    loss = noise(0.02, 0.1, seed=11)
    final = only(loss)
    assert final.verdict is not Verdict.UNDECIDED
    for n in range(1, 600, 37):
        early = only(loss[:n])
        if n < final.trials:
            assert early.verdict is Verdict.UNDECIDED
        else:
            assert early == final


@pytest.mark.parametrize(
    ("verdicts", "whole"),
    [
        ("pp", Verdict.PASS),
        ("pf", Verdict.FAIL),
        ("uf", Verdict.FAIL),
        ("pu", Verdict.UNDECIDED),
        ("", Verdict.UNDECIDED),
    ],
)
def test_the_whole(verdicts, whole):
    letters = {"p": Verdict.PASS, "f": Verdict.FAIL, "u": Verdict.UNDECIDED}
    assert overall([letters[v] for v in verdicts]) is whole


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "one of margin and relative_margin, got 'neither'"),
        ({"margin": 1.0, "relative_margin": 0.1}, "got 'both'"),
        ({"margin": 0.0}, "above 0"),
        ({"margin": float("nan")}, "above 0"),
        ({"margin": True}, "above 0"),
        ({"relative_margin": -1.0}, "above 0"),
        ({"margin": 1.0, "alpha": 0.5}, "below 0.2"),
        ({"margin": 1.0, "rarest": 0.0}, "above 0"),
        ({"margin": 1.0, "max_trials": 0}, "at least 1"),
        ({"margin": 1.0, "max_trials": 2.5}, "whole number"),
    ],
)
def test_impossible_rules_are_refused(changes, words):
    with pytest.raises(InputError, match=words):
        Rules(**changes)
