"""The wheel: with a compiler, without one, and what it carries."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
NO_COMPILER = {"CC": "/bin/false", "CXX": "/bin/false"}


def build(folder, **environment):
    """The names in the wheel that pip builds, and the wheel's own; or None where pip refuses."""
    source, wheels = folder / "source", folder / "wheels"
    unwanted = shutil.ignore_patterns("__pycache__", "*.html", "*.svg")
    for name in ("pmbm", "sim", "reports", "scenarios"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=unwanted)
    example = Path("tests/examples/my_tracker")
    shutil.copytree(ROOT / example, source / example, ignore=unwanted)
    for name in ("pyproject.toml", "CMakeLists.txt", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    ours = ("PMBM_NO_NATIVE", "PMBM_REQUIRE_NATIVE")
    inherited = {name: value for name, value in os.environ.items() if name not in ours}
    run = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--no-deps", "-w", wheels, source],
        env={**inherited, **environment},
        capture_output=True,
        text=True,
    )
    if run.returncode:
        if "No matching distribution" in run.stdout + run.stderr:
            pytest.skip("the build's own requirements cannot be fetched here")
        return None
    (wheel,) = wheels.glob("*.whl")
    return wheel.name, zipfile.ZipFile(wheel).namelist()


def has_kernel(names):
    return any(name.startswith("pmbm/_native.") for name in names)


def test_the_wheel_carries_the_kernel_and_the_scenarios(tmp_path):
    if shutil.which("c++") is None:
        pytest.skip("no C++ compiler on PATH")
    wheel, names = build(tmp_path, PMBM_REQUIRE_NATIVE="1")
    assert has_kernel(names)
    assert "none-any" not in wheel
    shipped = {Path(name).name for name in names if name.startswith("pmbm/sim/scenarios/")}
    assert shipped == {path.name for path in (ROOT / "scenarios").rglob("*") if path.is_file()}
    assert not [name for name in names if name.endswith((".cpp", ".hpp"))]
    # What `pmbm init` writes is there; what the repository shows and records is not.
    assert "pmbm/example/tests/test_nearest.py" in names
    assert not [name for name in names if name.endswith((".png", ".json", ".svg"))]


@pytest.mark.parametrize("environment", [NO_COMPILER, {"PMBM_NO_NATIVE": "1"}])
def test_without_a_compiler_the_wheel_is_pure_python(tmp_path, environment):
    wheel, names = build(tmp_path, **environment)
    assert wheel.endswith("-py3-none-any.whl")
    assert not has_kernel(names)
    assert "pmbm/assignment/reference.py" in names


def test_the_kernel_can_be_required(tmp_path):
    assert build(tmp_path, **NO_COMPILER, PMBM_REQUIRE_NATIVE="1") is None


def test_nothing_is_called_that_windows_does_not_have():
    """But by programs as trackers, which are refused there."""
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--platform", "win32", "--cache-dir", os.devnull],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    wrong = [line for line in checked.stdout.splitlines() if ": error: " in line]
    assert checked.returncode in (0, 1), checked.stdout + checked.stderr
    assert not [line for line in wrong if not line.startswith("pmbm/external/process.py")]
