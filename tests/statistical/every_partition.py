"""The exact posterior of a small world, by listing everything that may have happened in it.

Every measurement of every frame is put into one cell of a partition: a cell is one object's
detections, or one false detection.  What a cell weighs is summed over the births and deaths that
it allows, with one joint Gaussian over its measurements: no recursion, no filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import multivariate_normal

H = np.eye(2, 4)
Cell = frozenset[tuple[int, int]]
"""(frame, measurement) of each detection."""


@dataclass(frozen=True)
class Small:
    """Objects that are there at first (`initial`), or are born in every later frame (`births`),
    from one Gaussian.

    One Gaussian is all that a first detection can come from, so the filter's moments are exact:
    either nothing is born later, or nothing moves.
    """

    F: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    detection: float
    survival: float
    clutter: float
    initial: float
    births: float

    def born(self, frame: int) -> float:
        return self.births if frame else self.initial

    def undetected(self, frames: int) -> float:
        """Expected number of objects that are there at the end and were never detected."""
        missed = self.survival * (1 - self.detection)
        return sum(
            self.born(b) * (1 - self.detection) * missed ** (frames - 1 - b) for b in range(frames)
        )


@dataclass(frozen=True)
class Weighed:
    """A cell: its weight, the probability that its object exists at the end, and its mean then."""

    weight: float
    existence: float
    mean: np.ndarray


def partitions(counts: list[int]) -> Iterator[frozenset[Cell]]:
    """Every way to share measurements out among cells, no two of one frame in the same; counts are
    those of the frames."""

    def extended(cells: list[Cell], rest: list[tuple[int, int]]) -> Iterator[frozenset[Cell]]:
        if not rest:
            yield frozenset(cells)
            return
        one, later = rest[0], rest[1:]
        for i, cell in enumerate(cells):
            if all(frame != one[0] for frame, _ in cell):
                yield from extended([*cells[:i], cell | {one}, *cells[i + 1 :]], later)
        yield from extended([*cells, frozenset({one})], later)

    yield from extended([], [(k, j) for k, n in enumerate(counts) for j in range(n)])


def weighed(world: Small, frames: list[np.ndarray], cell: Cell) -> Weighed:
    """Sum of everything that can have led to these detections."""
    seen = sorted(cell)
    first, last, end = seen[0][0], seen[-1][0], len(frames) - 1
    z = np.concatenate([frames[k][j] for k, j in seen])
    P_D, P_S = world.detection, world.survival
    unseen = P_S * (1 - P_D)
    between = P_D ** len(seen) * (1 - P_D) ** (last - first + 1 - len(seen)) * P_S ** (last - first)
    alive = unseen ** (end - last)
    dead = sum(unseen**d * (1 - P_S) for d in range(end - last))
    object_weight, mean = 0.0, np.zeros(4)
    for birth in range(first + 1):
        joint, cross, expected, at_end = _joint(world, birth, [k for k, _ in seen], end)
        here = world.born(birth) * unseen ** (first - birth) * between
        here *= multivariate_normal.pdf(z, expected, joint)
        object_weight += here
        mean += here * (at_end + cross @ np.linalg.solve(joint, z - expected))
    weight = object_weight * (alive + dead) + (world.clutter if len(seen) == 1 else 0.0)
    exists = object_weight * alive / weight if weight else 0.0
    return Weighed(weight, exists, mean / object_weight if object_weight else mean)


def _joint(world: Small, birth: int, seen: list[int], end: int):
    """Covariance of the measurements at these frames, theirs with the state at the end, and the
    means of both."""
    state, mean = [world.cov], [world.mean]
    for _ in range(birth, end):
        state.append(world.F @ state[-1] @ world.F.T + world.Q)
        mean.append(world.F @ mean[-1])

    def covariance(a: int, b: int) -> np.ndarray:
        """Of the states at frames a and b."""
        if a > b:
            return covariance(b, a).T
        return state[a - birth] @ np.linalg.matrix_power(world.F, b - a).T

    blocks = [[H @ covariance(a, b) @ H.T + (world.R if a == b else 0) for b in seen] for a in seen]
    cross = np.concatenate([covariance(end, a) @ H.T for a in seen], axis=1)
    expected = np.concatenate([H @ mean[a - birth] for a in seen])
    return np.block(blocks), cross, expected, mean[end - birth]


def posterior(
    world: Small, frames: list[np.ndarray]
) -> tuple[dict[frozenset[Cell], float], dict[Cell, Weighed]]:
    """Probability of every partition, and all cells."""
    cells: dict[Cell, Weighed] = {}
    weight = {}
    for partition in partitions([len(z) for z in frames]):
        total = 1.0
        for cell in partition:
            if cell not in cells:
                cells[cell] = weighed(world, frames, cell)
            total *= cells[cell].weight
        weight[partition] = total
    total = sum(weight.values())
    return {partition: w / total for partition, w in weight.items()}, cells
