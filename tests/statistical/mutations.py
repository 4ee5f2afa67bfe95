"""Would the tests notice?  Plants mistakes in a copy of the project, one at a time, and runs the
tests that should catch them.

    python tests/statistical/mutations.py            all of them: a table, exit code 1 if one lives
    python tests/statistical/mutations.py NAME ...   only these

A plant is a name, a file, a passage that stands in it exactly once, and what replaces it.  Those
from "likelihood at the posterior" to "ids used again" have all been found in public code.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILTER_TESTS = (
    "tests/unit/test_filter_exact.py",
    "tests/unit/test_filter_models.py",
    "tests/unit/test_filter_presets.py",
    "tests/unit/test_filter_tracker.py",
    "tests/oracle/test_filter_oracle.py::test_a_tiny_problem_solved_exactly",
)
TRAFFIC_TESTS = ("tests/unit/test_traffic.py",)
TIME_LIMIT = 600


@dataclass(frozen=True)
class Plant:
    """A mistake: in `file`, `old` becomes `new`; one of `tests` should fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...] = FILTER_TESTS


def _filter(name: str, file: str, old: str, new: str) -> Plant:
    return Plant(name, f"pmbm/filter/{file}.py", old, new)


PLANTS = [
    _filter(
        "likelihood at the posterior",
        "association",
        "    possible = log_weight > -np.inf\n",
        "    log_weight = log_weight + 0.25 * (y * y).sum(axis=1)\n"
        "    possible = log_weight > -np.inf\n",
    ),
    _filter(
        "undetected times P_D",
        "update",
        "ppp.log_weight + np.log1p(-detection)",
        "ppp.log_weight + np.log(detection)",
    ),
    _filter(
        "no clutter outside the birth gate",
        "association",
        "np.maximum(np.logaddexp(log_first, log_clutter), LOG_TINY)",
        "np.where(log_first > -np.inf, np.logaddexp(log_first, log_clutter), LOG_TINY)",
    ),
    _filter(
        "misses of the parent dropped",
        "association",
        "        + summed(log_missed[parents.member], row_of_entry, len(parents))\n",
        "",
    ),
    _filter(
        "a lone measurement is no clutter",
        "association",
        "    best = k_best_choices(\n",
        "    gain = gain + 50.0 * (np.bincount(known.measurement)[known.measurement] == 1)\n"
        "    best = k_best_choices(\n",
    ),
    _filter(
        "recycled with the hypotheses' weight alone",
        "reduction",
        "probability[rows] * local.existence[rows]",
        "probability[rows]",
    ),
    _filter(
        "recycled with r alone",
        "reduction",
        "probability[rows] * local.existence[rows]",
        "local.existence[rows]",
    ),
    _filter(
        "a pruned Bernoulli takes its hypotheses along",
        "reduction",
        "    before = starts(staying.astype(np.intp))\n",
        "    hit = np.bincount(table.row_of_member(), ~staying, minlength=len(table)) > 0\n"
        "    if not hit.all():\n"
        "        table = _keep(table, ~hit)\n"
        "        staying = np.ones(len(table.member), bool)\n"
        "    before = starts(staying.astype(np.intp))\n",
    ),
    _filter(
        "no largest of an empty pool",
        "association",
        "        if not len(pairs.row):\n            return np.full(len(z), -np.inf)\n",
        "",
    ),
    _filter(
        "existence overwritten before its weight",
        "models",
        "        left = 1 - r * P_D\n",
        "        r = r * (1 - P_D) / np.maximum(1 - r * P_D, 1e-300)\n        left = 1 - r * P_D\n",
    ),
    _filter(
        "time stops in empty frames",
        "tracker",
        "            dt = self._elapsed(detections.time)\n",
        "            dt = self._elapsed(detections.time) if len(detections) else 0.0\n",
    ),
    _filter(
        "ids used again",
        "update",
        "density.detections_seen + np.arange(len(scan))",
        "len(density.track_id) + np.arange(len(scan))",
    ),
    _filter(
        "Q in the order x, vx, y, vy",
        "models",
        "    Q[0, 2] = Q[2, 0] = Q[1, 3] = Q[3, 1] = dt**2 / 2\n",
        "    Q = np.diag([dt**3 / 3, dt, dt**3 / 3, dt])\n"
        "    Q[0, 1] = Q[1, 0] = Q[2, 3] = Q[3, 2] = dt**2 / 2\n",
    ),
    _filter(
        "Q of the discrete form",
        "models",
        "    Q = np.diag([dt**3 / 3, dt**3 / 3, dt, dt])\n"
        "    Q[0, 2] = Q[2, 0] = Q[1, 3] = Q[3, 1] = dt**2 / 2\n",
        "    Q = np.diag([dt**4 / 4, dt**4 / 4, dt**2, dt**2])\n"
        "    Q[0, 2] = Q[2, 0] = Q[1, 3] = Q[3, 1] = dt**3 / 2\n",
    ),
    _filter(
        "sign of the log determinant",
        "gaussian",
        "-_LOG_2PI - np.log(self.l11) - np.log(self.l22)",
        "-_LOG_2PI + np.log(self.l11) + np.log(self.l22)",
    ),
    _filter(
        "P_S whatever the interval",
        "models",
        "    return survival ** (dt / interval)",
        "    return survival",
    ),
    _filter(
        "births whatever the interval",
        "models",
        "rate * (dt if mu == 0 else -math.expm1(-mu * dt) / mu)",
        "rate * interval",
    ),
    _filter(
        "merged hypotheses lose weight",
        "clusters",
        "    log_weight[kept] = top + np.log(np.add.reduceat(weight, first))\n",
        "    log_weight[kept] = top\n",
    ),
    _filter(
        "equal rows by a hash that knows no zero",
        "clusters",
        "(table.member + 1).astype(np.uint64)",
        "table.member.astype(np.uint64)",
    ),
    _filter(
        "weights not shared out after pruning",
        "reduction",
        "        normalised(table.log_weight[rows], cluster),\n",
        "        table.log_weight[rows],\n",
    ),
    _filter(
        "children out of proportion",
        "association",
        "np.ceil(allowed * np.exp(parents.log_weight) - 1e-9)",
        "np.ceil(allowed * np.ones(len(parents)))",
    ),
    _filter(
        "no survival for undetected objects",
        "prediction",
        "Mixture(ppp.log_weight + log_survival, ",
        "Mixture(ppp.log_weight, ",
    ),
    _filter(
        "spread of the fused means forgotten",
        "gaussian",
        "(cov + spread[:, :, None] * spread[:, None, :])",
        "cov",
    ),
    _filter(
        "a split keeps only the first cluster's weights",
        "clusters",
        "np.concatenate([table.log_weight[kept], np.zeros(len(alone))])",
        "np.concatenate([np.zeros(len(kept)), np.zeros(len(alone))])",
    ),
    _filter(
        "a product of clusters forgets a factor's weight",
        "clusters",
        "        summed(table.log_weight[source], joint, rows),\n",
        "        summed(\n"
        "            table.log_weight[source] * (np.diff(joint, prepend=-1) > 0), joint, rows\n"
        "        ),\n",
    ),
    _filter(
        "a shared measurement joins no clusters",
        "clusters",
        "    if len(ties):\n",
        "    if False:\n",
    ),
    _filter(
        "dependent groups taken apart",
        "clusters",
        "coo_array(between > tolerance)",
        "coo_array(between > 10.0)",
    ),
    _filter(
        "detected with the existence it had",
        "update",
        "        np.ones(len(pairs)),\n",
        "        before.existence,\n",
    ),
    _filter(
        "a gate of the wrong root",
        "gating",
        "np.nonzero(y0 * y0 + y1 * y1 < threshold)",
        "np.nonzero(y0 * y0 + y1 * y1 < threshold**0.5)",
    ),
    _filter(
        "crowded gates cut short",
        "gating",
        "    within[crowded] = False\n",
        "    crowded[:] = False\n",
    ),
    _filter(
        "position noise in place of its square",
        "tracker",
        "R=config.measurement_sd**2 * np.eye(2)",
        "R=config.measurement_sd * np.eye(2)",
    ),
    _filter(
        "reported from the best hypothesis alone",
        "estimation",
        "    existence = summed(mass, local.track, tracks)\n",
        "    existence = np.zeros(tracks)\n    np.maximum.at(existence, local.track, mass)\n",
    ),
    _filter(
        "cardinality without the rest's absence",
        "estimation",
        "        left = np.concatenate([np.cumsum(np.log1p(-falling[::-1]))[::-1], [0.0]])\n",
        "        left = np.zeros(len(falling) + 1)\n",
    ),
    _filter(
        "a track out of view is still reported",
        "tracker",
        "view.share_inside(local.mean, local.cov) > 0.5",
        "view.share_inside(local.mean, local.cov) > -1",
    ),
    _filter(
        "scores speak the wrong way round",
        "tracker",
        "np.column_stack([2 * s, 2 * (1 - s)])",
        "np.column_stack([2 * (1 - s), 2 * s])",
    ),
    _filter(
        "state changed before time is checked",
        "tracker",
        "            dt = self._elapsed(detections.time)\n",
        "            before, self._time = self._time, detections.time\n"
        "            if detections.time < before:\n"
        "                raise InputError('detections out of order', field='time')\n"
        "            dt = detections.time - before\n",
    ),
    Plant(
        "y not mirrored",
        "sim/traffic.py",
        "path.rows.append((x, -y, ",
        "path.rows.append((x, y, ",
        TRAFFIC_TESTS,
    ),
]


