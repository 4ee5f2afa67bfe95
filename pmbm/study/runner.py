"""Runs what a study's store does not hold yet, and loses nothing on the way."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import psutil

from pmbm.study.parallel import process_pool
from pmbm.study.store import Store, StoreRow, open_store
from pmbm.study.study import Study
from pmbm.study.worker import Task, compute, failed, prepare

ALONE_SECONDS = 3600.0
ALONE_MEMORY_SHARE = 0.9
"""Limits of a suspected trial, alone in its process, where the study sets none."""
_DEATHS = 2
_GRACE = 10.0
_LOOK_EVERY = 1.0


@dataclass(frozen=True)
class Progress:
    """How far a study is: trials in all, stored, stored as failures, and damaged rows that are
    run again."""

    total: int
    done: int
    failed: int
    damaged: tuple[int, ...] = ()


Tell = Callable[[Progress], None]


def run_study(
    study: Study,
    file: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    tell: Tell | None = None,
) -> Progress:
    """Run every trial that the store does not hold; call again to resume.

    jobs : worker processes; 0 computes in this one.
    scheduler : address of a Dask scheduler to use instead.
    tell : called after every trial.

    A trial that raises, takes too long, or runs out of memory is a row like any other.  Where a
    worker dies, the trials that were in flight run again, each alone in a process with limits; one
    that dies so twice is stored as having died.

    Raises InputError for a store that cannot be used (see `open_store`).
    """
    with open_store(file, study) as store:
        contents = store.contents
        if contents.damaged:
            store.forget(contents.damaged)
        rows = {index: row for index, row in contents.rows.items() if index < len(study)}
        driver = _Driver(
            study,
            store,
            tell or (lambda progress: None),
            done=len(rows),
            failed=sum(row.outcome != "ok" for row in rows.values()),
            damaged=contents.damaged,
        )
        missing = [index for index in range(len(study)) if index not in rows]
        driver.run(missing, jobs, scheduler)
        return driver.progress


class _Driver:
    """One run of a study over its missing trials."""

    def __init__(
        self,
        study: Study,
        store: Store,
        tell: Tell,
        *,
        done: int,
        failed: int,
        damaged: tuple[int, ...],
    ) -> None:
        self.study = study
        self.store = store
        self.tell = tell
        self.progress = Progress(len(study), done, failed, damaged)

    def run(self, missing: list[int], jobs: int, scheduler: str | None) -> None:
        self.tell(self.progress)
        # What was in flight when a driver died may be what killed it.
        suspects = [index for index, _ in self.store.in_flight() if index in set(missing)]
        try:
            for index in suspects:
                self._alone(index)
            rest = [index for index in missing if index not in set(suspects)]
            if jobs == 0 and scheduler is None:
                self._here(rest)
            while rest:
                rest = self._together(rest, jobs, scheduler)
        except KeyboardInterrupt:
            self.store.land()
            raise
        self.store.land()

    def _here(self, indices: list[int]) -> None:
        while indices:
            index = indices.pop(0)
            self.store.start([index])
            self._keep(compute(Task.of(self.study, index)))

    def _together(self, indices: list[int], jobs: int, scheduler: str | None) -> list[int]:
        """Run trials in a pool until done or until it breaks; gives back what is left."""
        waiting = iter(indices)
        with _executor(self.study, jobs, scheduler) as (pool, width):
            flight: dict[Future[StoreRow], int] = {}
            since: dict[int, float] = {}

            lost: list[int] = []

            def submit(some: Iterable[int]) -> None:
                for index in some:
                    try:
                        future = pool.submit(compute, Task.of(self.study, index))
                    except BrokenExecutor:
                        lost.append(index)
                    else:
                        flight[future] = index
                        since[index] = time.monotonic()

            first = list(islice(waiting, width))
            self.store.start(first)
            submit(first)
            while flight and not lost:
                finished, _ = wait(flight, timeout=_LOOK_EVERY, return_when=FIRST_COMPLETED)
                for future in finished:
                    index = flight.pop(future)
                    row = _row(future)
                    if row is None:
                        lost.append(index)
                        continue
                    following = [] if lost else list(islice(waiting, 1))
                    self._keep(row, following)
                    submit(following)
                if not lost and self._overdue(since, flight):
                    lost += flight.values()
            # Whatever else was in flight is as suspect as the first.
            lost += [index for future, index in flight.items() if not self._landed(future)]
        for index in sorted(set(lost)):
            self._alone(index)
        return list(waiting)

    def _landed(self, future: Future[StoreRow]) -> bool:
        row = _row(future) if future.done() else None
        if row is not None:
            self._keep(row)
        return row is not None

    def _overdue(self, since: dict[int, float], flight: dict[Future[StoreRow], int]) -> bool:
        """Whether a trial hangs where no alarm reaches it; one may wait for another first."""
        limit = self.study.time_limit
        if limit is None:
            return False
        now = time.monotonic()
        return any(now - since[index] > 2 * limit + _GRACE for index in flight.values())

    def _alone(self, index: int) -> None:
        """Run a suspected trial in a process of its own, with limits, twice at most."""
        study = self.study
        seconds = study.time_limit or ALONE_SECONDS
        memory = study.memory_limit or _physical_megabytes() * ALONE_MEMORY_SHARE
        deaths = dict(self.store.in_flight()).get(index)
        if deaths is None:
            self.store.start([index])
            deaths = 0
        while deaths < _DEATHS:
            with _processes(1, memory) as pool:
                future = pool.submit(compute, Task.of(study, index))
                finished, _ = wait([future], timeout=seconds + _GRACE)
                row = _row(future) if finished else None
            if row is None and not finished:
                row = failed(index, "timeout", f"longer than {seconds:g} s")
            if row is not None:
                self._keep(row)
                return
            deaths = self.store.died(index)
        self._keep(failed(index, "died", f"its process died {_DEATHS} times, alone"))

    def _keep(self, row: StoreRow, following: Iterable[int] = ()) -> None:
        self.store.finish(row, following)
        p = self.progress
        self.progress = Progress(p.total, p.done + 1, p.failed + (row.outcome != "ok"), p.damaged)
        self.tell(self.progress)


def _row(future: Future[StoreRow]) -> StoreRow | None:
    """The row of a future, or None where its worker, and not the trial, failed."""
    try:
        return future.result()
    except Exception:
        return None


@contextmanager
def _executor(study: Study, jobs: int, scheduler: str | None) -> Iterator[tuple[Executor, int]]:
    """An executor, and how many trials to keep in flight there."""
    if scheduler is None:
        with _processes(jobs, study.memory_limit) as pool:
            yield pool, 2 * jobs
        return
    from pmbm.study.dask import dask_executor

    with dask_executor(scheduler) as found:
        yield found


@contextmanager
def _processes(jobs: int, memory: float | None) -> Iterator[Executor]:
    """Worker processes that are gone afterwards, whatever happens."""
    pool: Any = process_pool(jobs, initializer=prepare, initargs=(os.getpid(), memory))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, kill_workers=True)


def _physical_megabytes() -> float:
    return float(psutil.virtual_memory().total / 1e6)
