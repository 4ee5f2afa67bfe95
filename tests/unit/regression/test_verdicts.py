"""The gate's rules, on losses whose verdict is known."""

from dataclasses import replace

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.regression.sequence import evidence, trials_without_change
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
    # Half of the wealth grows by 1 / .95 a trial: log(.01 / 2) / log(.95) = 103.3, less what the
    # other bets bring.
    assert (decision.verdict, decision.trials, decision.equal) == (Verdict.PASS, 103, True)
    assert decision.needs == 103
    assert decision.hidden == pytest.approx(1 - 0.01 ** (1 / 103))
    assert not decision.worse_within_margin
    assert only(np.zeros(102)).verdict is Verdict.UNDECIDED


def test_a_wide_margin_waits_for_rare_disasters():
    rules = Rules(margin=0.1)
    assert only(np.zeros(600), rules).trials == 90
    assert only(np.zeros(600), Rules(margin=0.1, rarest=0.02)).trials == 228
    assert only(np.zeros(600), rules).needs == 90


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
    least = trials_without_change(0.02, ceiling=0.98, level=0.01)
    rules = Rules(margin=0.02)
    decision = only(noise(0.0, 1e-6, n=least - 1), rules)
    assert decision.verdict is Verdict.UNDECIDED
    assert decision.needs == least
    assert decision.high > 0.02
    assert only(noise(0.0, 1e-6, n=least), rules).verdict is Verdict.PASS


def test_a_single_disaster_keeps_a_pass_away():
    # The largest bet is lost with it; the next, of half its size and a seventh of its wealth, must
    # make it good.
    rules = Rules(margin=1 / 60)
    calm = noise(0.0, 0.001)
    needed = only(calm, rules).trials
    struck = calm.copy()
    struck[40] = 1.0
    found = only(np.concatenate([struck, calm]), rules)
    assert found.verdict is Verdict.PASS
    assert found.trials > 2 * needed


def test_a_relative_margin_is_a_share_of_each_trials_baseline():
    baseline = np.random.default_rng(4).uniform(0.2, 0.9, 600)
    loss = 0.05 * baseline + noise(0.0, 0.002, 5)
    assert only(loss, Rules(relative_margin=0.02), baseline=baseline).verdict is Verdict.FAIL
    # The loss is there, but the first trial that may pass comes before it is proven.
    found = only(loss, Rules(relative_margin=0.4), baseline=baseline)
    assert found.verdict is Verdict.PASS
    assert found.margin == pytest.approx(0.4 * baseline[: found.trials].mean())


@pytest.mark.parametrize("loss", [np.zeros(50), np.full(50, 0.01)])
def test_a_share_of_nothing_is_refused(loss):
    with pytest.raises(InputError, match=r"mean is zero in 'scene'.*say margin"):
        only(loss, Rules(relative_margin=0.1), baseline=0.0)


def test_a_relative_margin_bets_within_the_wider_range():
    # E[loss - r |baseline|] >= 0 within B (1 + r): equal values gain r |baseline| / (B (1 + r)).
    found = only(np.zeros(600), Rules(relative_margin=0.2), baseline=0.5)
    by_hand = trials_without_change(0.1, ceiling=1.2, level=0.01)
    assert (found.verdict, found.trials) == (Verdict.PASS, max(90, by_hand))
    found = only(np.zeros(600), Rules(relative_margin=0.05), baseline=0.5)
    assert found.trials == trials_without_change(0.025, ceiling=1.05, level=0.01) > 90
    assert found.high < found.margin == pytest.approx(0.025)


def test_a_margin_as_wide_as_the_range_is_refused():
    with pytest.raises(InputError, match="less than the metric's range, 1"):
        only(np.zeros(50), Rules(margin=1.0))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"candidate": [0.0, np.nan]}, "nan in trial 1"),
        ({"baseline": [np.inf, 0.0]}, "inf in trial 0"),
        ({"baseline": [0.0]}, "2 values|1 values"),
        ({"baseline": [], "candidate": []}, "one trial at least"),
        ({"value_range": 0.0}, "above 0"),
    ],
)
def test_impossible_pairs_are_refused(changes, words):
    given = {"baseline": [0.0, 0.0], "candidate": [0.0, 0.0], "value_range": 1.0}
    with pytest.raises(InputError, match=words):
        Pairs(**(given | changes))


