"""One trial in whatever process it runs: never raises, keeps its limits, dies with its driver."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits

from pmbm.errors import notes_of
from pmbm.study.configured import ConfiguredTracker
from pmbm.study.sources import Source
from pmbm.study.store import StoreRow
from pmbm.study.study import Study, canonical
from pmbm.study.trial import run_trial

_LONGEST_MESSAGE = 500


class TrialTimeout(BaseException):
    """A trial took longer than it may; no exception that a tracker could catch by mistake."""


@dataclass(frozen=True)
class Task:
    """All that one trial needs, small enough to send anywhere."""

    index: int
    trial: int
    seed: int
    source: Source
    trackers: Mapping[str, ConfiguredTracker]
    metrics: tuple[str, ...] | None
    time_limit: float | None

    @classmethod
    def of(cls, study: Study, index: int) -> Task:
        cell = study.cell(index)
        return cls(
            index=index,
            trial=study.trial(index),
            seed=study.seed,
            source=cell.source,
            trackers=cell.trackers,
            metrics=study.metrics,
            time_limit=study.time_limit,
        )


def compute(task: Task) -> StoreRow:
    """The row of a trial: its result, or how it failed."""
    start = time.perf_counter()
    try:
        with threadpool_limits(limits=1), _alarm(task.time_limit):
            found = run_trial(task.source, task.trackers, task.seed, task.trial, task.metrics)
    except TrialTimeout as error:
        notes = "\n".join(notes_of(error))
        return failed(task.index, "timeout", f"longer than {task.time_limit:g} s", notes)
    except MemoryError:
        return failed(task.index, "memory", "out of memory")
    except Exception as error:
        message = f"{type(error).__name__}: {error}"
        return failed(task.index, "raised", message, traceback.format_exc())
    scores = {name: dict(values) for name, values in found.scores.items()}
    result = {"recording": found.recording, "scores": scores}
    steps = {name: [t.mean, t.median, t.p99] for name, t in found.time.items()}
    seconds = time.perf_counter() - start
    time_ = canonical({"seconds": seconds, "steps": steps})
    if not found.errors:
        return StoreRow(task.index, "ok", canonical(result), time_)
    result["errors"] = {name: _plain(error.message) for name, error in found.errors.items()}
    note = "\n".join("\n".join(error.notes) or error.traceback for error in found.errors.values())
    return StoreRow(task.index, "tracker raised", canonical(result), time_, note)


def failed(index: int, outcome: str, message: str, note: str = "") -> StoreRow:
    """The row of a trial that gave no result."""
    return StoreRow(index, outcome, canonical({"error": _plain(message)}), note=note)


def _plain(message: str) -> str:
    """A message without addresses, which differ from process to process and would make equal
    failures look different."""
    return re.sub(r"0x[0-9a-fA-F]+", "0x...", message)[:_LONGEST_MESSAGE]


def prepare(driver: int, memory_limit: float | None) -> None:
    """Make this process a worker of the driver: it leaves interrupts to the driver, and ends when
    the driver does, also when that is killed and cannot say so."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory(memory_limit)
    threading.Thread(target=_die_with, args=(driver,), daemon=True).start()


def limit_memory(megabytes: float | None) -> None:
    if megabytes is not None and sys.platform != "win32":
        import resource

        limit = int(megabytes * 1e6)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def _die_with(driver: int) -> None:
    while os.getppid() == driver:
        time.sleep(0.5)
    os._exit(1)


@contextmanager
def _alarm(seconds: float | None) -> Iterator[None]:
    """Raise TrialTimeout after so many seconds, where the thread can be interrupted at all."""
    here = threading.current_thread() is threading.main_thread()
    if sys.platform == "win32" or seconds is None or not here:
        yield
    else:

        def ring(_signal: int, _frame: Any) -> None:
            raise TrialTimeout

        before = signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, seconds)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
