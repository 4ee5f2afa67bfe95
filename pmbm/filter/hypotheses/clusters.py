"""Independent clusters of tracks: joined where a measurement is in the gates of both, split where
they have become independent."""

from __future__ import annotations

import numpy as np

from pmbm.filter.density import Globals, Index, ragged, starts, summed
from pmbm.types import ABSENT, FloatArray

_SPLITMIX = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB], np.uint64)
TRACKS_IN_FULL = 30
"""A cluster of at most so many tracks keeps as many hypotheses as the configuration says; one of
more keeps fewer, so that no frame takes longer than its number of objects warrants."""
_LEAST_TABLE, _MOST_TABLE = 6000, 10**9
WORTH_FACTORING = 32
"""Members in a cluster's table, above which a split may save more than it costs."""


def largest_table(cap: int) -> int:
    """Members, over all hypotheses, that the table of one cluster may have, where `cap` hypotheses
    are kept of each: `cap` for each of `TRACKS_IN_FULL` tracks, but no fewer than 6000."""
    return min(max(_LEAST_TABLE, TRACKS_IN_FULL * cap), _MOST_TABLE)


def joined(
    table: Globals,
    locals_count: int,
    pair_row: Index,
    pair_measurement: Index,
    measurements: int,
    cap: int,
) -> tuple[Globals, Index]:
    """The hypotheses with the clusters joined that gated pairs of a local hypothesis and a
    measurement tie together, at most `cap` rows each, and the cluster of each measurement (M,).

    A measurement in the gate of none has a cluster of its own, of one empty hypothesis.
    """
    # Those that no hypothesis mentions belong nowhere; they must not belong to noise.
    cluster_of = np.zeros(locals_count, np.intp)
    cluster_of[table.member] = np.repeat(table.cluster, np.diff(table.start))
    number, component, of_measurement = components(
        table.clusters, measurements, cluster_of[pair_row], pair_measurement
    )
    return join(table, component, number, cap), of_measurement


def components(
    clusters: int, measurements: int, pair_cluster: Index, pair_measurement: Index
) -> tuple[int, Index, Index]:
    """Connected components of the graph of clusters and measurements tied by gated pairs.

    Gives their number, the component of each cluster (C,) and of each measurement (M,).  Clusters
    that are joined with none come first, in their order; then those that are; then measurements in
    the gate of none.
    """
    component = np.full(measurements, -1, np.intp)
    component[pair_measurement] = pair_cluster
    of_cluster, joined = np.arange(clusters), clusters
    ties = np.flatnonzero(component[pair_measurement] != pair_cluster)
    if len(ties):
        one, other = pair_cluster[ties], component[pair_measurement[ties]]
        tied, node = np.unique(np.concatenate([one, other]), return_inverse=True)
        label = _connected(node[: len(ties)], node[len(ties) :], len(tied))
        apart = np.ones(clusters, bool)
        apart[tied] = False
        of_cluster = np.cumsum(apart) - 1
        of_cluster[tied] = clusters - len(tied) + label
        joined = clusters - len(tied) + int(label.max()) + 1
    gated = component >= 0
    alone = np.flatnonzero(~gated)
    component[gated] = of_cluster[component[gated]]
    component[alone] = joined + np.arange(len(alone))
    return joined + len(alone), of_cluster, component


def _connected(one: Index, other: Index, nodes: int) -> Index:
    """(nodes,) number, from 0, of the connected component of each node of a small graph.

    The least node of a component spreads along its edges; scipy's routine costs more than a whole
    frame of few objects.
    """
    least = np.arange(nodes)
    while True:
        low = np.minimum(least[one], least[other])
        spread = least.copy()
        np.minimum.at(spread, one, low)
        np.minimum.at(spread, other, low)
        spread = spread[spread]
        if np.array_equal(spread, least):
            return np.unique(least, return_inverse=True)[1]
        least = spread


def join(table: Globals, component: Index, number: int, cap: int) -> Globals:
    """The product of the hypotheses of the clusters of each component, as `components` numbers
    them: clusters that stay apart, then products, then components without clusters, which get one
    empty hypothesis.

    Where a product would have more than `cap` rows (fewer, by `largest_table`), the best are kept;
    they are exact, since a row among the best of a product is made of rows among the best of each
    factor.
    """
    joined = np.bincount(component, minlength=number)[component] > 1
    if not joined.any():
        return _with_empty_clusters(table, number - table.clusters)
    rows_joined = joined[table.cluster]
    apart = _rows_of(table, ~rows_joined)
    products = _product(_rows_of(table, rows_joined), component[joined] - apart.clusters, cap)
    known = _stacked([apart, products])
    return _with_empty_clusters(known, number - known.clusters)