@dataclass(frozen=True)
class Outcome:
    plant: Plant
    killed: bool
    seconds: float
    by: str


def run(plant: Plant, root: Path = ROOT) -> Outcome:
    """Copy what the tests need, plant the mistake, run the tests until one fails."""
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutation-") as name:
        copy = Path(name)
        for folder in ("pmbm", "sim", "reports", "scenarios", "tests"):
            shutil.copytree(
                root / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__")
            )
        shutil.copy(root / "pyproject.toml", copy)
        path = copy / plant.file
        text = path.read_text(encoding="utf-8")
        if text.count(plant.old) != 1:
            raise LookupError(f"{plant.name}: its passage stands {text.count(plant.old)} times")
        path.write_text(text.replace(plant.old, plant.new), encoding="utf-8")
        return _outcome(plant, copy, start)


CONTROL = Plant("nothing planted", "pmbm/filter/tracker.py", "import math\n", "import math\n")
"""Lives, or the tests' failing means nothing."""

_RUNNER = """
import sys
# An editable install answers imports before any path does; the copy has to be found instead.
sys.meta_path[:] = [f for f in sys.meta_path if "_editable_" not in type(f).__module__]
sys.path.insert(0, {copy!r})
import pmbm
assert pmbm.__file__.startswith({copy!r}), pmbm.__file__
import pytest
sys.exit(pytest.main({arguments!r}))
"""


