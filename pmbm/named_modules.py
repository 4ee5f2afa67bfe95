"""Modules of the current folder: imported where MODULE:FACTORY names them, and nowhere else."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import FrameType, ModuleType


def import_named(name: str) -> ModuleType:
    """The module of that name, looked for in the current folder last.

    What it imports, then or later, is looked for there too; the folder is not on the import path,
    so what lies in it is in reach of nobody else.
    """
    with _current_folder().named(name):
        return importlib.import_module(name)


def find_named(name: str) -> ModuleSpec | None:
    """The spec of a top-level module that `import_named` would import."""
    with _current_folder().named(name):
        return importlib.util.find_spec(name)


def missing_hint(error: Exception, name: str) -> str | None:
    """The hint where the named module itself, and nothing that it imports, is not there."""
    if isinstance(error, ModuleNotFoundError) and error.name in (name, _top(name)):
        return "a module is one that is installed, or lies in the current folder"
    return None


class _Folder(MetaPathFinder):
    """Finds top-level modules in a folder: the one that is named, and what those found before
    import."""

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self._named: str | None = None
        self._found: set[str] = set()

    @contextmanager
    def named(self, name: str) -> Iterator[None]:
        before, self._named = self._named, _top(name)
        try:
            yield
        finally:
            self._named = before

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if path is not None:
            return None
        if fullname != self._named and _importer() not in self._found:
            return None
        spec = PathFinder.find_spec(fullname, [self.folder])
        if spec is not None:
            self._found.add(fullname)
        return spec


def _current_folder() -> _Folder:
    """The finder of the current folder, asked after all others."""
    folder = os.getcwd()
    for finder in sys.meta_path:
        if isinstance(finder, _Folder) and finder.folder == folder:
            return finder
    made = _Folder(folder)
    sys.meta_path.append(made)
    return made


def _importer() -> str | None:
    """The top-level module that the running import statement stands in."""
    frame: FrameType | None = sys._getframe(2)
    while frame is not None and _top(frame.f_globals.get("__name__")) == "importlib":
        frame = frame.f_back
    return None if frame is None else _top(frame.f_globals.get("__name__"))


def _top(name: str | None) -> str:
    return (name or "").partition(".")[0]
