"""Versions that move a number: pinned, recorded, or made to be without effect."""

import ast
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from test_layers import dotted, imports, modules

from pmbm.provenance import made_with, provenance
from pmbm.tune import Choice, Range, tune

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
OF_TRIALS = ("pmbm.filter", "pmbm.assignment", "pmbm.baselines", "pmbm.metrics", "pmbm.geometry")
OF_TRIALS += ("pmbm.tracking", "pmbm.score", "pmbm.seeding", "pmbm.datasets", "pmbm.sim")
"""What a trial's numbers come from."""
WITHOUT_NUMBERS = {"pydantic", "pydantic_core", "hypothesis", "pyarrow", "google", "pandas"}
"""Third parties that only check, read or show values there."""
DISTRIBUTION = {"highway_env": "highway-env"}


def third_parties(path):
    for _, name in imports(path):
        top = name.split(".")[0]
        if top not in sys.stdlib_module_names and top != "pmbm":
            yield top


def test_the_provenance_names_every_package_that_computes_a_trial():
    used = set()
    for path in modules():
        if dotted(path).startswith(OF_TRIALS):
            used |= set(third_parties(path))
    named = {DISTRIBUTION.get(name, name) for name in used - WITHOUT_NUMBERS}
    assert {"numpy", "scipy", "shapely", "highway-env", "gymnasium", "filterpy"} <= named
    assert named <= set(provenance()["versions"])


def test_a_search_names_the_version_of_what_draws():
    said = made_with("optuna")
    assert f"optuna {metadata.version('optuna')}" in said
    assert all(f"{name} {version}" in said for name, version in provenance()["versions"].items())


@pytest.mark.parametrize("name", ["highway-env", "optuna", "ruff", "mypy", "pandas-stubs"])
def test_what_draws_or_judges_has_one_version(name):
    """Other versions leave other vehicles, draw other parameters, complain of other lines."""
    extras = PROJECT["optional-dependencies"]
    wanted = [*PROJECT["dependencies"], *extras["tune"], *extras["lint"]]
    (pinned,) = (line for line in wanted if line.startswith(name))
    assert pinned == f"{name}=={metadata.version(name)}"


def test_of_filterpy_only_the_plain_filter_is_used():
    """`predict(F=, Q=)` and `update(z)` with H and R that are set; version 2 changed
    `kinematic_kf` and the unscented filter."""
    taken = set()
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("filterpy"):
                taken |= {alias.name for alias in node.names}
            if isinstance(node, ast.Import):
                assert not [a.name for a in node.names if a.name.startswith("filterpy")], path
    assert taken == {"KalmanFilter"}


def test_a_search_draws_what_the_pinned_version_draws():
    """Attempts beyond the random ones at the start, as Optuna 5.0.0 draws them."""
    space = {
        "a": Range(0, 1),
        "b": Range(0.01, 10, log=True),
        "n": Range(1, 8, whole=True),
        "c": Choice(("x", "y")),
    }

    def objective(p):
        if not p:
            return 1.0
        return (p["a"] - 0.3) ** 2 + abs(p["b"] - 1) + 0.1 * p["n"] + (p["c"] == "x")

    found = tune(objective, space, trials=16, seed=3)
    assert dict(found.parameters) == {"a": 0.441, "b": 1.019, "n": 4, "c": "y"}
    first = {"a": 0.551, "b": 1.332, "n": 3, "c": "y"}
    assert dict(found.attempts[1].parameters) == first
