"""Would the tests notice?  Plants mistakes in a copy of the project, one at a time, and runs the
tests that should catch them.

    python tests/statistical/mutations.py            all of them: a table, exit code 1 if one lives
    python tests/statistical/mutations.py NAME ...   only these

The test that noticed a mistake last is asked first; where it does not, all those that are there
for it.  The plain twins of what is compiled are tested, since it is Python that is planted in.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plants import PLANTS, Plant

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("pmbm", "sim", "reports", "scenarios", "tests")
CPU_LIMIT = 120
"""s of CPU, whatever else the machine does; whoever needs more hangs."""


@dataclass(frozen=True)
class Outcome:
    """How the tests took a plant.  by : the test that failed first, or nothing."""

    plant: Plant
    by: str
    seconds: float

    @property
    def killed(self) -> bool:
        return bool(self.by)


# Imports take longer than most tests: what is not ours is imported once, and every run is a fork
# that imports ours afresh.
_SERVER = """
import json, os, resource, sys
sys.dont_write_bytecode = True
# An editable install answers imports before any path does; the copy has to be found instead.
sys.meta_path[:] = [f for f in sys.meta_path if "_editable_" not in type(f).__module__]
sys.path.insert(0, os.getcwd())
import filterpy.common, filterpy.kalman, hypothesis, numpy, pytest
import scipy.optimize, scipy.sparse.csgraph, scipy.spatial, scipy.stats, shapely
for line in sys.stdin:
    arguments, limit, log = json.loads(line)
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        written = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(written, 1)
        os.dup2(written, 2)
        import pmbm
        assert pmbm.__file__.startswith(os.getcwd()), pmbm.__file__
        code = int(pytest.main(arguments))
        sys.stdout.flush()
        os._exit(code)
    print(json.dumps(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])), flush=True)
"""


class Bench:
    """A copy of the project to plant mistakes in, and a process that runs its tests."""

    def __init__(self, copy: Path, server: subprocess.Popen[str]) -> None:
        self.copy, self.server = copy, server

    def run(self, plant: Plant) -> Outcome:
        """Plant the mistake, ask the tests until one fails, and pull it out again.

        Raises LookupError where the plant does not apply, and RuntimeError where the tests could
        not run: a module that does not import proves nothing.
        """
        start = time.monotonic()
        path = self.copy / plant.file
        sound = path.read_text(encoding="utf-8")
        path.write_text(plant.planted(sound), encoding="utf-8")
        try:
            by = self._first_failure(plant, (plant.by,)) if plant.by else ""
            by = by or self._first_failure(plant, plant.tests)
        finally:
            path.write_text(sound, encoding="utf-8")
        return Outcome(plant, by, time.monotonic() - start)

    def sound(self, tests: tuple[str, ...]) -> str:
        """The control: the test that fails where nothing is planted, or nothing."""
        control = Plant("nothing planted", "pmbm/errors.py", "", "", tests=tests)
        return self._first_failure(control, tests)

    def _first_failure(self, plant: Plant, tests: tuple[str, ...]) -> str:
        log = self.copy / "tests.log"
        arguments = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *tests]
        assert self.server.stdin is not None
        assert self.server.stdout is not None
        self.server.stdin.write(json.dumps([arguments, CPU_LIMIT, str(log)]) + "\n")
        self.server.stdin.flush()
        code = int(self.server.stdout.readline() or -1)
        said = log.read_text(encoding="utf-8", errors="replace")
        failed = [line for line in said.splitlines() if line.startswith("FAILED ")]
        if code == 1 and failed:
            return failed[0].split(" - ")[0].removeprefix("FAILED ")
        if code < -1:
            return f"the limit of {CPU_LIMIT} s of CPU"
        # A test that was renamed since is no reason not to ask the others.
        if code == 0 or (tests == (plant.by,) and code == 4):
            return ""
        raise RuntimeError(f"{plant.name}: the tests did not run\n{said}")


@contextmanager
def bench(root: Path = ROOT) -> Iterator[Bench]:
    """A bench that is cleared away afterwards."""
    with tempfile.TemporaryDirectory(prefix="mutation-") as name:
        copy = Path(name).resolve()
        no_caches: Any = shutil.ignore_patterns("__pycache__")
        for folder in FOLDERS:
            shutil.copytree(root / folder, copy / folder, ignore=no_caches)
        shutil.copy(root / "pyproject.toml", copy)
        environment = {**os.environ, "PMBM_NO_NATIVE": "1", "OMP_NUM_THREADS": "1"}
        environment["OPENBLAS_NUM_THREADS"] = "1"
        # Options and workers of a test run that this may be part of are not for the tests here.
        environment = {k: v for k, v in environment.items() if not k.startswith("PYTEST_")}
        server = subprocess.Popen(
            [sys.executable, "-c", _SERVER],
            cwd=copy,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            yield Bench(copy, server)
        finally:
            server.stdin.close()
            server.wait()
            server.stdout.close()


def main(names: list[str]) -> int:
    unknown = set(names) - {plant.name for plant in PLANTS}
    if unknown:
        print(f"no such plant: {', '.join(sorted(unknown))}")
        return 2
    chosen = [plant for plant in PLANTS if not names or plant.name in names]
    alive = 0
    with bench() as made:
        for tests in {plant.tests: None for plant in chosen}:
            if failing := made.sound(tests):
                print(f"the tests fail as they stand: {failing}")
                return 1
        for plant in chosen:
            outcome = made.run(plant)
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
