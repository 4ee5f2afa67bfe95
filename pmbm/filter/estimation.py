"""Reports: tracks by their probabilities over all global hypotheses, and no two at one place.

The estimators of the literature are in `pmbm.filter.estimators`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmbm import kernels
from pmbm.filter.density import Density, Index, Locals, summed
from pmbm.filter.models.view import View
from pmbm.kernels import twin
from pmbm.types import BoolArray, FloatArray, IntArray

ALIKE = 1e-9
"""Relative difference of masses below which rounding must not choose between them."""
STAY = 30.0
"""How many times likelier than what was reported last of a track something else must be to take its
place.  Where two tracks may be exchanged, the scales tip with every detection."""
WHOLE = 1.5
"""A box this many times as large as another at its place is the whole of which that is a part."""


@dataclass(frozen=True, eq=False, slots=True)
class Marginals:
    """Per track: existence (T,), over all hypotheses; of_class (T,K), that of a source of each
    class; and best (T,), the row of the most probable of its local hypotheses among those that took
    last what the track most probably took last; what was reported last stays for `STAY` times its
    probability."""

    existence: FloatArray
    of_class: FloatArray
    best: Index

    def objects(self, object_share: FloatArray) -> FloatArray:
        """(T,) the probability to exist and be an object, given P(object) (K,) of a source of each
        class."""
        return _objects(self.of_class, self.existence, object_share)

    def shown_as(self, local: Locals) -> BoolArray:
        """(H,) whether each local hypothesis has its track as `best` has it."""
        shown: BoolArray = local.newest == local.newest[self.best][local.track]
        return shown


@twin("objects")
def _objects(of_class: FloatArray, existence: FloatArray, share: FloatArray) -> FloatArray:
    return np.minimum(of_class @ share, existence)


def in_view(density: Density, view: View) -> tuple[Marginals, FloatArray]:
    """The marginals of a density, and the probability (T,) that each track's likeliest state lies
    in the view."""
    marginal, local = marginals(density), density.local
    return marginal, view.share_inside(local.mean[marginal.best], local.cov[marginal.best])


def marginals(density: Density) -> Marginals:
    """Existence of every track summed over the global hypotheses, and its likeliest state."""
    local, tracks = density.local, len(density.track_id)
    mass = density.hypothesis_probability() * local.existence
    existence = summed(mass, local.track, tracks)
    best = _likeliest(
        local.track, local.newest, np.where(local.shown, STAY, 1.0) * mass, tracks, ALIKE
    )
    of_class = _by_class(local.track, local.marks.source, mass, tracks)
    return Marginals(existence.clip(max=1.0), of_class, best)


def _likeliest(
    track: Index, newest: IntArray, mass: FloatArray, tracks: int, alike: float
) -> Index:
    """(tracks,) of each track the row of the largest mass among those that took last what is
    likeliest in all; of equals the first.

    Hypotheses that took the same detection last agree on where the object is: three that differ in
    older steps alone may together outweigh a heavier one that took another.
    """
    _, group = np.unique(np.stack([track, newest]), axis=1, return_inverse=True)
    group = group.reshape(-1)
    agreed = _first_of_largest(track, summed(mass, group, len(track))[group], tracks, alike)
    own = np.where(group == group[agreed][track], mass, -1.0)
    return _first_of_largest(track, own, tracks, alike)


def _first_of_largest(track: Index, value: FloatArray, tracks: int, alike: float) -> Index:
    """(tracks,) of each track the first row of those whose value is alike its largest."""
    top = np.zeros(tracks)
    np.maximum.at(top, track, value)
    near = np.flatnonzero(value >= top[track] * (1 - alike))[::-1]
    first = np.zeros(tracks, np.intp)
    first[track[near]] = near
    return first


def _by_class(track: Index, source: FloatArray, mass: FloatArray, tracks: int) -> FloatArray:
    classes = source.shape[1]
    cell = track[:, None] * classes + np.arange(classes)
    of_class = summed((mass[:, None] * source).ravel(), cell.ravel(), tracks * classes)
    return of_class.reshape(tracks, classes)


class ReportedColumns(NamedTuple):
    """Columns of `pmbm.types.Tracks`, of the tracks that are reported."""

    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    velocity: FloatArray
    score: FloatArray
    label: NDArray[np.int8]
    covariance: FloatArray


def reported_in(
    density: Density,
    best: Index,
    exists: FloatArray,
    inside: FloatArray,
    *,
    above: float,
    exclusive: bool,
) -> tuple[Index, ReportedColumns, FloatArray]:
    """The tracks that are reported, and how: those that are objects with a probability (T,) above
    `above` and probably inside the view, as `best` (T,) has them; and P(class) (R,K) of each.

    exclusive : whether of two at one place one is held back.  What is known for longer has the
        priority, if it is there more probably than not.
    """
    if density.held is not None and kernels.native is not None:
        rows, columns, source = density.held.reported(best, exists, inside, above, exclusive, WHOLE)
    else:
        local = density.local
        rows, columns, source = _reported(
            density.track_id,
            best,
            exists,
            inside,
            local.mean,
            local.cov,
            local.box,
            local.label,
            local.marks.source,
            above,
            exclusive,
            WHOLE,
        )
    return rows, ReportedColumns(*columns), source


@twin("reported")
def _reported(
    track_id: IntArray,
    best: Index,
    exists: FloatArray,
    inside: FloatArray,
    mean: FloatArray,
    cov: FloatArray,
    box: FloatArray,
    label: NDArray[np.int8],
    source: FloatArray,
    above: float,
    exclusive: bool,
    whole: float,
) -> tuple[Index, tuple[Any, ...], FloatArray]:
    rows = np.flatnonzero((exists > above) & (inside > 0.5))
    if exclusive and len(rows) > 1:
        doubtful, at = exists[rows] <= 0.5, best[rows]
        order = np.lexsort((track_id[rows], doubtful))
        sure = len(order) - int(np.count_nonzero(doubtful))
        rows = rows[_suppress_overlaps(mean[at, :2], box[at], order, sure, whole)]
    at = best[rows]
    state, outline = mean[at], box[at]
    columns = (
        np.column_stack([state[:, :2], outline[:, 0]]),
        outline[:, 1:4].copy(),
        outline[:, 4].copy(),
        state[:, 2:4].copy(),
        exists[rows],
        label[at],
        cov[at],
    )
    return rows, columns, source[at]


def suppress_overlaps(position: FloatArray, box: FloatArray, order: Index, sure: int) -> Index:
    """Suppress overlapping reports: rows of those that are left.

    Of two, one's centre inside the other's box, the one with the higher priority is kept, unless
    the other is 1.5 times as large: trucks are detected in halves.

    position (N,2); box (N,5) : z, length, width, height, yaw; order (N,) : the rows by falling
    priority, of which the first `sure` may suppress others.
    """
    return _suppress_overlaps(position, box, order, sure, WHOLE)


@twin("suppress_overlaps")
def _suppress_overlaps(
    position: FloatArray, box: FloatArray, order: Index, sure: int, whole: float
) -> Index:
    area, stands = box[:, 1] * box[:, 2], np.zeros(len(position), bool)
    may_hold = np.zeros(len(position), bool)
    may_hold[order[:sure]] = True
    rivals_of = _at_one_place(position, box)
    for b in order.tolist():
        rivals = [a for a in rivals_of.get(b, []) if stands[a] and may_hold[a]]
        if all(area[b] > whole * area[a] for a in rivals):
            stands[rivals], stands[b] = False, True
    return np.flatnonzero(stands)


def _at_one_place(position: FloatArray, box: FloatArray) -> dict[int, list[int]]:
    """For each row, the others whose box holds its centre or whose centre is in its box."""
    rivals: dict[int, list[int]] = {}
    if len(position) < 2:
        return rivals
    from scipy.spatial import cKDTree

    reach = np.hypot(box[:, 1], box[:, 2]).max() / 2
    first, second = cKDTree(position).query_pairs(reach, output_type="ndarray").T
    between = position[second] - position[first]
    near = np.zeros(len(first), bool)
    for rows in (first, second):
        c, s = np.cos(box[rows, 4]), np.sin(box[rows, 4])
        along, across = c * between[:, 0] + s * between[:, 1], c * between[:, 1] - s * between[:, 0]
        near |= (np.abs(along) < box[rows, 1] / 2) & (np.abs(across) < box[rows, 2] / 2)
    for a, b in zip(first[near].tolist(), second[near].tolist(), strict=True):
        rivals.setdefault(a, []).append(b)
        rivals.setdefault(b, []).append(a)
    return rivals
