"""Settings that every test shares; helpers live beside the tests that use them."""

import json
import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("everyday", deadline=None, max_examples=50, derandomize=True)
settings.register_profile("long", deadline=None, max_examples=1000)
settings.load_profile("everyday")


@pytest.fixture(scope="module", params=["reference", "compiled"])
def assignment_kernel(request):
    """Runs a module's tests once over what is compiled and once over its plain twins."""
    from pmbm import compiled

    chosen = compiled.native
    if request.param == "compiled":
        compiled.native = pytest.importorskip("pmbm._native", reason="installed without a compiler")
    else:
        compiled.native = None
    yield request.param
    compiled.native = chosen


def pytest_addoption(parser):
    parser.addoption(
        "--verification", metavar="FILE", help="Write the rows of the `verified` fixture as JSON."
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
        request.node.user_properties.append(("verified", row))
        print(f"{id}: {what}: {figure} (bound {bound}): {verdict}")

    return add


@pytest.fixture
def drawn(request, tmp_path):
    """`drawn(id, figure)` keeps a figure as SVG: beside the record of `--verification FILE`, as
    FILE_ID.svg without its suffix, and else nowhere that lasts."""

    def keep(id, figure):
        from reports.drawing import save

        file = Path(request.config.getoption("--verification") or tmp_path / "verification.json")
        path = file.with_name(f"{file.stem}_{id}.svg")
        path.parent.mkdir(parents=True, exist_ok=True)
        save(figure, path)
        return path

    return keep


class _Verification:
    """Gathers the rows, from worker processes too, and writes them in order of their ids."""

    def __init__(self, file):
        self.file = Path(file)
        self.rows = []

    def pytest_runtest_logreport(self, report):
        if report.when == "teardown":
            self.rows += [row for name, row in report.user_properties if name == "verified"]

    def pytest_sessionfinish(self, session):
        from pmbm.provenance import provenance

        self.rows.sort(key=lambda row: (row["id"], row["what"]))
        record = {"provenance": provenance(), "rows": self.rows}
        self.file.parent.mkdir(parents=True, exist_ok=True)
        self.file.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def pytest_configure(config):
    if hasattr(config, "cache"):
        # Simulated scenes are kept between runs, away from the user's own.
        os.environ.setdefault("PMBM_CACHE", str(config.cache.mkdir("scenes")))
    file = config.getoption("--verification")
    if file and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Verification(file))