def _outcome(plant: Plant, copy: Path, start: float) -> Outcome:
    import os

    arguments = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *plant.tests]
    code = _RUNNER.format(copy=str(copy), arguments=arguments)
    environment = {**os.environ, "PMBM_NO_NATIVE": "1", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=copy,
            env=environment,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Outcome(plant, plant is not CONTROL, time.monotonic() - start, "time limit")
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
    by = failed[0].split(" - ")[0].removeprefix("FAILED ") if failed else ""
    # A collection that broke, or a test run that never began, would prove nothing.
    if done.returncode != (1 if by else 0):
        raise RuntimeError(f"{plant.name}: the tests did not run\n{done.stdout}{done.stderr}")
    return Outcome(plant, done.returncode == 1, time.monotonic() - start, by)


def main(names: list[str]) -> int:
    chosen = [plant for plant in PLANTS if not names or plant.name in names]
    if run(CONTROL).killed:
        print("the tests fail as they stand")
        return 1
    alive = 0
    for plant in chosen:
        outcome = run(plant)
        alive += not outcome.killed
        print(
            f"{'killed' if outcome.killed else 'LIVES '} {outcome.seconds:5.1f} s  "
            f"{plant.name:50} {outcome.by}",
            flush=True,
        )
    print(f"{len(chosen) - alive} of {len(chosen)} killed")
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
