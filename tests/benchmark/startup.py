"""What it costs to import us, to be loaded by pytest, and to get a first result."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

RUNS = 5


def j_import() -> tuple[float, dict[str, Any]]:
    """Time of `import pmbm` over that of `import numpy`, each in fresh processes."""
    times: dict[str, list[float]] = {"pmbm": [], "numpy": []}
    for _ in range(RUNS):
        for module in times:
            program = (
                "import time; begin = time.process_time(); "
                f"import {module}; print(time.process_time() - begin)"
            )
            times[module].append(float(_python("-c", program)))
    medians = {f"{module}_ms": 1e3 * float(np.median(taken)) for module, taken in times.items()}
    return medians["pmbm_ms"] / medians["numpy_ms"], medians


def j_plugin() -> tuple[float, dict[str, Any]]:
    """How many of numpy and highway_env loading the pytest plugin imports."""
    program = (
        "import sys, pmbm.pytest_plugin; "
        "print(*[name for name in ('numpy', 'highway_env') if name in sys.modules])"
    )
    loaded = _python("-c", program).split()
    return float(len(loaded)), {"loaded": loaded}


def k() -> tuple[float, dict[str, Any]]:
    """Seconds from the first `pmbm run` to its result, without bytecode or caches."""
    with tempfile.TemporaryDirectory() as folder:
        fresh = {
            "PMBM_CACHE": os.path.join(folder, "cache"),
            "PYTHONPYCACHEPREFIX": os.path.join(folder, "bytecode"),
        }
        begin = time.perf_counter()
        program = "from pmbm.cli import main; main()"
        _python("-c", program, "run", "crossing", "--out", folder, **fresh)
        return time.perf_counter() - begin, {"command": "pmbm run crossing"}


def _python(*arguments: str, **environment: str) -> str:
    return subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, **environment},
        check=True,
        capture_output=True,
        text=True,
    ).stdout
