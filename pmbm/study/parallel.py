"""Trials over processes, for runs short enough to keep no store."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager
from typing import Any

from threadpoolctl import threadpool_limits

from pmbm.study.sources import Source
from pmbm.study.trial import Metrics, TrialResult, run_trial
from pmbm.tracking import TrackerFactory

Progress = Callable[[int, int], None]
"""Called with trials done and trials in all."""

_THREAD_COUNTS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)
_SAFE_PATH = "PYTHONSAFEPATH"
WORKER_ENVIRONMENT = {**dict.fromkeys(_THREAD_COUNTS, "1"), _SAFE_PATH: "1"}
"""Of a worker: one process a core, sums in one order, and no import from the current folder."""


class TrialsInterrupted(KeyboardInterrupt):
    """An interrupt, with the results of the trials that were done."""

    def __init__(self, results: Sequence[TrialResult]) -> None:
        super().__init__()
        self.results = tuple(results)


def process_pool(
    jobs: int, initializer: Callable[..., None] | None = None, initargs: tuple[Any, ...] = ()
) -> Executor:
    """A pool of `jobs` fresh processes (loky's: spawned, so nothing leaks in from the parent),
    each with one BLAS thread."""
    from loky import ProcessPoolExecutor

    _start_resource_trackers()
    pool: Executor = ProcessPoolExecutor(
        max_workers=jobs,
        env=dict(WORKER_ENVIRONMENT),
        initializer=_begin,
        initargs=(initializer, *initargs),
    )
    return pool


@contextmanager
def workers(jobs: int) -> Iterator[Executor]:
    """A `process_pool` whose workers are ended at once where anything is raised."""
    pool = process_pool(jobs)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=True, kill_workers=True)  # type: ignore[call-arg]
        raise
    pool.shutdown(wait=True)


def _start_resource_trackers() -> None:
    """Start the processes that clean up after workers, which would look for modules in the current
    folder first."""
    from multiprocessing import resource_tracker as of_python

    from loky.backend import resource_tracker as of_loky

    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        of_python.ensure_running()
        of_loky.ensure_running()
    finally:
        os.environ.pop(_SAFE_PATH)
        if before is not None:
            os.environ[_SAFE_PATH] = before


def _begin(initializer: Callable[..., None] | None, *arguments: Any) -> None:
    # The driver is interrupted, and ends its workers: none of them has anything to say of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # It was for this process, not for programs that trackers start.
    os.environ.pop(_SAFE_PATH, None)
    if initializer is not None:
        initializer(*arguments)


def run_trials(
    source: Source,
    trackers: Mapping[str, TrackerFactory | str],
    seed: int,
    trials: int,
    jobs: int = 1,
    progress: Progress | None = None,
    metrics: Sequence[str] | Metrics | None = None,
) -> list[TrialResult]:
    """Trials 0 to `trials` - 1 in order; the results do not depend on `jobs`.

    With `jobs` = 1 they run in this process.  What a trial raises is raised here, and ends the
    workers.  An interrupt (Ctrl-C) does too, as `TrialsInterrupted`, which holds what is done.
    """
    tell = progress or (lambda done, total: None)
    tell(0, trials)
    results: list[TrialResult] = []
    if jobs == 1 or trials == 1:
        try:
            with threadpool_limits(limits=1):
                for trial in range(trials):
                    results.append(run_trial(source, trackers, seed, trial, metrics))
                    tell(trial + 1, trials)
        except KeyboardInterrupt:
            raise TrialsInterrupted(results) from None
        return results
    futures = []
    try:
        with workers(min(jobs, trials)) as pool:
            futures = [
                pool.submit(run_trial, source, trackers, seed, trial, metrics)
                for trial in range(trials)
            ]
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                tell(done, trials)
    except KeyboardInterrupt:
        done_ones = [f.result() for f in futures if f.done() and f.exception() is None]
        raise TrialsInterrupted(done_ones) from None
    return [future.result() for future in futures]
