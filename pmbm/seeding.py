"""Global random state, for trackers that draw from it: set for a run, and put back after it."""

from __future__ import annotations

import random
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

_TRACKER = 0x747261636B
"""Keeps a tracker's draws apart from the streams of simulated worlds, which have keys of three."""
_RECORDING = 0x7265636F7264

_alone = threading.RLock()


def tracker_seed(seed: int, run: int | str) -> int:
    """The seed, below 2**32, of every tracker in one run: a number that is the same wherever the
    run is repeated.

    seed : of the study.
    run : a trial's number or a sequence's name.
    """
    number = zlib.crc32(run.encode()) if isinstance(run, str) else run
    sequence = np.random.SeedSequence(seed, spawn_key=(number, _TRACKER))
    return int(sequence.generate_state(1)[0])


def recording_seed(seed: int, trial: int) -> int:
    """The seed, below 2**32, of a trial's recording where its source takes no trial."""
    sequence = np.random.SeedSequence(seed, spawn_key=(trial, _RECORDING))
    return int(sequence.generate_state(1)[0])


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Start `random` and `numpy.random` from `seed` within a block, and restore them afterwards.

    One thread at a time: the state belongs to the process.
    """
    with _alone:
        plain, numpys = random.getstate(), np.random.get_state()  # noqa: NPY002
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        try:
            yield
        finally:
            random.setstate(plain)
            np.random.set_state(numpys)  # noqa: NPY002
