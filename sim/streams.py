"""Keyed random streams: every draw has its own place, so that nothing moves anything else.

There is one generator per (seed, trial, purpose, object), and where there are several sensors for
each of them.  It gives a fixed number of uniforms per frame, all frames at once, and the row is the
frame's number.  Each quantity is mapped from its own uniforms by the inverse of its distribution
function.  So one knob, one object or one clutter box
more changes no other draw, and two configurations that are run over the same seed and trial share
their luck (common random numbers).
"""

from __future__ import annotations

import enum
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from pmbm.types import FloatArray, IntArray

_SMALLEST = 2.0**-54
"""Uniforms are kept above zero, so that every inverse distribution function is finite."""


class Purpose(enum.IntEnum):
    """The purpose of a stream; the numbers are part of every recording's identity."""

    TRAFFIC = 0
    MISS = 1
    BURST = 2
    POSITION = 3
    SIZE = 4
    HEADING = 5
    SCORE = 6
    CLUTTER = 7
    DUPLICATE = 8
    LABEL = 9
    DROPOUT = 10
    EGO_POSE = 11
    PLACE = 12
    PLACE_SEEN = 13
    FLIP = 14
    LASTING = 15
    ECHO = 16
    COMPANION = 17
    RADIAL = 18
    CLUTTER_SPEED = 19
    PLACE_SCORE = 20


@dataclass(frozen=True)
class Streams:
    """All random streams of one trial.

    seed : of the study, or given to `record`.
    trial : number of the trial; `record(seed)` is trial 0.
    sensor : name of the sensor that draws, where there are several: each has streams of its own.
    """

    seed: int
    trial: int = 0
    sensor: str = ""

    def generator(self, purpose: Purpose, object_id: int = 0) -> np.random.Generator:
        """The generator of one purpose and object."""
        key: tuple[int, ...] = (self.trial, int(purpose), int(object_id) % 2**64)
        if self.sensor:
            # Always two words of 32 bits, so that no key of one sensor is another's.
            name = hashlib.sha256(self.sensor.encode()).digest()[:8]
            key = (*key, int.from_bytes(name, "big") | 2**63)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def uniforms(self, purpose: Purpose, frames: int, width: int, object_id: int = 0) -> FloatArray:
        """Uniforms (frames, width) in (0, 1) of one purpose and object, one row a frame."""
        draws = self.generator(purpose, object_id).random((frames, width))
        return np.maximum(draws, _SMALLEST)


@dataclass(frozen=True, eq=False)
class StreamMembers:
    """The rows of a flat table that belong to each object.

    frame (R,) : absolute frame of each row, ascending within an object.
    object_id (R,) : whose row it is.
    """

    frame: IntArray
    object_id: IntArray

    def __iter__(self) -> Iterator[tuple[int, IntArray]]:
        """Each object's id and its rows, in order of frames."""
        order = np.argsort(self.object_id, kind="stable")
        ids, start = np.unique(self.object_id[order], return_index=True)
        return zip(ids.tolist(), np.split(order, start[1:]), strict=False)

    def uniforms(self, streams: Streams, purpose: Purpose, width: int) -> FloatArray:
        """Uniforms (R, width) in (0, 1): every row has those of its object and frame."""
        draws = np.empty((len(self.frame), width))
        for object_id, rows in self:
            frames = self.frame[rows]
            table = streams.uniforms(purpose, int(frames[-1]) + 1, width, object_id)
            draws[rows] = table[frames]
        return draws

    def lasting_normals(self, streams: Streams, purpose: Purpose, width: int) -> FloatArray:
        """Standard normal values (R, width), the same for all rows of an object."""
        values = np.empty((len(self.frame), width))
        for object_id, rows in self:
            values[rows] = normal(streams.uniforms(purpose, 1, width, object_id))
        return values

    def normals(
        self, streams: Streams, purpose: Purpose, width: int, persistence: float = 0.0
    ) -> FloatArray:
        """Standard normal values (R, width), each correlated by `persistence` with that of the
        object's row before: a stationary autoregressive process of first order."""
        values = normal(self.uniforms(streams, purpose, width))
        if persistence > 0.0:
            fresh = np.sqrt(1.0 - persistence**2)
            for _, rows in self:
                own = fresh * values[rows]
                own[0] = fresh * (values[rows[0]] / fresh)
                # Bit for bit scipy.signal.lfilter, which takes a second to import.
                for row in range(1, len(own)):
                    own[row] += persistence * own[row - 1]
                values[rows] = own
        return values


def normal(uniform: FloatArray) -> FloatArray:
    """Standard normal values by inverse distribution function."""
    value: FloatArray = special.ndtri(uniform)
    return value


def correlated(values: FloatArray, correlation: float | tuple[float, float, float]) -> FloatArray:
    """Standard normals (R,3) from independent ones (R,4): every two of this correlation, or the
    first two, the outer two and the last two of these."""
    if isinstance(correlation, tuple):
        first, outer, last = correlation
        matrix = np.array([[1.0, first, outer], [first, 1.0, last], [outer, last, 1.0]])
        mixed: FloatArray = values[:, 1:] @ np.linalg.cholesky(matrix).T
        return mixed
    common = np.sqrt(correlation) * values[:, :1]
    return common + np.sqrt(1.0 - correlation) * values[:, 1:]


def cumulative_normal(value: FloatArray) -> FloatArray:
    """Uniforms in (0, 1) of standard normal values."""
    uniform: FloatArray = np.clip(special.ndtr(value), _SMALLEST, 1.0 - 2 * _SMALLEST)
    return uniform


def beta(uniform: FloatArray, mean: FloatArray, concentration: float) -> FloatArray:
    """Beta values by inverse distribution function; `concentration` is the sum of both shapes."""
    mean = np.clip(mean, 1e-6, 1 - 1e-6)
    value: FloatArray = special.betaincinv(
        mean * concentration, (1 - mean) * concentration, uniform
    )
    return value