def _product(table: Globals, component: Index, cap: int) -> Globals:
    """The product of the clusters of each component (C,), numbered from 0."""
    joint, source, joint_component = _product_rows(table, component, int(component.max()) + 1, cap)
    rows, length = len(joint_component), np.diff(table.start)
    count = np.bincount(joint, length[source], minlength=rows).astype(np.intp)
    return Globals(
        joint_component,
        summed(table.log_weight[source], joint, rows),
        starts(count),
        table.member[ragged(table.start[source], length[source])],
    )


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
    order = np.argsort(component, kind="stable")
    owner = component[order]
    size = np.bincount(table.cluster, minlength=table.clusters)
    breadth = (summed(np.diff(table.start), table.cluster, table.clusters) / size)[order]
    size, first_row = size[order], _first_row(table)[order]
    begin = np.searchsorted(owner, np.arange(number))
    factors = np.diff(begin, append=len(owner))
    most = largest_table(cap)
    limit = np.clip(most / np.maximum(summed(breadth, owner, number), 1.0), 1, cap)

    # A product's rows are counted like the digits of a clock: one wheel a factor.
    stride = np.ones(len(owner), np.intp)
    rank = np.arange(len(owner)) - begin[owner]
    for wheel in range(1, int(factors.max())):
        at = np.flatnonzero(rank == wheel)
        stride[at] = np.minimum(stride[at - 1] * size[at - 1], most + 1)
    rows_of = stride[begin + factors - 1] * size[begin + factors - 1]
    too_many = rows_of > limit
    best = {
        label: _best_of_product(
            [
                np.arange(first_row[k], first_row[k] + size[k])
                for k in range(begin[label], begin[label] + factors[label])
            ],
            table.log_weight,
            int(limit[label]),
        )
        for label in np.flatnonzero(too_many).tolist()
    }
    for label, made in best.items():
        rows_of[label] = len(made)
    first = starts(rows_of)[:-1]
    whole = np.flatnonzero(~too_many[owner])
    factor_of = np.repeat(whole, rows_of[owner[whole]])
    row = ragged(np.zeros(len(whole), np.intp), rows_of[owner[whole]])
    joint_parts = [first[owner[factor_of]] + row]
    source_parts = [first_row[factor_of] + row // stride[factor_of] % size[factor_of]]
    for label, made in best.items():
        joint_parts.append(np.repeat(first[label] + np.arange(len(made)), made.shape[1]))
        source_parts.append(made.ravel())
    joint, source = np.concatenate(joint_parts), np.concatenate(source_parts)
    by_row = np.argsort(joint, kind="stable")
    return joint[by_row], source[by_row], np.repeat(np.arange(number), rows_of)


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


def merge_equal(table: Globals) -> Globals:
    """Global hypotheses of one cluster that say the same become one, of their weights' sum.

    Rows are compared by the sum of a 64-bit hash of each of their members.
    """
    if len(table) == table.clusters:
        return table
    # One is added, since zero hashes to zero and would look like an absent member.
    key = (table.member + 1).astype(np.uint64) * _SPLITMIX[0]
    key = (key ^ (key >> np.uint64(30))) * _SPLITMIX[1]
    key = (key ^ (key >> np.uint64(27))) * _SPLITMIX[2]
    key ^= key >> np.uint64(31)
    running = np.zeros(len(key) + 1, np.uint64)
    np.cumsum(key, out=running[1:])
    total = running[table.start[1:]] - running[table.start[:-1]]
    order = np.lexsort((total, table.cluster))
    new = np.ones(len(order), bool)
    new[1:] = (np.diff(total[order]) != 0) | (np.diff(table.cluster[order]) != 0)
    if new.all():
        return table
    first = np.flatnonzero(new)
    kept = order[first]
    top = np.maximum.reduceat(table.log_weight[order], first)
    count = np.diff(first, append=len(order))
    weight = np.exp(table.log_weight[order] - np.repeat(top, count))
    log_weight = table.log_weight.copy()
    log_weight[kept] = top + np.log(np.add.reduceat(weight, first))
    mask = np.zeros(len(table), bool)
    mask[kept] = True
    members = np.diff(table.start)
    return Globals(
        table.cluster[mask],
        log_weight[mask],
        starts(members[mask]),
        table.member[np.repeat(mask, members)],
    )


def row_limit(table: Globals, cap: int) -> Index:
    """(C,) hypotheses that each cluster may have: `cap`, or fewer where that many would hold more
    than `largest_table` members."""
    length, most = np.diff(table.start), largest_table(cap)
    if length.max(initial=0) * cap <= most:
        return np.full(table.clusters, cap)
    rows = np.bincount(table.cluster, minlength=table.clusters)
    members = summed(length, table.cluster, table.clusters)
    return np.clip(most * rows / np.maximum(members, 1.0), 1, cap).astype(np.intp)


def factor(table: Globals, track: Index, tolerance: float) -> Globals:
    """The mixture with large clusters taken apart where groups of their tracks hardly depend on
    one another: each such cluster becomes the product of its groups' marginal tables.

    track (H,) of each local hypothesis.  Two tracks depend on each other by the sum, over their
    pairs of local hypotheses, of |P(both) - P(one) P(other)|; groups are connected by pairs above
    `tolerance`.
    """
    if tolerance <= 0:
        return table
    rows = np.bincount(table.cluster, minlength=table.clusters)
    members = summed(np.diff(table.start), table.cluster, table.clusters)
    large = (members > WORTH_FACTORING) & (rows >= 4)
    if not large.any():
        return table
    parts = [_rows_of(table, ~large[table.cluster])]
    first_row = _first_row(table)
    for cluster in np.flatnonzero(large).tolist():
        own = slice(first_row[cluster], first_row[cluster] + rows[cluster])
        choice, weight = _dense(table, own, track), np.exp(table.log_weight[own])
        parts += [
            _marginal(choice[:, group], weight) for group in _groups(choice, weight, tolerance)
        ]
    return _stacked(parts)


def _dense(table: Globals, rows: slice, track: Index) -> Index:
    """(G,J) local hypothesis of each track in each of these rows, or ABSENT."""
    first, last = table.start[rows.start], table.start[rows.stop]
    member = table.member[first:last]
    tracks, column = np.unique(track[member], return_inverse=True)
    choice = np.full((rows.stop - rows.start, len(tracks)), ABSENT, np.intp)
    count = np.diff(table.start[rows.start : rows.stop + 1])
    choice[np.repeat(np.arange(len(count)), count), column] = member
    return choice


def _groups(choice: Index, weight: FloatArray, tolerance: float) -> list[Index]:
    """Columns of a dense table (G,J), in groups that hardly depend on each other."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    tracks = choice.shape[1]
    present = choice != ABSENT
    names, column = np.unique(choice[present], return_inverse=True)
    taken = np.zeros((len(choice), len(names)))
    row, owner = np.nonzero(present)
    taken[row, column] = 1.0
    of_track = np.zeros((len(names), tracks))
    of_track[column, owner] = 1.0
    p = weight @ taken
    dependence = np.abs((taken * weight[:, None]).T @ taken - np.outer(p, p))
    between = of_track.T @ dependence @ of_track
    number, label = connected_components(coo_array(between > tolerance), directed=False)
    return [np.flatnonzero(label == one) for one in range(number)]


def _marginal(choice: Index, weight: FloatArray) -> Globals:
    """A table of the distinct rows of a dense one, each with the weight of all that are equal to
    it."""
    rows, which = np.unique(choice, axis=0, return_inverse=True)
    present = rows != ABSENT
    return Globals(
        np.zeros(len(rows), np.intp),
        np.log(summed(weight, which.ravel(), len(rows))),
        starts(present.sum(axis=1)),
        rows[present],
    )


def _rows_of(table: Globals, keep: np.ndarray) -> Globals:
    """The table with these rows only, whole clusters of them, numbered from 0 again."""
    count = np.diff(table.start)
    cluster = table.cluster[keep]
    return Globals(
        np.cumsum(np.diff(cluster, prepend=cluster[:1]) != 0),
        table.log_weight[keep],
        starts(count[keep]),
        table.member[np.repeat(keep, count)],
    )


def _stacked(tables: list[Globals]) -> Globals:
    """The product of tables of different clusters."""
    clusters = starts(np.array([table.clusters for table in tables]))
    return Globals(
        np.concatenate([t.cluster + n for t, n in zip(tables, clusters, strict=False)]),
        np.concatenate([t.log_weight for t in tables]),
        starts(np.concatenate([np.diff(t.start) for t in tables])),
        np.concatenate([t.member for t in tables]),
    )
