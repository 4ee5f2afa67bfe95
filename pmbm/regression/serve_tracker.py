"""Runs as a script in a process of its own: a tracker from another version of the sources.

Started with the number of an open connection, a folder of sources, a tracker's name and its
parameters (JSON).  It is asked ("new", site) and ("step", detections), and answers ("ok", value)
or ("error", text).  It imports nothing of this version of the project, which the other version
takes the place of.
"""

from __future__ import annotations

import json
import os
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
                tracker, answer = make_tracker(factory, value), None
            else:
                answer = tracker.step(value)
            connection.send(("ok", answer))
        except Exception as error:
            connection.send(("error", f"{type(error).__name__}: {error}"))


def _look_in(folder: str) -> None:
    """Import from `folder` before anything that is installed."""
    sys.path[0] = folder
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