def test_a_difference_beyond_the_range_counts_as_the_range():
    beyond = noise(0.0, 0.02)
    beyond[::20] = 1.3
    inside = beyond.clip(-1.0, 1.0)
    assert replace(only(beyond), candidate=0.0) == replace(only(inside), candidate=0.0)


def test_the_interval_holds_the_mean_and_says_what_the_verdict_says():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        loss = rng.uniform(-0.1, 0.2) + rng.uniform(0.01, 0.4) * rng.uniform(-1, 1, 600)
        found = only(loss)
        assert found.low < found.loss < found.high
        assert (found.verdict is Verdict.PASS) == (found.high < 0.05)
        assert (found.verdict is Verdict.FAIL) == (found.low > 0 and found.high > 0.05)


def test_one_scenario_pays_for_itself_alone_and_m_scenarios_for_m():
    zeros = pairs(np.zeros(600))
    for m in (1, 2, 3, 7):
        found = judge({f"s{k}": zeros for k in range(m)}, RULES)
        assert {d.level for d in found.values()} == {0.01 / m}
        expected = trials_without_change(0.05, ceiling=0.95, level=0.01 / m)
        assert {d.trials for d in found.values()} == {expected}


def test_a_decided_scenario_frees_nothing_since_its_other_hypothesis_may_be_true():
    # "same" passes; that it loses nothing is true, and had its chance to be rejected by mistake.
    same, worse = pairs(np.zeros(600)), pairs(noise(0.2, 0.02))
    late = pairs(noise(0.0, 0.2, seed=3))
    found = judge({"same": same, "worse": worse, "late": late}, RULES)
    assert found["worse"].trials < found["same"].trials < found["late"].trials
    assert {d.level for d in found.values()} == {0.01 / 3}


def test_holm_by_hand():
    # A loss of .2 under a margin of .5: both of "between"'s hypotheses are false and known to be
    # once both are rejected at .01 / 3, which leaves .01 / 2 to the others from that trial on.
    rules = Rules(margin=0.5)
    lies_between = np.full(600, 0.2)
    proof = evidence(lies_between, lies_between - 0.5, value_range=1.0, ceiling=0.5)
    from_trial = 1 + int(np.argmax(np.maximum(proof.fail, proof.margin) <= 0.01 / 3))
    assert from_trial < 90
    scenes = {name: pairs(np.zeros(600)) for name in "ab"} | {"between": pairs(lies_between)}
    found = judge(scenes, rules)
    # log(.01 / 2) / log(.95) = 103.3 for rare disasters.
    assert {name: d.trials for name, d in found.items()} == {"a": 104, "b": 104, "between": 104}
    assert found["between"].worse_within_margin
    assert found["a"].level == pytest.approx(0.01 / 2)
    # Not before it is known: a loss proven at once needs .01 / 3.
    quick = judge({"worse": pairs(np.full(600, 0.9)), **scenes}, rules)["worse"]
    assert quick.trials < from_trial
    assert quick.level == pytest.approx(0.01 / 4)


def test_what_is_told_after_each_trial_is_what_is_told_at_the_end():
    rules = Rules(margin=0.3)
    scenes = {
        f"s{k}": pairs(noise(mean, 0.2, seed=k, n=300).clip(-1, 1))
        for k, mean in enumerate((0.1, 0.12, 0.0, 0.4, 0.15))
    }
    whole = judge(scenes, rules)
    assert len({d.level for d in whole.values()}) > 1
    seen = {}
    for n in range(1, 301):
        so_far = {
            name: Pairs(
                baseline=p.baseline[: min(n, seen.get(name, n))],
                candidate=p.candidate[: min(n, seen.get(name, n))],
                value_range=1.0,
            )
            for name, p in scenes.items()
        }
        for name, d in judge(so_far, rules).items() if n % 23 == 0 or n == 300 else ():
            if d.verdict is not Verdict.UNDECIDED:
                seen[name] = d.trials
                assert d == whole[name]


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
