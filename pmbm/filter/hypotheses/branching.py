"""The K best children of each global hypothesis: which measurement each track takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmbm.assignment import k_best_choices
from pmbm.filter.density import Globals, Index, ragged, starts, summed
from pmbm.filter.hypotheses.clusters import joined, row_limit
from pmbm.filter.hypotheses.gating import GatedPairs
from pmbm.filter.hypotheses.weights import likely, log_of, normalised
from pmbm.types import FloatArray

LARGEST_SEARCH = 300_000
"""Options of a track and a measurement that are looked through in one cluster in one scan.  A
cluster of more, such as a scan of thousands of detections on one spot, goes on from its likeliest
parents alone and gives them fewer children, so that no frame stalls."""


@dataclass(frozen=True, eq=False, slots=True)
class Children:
    """Global hypotheses after the scan, N rows sorted by cluster.

    parent (N,) : row of the table of parents.
    log_weight (N,) : from w_parent and everything that the child says; the weights of one cluster's
        children add up to one.
    taker (t,), entry (t,), pair (t,) : child `taker` lets the member `entry` of its parent take the
        measurement of pair `pair`.  Members that take nothing are missed; measurements of the
        parent's cluster that nobody takes are new objects or clutter.
    dropped : how many children were too unlikely to be kept.
    """

    parent: Index
    log_weight: FloatArray
    taker: Index
    entry: Index
    pair: Index
    dropped: int


def branch(
    table: Globals,
    known: GatedPairs,
    log_missed: FloatArray,
    log_new: FloatArray,
    *,
    max_hypotheses: int,
    negligible: float,
    clustering: bool,
) -> tuple[Globals, int]:
    """The children of all global hypotheses, as `Association.hypotheses` has them, and how many
    were dropped; see `associate` for their number.

    log_missed (H,) : what missing each local hypothesis weighs.  log_new (M,) : what each
    measurement weighs as a new object or clutter.
    """
    H, M = len(log_missed), len(log_new)
    if clustering:
        parents, cluster_of = joined(table, H, known.row, known.measurement, M, max_hypotheses)
        allowed = row_limit(parents, max_hypotheses)
    else:
        parents, cluster_of = table, np.zeros(M, np.intp)
        allowed = np.full(parents.clusters, max_hypotheses)
    parents = _affordable(parents, np.bincount(known.row, minlength=H))
    children = best_children(
        parents, cluster_of, known, log_missed, log_new, allowed, log_of(negligible)
    )
    return _over_candidates(parents, children, cluster_of, known, H), children.dropped


def _affordable(parents: Globals, pairs_of: Index) -> Globals:
    """The heaviest rows of each cluster whose options are together at most `LARGEST_SEARCH`, one at
    least.  pairs_of (H,) : options of each local hypothesis."""
    choices = pairs_of[parents.member]
    if choices.sum() <= LARGEST_SEARCH:
        return parents
    options = summed(choices.astype(np.float64), parents.row_of_member(), len(parents))
    order = np.lexsort((-parents.log_weight, parents.cluster))
    first = np.flatnonzero(np.diff(parents.cluster, prepend=-1))
    so_far = np.cumsum(options[order])
    before = (so_far - options[order])[first]
    kept = np.zeros(len(parents), bool)
    kept[order] = so_far - before[parents.cluster] <= LARGEST_SEARCH
    kept[order[first]] = True
    length = np.diff(parents.start)
    return Globals(
        parents.cluster[kept],
        parents.log_weight[kept],
        starts(length[kept]),
        parents.member[np.repeat(kept, length)],
    )


def best_children(
    parents: Globals,
    cluster_of: Index,
    known: GatedPairs,
    log_missed: FloatArray,
    log_new: FloatArray,
    allowed: Index,
    log_negligible: float,
) -> Children:
    """The best children of every parent; one of weight w has at most ceil(`allowed` w), where
    `allowed` (C,) is for each cluster.

    The log weight of a child is that of its parent with all tracks missed and all measurements
    new, plus, for every track that takes a measurement, what taking it gains over that.
    """
    row_of_entry = parents.row_of_member()
    new_by_cluster = summed(log_new, cluster_of, parents.clusters)
    base = (
        parents.log_weight
        + summed(log_missed[parents.member], row_of_entry, len(parents))
        + new_by_cluster[parents.cluster]
    )
    # Options: every member of every parent with every measurement in its gate; a row is a
    # measurement as one parent sees it, a column a member.
    pairs_of = np.bincount(known.row, minlength=len(log_missed))
    choices = pairs_of[parents.member]
    entry = np.repeat(np.arange(len(parents.member)), choices)
    pair = ragged(starts(pairs_of)[parents.member], choices)
    order = np.lexsort((known.measurement[pair], row_of_entry[entry]))
    entry, pair = entry[order], pair[order]
    parent, measurement = row_of_entry[entry], known.measurement[pair]
    new_row = np.ones(len(order), bool)
    new_row[1:] = (parent[1:] != parent[:-1]) | (measurement[1:] != measurement[:-1])
    gain = known.log_weight - log_missed[known.row] - log_new[known.measurement]
    quota = np.ceil(allowed[parents.cluster] * np.exp(parents.log_weight) - 1e-9)
    options = summed(choices.astype(np.float64), row_of_entry, len(parents))
    quota = np.minimum(quota, LARGEST_SEARCH // np.maximum(options, 1))
    best = k_best_choices(
        np.cumsum(new_row) - 1,
        entry,
        -gain[pair],
        first_row=starts(np.bincount(parent[new_row], minlength=len(parents))),
        first_column=parents.start,
        ks=quota.clip(1).astype(np.intp),
        margin=-log_negligible,
    )
    of_child = parents.cluster[best.problem]
    log_weight = normalised(base[best.problem] - best.cost, of_child)
    kept = likely(log_weight, of_child, log_negligible)
    uses = kept[best.way]
    return Children(
        best.problem[kept],
        log_weight if kept.all() else normalised(log_weight[kept], of_child[kept]),
        (np.cumsum(kept) - 1)[best.way[uses]],
        entry[best.option[uses]],
        pair[best.option[uses]],
        int((~kept).sum()),
    )


def _over_candidates(
    parents: Globals, children: Children, cluster_of: Index, known: GatedPairs, H: int
) -> Globals:
    """The children as rows over the candidates; `cluster_of` (M,) is the measurements'."""
    n = len(known.row)
    members = np.diff(parents.start)[children.parent]
    first_member = starts(members)
    candidate = parents.member[ragged(parents.start[children.parent], members)]
    where = (
        first_member[children.taker]
        + children.entry
        - parents.start[children.parent[children.taker]]
    )
    candidate[where] = H + children.pair

    # Measurements of the child's cluster, minus those that a member takes.
    by_cluster = np.argsort(cluster_of, kind="stable")
    in_cluster = np.bincount(cluster_of, minlength=parents.clusters)
    first_of_cluster = np.cumsum(in_cluster) - in_cluster
    rank = np.empty(len(by_cluster), np.intp)
    rank[by_cluster] = np.arange(len(by_cluster)) - first_of_cluster[cluster_of[by_cluster]]
    cluster = parents.cluster[children.parent]
    free = in_cluster[cluster]
    first_free = starts(free)
    measurement = by_cluster[ragged(first_of_cluster[cluster], free)]
    unclaimed = np.ones(len(measurement), bool)
    unclaimed[first_free[children.taker] + rank[known.measurement[children.pair]]] = False
    child = np.concatenate(
        [
            np.repeat(np.arange(len(members)), members),
            np.repeat(np.arange(len(free)), free)[unclaimed],
        ]
    )
    order = np.argsort(child, kind="stable")
    member = np.concatenate([candidate, H + n + measurement[unclaimed]])[order]
    return Globals(
        cluster,
        children.log_weight,
        starts(np.bincount(child, minlength=len(members))),
        member,
    )
