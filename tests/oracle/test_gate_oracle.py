"""The gate's wealth and bounds against those of the package confseq, run once: gate_answers.py."""

import json
from pathlib import Path

import numpy as np
import pytest

from pmbm.regression.sequence import log_wealth, upper_bound

ANSWERS = json.loads((Path(__file__).with_name("gate") / "confseq.json").read_text("utf-8"))
CASES = ANSWERS["cases"]


@pytest.mark.parametrize("name", CASES)
def test_wealth_is_that_of_confseq(name):
    loss = np.array(CASES[name]["loss"])
    for mean, theirs in CASES[name]["above"].items():
        ours = np.exp(log_wealth(loss, 1.0, float(mean)))
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    for mean, theirs in CASES[name]["below"].items():
        ours = np.exp(log_wealth(-loss, 1.0, -float(mean)))
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_bounds_are_those_of_confseq_to_its_grid(name):
    loss, step = np.array(CASES[name]["loss"]), ANSWERS["grid"]
    for n in (1, 2, 7, 30, 119, 120):
        # confseq reports the outermost mean of its grid that is not refuted, one step wider.
        high = upper_bound(loss[:n], 1.0, ANSWERS["level"])
        low = -upper_bound(-loss[:n], 1.0, ANSWERS["level"])
        assert CASES[name]["high"][n - 1] == pytest.approx(high, abs=1.01 * step)
        assert CASES[name]["low"][n - 1] == pytest.approx(low, abs=1.01 * step)
