"""Each broken tracker fails the tests about its fault, and no other."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FAULTS = {
    "NeverBirths": {"test_births_are_found_soon"},
    "NeverDies": {"test_deaths_leave_no_ghosts"},
    "ForgetsWhenHidden": {"test_hidden_objects_are_remembered"},
    "SwapsAtCrossings": {"test_crossing_objects_keep_their_ids"},
    "IgnoresTheScore": {"test_clutter_is_not_believed"},
}


def failures_of(tracker, tmp_path):
    """Names of the suite's tests that fail for a tracker, and of those that pass."""
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", str(HERE / "test_tracking.py"), "-q", "-rA"),
            *("--pmbm-tracker", f"trackers:{tracker}", "-p", "no:cacheprovider"),
            *("--pmbm-report-dir", str(tmp_path), "-o", "filterwarnings=default"),
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=HERE,
    )
    assert done.returncode in (0, 1), done.stdout + done.stderr
    found = re.findall(r"^(PASSED|FAILED|ERROR) \S*::(\w+)", done.stdout, re.MULTILINE)
    assert len(found) == 6, done.stdout
    return {name for verdict, name in found if verdict != "PASSED"}


@pytest.mark.slow
@pytest.mark.parametrize("tracker", FAULTS)
def test_a_broken_tracker_fails_the_tests_about_its_fault(tracker, tmp_path):
    assert failures_of(tracker, tmp_path) == FAULTS[tracker]
    assert len(list(tmp_path.glob("*.html"))) == 1
