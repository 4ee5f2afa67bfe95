"""The compiled kernels under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SOURCES = HERE.parents[1] / "pmbm" / "native"


@pytest.mark.slow
def test_sanitizers_find_nothing(tmp_path):
    compiler = shutil.which(os.environ.get("CXX", "")) or shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler on PATH")
    probe = tmp_path / "probe.cpp"
    probe.write_text("int main() {}")
    sanitize = ["-std=c++17", "-g", "-O1", "-fsanitize=address,undefined"]
    if subprocess.run([compiler, *sanitize, probe, "-o", tmp_path / "probe"]).returncode:
        pytest.skip(f"{compiler} has no sanitizers")

    program = tmp_path / "fuzz"
    strict = ["-Wall", "-Wextra", "-Wconversion", "-Wno-sign-conversion", "-Werror"]
    checks = ["-fno-sanitize-recover=all", "-D_GLIBCXX_ASSERTIONS"]
    sources = [f"-I{SOURCES}", HERE / "kernel_fuzz.cpp"]
    subprocess.run([compiler, *sanitize, *checks, *strict, *sources, "-o", program], check=True)
    run = subprocess.run([program, "1500"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout == "1500 problems\n"
