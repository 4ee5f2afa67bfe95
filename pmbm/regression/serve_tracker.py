"""Runs as a script in a process of its own: a tracker from another version of the sources.

Started with the number of an open connection, a folder of sources, a tracker's name and its
parameters (JSON).  It is asked ("new", (site, seed)) and ("step", detections), and answers ("ok",
value) or ("error", text).  It imports nothing of this version of the project, which the other
version takes the place of.
"""

from __future__ import annotations

import functools
import inspect
import json
import os
import random
import sys
from multiprocessing.connection import Connection
from typing import Any


def main() -> None:
    number, folder, name = int(sys.argv[1]), sys.argv[2], sys.argv[3]
    parameters = json.loads(sys.argv[4])
    _look_in(folder)
    connection: Any = Connection(number)
    try:
        from pmbm.tracking import make_tracker, tracker_factory

        if parameters:
            from pmbm.study.configured import ConfiguredTracker

            factory = ConfiguredTracker(name, tuple(parameters.items())).bound()
        else:
            factory = tracker_factory(name)
    except Exception as error:
        connection.send(("error", f"{type(error).__name__}: {error}"))
        return
    connection.send(("ok", None))
    tracker: Any = None
    while True:
        try:
            what, value = connection.recv()
        except EOFError:
            return
        try:
            if what == "new":
                site, seed = value
                _seed(seed)
                tracker, answer = make_tracker(_with_seed(factory, seed), site), None
            else:
                answer = tracker.step(value)
            connection.send(("ok", answer))
        except Exception as error:
            connection.send(("error", f"{type(error).__name__}: {error}"))


def _seed(seed: int) -> None:
    """Start this process's global random state as `pmbm.seeding.seeded` does, also for versions
    that have no such module."""
    import numpy as np

    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002


def _with_seed(factory: Any, seed: int) -> Any:
    """The factory with its seed, where it takes one that is not set; older versions give none."""
    try:
        takes = "seed" in inspect.signature(factory).parameters
    except (TypeError, ValueError):
        return factory
    is_set = "seed" in getattr(factory, "keywords", ())
    return functools.partial(factory, seed=seed) if takes and not is_set else factory


def _look_in(folder: str) -> None:
    """Import from `folder` before anything that is installed."""
    sys.path.insert(0, folder)
    if os.path.isdir(os.path.join(folder, "src")):
        sys.path.insert(0, os.path.join(folder, "src"))
    if os.path.isdir(os.path.join(folder, "pmbm")):
        # An editable install answers imports before the path is asked.
        sys.meta_path[:] = [
            finder
            for finder in sys.meta_path
            if "Editable" not in _kind(finder) and "Redirecting" not in _kind(finder)
        ]


def _kind(finder: Any) -> str:
    return getattr(finder, "__name__", type(finder).__name__)


if __name__ == "__main__":
    main()
