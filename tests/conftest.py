"""Settings that every test shares; helpers live beside the tests that use them."""

import json
import os
from pathlib import Path

import pytest
from hypothesis import settings

from pmbm.durable import replace_text
from pmbm.provenance import provenance

settings.register_profile("everyday", deadline=None, max_examples=50, derandomize=True)
settings.register_profile("long", deadline=None, max_examples=1000)
settings.load_profile("everyday")


@pytest.fixture(scope="module", params=["reference", "compiled"])
def assignment_kernel(request):
    """Runs a module's tests once over what is compiled and once over its plain twins."""
    from pmbm import kernels

    chosen = kernels.native
    if request.param == "compiled":
        kernels.native = pytest.importorskip("pmbm._native", reason="installed without a compiler")
    else:
        kernels.native = None
    yield request.param
    kernels.native = chosen


def pytest_addoption(parser):
    parser.addoption(
        "--verification", metavar="FILE", help="Write the rows of the `verified` fixture as JSON."
    )
    parser.addoption(
        "--verification-part",
        action="store_true",
        help="This run is a part of the suite: keep the rows in FILE of tests that did not run.",
    )


@pytest.fixture
def verified(request):
    """`verified(id, what, figure, bound, verdict)` adds a row to the record of `make verify`.

    verdict : "pass", "fail", or "report" for what is measured but not promised; or a bool.
    """

    def add(id, what, figure, bound=None, verdict="report"):
        if isinstance(verdict, bool):
            verdict = "pass" if verdict else "fail"
        row = {"id": id, "what": what, "figure": figure, "bound": bound, "verdict": verdict}
        row["test"] = request.node.nodeid
        request.node.user_properties.append(("verified", row))
        print(f"{id}: {what}: {figure} (bound {bound}): {verdict}")

    return add


@pytest.fixture
def drawn(request, tmp_path):
    """`drawn(id, figure)` keeps a figure as SVG: beside the record of `--verification FILE`, as
    FILE_ID.svg without its suffix, and else nowhere that lasts."""

    def keep(id, figure):
        from pmbm.reports.drawing import save

        file = Path(request.config.getoption("--verification") or tmp_path / "verification.json")
        path = file.with_name(f"{file.stem}_{id}.svg")
        path.parent.mkdir(parents=True, exist_ok=True)
        save(figure, path)
        return path

    return keep


class _Verification:
    """Gathers the rows, from worker processes too, and writes them in order of their ids.

    earlier : rows of earlier parts of the suite, of which those of a test that runs now go, and
        those of a test that is no longer there.
    """

    def __init__(self, file, earlier=()):
        self.file = file
        self.earlier = list(earlier)
        self.rows = []
        self.run = set()

    def pytest_runtest_logreport(self, report):
        # A test that is skipped measures nothing: what it measured elsewhere stands.
        if report.failed or (report.when == "call" and not report.skipped):
            self.run.add(report.nodeid)
        if report.when == "teardown":
            self.rows += [row for name, row in report.user_properties if name == "verified"]

    def pytest_sessionfinish(self, session):
        there = [row for row in self.earlier if _stands(row["test"], session.config.rootpath)]
        kept = [row for row in there if row["test"] not in self.run]
        rows = sorted(kept + self.rows, key=lambda row: (row["id"], row["what"]))
        record = {"provenance": provenance(), "rows": rows}
        self.file.parent.mkdir(parents=True, exist_ok=True)
        replace_text(self.file, json.dumps(record, indent=1) + "\n")


def _stands(nodeid, root):
    file, _, function = nodeid.partition("::")
    definition = f"def {function.partition('[')[0]}("
    return (root / file).is_file() and definition in (root / file).read_text(encoding="utf-8")


def _rows_of_earlier_parts(file):
    """Raises UsageError where other versions measured them: one record speaks of one setting."""
    if not file.is_file():
        return []
    record = json.loads(file.read_text(encoding="utf-8"))
    now, then = provenance(), record["provenance"]
    # A record from before a package was listed says nothing of it.
    now["versions"] = {name: now["versions"].get(name) for name in then["versions"]}
    if then != now:
        raise pytest.UsageError(
            f"{file} was measured with other versions, {record['provenance']['versions']}: "
            "run the whole suite, without --verification-part"
        )
    return record["rows"]


def pytest_configure(config):
    if hasattr(config, "cache"):
        # Simulated scenes are kept between runs, away from the user's own.
        os.environ.setdefault("PMBM_CACHE", str(config.cache.mkdir("scenes")))
    file = config.getoption("--verification")
    if file and not hasattr(config, "workerinput"):
        file = Path(file)
        part = config.getoption("--verification-part")
        config.pluginmanager.register(
            _Verification(file, _rows_of_earlier_parts(file) if part else ())
        )
