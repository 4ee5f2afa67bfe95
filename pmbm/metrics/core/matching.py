"""Choosing pairs: maximum-weight matching of sparse bipartite graphs, many frames in one call.

A pair that no metric may choose is simply not in the list, so the graph falls into small connected
components.  Most hold one pair and need no solver; the rest are solved one by one, exactly.

Ties: callers list rows and columns in ascending order of (frame, id), so among equally good
choices the outcome depends on ids alone, never on the order of objects inside a frame.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pmbm.arrays import FloatArray, IntArray

_BATCH: Final = 32
"""Rows, or columns, of components that are solved in one call."""


def best_matching(rows: IntArray, columns: IntArray, benefit: FloatArray) -> IntArray:
    """The pairs (indices into the list, ascending) of the matching with the largest total benefit.

    rows, columns (Q,) : the two ends of each allowed pair, each pair listed once; several frames
    are solved together where their numbers do not overlap.  benefit (Q,) : > 0.
    """
    if len(rows) == 0:
        return np.zeros(0, np.int64)
    alone = (np.bincount(rows)[rows] == 1) & (np.bincount(columns)[columns] == 1)
    chosen = [np.flatnonzero(alone)]
    contested = np.flatnonzero(~alone)
    if len(contested):
        chosen.extend(
            _contested(rows[contested], columns[contested], benefit[contested], contested)
        )
    return np.sort(np.concatenate(chosen))


def most_then_nearest(rows: IntArray, columns: IntArray, distance: FloatArray) -> IntArray:
    """The pairs of the matching with the most pairs and, among those, the least total distance.

    Arguments as in `best_matching`; distance (Q,) : >= 0.
    """
    if len(rows) == 0:
        return np.zeros(0, np.int64)
    # With k pairs at most, one more pair must outweigh any sum of k distances.
    most = min(int(np.ptp(rows)), int(np.ptp(columns))) + 1
    return best_matching(rows, columns, 1.0 + (most + 1) * (distance.max() + 1.0) - distance)


def _contested(
    rows: IntArray, columns: IntArray, benefit: FloatArray, names: IntArray
) -> Iterator[IntArray]:
    """The chosen pairs, by name, of each connected component of a graph."""
    row, column = _dense_numbers(rows), _dense_numbers(columns)
    n_rows, n_columns = int(row.max()) + 1, int(column.max()) + 1
    nodes = n_rows + n_columns
    graph = coo_array(
        (np.ones(len(row), np.int8), (row, column + n_rows)), shape=(nodes, nodes)
    ).tocsr()
    components, label = connected_components(graph, directed=False)
    rows_of = np.bincount(label[:n_rows], minlength=components)
    columns_of = np.bincount(label[n_rows:], minlength=components)
    star = (rows_of == 1) | (columns_of == 1)
    pair_label = label[row]
    in_star = np.flatnonzero(star[pair_label])
    # One row, or one column, takes its best pair; the first of equals.
    best_first = in_star[np.lexsort((-benefit[in_star], pair_label[in_star]))]
    first = np.diff(pair_label[best_first], prepend=-1) != 0
    yield names[best_first[first]]

    # Small components are solved together: a call costs more than the zeros between them.
    size = np.where(star, 0, np.maximum(rows_of, columns_of))
    batch = (np.cumsum(size) - size) // _BATCH
    row_batch, column_batch = batch[label[:n_rows]], batch[label[n_rows:]]
    row_batch[star[label[:n_rows]]] = column_batch[star[label[n_rows:]]] = -1
    others = np.flatnonzero(~star[pair_label])
    others = others[np.argsort(row_batch[row[others]], kind="stable")]
    place_row, height = _places_within(row_batch)
    place_column, width = _places_within(column_batch)
    own_row, own_column = row[others], column[others]
    i, j, value = place_row[own_row], place_column[own_column], benefit[others]
    own_batch = row_batch[own_row]
    cuts = np.flatnonzero(np.diff(own_batch, prepend=-1, append=-1))
    used = own_batch[cuts[:-1]]
    partner = np.full((len(used), int(height.max(initial=0))), -1)
    for number, (begin, end) in enumerate(itertools.pairwise(cuts.tolist())):
        table = np.zeros((height[used[number]], width[used[number]]))
        table[i[begin:end], j[begin:end]] = value[begin:end]
        rows_taken, columns_taken = linear_sum_assignment(table, maximize=True)
        partner[number, rows_taken] = columns_taken
    yield names[others[partner[np.searchsorted(used, own_batch), i] == j]]


def _dense_numbers(numbers: IntArray) -> IntArray:
    """The place of each number among the distinct ones."""
    present = np.zeros(int(numbers.max()) + 1, np.bool_)
    present[numbers] = True
    return (np.cumsum(present) - 1)[numbers]


def _places_within(group: IntArray) -> tuple[IntArray, IntArray]:
    """The place of each node among the nodes of its group (-1: of none), in ascending order, and
    the size of each group."""
    order = np.argsort(group, kind="stable")
    sizes = np.bincount(group[order] + 1)
    first = np.cumsum(sizes) - sizes
    place = np.empty(len(group), np.int64)
    place[order] = np.arange(len(group)) - first[group[order] + 1]
    return place, sizes[1:]
