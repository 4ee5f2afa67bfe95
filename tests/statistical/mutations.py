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
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from plants import FILTER_PLANTS, Plant
from plants_elsewhere import OTHER_PLANTS

PLANTS = [*FILTER_PLANTS, *OTHER_PLANTS]
ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("pmbm", "sim", "reports", "scenarios", "tests")
CPU_LIMIT = 150
"""s of CPU, whatever else the machine does; what needs more hangs."""
OUT_OF_TIME = f"the limit of {CPU_LIMIT} s of CPU"


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
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
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
        not run, or the one that fails does so without the plant: neither proves anything.
        """
        start = time.monotonic()
        path = plant.place(self.copy)
        sound = path.read_text(encoding="utf-8")
        path.write_text(sound.replace(plant.old, plant.new), encoding="utf-8")
        try:
            by = self._first_failure((plant.by,)) if plant.by else ""
            by = by or self._first_failure(plant.tests)
        finally:
            path.write_text(sound, encoding="utf-8")
        if by not in ("", plant.by, OUT_OF_TIME):
            self.check_sound([by])
        return Outcome(plant, by, time.monotonic() - start)

    def check_sound(self, tests: Iterable[str]) -> None:
        """The control: raise RuntimeError where one of these tests fails with nothing planted."""
        failing = self._first_failure(tuple(dict.fromkeys(tests)))
        if failing:
            raise RuntimeError(f"a test fails as the code stands: {failing}")

    def _first_failure(self, tests: tuple[str, ...]) -> str:
        log = self.copy / "tests.log"
        arguments = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *tests]
        assert self.server.stdin is not None
        assert self.server.stdout is not None
        self.server.stdin.write(json.dumps([arguments, CPU_LIMIT, str(log)]) + "\n")
        self.server.stdin.flush()
        code = int(self.server.stdout.readline())
        said = log.read_text(encoding="utf-8", errors="replace")
        failed = [line for line in said.splitlines() if line.startswith("FAILED ")]
        if code == 1 and failed:
            return failed[0].split(" - ")[0].removeprefix("FAILED ")
        if code == -signal.SIGXCPU:
            return OUT_OF_TIME
        if code:
            raise RuntimeError(f"the tests did not run: {' '.join(tests)}\n{said}")
        return ""


@contextmanager
def bench(root: Path = ROOT) -> Iterator[Bench]:
    """A bench that is cleared away afterwards."""
    with tempfile.TemporaryDirectory(prefix="mutation-") as name:
        copy = Path(name).resolve()
        no_caches: Any = shutil.ignore_patterns("__pycache__")
        for folder in FOLDERS:
            shutil.copytree(root / folder, copy / folder, symlinks=True, ignore=no_caches)
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
        made.check_sound(plant.by for plant in chosen if plant.by)
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
