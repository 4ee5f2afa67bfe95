"""The filter's own tests once more without anything compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_plain_filter_passes_the_same_tests():
    tests = [*sorted((ROOT / "tests" / "unit").glob("test_filter_*.py"))]
    tests += [ROOT / "tests" / "oracle" / "test_filter_oracle.py"]
    assert len(tests) > 4
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *tests],
        cwd=ROOT,
        env={**os.environ, "PMBM_NO_NATIVE": "1"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout[-4000:]
    assert " passed" in run.stdout
