"""The record of `--verification`: of one run, or put together from parts of the suite."""

import json
import shutil
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

MEASURES = """
import pytest

@pytest.mark.parametrize("n", [1, 2])
def test_first(verified, n):
    verified("first", f"number {n}", FIGURE)

def test_second(verified):
    MISHAP
    verified("second", "of its own", FIGURE, FIGURE, True)
"""


@pytest.fixture
def suite(pytester):
    shutil.copy(Path(__file__).parents[1] / "conftest.py", pytester.path)

    def run(*arguments, mishap="pass", measures=MEASURES, figure=1):
        text = measures.replace("FIGURE", str(figure)).replace("MISHAP", mishap)
        pytester.makepyfile(test_measures=text)
        result = pytester.runpytest("--verification", "record.json", *arguments)
        record = json.loads((pytester.path / "record.json").read_text())
        rows = {row["what"]: row["figure"] for row in record["rows"]}
        assert len(rows) == len(record["rows"])
        return result, rows

    return run


BOTH = {"number 1": 1, "number 2": 1, "of its own": 1}


@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_part_replaces_what_it_measured_and_keeps_the_rest(suite, workers):
    assert suite("-n", workers)[1] == BOTH
    part = ("-n", workers, "--verification-part")
    _, rows = suite(*part, "test_measures.py::test_first[2]", figure=7)
    assert rows == BOTH | {"number 2": 7}
    _, rows = suite(*part, "-k", "second", figure=8)
    assert rows == {"number 1": 1, "number 2": 7, "of its own": 8}


def test_a_run_of_its_own_keeps_nothing(suite):
    suite()
    assert suite("-k", "second", figure=2)[1] == {"of its own": 2}


@pytest.mark.parametrize(
    ("mishap", "left"),
    [("assert False", {"number 1": 1, "number 2": 1}), ("pytest.skip('no data')", BOTH)],
    ids=["failed", "skipped"],
)
def test_a_test_that_fails_early_leaves_no_row_and_one_that_is_skipped_its_last(
    suite, mishap, left
):
    suite()
    assert suite("--verification-part", "-k", "second", mishap=mishap, figure=2)[1] == left


def test_rows_of_tests_that_are_gone_go(suite):
    suite()
    renamed = MEASURES.replace("test_second", "test_other")
    _, rows = suite("--verification-part", "-k", "first", measures=renamed)
    assert rows == {"number 1": 1, "number 2": 1}


def test_other_versions_are_not_mixed(suite, pytester):
    suite()
    path = pytester.path / "record.json"
    record = json.loads(path.read_text())
    record["provenance"]["versions"]["numpy"] = "0.1"
    path.write_text(json.dumps(record))
    result, rows = suite("--verification-part", figure=2)
    assert rows == BOTH
    result.stderr.fnmatch_lines(["*other versions*0.1*run the whole suite*"])
