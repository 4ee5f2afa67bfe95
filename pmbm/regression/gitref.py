"""Trackers from another commit: checked out beside the sources, run in a process of their own."""

from __future__ import annotations

import atexit
import hashlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

from pmbm.errors import InputError
from pmbm.external import EXEC
from pmbm.named_modules import find_named
from pmbm.study.code import WITHOUT_EFFECT
from pmbm.types import Detections, Site, Tracks

_END = "--end-of-options"
"""What follows is no option of git's, whatever it looks like."""
_NATIVE_SOURCES = ("CMakeLists.txt", "pmbm/*.cpp", "pmbm/*.hpp")


@dataclass(frozen=True)
class GitTracker:
    """A tracker factory: the tracker of that name as it was in a checkout.

    folder : the checkout.
    name : a shipped name, MODULE:FACTORY or exec:COMMAND, looked up in the checkout first.
    parameters : as of `ConfiguredTracker`.
    """

    folder: str
    name: str
    parameters: tuple[tuple[str, Any], ...] = ()

    def __call__(self, site: Site, seed: int = 0) -> _Remote:
        server = _server(self)
        server.ask("new", (site, seed))
        return _Remote(server)


@dataclass(frozen=True)
class _Remote:
    server: _Server

    def step(self, detections: Detections, /) -> Tracks:
        tracks: Tracks = self.server.ask("step", detections)
        return tracks


class _Server:
    """The process that runs one tracker of one checkout."""

    def __init__(self, tracker: GitTracker) -> None:
        self._what = f"tracker '{tracker.name}' of commit {Path(tracker.folder).name}"
        self._connection, theirs = Pipe()
        script = Path(__file__).with_name("serve_tracker.py")
        number = theirs.fileno()
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-P", str(script), str(number), tracker.folder, tracker.name),
                json.dumps(dict(tracker.parameters)),
            ],
            pass_fds=[number],
            cwd=tracker.folder,
            stdin=subprocess.DEVNULL,
        )
        theirs.close()
        atexit.register(self.close)
        self._answer()

    def ask(self, what: str, value: Any) -> Any:
        try:
            self._connection.send((what, value))
        except OSError as error:
            raise RuntimeError(f"{self._what} died") from error
        return self._answer()

    def _answer(self) -> Any:
        try:
            kind, value = self._connection.recv()
        except (EOFError, OSError) as error:
            raise RuntimeError(f"{self._what} died") from error
        if kind == "error":
            raise RuntimeError(f"{self._what}: {value}")
        return value

    def close(self) -> None:
        self._connection.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


_servers: dict[GitTracker, _Server] = {}


def _server(tracker: GitTracker) -> _Server:
    """The server of this process for a tracker; trials run one after another, so one is enough."""
    if tracker not in _servers:
        _servers[tracker] = _Server(tracker)
    return _servers[tracker]


def close_servers(folder: str) -> None:
    """End the servers that run from a checkout."""
    for tracker in [tracker for tracker in _servers if tracker.folder == folder]:
        _servers.pop(tracker).close()


@contextmanager
def checked_out(ref: str, repository: Path | None = None) -> Iterator[str]:
    """A git worktree of `ref`, gone afterwards.

    Raises InputError where there is no repository or no such commit.
    """
    check_ref(ref)
    if os.name != "posix":
        raise InputError(
            f"trackers of another commit ('{ref}') run on Linux and macOS alone",
            hint="name a tracker, or compare with a stored baseline",
        )
    top = repository_of(repository or Path.cwd())
    commit = git(
        top, "rev-parse", "--verify", "--quiet", _END, f"{ref}^{{commit}}", what=f"'{ref}'"
    )
    with tempfile.TemporaryDirectory(prefix="pmbm-") as parent:
        folder = str(Path(parent) / commit[:12])
        git(top, "worktree", "add", "--detach", "--", folder, commit, what=f"a worktree of {ref}")
        try:
            _share_native(top, commit, Path(folder))
            yield folder
        finally:
            close_servers(folder)
            git(top, "worktree", "remove", "--force", "--", folder, what=f"the worktree of {ref}")


def check_ref(ref: str) -> None:
    """Raise InputError where git would take a name for an option."""
    if ref.startswith("-"):
        raise InputError("not the name of a commit", expected="no dash in front", got=ref)


def commits_of(top: Path, interval: str) -> list[str]:
    """The commits of GOOD..BAD, oldest first."""
    found = git(top, "rev-list", "--reverse", _END, interval, "--", what=f"'{interval}'")
    return found.split()


def subject_of(top: Path, commit: str) -> str:
    """A commit's short name and the first line of its message."""
    return git(top, "log", "-1", "--format=%h %s", _END, commit, "--", what=commit)


def repository_of(folder: Path) -> Path:
    return Path(git(folder, "rev-parse", "--show-toplevel", what="a git repository"))


def git(folder: Path, *arguments: str, what: str) -> str:
    """Output of a git command; InputError where it fails."""
    done = subprocess.run(
        ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        said = " ".join(done.stderr.split()) or "not found"
        raise InputError(
            f"git knows nothing of {what}: {said}", hint="name a commit, branch or tag"
        )
    return done.stdout.strip()


def same_sources(folder: str, factory: str, repository: Path | None = None) -> bool:
    """Whether the code that a tracker's trial depends on is the same there and here; never of a
    program, which may read anything."""
    if factory.startswith(EXEC):
        return False
    top = repository_of(repository or Path.cwd())
    module = factory.partition(":")[0] if ":" in factory else "pmbm"
    for package in {"pmbm", module.split(".")[0]}:
        here = _place(package)
        if here is None or not here.is_relative_to(top):
            # Not of this repository: installed, and the same for both.
            continue
        there = Path(folder) / here.relative_to(top)
        passed_over = WITHOUT_EFFECT if package == "pmbm" else ()
        if _tree(here, passed_over) != _tree(there, passed_over):
            return False
    return True


def _place(package: str) -> Path | None:
    spec = find_named(package)
    if spec is None or spec.origin is None:
        return None
    origin = Path(spec.origin).resolve()
    return origin.parent if spec.submodule_search_locations is not None else origin


def _tree(place: Path, passed_over: Sequence[str]) -> str:
    hasher = hashlib.sha256()
    files = [place] if place.is_file() else sorted(place.rglob("*"))
    for file in files:
        name = "" if file == place else file.relative_to(place).as_posix()
        if name.split("/")[0] in passed_over:
            continue
        if file.suffix in (".py", ".toml", ".cpp", ".hpp") and file.is_file():
            hasher.update(f"{name} {file.stat().st_size};".encode())
            hasher.update(file.read_bytes())
    return hasher.hexdigest()


def _share_native(top: Path, commit: str, folder: Path) -> None:
    """Let the checkout use the compiled kernel where its C++ is the same; else it runs the plain
    version, whose results are the same."""
    spec = importlib.util.find_spec("pmbm._native") if (folder / "pmbm").is_dir() else None
    if spec is None or spec.origin is None:
        return
    changed = subprocess.run(
        ["git", "-C", str(top), "diff", "--quiet", commit, "--", *_NATIVE_SOURCES], check=False
    )
    if changed.returncode == 0:
        os.symlink(spec.origin, folder / "pmbm" / Path(spec.origin).name)
