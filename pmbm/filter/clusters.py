"""Independent clusters of tracks: joining those that a measurement ties together, and splitting
off what no longer depends on anything else."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pmbm.filter.density import Globals, Index, ragged, starts, summed
from pmbm.types import FloatArray


def components(
    clusters: int, measurements: int, pair_cluster: Index, pair_measurement: Index
) -> tuple[int, Index, Index]:
    """Connected components of the graph of clusters and measurements tied by gated pairs.

    Gives their number, the component of each cluster (C,) and of each measurement (M,).  Component
    numbers rise with the clusters' as long as none are joined.
    """
    component = np.full(measurements, -1, np.intp)
    component[pair_measurement] = pair_cluster
    if np.array_equal(component[pair_measurement], pair_cluster):
        # No measurement ties two clusters together.
        alone = np.flatnonzero(component < 0)
        component[alone] = clusters + np.arange(len(alone))
        return clusters + len(alone), np.arange(clusters), component
    nodes = clusters + measurements
    graph = coo_array(
        (np.ones(len(pair_cluster), np.int8), (pair_cluster, clusters + pair_measurement)),
        shape=(nodes, nodes),
    )
    number, label = connected_components(graph, directed=False)
    label = label.astype(np.intp)
    return int(number), label[:clusters], label[clusters:]


def join(table: Globals, component: Index, number: int, cap: int) -> Globals:
    """The product of the hypotheses of the clusters of each component.

    component (C,) of each cluster, out of `number`.  A component without clusters gets one empty
    hypothesis.  Where a product would have more than `cap` rows, its `cap` best are kept, which
    are exact: a row among the best of a product is made of rows among the best of each factor.
    """
    if np.array_equal(component, np.arange(table.clusters)):
        return _with_empty_clusters(table, number - table.clusters)
    joint, source, joint_component = _product_rows(table, component, number, cap)
    rows = len(joint_component)
    count = np.bincount(joint, np.diff(table.start)[source], minlength=rows).astype(np.intp)
    member = table.member[ragged(table.start[source], np.diff(table.start)[source])]
    log_weight = summed(table.log_weight[source], joint, rows)
    return Globals(joint_component, log_weight, starts(count), member)


def _with_empty_clusters(table: Globals, more: int) -> Globals:
    """The table and so many clusters of one empty hypothesis after it."""
    if not more:
        return table
    return Globals(
        np.concatenate([table.cluster, table.clusters + np.arange(more)]),
        np.concatenate([table.log_weight, np.zeros(more)]),
        np.concatenate([table.start, np.full(more, table.start[-1])]),
        table.member,
    )


def _product_rows(
    table: Globals, component: Index, number: int, cap: int
) -> tuple[Index, Index, Index]:
    """Pairs (row of the product, row of `table` it is made of), sorted by the former, and the
    component of each row of the product, ascending."""
    row_component = component[table.cluster]
    size = np.bincount(table.cluster, minlength=table.clusters)
    factors = np.bincount(component, minlength=number)
    branching = np.bincount(component, size > 1, minlength=number)
    # Components whose product has one row per row of their only cluster, or one row in all.
    plain = (factors <= 1) | (branching == 0)
    made_of = np.flatnonzero(plain[row_component])
    by_component = made_of[np.argsort(row_component[made_of], kind="stable")]
    owner = row_component[by_component]
    one_row = branching == 0
    rows_of = np.where(one_row, 1, np.bincount(owner, minlength=number))
    products = {}
    first_row = _first_row(table)
    for label in np.flatnonzero(~plain).tolist():
        members = np.flatnonzero(component == label)
        products[label] = _best_of_product(
            [np.arange(first_row[c], first_row[c] + size[c]) for c in members],
            table.log_weight,
            cap,
        )
        rows_of[label] = len(products[label])
    first = starts(rows_of)[:-1]
    rank = np.arange(len(owner)) - np.searchsorted(owner, owner)
    joint_parts = [first[owner] + np.where(one_row[owner], 0, rank)]
    source_parts = [by_component]
    for label, made in products.items():
        joint_parts.append(np.repeat(first[label] + np.arange(len(made)), made.shape[1]))
        source_parts.append(made.ravel())
    joint, source = np.concatenate(joint_parts), np.concatenate(source_parts)
    order = np.argsort(joint, kind="stable")
    return joint[order], source[order], np.repeat(np.arange(number), rows_of)


def _best_of_product(factors: list[Index], log_weight: FloatArray, cap: int) -> Index:
    """(n, factors) rows chosen from each factor, for the `cap` likeliest combinations."""
    total = np.zeros(1)
    chosen = np.zeros((1, 0), np.intp)
    for rows in sorted(factors, key=len):
        sums = (total[:, None] + log_weight[rows]).ravel()
        best = np.sort(np.argsort(-sums, kind="stable")[:cap])
        total = sums[best]
        chosen = np.column_stack([chosen[best // len(rows)], rows[best % len(rows)]])
    return chosen


def split(table: Globals, locals_count: int) -> Globals:
    """The same mixture with every track that is certain in its cluster in a cluster of its own.

    A local hypothesis that belongs to all global hypotheses of its cluster is independent of what
    the rest of the cluster does.
    """
    size = np.bincount(table.cluster, minlength=table.clusters)
    row = table.row_of_member()
    member_cluster = table.cluster[row]
    times = np.bincount(table.member, minlength=locals_count)
    certain = times[table.member] == size[member_cluster]
    open_cluster = np.zeros(table.clusters, bool)
    open_cluster[member_cluster[~certain]] = True
    alone = np.flatnonzero(certain & (row == _first_row(table)[member_cluster]))
    kept = np.flatnonzero(open_cluster[table.cluster])
    renumber = np.cumsum(open_cluster) - 1
    count = np.bincount(row[~certain], minlength=len(table))[kept]
    open_clusters = int(open_cluster.sum())
    return Globals(
        cluster=np.concatenate(
            [renumber[table.cluster[kept]], open_clusters + np.arange(len(alone))]
        ),
        log_weight=np.concatenate([table.log_weight[kept], np.zeros(len(alone))]),
        start=starts(np.concatenate([count, np.ones(len(alone), np.intp)])),
        member=np.concatenate([table.member[~certain], table.member[alone]]),
    )


def _first_row(table: Globals) -> Index:
    return np.searchsorted(table.cluster, np.arange(table.clusters))
