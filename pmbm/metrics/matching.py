"""Choosing pairs: maximum-weight matching of sparse bipartite graphs, many frames in one call.

A pair that no metric may choose is simply not in the list, so the graph falls into small connected
components.  Most hold one pair and need no solver; the rest are solved one by one, exactly.

Ties: callers list rows and columns in ascending order of (frame, id), so among equally good
choices the outcome depends on ids alone, never on the order of objects inside a frame.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
    row_label, column_label = label[:n_rows], label[n_rows:]
    rows_of = np.bincount(row_label, minlength=components)
    columns_of = np.bincount(column_label, minlength=components)
    local_row = _numbers_within(row_label, rows_of)
    local_column = _numbers_within(column_label, columns_of)

    pair_label = row_label[row]
    star = (rows_of == 1) | (columns_of == 1)
    in_star = np.flatnonzero(star[pair_label])
    # One row, or one column, takes its best pair; the first of equals.
    best_first = in_star[np.lexsort((in_star, -benefit[in_star], pair_label[in_star]))]
    yield names[best_first[np.unique(pair_label[best_first], return_index=True)[1]]]

    others = np.flatnonzero(~star[pair_label])
    others = others[np.argsort(pair_label[others], kind="stable")]
    cuts = np.flatnonzero(np.diff(pair_label[others])) + 1
    for pairs in np.split(others, cuts) if len(others) else ():
        component = pair_label[pairs[0]]
        shape = (rows_of[component], columns_of[component])
        i, j = local_row[row[pairs]], local_column[column[pairs]]
        value = np.zeros(shape)
        value[i, j] = benefit[pairs]
        name = np.full(shape, -1)
        name[i, j] = names[pairs]
        taken = name[linear_sum_assignment(value, maximize=True)]
        yield taken[taken >= 0]


def _dense_numbers(numbers: IntArray) -> IntArray:
    """The place of each number among the distinct ones."""
    present = np.zeros(int(numbers.max()) + 1, np.bool_)
    present[numbers] = True
    return (np.cumsum(present) - 1)[numbers]


def _numbers_within(label: IntArray, sizes: IntArray) -> IntArray:
    """The place of each node among the nodes of its component, in ascending order."""
    order = np.argsort(label, kind="stable")
    first = np.cumsum(sizes) - sizes
    place = np.empty(len(label), np.int64)
    place[order] = np.arange(len(label)) - first[label[order]]
    return place
