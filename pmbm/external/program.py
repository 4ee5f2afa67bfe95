"""A program as a tracker: named `exec:COMMAND` wherever a tracker is."""

from __future__ import annotations

import atexit
import hashlib
import os
import shlex
import shutil
import time
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pmbm.errors import InputError
from pmbm.external import protocol
from pmbm.external.process import Process
from pmbm.types import Detections, Site, Tracks

EXEC: Final = "exec:"
"""Begins the name of a tracker that is a program."""
DEADLINE: Final = 10.0
"""Seconds that an answer may take."""
START_DEADLINE: Final = 60.0
"""Seconds that the answer to the greeting may take, which may have to load much."""


@dataclass(frozen=True)
class Program:
    """A tracker factory: the program that a command starts.

    command : the program and its arguments; no shell reads them.

    Every tracker has a running program to itself, which the next one takes over once the tracker
    is gone: one program in a process that runs one recording after another.
    """

    command: tuple[str, ...]

    @property
    def name(self) -> str:
        return EXEC + shlex.join(self.command)

    def __call__(
        self, site: Site, seed: int = 0, *, deadline: float = DEADLINE, **parameters: Any
    ) -> _ProgramTracker:
        """A tracker that begins anew.

        deadline : seconds that each answer may take.
        parameters : for the program, in its greeting.

        Raises InputError where the program does not start or does not answer the greeting.
        """
        if not (isinstance(deadline, int | float) and 0 < deadline < float("inf")):
            raise InputError(f"tracker '{self.name}'", field="deadline", expected="seconds above 0",
                             got=deadline)  # fmt: skip
        line = protocol.greeting(site, seed, parameters)
        return _ProgramTracker(self, line, float(deadline))

    def files(self) -> Iterator[Path]:
        """The files that the command names: what the tracks depend on, as far as it shows."""
        program = shutil.which(self.command[0])
        if program is not None:
            yield Path(program)
        for argument in self.command[1:]:
            if Path(argument).is_file():
                yield Path(argument)

    def digest(self) -> str:
        """SHA-256 of the command's words and of the files that it names."""
        hasher = hashlib.sha256(repr(self.command).encode())
        for file in self.files():
            content = file.read_bytes()
            hasher.update(f"{len(content)};".encode())
            hasher.update(content)
        return hasher.hexdigest()


def program_named(name: str) -> Program:
    """The program of an `exec:COMMAND`.

    Raises InputError where there is no command, or no program of that name.
    """
    try:
        command = tuple(shlex.split(name.removeprefix(EXEC)))
    except ValueError as error:
        raise InputError(f"tracker '{name}': {error}", expected="exec:COMMAND") from None
    if not command:
        raise InputError(f"tracker '{name}' names no program", expected="exec:COMMAND")
    if os.name != "posix":
        raise InputError(f"tracker '{name}': programs are started on Linux and macOS alone")
    if shutil.which(command[0]) is None:
        there = Path(command[0]).exists()
        raise InputError(
            f"tracker '{name}': no program '{command[0]}'",
            hint=f"it is no executable file: chmod +x {command[0]}"
            if there
            else "build it first, and name it from the current folder",
        )
    return Program(command)


def program_hint(name: str) -> str | None:
    """The hint for an unknown tracker whose name is a command with a path or arguments, or one
    behind a mistyped `exec:`."""
    start, _, rest = name.partition(":")
    command = rest if start.startswith("ex") else name
    word = next(iter(command.split()), "")
    like_one = command == rest or "/" in command or " " in command
    if word and like_one and shutil.which(word) is not None:
        return f"did you mean '{EXEC}{command}'?"
    return None


class _ProgramTracker:
    """The `Tracker` of one recording that a program is asked for.

    step_seconds : what the last step took, s: as the program says, else as the wall clock does.
    """

    step_seconds: float | None = None

    def __init__(self, program: Program, greeting: bytes, deadline: float) -> None:
        self._name = f"tracker '{program.name}'"
        self._deadline = deadline
        self._steps = 0
        self._process = _borrowed(program, self._name)
        weakref.finalize(self, _give_back, program, self._process)
        answer = self._process.ask(greeting, max(deadline, START_DEADLINE), "greeting")
        try:
            protocol.check_ready(answer)
        except InputError as error:
            raise self._refused(error, "greeting") from None

    def step(self, detections: Detections, /) -> Tracks:
        """The program's answer to one delivery of detections.

        Raises InputError where it gives none in time, or one that cannot be used; the program is
        ended then.
        """
        number = self._steps
        start = time.perf_counter()
        line = protocol.frame_line(number, detections)
        answer = self._process.ask(line, self._deadline, f"step {number}")
        try:
            tracks, said = protocol.read_tracks(answer, number, detections.time)
        except InputError as error:
            raise self._refused(error, f"step {number}") from None
        self.step_seconds = time.perf_counter() - start if said is None else said
        self._steps += 1
        return tracks

    def _refused(self, error: InputError, asked: str) -> InputError:
        found = error.located(problem=f"{self._name}, {asked}: {error.problem}")
        self._process.fail(found)
        return found


_idle: dict[tuple[int, Program], list[Process]] = {}
"""Programs that no tracker has at the moment, of this process: a fork has none of its parent's."""


def _borrowed(program: Program, name: str) -> Process:
    idle = _idle.get((os.getpid(), program), [])
    while idle:
        process = idle.pop()
        if process.alive:
            return process
        process.close()
    return Process(program.command, name)


def _give_back(program: Program, process: Process) -> None:
    if not process.closed:
        _idle.setdefault((os.getpid(), program), []).append(process)


def close_programs() -> None:
    """End the programs that no tracker has."""
    for programs in _idle.values():
        while programs:
            programs.pop().close()


atexit.register(close_programs)
