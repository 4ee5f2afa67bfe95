"""The trajectory metric: GOSPA over whole trajectories, with a cost for switching tracks.

Garcia-Fernandez, Rahmathullah, Svensson, "A metric on the space of finite sets of trajectories for
evaluation of multi-target tracking algorithms", IEEE TSP 68, 2020, in the linear-programming form:

    d^p = min over W of  sum_k [ cost of W_k ] + gamma^p / 2  sum_k sum_ij |W_k+1(i,j) - W_k(i,j)|

with soft assignments W_k of objects to tracks, each row and column summing to at most one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, eye_array, hstack, vstack
from scipy.sparse.csgraph import connected_components

from pmbm.arrays import FloatArray, IntArray
from pmbm.errors import InputError
from pmbm.metrics.core.family import Family, Tally, Work
from pmbm.metrics.core.formulas import Totals
from pmbm.metrics.core.points import check_cutoff_and_order
from pmbm.metrics.core.result import Counts, Metric
from pmbm.metrics.core.scene import ScoredScene


@dataclass(frozen=True, kw_only=True)
class Tgospa:
    """distance, m; its parts add up to distance^order.  The parts are unique only up to ties
    between equally cheap assignments."""

    distance: float
    localisation: float
    missed: float
    false: float
    switch: float


def tgospa(
    scene: ScoredScene, *, cutoff: float = 4.0, order: float = 2.0, switch: float = 2.0
) -> Tgospa:
    """The trajectory metric between the objects and the tracks of a scene.

    cutoff : c > 0, m.  order : p >= 1.  switch : gamma > 0, m: an object that changes from one
    track to another adds gamma^p; from a track to none, or back, half of it.

    Objects and tracks that are never nearer than the cutoff to each other have nothing to decide
    and fall into clusters, each solved alone; frames without any near pair of a cluster can keep
    the assignment of the frame before, so they are left out of its program.
    """
    check_cutoff_and_order(cutoff, order)
    if not 0 < switch < np.inf:
        raise InputError("bad switch cost", field="switch", expected="above 0 m", got=switch)
    near = scene.near(cutoff)
    truth_id = scene.truth.index[near.truth]
    track_id = scene.tracks.index[near.track]
    power = near.distance**order
    assigned = localisation = switched = 0.0
    for rows in _clusters(truth_id, track_id):
        weight, changes = _assign(
            near.frame[rows],
            truth_id[rows],
            track_id[rows],
            cutoff**order - power[rows],
            switch**order / 2,
        )
        assigned += float(weight.sum())
        localisation += float((weight * power[rows]).sum())
        switched += switch**order / 2 * changes
    missed = cutoff**order / 2 * (len(scene.truth) - assigned)
    false = cutoff**order / 2 * (len(scene.tracks) - assigned)
    return Tgospa(
        distance=(localisation + missed + false + switched) ** (1 / order),
        localisation=localisation,
        missed=missed,
        false=false,
        switch=switched,
    )


def _clusters(truth_id: IntArray, track_id: IntArray) -> list[IntArray]:
    """Near pairs of rows grouped by connected objects and tracks."""
    if len(truth_id) == 0:
        return []
    objects, nodes = int(truth_id.max()) + 1, int(truth_id.max() + track_id.max()) + 2
    graph = coo_array((np.ones(len(truth_id)), (truth_id, track_id + objects)), (nodes, nodes))
    label = connected_components(graph, directed=False)[1][truth_id]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _assign(
    frame: IntArray, truth_id: IntArray, track_id: IntArray, gain: FloatArray, change_cost: float
) -> tuple[FloatArray, float]:
    """The best weight of each near pair of rows of one cluster, and the sum of all changes.

    Maximises gain minus changes: variables are the weight of every id pair at every frame with a
    near pair, and the changes between consecutive ones.
    """
    step = np.unique(frame, return_inverse=True)[1]
    steps = int(step.max()) + 1
    ids, pair = np.unique(np.stack([truth_id, track_id]), axis=1, return_inverse=True)
    pairs = ids.shape[1]
    if pairs == 1:
        return np.ones(len(frame)), 0.0
    cell = step * pairs + pair
    size = steps * pairs
    benefit = np.zeros(size)
    benefit[cell] = gain

    # Each object and each track is assigned at most once in a step.
    at_most_once = []
    for side in ids:
        number = np.unique(side, return_inverse=True)[1]
        rows = int(number.max()) + 1
        row = (np.arange(steps)[:, None] * rows + number).ravel()
        at_most_once.append(
            coo_array((np.ones(size), (row, np.arange(size))), (steps * rows, size))
        )
    limits = vstack(at_most_once)
    bounds = np.ones(limits.shape[0])
    changes = (steps - 1) * pairs
    if changes:
        step_up = (eye_array(changes, size, k=pairs) - eye_array(changes, size)).tocoo()
        slack = -eye_array(changes)
        none = coo_array((limits.shape[0], changes))
        limits = vstack(
            [hstack([limits, none]), hstack([step_up, slack]), hstack([-step_up, slack])]
        )
        bounds = np.concatenate([bounds, np.zeros(2 * changes)])
    cost = np.concatenate([-benefit, np.full(changes, change_cost)])
    solution = linprog(cost, A_ub=limits.tocsr(), b_ub=bounds, bounds=(0, None), method="highs")
    if not solution.success:
        raise RuntimeError(f"the linear program of a T-GOSPA cluster failed: {solution.message}")
    return solution.x[:size][cell], float(solution.x[size:].sum())


@dataclass(frozen=True)
class RootOfSum:
    """The sum of the parts, to the power 1 / order."""

    parts: tuple[str, ...]

    def __call__(self, counts: Counts) -> float:
        total: float = sum(counts[part] for part in self.parts) ** (1 / counts["order"])
        return total


def _count(work: Work) -> Tally:
    p = work.parameters
    result = tgospa(
        work.scene, cutoff=p.tgospa_cutoff, order=p.tgospa_order, switch=p.tgospa_switch
    )
    return Tally.of(
        {key: value for key, value in vars(result).items() if key != "distance"},
        cutoff=p.tgospa_cutoff,
        order=p.tgospa_order,
        switch_cost=p.tgospa_switch,
        distance="xy",
    )


_PARTS: Final = ("localisation", "missed", "false", "switch")

FAMILY: Final = Family(
    name="tgospa",
    rule="trajectory GOSPA, a linear program: costly",
    count=_count,
    metrics=(
        Metric(
            name="tgospa",
            unit="m",
            direction="lower",
            default=False,
            question="How far are whole trajectories off, switches of identity included?",
            formula=RootOfSum(_PARTS),
            parts=Totals(_PARTS),
        ),
    ),
)
