"""A driver to be killed: runs a study of slow trials into a store.

Usage: study_driver.py STORE JOBS TRIALS FOLDER...  (folders to import from)
"""

import signal
import sys
from pathlib import Path

sys.path[:0] = sys.argv[4:]

from study_worlds import Trouble  # noqa: E402

from pmbm.study import Cell, ConfiguredTracker, Study, run_study  # noqa: E402
from pmbm.study import study as study_module  # noqa: E402


def slow_study(trials):
    source = Trouble(frames=3, how=tuple((trial, "slow") for trial in range(200)))
    cell = Cell("slow", {}, source, {"echo": ConfiguredTracker("study_worlds:Echo")})
    return Study(name="slow", cells=(cell,), trials=trials, metrics=("ospa",))


if __name__ == "__main__":
    # A test run that a shell put in the background ignores the signal, and its children with it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # Sources may be edited while the tests run; whose code it is is tested elsewhere.
    study_module.code_version = lambda modules: {}
    try:
        run_study(slow_study(int(sys.argv[3])), Path(sys.argv[1]), jobs=int(sys.argv[2]))
    except KeyboardInterrupt:
        sys.exit(130)
