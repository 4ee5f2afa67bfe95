"""The compiled kernel against the plain one, where enumeration cannot reach; and which one runs."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from pmbm.assignment import kernel
from pmbm.kernels import TWINS, checked, fingerprint

INF = np.inf


@pytest.fixture
def native():
    return pytest.importorskip("pmbm._native", reason="installed without a compiler")


def dense(random, rows, width):
    return random.normal(scale=5, size=(rows, width))


def gated(random, rows, others):
    """Rows and others on a line; near pairs are allowed, and each row has a column of its own."""
    here, there = random.uniform(0, 3 * rows, rows), random.uniform(0, 3 * rows, others)
    distance = np.abs(here[:, None] - there)
    cost = np.full((rows, others + rows), INF)
    cost[:, :others] = np.where(distance < 5, distance**2 - 10, INF)
    cost[np.arange(rows), others + np.arange(rows)] = random.normal(size=rows)
    return cost


PROBLEMS = {
    "dense square": lambda random: dense(random, 15, 15),
    "dense wide": lambda random: dense(random, 20, 40),
    "one row": lambda random: dense(random, 1, 300),
    "gated": lambda random: gated(random, 40, 40),
    "gated, few others": lambda random: gated(random, 30, 4),
    "scales far apart": lambda random: dense(random, 12, 20) * 10.0 ** random.integers(-3, 4, 20),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_same_solutions_and_same_bits(native, name):
    costs = [PROBLEMS[name](np.random.default_rng([7, seed])) for seed in range(4)]
    rows, widths = np.array([cost.shape for cost in costs], dtype=np.int32).T.copy()
    problem = (
        np.concatenate([cost.ravel() for cost in costs]),
        rows,
        widths,
        np.array([60, 1, 150, 17]),
    )
    for fast, plain in zip(native.k_best(*problem), TWINS["k_best"](*problem), strict=True):
        assert fast.dtype == plain.dtype
        assert fast.tolist() == plain.tolist()


@pytest.mark.parametrize(
    ("setting", "expected"), [("", None), ("0", None), ("1", "reference"), ("true", "reference")]
)
def test_the_environment_chooses(setting, expected):
    out = subprocess.run(
        [sys.executable, "-c", "from pmbm.cli import main; main(['--version'])"],
        env={**os.environ, "PMBM_NO_NATIVE": setting},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert (expected or kernel()) in out


def test_what_was_compiled_from_other_sources_is_refused(native, monkeypatch, tmp_path):
    """Also what is from before there was a fingerprint; where no sources are, nothing is known."""
    if (own := fingerprint()) is not None:
        assert native.fingerprint == own
    (tmp_path / "module.cpp").write_text("int other;")
    monkeypatch.setattr("pmbm.kernels._SOURCES", tmp_path)
    old = SimpleNamespace(__file__="/lib/_native.so")
    for module in (native, old):
        with pytest.raises(ImportError, match="pip install -e") as error:
            checked(module)
        assert str(tmp_path) in str(error.value)
        assert module.__file__ in str(error.value)
    (tmp_path / "module.cpp").unlink()
    assert checked(native) is native
