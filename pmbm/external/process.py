"""A program that answers lines with lines: asked with a deadline, and never left behind."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import time
from collections.abc import Sequence
from typing import Final

from pmbm.errors import InputError

_LAST_LINES: Final = 5
_KEPT_BYTES: Final = 4096
_CHUNK: Final = 1 << 16
_LONGEST_ANSWER: Final = 1 << 26
_SHOWN_BYTES: Final = 100
_GRACE: Final = 1.0

STDERR_IS_FREE: Final = "what is no answer goes to stderr"
"""What to do about a line that the program printed."""

_WATCHDOG: Final = ("/bin/sh", "-c", "trap '' HUP INT TERM; read -r line; kill -9 0")
"""Leads the group of processes that a program belongs to, and kills it when this process is gone,
however it went: the other end of its standard input closes then.  Being born into the group, a
program and what it starts cannot be missed; only what leaves the group by itself is."""


class Process:
    """A running program.

    command : the program and its arguments.
    name : what messages call it.

    Raises InputError where it cannot be started.
    """

    def __init__(self, command: Sequence[str], name: str) -> None:
        self._name = name
        self._owner = os.getpid()
        self._asked = ""
        self._stderr = b""
        self._watchdog = subprocess.Popen(
            _WATCHDOG,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            process_group=0,
        )
        try:
            self._program = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                process_group=self._watchdog.pid,
                bufsize=0,
            )
        except OSError as error:
            self._end(self._watchdog)
            raise InputError(f"{name} cannot be started: {error.strerror}") from None
        pipes = (self._program.stdin, self._program.stdout, self._program.stderr)
        self._in, self._out, self._err = (pipe.fileno() for pipe in pipes if pipe is not None)
        for end in (self._in, self._out, self._err):
            os.set_blocking(end, False)
        self._poll = select.poll()
        self._poll.register(self._out, select.POLLIN)
        self._poll.register(self._err, select.POLLIN)
        self.closed = False

    def ask(self, line: bytes, seconds: float, asked: str) -> bytes:
        """The one line that answers a line; `asked` is what messages call that.

        Raises InputError where it does not come in time, or more comes; the program is ended then,
        and also where anything else interrupts the wait.  The last lines of its stderr are a note
        of what is raised.
        """
        self._asked = asked
        if self.closed:
            raise self._failed("has ended before")
        try:
            return self._answer(line, time.monotonic() + seconds, seconds)
        except BaseException as error:
            self.fail(error)
            raise

    def fail(self, error: BaseException) -> None:
        """End the program for an error, and note there what it said last on stderr."""
        self.close()
        lines = self._stderr.decode(errors="replace").splitlines()[-_LAST_LINES:]
        if lines:
            error.add_note("\n  ".join([f"{self._name} said last:", *map(str.rstrip, lines)]))

    @property
    def alive(self) -> bool:
        return not self.closed and self._program.poll() is None

    def close(self) -> None:
        """End the program and all that it started in its group."""
        if self.closed or os.getpid() != self._owner:
            return
        self.closed = True
        self._hear()
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._watchdog.pid, signal.SIGKILL)
        self._end(self._program)
        self._end(self._watchdog)

    def _answer(self, question: bytes, deadline: float, seconds: float) -> bytes:
        answer = bytearray()
        unsent = memoryview(question)
        unsent = unsent[self._write(unsent) :]
        if unsent:
            self._poll.register(self._in, select.POLLOUT)
        complete = False
        while not complete:
            left = deadline - time.monotonic()
            if left <= 0:
                raise self._failed(f"gave no answer within {seconds:g} s", answer)
            for end, _ in self._poll.poll(1000 * left):
                if end == self._err:
                    if not self._hear():
                        self._poll.unregister(self._err)
                elif end == self._out:
                    found = self._read()
                    answer += found
                    complete = b"\n" in found
                    if len(answer) > _LONGEST_ANSWER:
                        raise self._failed(f"wrote a line of more than {_LONGEST_ANSWER} bytes")
                else:
                    unsent = unsent[self._write(unsent) :]
                    if not unsent:
                        self._poll.unregister(self._in)
        if unsent:
            raise self._failed("answered before it had read the whole line")
        line, *more = answer.removesuffix(b"\n").split(b"\n")
        if more:
            # Answers are objects: another line was printed astray, wherever it stands.
            astray = [one for one in (line, *more) if not one.startswith(b"{")]
            error = self._failed("answered more than one line", (astray or more)[0])
            raise error.located(hint=STDERR_IS_FREE)
        return bytes(line)

    def _read(self) -> bytes:
        """The bytes that the program has answered; raises where it has ended its output."""
        try:
            found = os.read(self._out, _CHUNK)
        except BlockingIOError:
            return b""
        if not found:
            raise self._failed(self._end_in_words())
        return found

    def _write(self, unsent: memoryview) -> int:
        try:
            return os.write(self._in, unsent)
        except BlockingIOError:
            return 0
        except BrokenPipeError:
            raise self._failed(self._end_in_words()) from None

    def _hear(self) -> bool:
        """Keep the end of what the program says on stderr; whether it may say more."""
        while True:
            try:
                found = os.read(self._err, _CHUNK)
            except BlockingIOError:
                return True
            except OSError:
                return False
            if not found:
                return False
            self._stderr = (self._stderr + found)[-_KEPT_BYTES:]

    def _end_in_words(self) -> str:
        try:
            code = self._program.wait(timeout=_GRACE)
        except subprocess.TimeoutExpired:
            return "closed its output"
        if code >= 0:
            return f"ended with exit code {code}"
        known = {each.value: each.name for each in signal.Signals}
        return f"died of {known.get(-code, f'signal {-code}')}"

    def _failed(self, what: str, answer: bytes | bytearray = b"") -> InputError:
        shown = answer[:_SHOWN_BYTES].decode(errors="replace").strip() or None
        return InputError(f"{self._name}, {self._asked}: {what}", got=shown)

    @staticmethod
    def _end(process: subprocess.Popen[bytes]) -> None:
        process.kill()
        for pipe in (process.stdin, process.stdout, process.stderr):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        process.wait()
