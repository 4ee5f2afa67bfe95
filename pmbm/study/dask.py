"""A Dask cluster as an executor: the same trials, on more than one machine."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from pmbm.errors import InputError


@contextmanager
def dask_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """The cluster behind a scheduler's address, and how many trials to keep in flight there.

    Raises InputError where Dask is not installed or the scheduler does not answer.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "Dask is not installed", field="--scheduler", hint="pip install 'pmbm[dask]'"
        ) from error
    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no scheduler answers there: {error}", field="--scheduler", got=address
        ) from error
    try:
        threads = sum(client.nthreads().values())
        # One attempt: a trial that takes its worker with it is the driver's to judge.
        yield client.get_executor(pure=False, retries=0), max(2 * threads, 2)
    finally:
        client.close()
