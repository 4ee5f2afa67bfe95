"""Box 2 of 4, data association (Pang & Radha 2021, Sec. 2.3).

Every measurement is a known track's, a new object's, or clutter.  A *parent* is a global
hypothesis before the scan; its *children* say, on top of it, which measurement each track takes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pmbm.assignment import k_best_batch
from pmbm.filter.clusters import components, join
from pmbm.filter.density import Density, Globals, Index, Mixture, ragged, starts, summed
from pmbm.filter.gating import gate
from pmbm.filter.gaussian import Innovation
from pmbm.filter.models import Sensor
from pmbm.types import FloatArray

LOG_TINY = -700.0
"""Stands in for log 0 in weights, so that what nothing explains gets the smallest weight there is
and a step never fails."""
_ENUMERATE_UP_TO = 256
"""Children of one parent; above, the K best are found by assignment instead of listing them all."""


@dataclass(frozen=True, eq=False, slots=True)
class Pairs:
    """Gated pairs of a Gaussian and a measurement.

    row (n,) : of the local table, or of the PPP.  measurement (n,).
    y (n,2) : whitened innovation.
    log_weight (n,) : log(r P_D N(z)) of a local hypothesis, log(w P_D N(z)) of a PPP component.
    """

    row: Index
    measurement: Index
    y: FloatArray
    log_weight: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Children:
    """Global hypotheses after the scan, N rows sorted by cluster.

    parent (N,) : row of `Association.parents`.
    log_weight (N,) : log w_parent plus the log weight of everything that the child says.
    taker (t,), entry (t,), pair (t,) : child `taker` lets the member `entry` of its parent take the
        measurement of pair `pair`.  Members that take nothing are missed; measurements of the
        parent's cluster that nobody takes are new objects or clutter.
    """

    parent: Index
    log_weight: FloatArray
    taker: Index
    entry: Index
    pair: Index


@dataclass(frozen=True, eq=False, slots=True)
class Association:
    """Everything that one scan says about the hypotheses.

    parents : the global hypotheses, joined where a measurement ties clusters together.
    cluster (M,) : the (joined) cluster that each measurement belongs to.
    known : pairs of local hypotheses and measurements.
    undetected : pairs of PPP components and measurements, sorted by measurement.
    log_missed (H,) : log(1 - r P_D).  detection (H,) and detection_undetected (P,) : P_D.
    log_first (M,) : log e, e = sum of w P_D N(z) over gated PPP components; -inf where none is.
    log_new (M,) : log(lambda_c + e).
    """

    parents: Globals
    cluster: Index
    known: Pairs
    undetected: Pairs
    log_missed: FloatArray
    detection: FloatArray
    detection_undetected: FloatArray
    log_first: FloatArray
    log_new: FloatArray
    children: Children


def associate(
    density: Density,
    z: FloatArray,
    sensor: Sensor,
    *,
    gate_threshold: float,
    max_hypotheses: int,
    clustering: bool = True,
) -> Association:
    """Gate, price and rank the association hypotheses of measurements z (M,2).

    A parent of weight w has at most ceil(`max_hypotheses` w) children, its best.
    """
    local, table = density.local, density.hypotheses
    detection, detection_if_seen = sensor.of_tracks(local)
    known = _gated(
        local.mean, local.cov, _log(local.existence * detection_if_seen), z, sensor, gate_threshold
    )
    log_missed = np.log(np.maximum(1 - local.existence * detection, math.exp(LOG_TINY)))

    ppp = density.undetected
    detection_undetected = sensor.detection_probability(ppp.mean, ppp.cov)
    undetected, log_first = _first_detections(
        ppp, ppp.log_weight + _log(detection_undetected), z, sensor, gate_threshold
    )
    log_new = np.maximum(np.logaddexp(log_first, _log(sensor.clutter)), LOG_TINY)

    if clustering:
        cluster_of = np.empty(len(local), np.intp)
        cluster_of[table.member] = np.repeat(table.cluster, np.diff(table.start))
        number, joined, cluster = components(
            table.clusters, len(z), cluster_of[known.row], known.measurement
        )
        parents = join(table, joined, number, max_hypotheses)
    else:
        parents, cluster = table, np.zeros(len(z), np.intp)

    children = _children(parents, cluster, known, log_missed, log_new, max_hypotheses)
    return Association(
        parents,
        cluster,
        known,
        undetected,
        log_missed,
        detection,
        detection_undetected,
        log_first,
        log_new,
        children,
    )


def _log(value: FloatArray | float) -> FloatArray:
    with np.errstate(divide="ignore"):
        return np.log(value)


def _gated(
    mean: FloatArray,
    cov: FloatArray,
    log_prior: FloatArray,
    z: FloatArray,
    sensor: Sensor,
    threshold: float,
) -> Pairs:
    """Pairs within the gate; a Gaussian that cannot be detected (-inf in `log_prior`) has none."""
    innovation = Innovation.of(mean, cov, sensor.R)
    row, measurement, y = gate(innovation, z, threshold)
    log_weight = (
        log_prior[row] + innovation.log_norm()[row] - 0.5 * (y[:, 0] * y[:, 0] + y[:, 1] * y[:, 1])
    )
    possible = log_weight > -np.inf
    if not possible.all():
        row, measurement, y = row[possible], measurement[possible], y[possible]
        log_weight = log_weight[possible]
    return Pairs(row, measurement, y, log_weight)


def _first_detections(
    ppp: Mixture, log_detected: FloatArray, z: FloatArray, sensor: Sensor, threshold: float
) -> tuple[Pairs, FloatArray]:
    """Gated pairs of PPP components and measurements, sorted by measurement, and log e (M,)."""
    pairs = _gated(ppp.mean, ppp.cov, log_detected, z, sensor, threshold)
    order = np.argsort(pairs.measurement, kind="stable")
    pairs = Pairs(
        pairs.row[order], pairs.measurement[order], pairs.y[order], pairs.log_weight[order]
    )
    log_first = np.full(len(z), -np.inf)
    if len(order):
        count = np.bincount(pairs.measurement, minlength=len(z))
        seen = np.flatnonzero(count)
        first = (np.cumsum(count) - count)[seen]
        top = np.maximum.reduceat(pairs.log_weight, first)
        share = np.exp(pairs.log_weight - np.repeat(top, count[seen]))
        log_first[seen] = top + np.log(np.add.reduceat(share, first))
    return pairs, log_first


def _children(
    parents: Globals,
    cluster: Index,
    known: Pairs,
    log_missed: FloatArray,
    log_new: FloatArray,
    max_hypotheses: int,
) -> Children:
    """The best children of every parent.

    The log weight of a child is that of its parent with all tracks missed and all measurements
    new, plus, for every track that takes a measurement, what taking it gains over that.
    """
    row_of_entry = parents.row_of_member()
    new_by_cluster = summed(log_new, cluster, parents.clusters)
    base = (
        parents.log_weight
        + summed(log_missed[parents.member], row_of_entry, len(parents))
        + new_by_cluster[parents.cluster]
    )
    # Options: every member of every parent with every measurement in its gate.
    pairs_of = np.bincount(known.row, minlength=len(log_missed))
    first_pair = starts(pairs_of)
    choices = pairs_of[parents.member]
    entry = np.repeat(np.arange(len(parents.member)), choices)
    pair = ragged(first_pair[parents.member], choices)
    parent = row_of_entry[entry]
    order = np.lexsort((known.measurement[pair], parent))
    options = _Options(parent[order], entry[order], pair[order], known)
    gain = (known.log_weight - log_missed[known.row] - log_new[known.measurement])[options.pair]

    quota = np.ceil(max_hypotheses * np.exp(parents.log_weight) - 1e-9).astype(np.intp)
    quota = np.maximum(quota, 1)
    few = options.combinations(len(parents)) <= _ENUMERATE_UP_TO
    listed = _enumerate(options, np.flatnonzero(few), len(parents))
    listed = _within_quota(listed, base, gain, quota)
    ranked = _rank(options, np.flatnonzero(~few), gain, quota)

    child_parent = np.concatenate([listed.parent, ranked.parent])
    taker = np.concatenate([listed.taker, ranked.taker + len(listed.parent)])
    option = np.concatenate([listed.option, ranked.option])
    order = np.argsort(child_parent, kind="stable")
    position = np.empty(len(order), np.intp)
    position[order] = np.arange(len(order))
    weight = base[child_parent] + summed(gain[option], taker, len(child_parent))
    return Children(
        child_parent[order],
        weight[order],
        position[taker],
        options.entry[option],
        options.pair[option],
    )


class _Options:
    """Who may take what: n options sorted by parent, then measurement.

    parent, entry, pair (n,).  A *group* is a parent's options for one measurement.
    """

    def __init__(self, parent: Index, entry: Index, pair: Index, known: Pairs) -> None:
        self.parent, self.entry, self.pair = parent, entry, pair
        measurement = known.measurement[pair]
        first = np.ones(len(parent), bool)
        first[1:] = (parent[1:] != parent[:-1]) | (measurement[1:] != measurement[:-1])
        self.group_start = np.flatnonzero(first)
        self.group_size = np.diff(self.group_start, append=len(parent))
        self.group_parent = parent[self.group_start]

    def groups_of(self, parents: int) -> tuple[Index, Index]:
        """First group (parents,) and number of groups (parents,) of each parent."""
        count = np.bincount(self.group_parent, minlength=parents)
        return np.cumsum(count) - count, count

    def combinations(self, parents: int) -> FloatArray:
        """(parents,) bound on the number of children: product over groups of 1 + size."""
        doublings = np.bincount(
            self.group_parent, np.log2(1.0 + self.group_size), minlength=parents
        )
        return np.exp2(np.minimum(doublings, 1000.0))


@dataclass(frozen=True, eq=False, slots=True)
class _Listed:
    """Children as found: parent (N,); child `taker` (t,) uses `option` (t,)."""

    parent: Index
    taker: Index
    option: Index


def _enumerate(options: _Options, rows: Index, parents: int) -> _Listed:
    """All children of the parents `rows`, measurement by measurement, for all parents at once."""
    first_group, groups = options.groups_of(parents)
    parent = rows
    used = np.zeros((len(rows), 0), np.intp)
    for level in range(int(groups[rows].max(initial=0))):
        has = np.flatnonzero(groups[parent] > level)
        group = first_group[parent[has]] + level
        size = options.group_size[group]
        child = np.repeat(has, size)
        option = ragged(options.group_start[group], size)
        if level:
            entry = options.entry[option]
            before = used[child]
            free = ~((before >= 0) & (options.entry[before] == entry[:, None])).any(axis=1)
            child, option = child[free], option[free]
        untaken = np.full((len(parent), 1), -1, np.intp)
        used = np.concatenate(
            [np.hstack([used, untaken]), np.hstack([used[child], option[:, None]])]
        )
        parent = np.concatenate([parent, parent[child]])
    taker, column = np.nonzero(used >= 0)
    return _Listed(parent, taker, used[taker, column])


def _within_quota(listed: _Listed, base: FloatArray, gain: FloatArray, quota: Index) -> _Listed:
    """Only the best `quota[parent]` children of each parent."""
    count = np.bincount(listed.parent, minlength=len(quota))
    if (count <= quota).all():
        return listed
    weight = summed(gain[listed.option], listed.taker, len(listed.parent))
    order = np.lexsort((-weight, listed.parent))
    rank = np.arange(len(order)) - (np.cumsum(count) - count)[listed.parent[order]]
    keep = np.zeros(len(order), bool)
    keep[order] = rank < quota[listed.parent[order]]
    renumber = np.cumsum(keep) - 1
    kept = keep[listed.taker]
    return _Listed(listed.parent[keep], renumber[listed.taker[kept]], listed.option[kept])


def _rank(options: _Options, rows: Index, gain: FloatArray, quota: Index) -> _Listed:
    """The best `quota[parent]` children of the parents `rows`, by Murty's algorithm.

    One assignment problem a parent: rows are measurements in a gate, columns the members that may
    take them and one "new or clutter" per measurement, at cost 0.
    """
    if not len(rows):
        nothing = np.zeros(0, np.intp)
        return _Listed(nothing, nothing, nothing)
    problems, option_at = [], []
    bounds = np.searchsorted(options.parent, np.stack([rows, rows + 1]))
    for first, last in bounds.T.tolist():
        chosen = np.arange(first, last)
        measurement = np.searchsorted(options.group_start, chosen, side="right")
        measurement -= measurement[0]
        members, column = np.unique(options.entry[chosen], return_inverse=True)
        size = int(measurement[-1]) + 1
        cost = np.full((size, len(members) + size), np.inf)
        cost[np.arange(size), len(members) + np.arange(size)] = 0.0
        cost[measurement, column] = -gain[chosen]
        at = np.full(cost.shape, -1, np.intp)
        at[measurement, column] = chosen
        problems.append(cost)
        option_at.append(at)
    solutions = k_best_batch(problems, quota[rows].tolist())
    parent, taker, option = [], [], []
    children = 0
    for row, at, (columns, _) in zip(rows.tolist(), option_at, solutions, strict=True):
        taken = at[np.arange(at.shape[0]), columns]
        child, which = np.nonzero(taken >= 0)
        parent.append(np.full(len(columns), row, np.intp))
        taker.append(children + child)
        option.append(taken[child, which])
        children += len(columns)
    return _Listed(np.concatenate(parent), np.concatenate(taker), np.concatenate(option))
