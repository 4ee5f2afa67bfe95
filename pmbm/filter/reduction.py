"""Box 4 of 4, reduction: pruning, capping, recycling, merging (Pang & Radha 2021, Sec. 2.7; the
fifth, gating, is part of the association)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmbm.filter.config import Reduction
from pmbm.filter.density import (
    Density,
    Globals,
    Index,
    Mixture,
    RecycledFrom,
    probability_of_members,
    starts,
    summed,
)
from pmbm.filter.hypotheses.clusters import factor, merge_equal, row_limit, split
from pmbm.filter.hypotheses.gating import near
from pmbm.filter.hypotheses.gaussian import moments
from pmbm.filter.hypotheses.weights import likely, log_of, normalised
from pmbm.filter.models.protocols import Birth
from pmbm.kernels import twin
from pmbm.types import FloatArray

FEW = 20
ALIKE = 1.0
"""Largest difference of log position areas (of log sds, summed) between components that merge."""
AS_HEAVY = 1e-6
"""Difference of log weights of components that are as heavy as each other."""


@dataclass(frozen=True, slots=True)
class ReductionStats:
    """What a reduction removed: global hypotheses pruned, capped and merged, local hypotheses
    recycled, and PPP components pruned, merged and capped; where the PPP is kept in detail, the
    expected number of objects that left its map or were negligible; and pairs of a local hypothesis
    and a measurement that the gate kept apart."""

    hypotheses_pruned: int = 0
    hypotheses_capped: int = 0
    hypotheses_merged: int = 0
    locals_recycled: int = 0
    tracks_capped: int = 0
    undetected_pruned: int = 0
    undetected_merged: int = 0
    undetected_capped: int = 0
    undetected_dropped: float = 0.0
    pairs_gated: int = 0


def reduce(
    density: Density, limits: Reduction, birth: Birth | None = None
) -> tuple[Density, ReductionStats]:
    """The density with fewer terms, as near as possible to the given one.

    In this order: unlikely global hypotheses go, the best of the rest stay and share their weight;
    tracks that hardly exist are moved back into the PPP; hypotheses that are equal without them
    become one; clusters fall apart; the PPP is pruned and merged.

    birth : says from what weight and how near on undetected objects are pruned and merged; None
        merges none.
    """
    density, returned, removed = _fewer(density, limits)

    prune, merge_below = limits.prune_undetected, 0.0
    if birth is not None:
        prune, merge_below = birth.thresholds(prune)
    ppp = Mixture.joined(density.undetected, returned) if len(returned) else density.undetected
    undetected, settled, pruned, merged, capped = _fewer_undetected(
        ppp, density.undetected_settled, limits, prune, merge_below
    )
    return replace(density, undetected=undetected, undetected_settled=settled), replace(
        removed, undetected_pruned=pruned, undetected_merged=merged, undetected_capped=capped
    )


def with_more_undetected(
    density: Density, more: Mixture, limits: Reduction, birth: Birth
) -> Density:
    """The density with further undetected objects, no more components than it may have."""
    prune, merge_below = birth.thresholds(limits.prune_undetected)
    undetected, settled, *_ = _fewer_undetected(
        Mixture.joined(density.undetected, more),
        density.undetected_settled,
        limits,
        prune,
        merge_below,
    )
    return replace(density, undetected=undetected, undetected_settled=settled)


def _fewer_undetected(
    ppp: Mixture, settled: int, limits: Reduction, prune: float, merge_below: float
) -> tuple[Mixture, int, int, int, int]:
    """The PPP pruned, merged and capped; of how many components it was when last merged; and how
    many each of the three removed."""
    kept = ppp.take(np.flatnonzero(ppp.log_weight > log_of(prune)))
    joined = kept
    if len(kept) > 2 * settled + FEW:
        # Merging takes longer than what it saves until the mixture has grown.
        joined = merge_mixture(kept, merge_below)
        settled = len(joined)
    heaviest = joined
    if len(joined) > limits.max_undetected:
        order = np.argsort(-joined.log_weight, kind="stable")[: limits.max_undetected]
        heaviest = joined.take(np.sort(order))
    return (
        heaviest,
        settled,
        len(ppp) - len(kept),
        len(kept) - len(joined),
        len(joined) - len(heaviest),
    )


def _fewer(density: Density, limits: Reduction) -> tuple[Density, Mixture, ReductionStats]:
    """The detected objects with fewer hypotheses, and what is moved back into the PPP."""
    local, whole, tracks = density.local, density.hypotheses, len(density.track_id)
    most = limits.max_hypotheses
    cap = row_limit(whole, most) if limits.clustering else np.full(whole.clusters, most)
    table, above = pruned(whole, log_of(limits.prune_hypothesis), cap)

    probability = probability_of_members(table, len(local))
    faint = local.existence < limits.recycle_below
    mass = probability * local.existence
    surplus = _surplus_tracks(mass, local.track, tracks, limits.max_tracks)[local.track]
    tracks_capped = int((surplus & ~faint).sum())
    faint = faint | surplus
    recycled = np.flatnonzero(faint & (probability > 0))
    before = len(table)
    staying = ~faint[table.member]
    if not staying.all():
        entries = starts(staying.astype(np.intp))
        emptied = Globals(
            table.cluster, table.log_weight, entries[table.start], table.member[staying]
        )
        # Hypotheses that differ stay different as long as nothing is taken out of them.
        table = merge_equal(emptied)
    equal = before - len(table)
    if limits.clustering:
        table = factor(split(table, len(local)), local.track, limits.split_below)
    rows, member = np.unique(table.member, return_inverse=True)
    alive, track = np.unique(local.track[rows], return_inverse=True)
    fewer = replace(
        density,
        local=replace(local.take(rows), track=track.reshape(-1)),
        hypotheses=replace(table, member=member.reshape(-1)),
        track_id=density.track_id[alive],
    )
    removed = ReductionStats(
        hypotheses_pruned=len(whole) - above,
        hypotheses_capped=above - before,
        hypotheses_merged=equal,
        locals_recycled=len(recycled),
        tracks_capped=tracks_capped,
    )
    return fewer, _returned(density, recycled, probability[recycled], limits), removed


def pruned(table: Globals, log_threshold: float, cap: Index) -> tuple[Globals, int]:
    """The likely rows, at most `cap` (C,) of each cluster, and how many were likely."""
    above = likely(table.log_weight, table.cluster, log_threshold)
    return _keep(table, _best(table, above, cap)), int(above.sum())


def _best(table: Globals, above: np.ndarray, cap: Index) -> np.ndarray:
    """(G,) the heaviest of the rows above the threshold of each cluster, `cap` (C,) of them."""
    rows = np.flatnonzero(above)
    count = np.bincount(table.cluster[rows], minlength=table.clusters)
    if (count <= cap).all():
        return above
    order = rows[np.lexsort((-table.log_weight[rows], table.cluster[rows]))]
    rank = np.arange(len(order)) - (np.cumsum(count) - count)[table.cluster[order]]
    best = np.zeros(len(table), bool)
    best[order[rank < cap[table.cluster[order]]]] = True
    return best


def _keep(table: Globals, rows: np.ndarray) -> Globals:
    """The table with the global hypotheses of this mask only, their weights normalised again."""
    if rows.all():
        return table
    count = np.diff(table.start)
    cluster = table.cluster[rows]
    return Globals(
        cluster,
        normalised(table.log_weight[rows], cluster),
        starts(count[rows]),
        table.member[np.repeat(rows, count)],
    )


def _returned(density: Density, rows: Index, probability: FloatArray, limits: Reduction) -> Mixture:
    """The Bernoullis of these rows (n,), as components of the PPP, or nothing where they are to be
    forgotten.  probability (n,) : of the hypotheses that they were part of."""
    local = density.local
    if not len(rows) or not limits.recycle:
        return Mixture.empty()
    with np.errstate(divide="ignore"):
        log_weight = np.log(probability * local.existence[rows])
    recycled_from = RecycledFrom.of(density.track_id[local.track[rows]])
    return Mixture(log_weight, local.mean[rows], local.cov[rows], recycled_from)


def _surplus_tracks(mass: FloatArray, track: Index, tracks: int, most: int) -> np.ndarray:
    """(T,) the tracks of the lowest existence, beyond the `most` that may stay; mass (H,) : of the
    existence of each track."""
    surplus = np.zeros(tracks, bool)
    if np.count_nonzero(np.bincount(track, minlength=tracks)) > most:
        surplus[np.argsort(-summed(mass, track, tracks), kind="stable")[most:]] = True
    return surplus


def merge_mixture(mixture: Mixture, threshold: float) -> Mixture:
    """Merge components that lie together, keeping weight, mean and covariance of their sum.

    Heaviest first, each takes in the lighter ones for which the squared Mahalanobis distance of
    the means is below `threshold` under either covariance (so a wide component does not swallow
    narrow ones that happen to lie inside it) and whose position areas are alike within a factor e.
    """
    if threshold <= 0 or len(mixture) < 2:
        return mixture
    group = _groups(mixture, threshold)
    order = np.argsort(group, kind="stable")
    first = np.flatnonzero(np.diff(group[order], prepend=-1))
    if len(first) == len(mixture):
        return mixture
    log_weight = mixture.log_weight[order]
    count = np.diff(first, append=len(order))
    top = np.maximum.reduceat(log_weight, first)
    weight = np.exp(log_weight - np.repeat(top, count))
    total = np.add.reduceat(weight, first)
    mean, cov = moments(
        weight / np.repeat(total, count), mixture.mean[order], mixture.cov[order], first
    )
    before = mixture.recycled_from
    after = None if before is None else before.merged(order, first, weight)
    return Mixture(top + np.log(total), mean, cov, after)


def _groups(mixture: Mixture, threshold: float) -> Index:
    """(P,) the component, by row, that each one is merged into."""
    columns = mixture.log_weight, mixture.mean, mixture.cov
    return _merge_groups(*columns, threshold, ALIKE, AS_HEAVY)


@twin("merge_groups")
def _merge_groups(
    log_weight: FloatArray,
    mean: FloatArray,
    cov: FloatArray,
    threshold: float,
    alike: float,
    as_heavy: float,
) -> Index:
    mixture = Mixture(log_weight, mean, cov)
    one, other = _close_pairs(mixture, threshold, alike)
    group = np.arange(len(mixture))
    if not len(one):
        return group
    neighbours: dict[int, list[int]] = {}
    for i, j in zip(one.tolist(), other.tolist(), strict=True):
        neighbours.setdefault(i, []).append(j)
    free = np.ones(len(mixture), bool)
    involved = np.fromiter(neighbours, np.intp)
    # Births weigh the same in many places: rounding must not put one first.
    weight = np.rint(log_weight[involved] / as_heavy)
    heaviest_first = involved[np.lexsort((involved, -weight))]
    for head in heaviest_first.tolist():
        if free[head]:
            free[head] = False
            taken = [j for j in neighbours[head] if free[j]]
            free[taken] = False
            group[taken] = head
    return group


def _close_pairs(mixture: Mixture, threshold: float, alike: float) -> tuple[Index, Index]:
    """Ordered pairs, both ways round, of components that may be merged."""
    cov = mixture.cov
    area = 0.5 * np.log(
        np.maximum(cov[:, 0, 0] * cov[:, 1, 1] - cov[:, 0, 1] ** 2, np.finfo(float).tiny)
    )
    radius = np.sqrt(threshold * (cov[:, 0, 0] + cov[:, 1, 1]))
    # Only components of similar size merge, so each run of sizes without a gap is on its own.
    by_size = np.argsort(area, kind="stable")
    runs = np.split(by_size, np.flatnonzero(np.diff(area[by_size]) > alike) + 1)
    ones, others = [], []
    for run in runs:
        if len(run) > 1:
            i, j = near(mixture.mean[run, :2], radius[run], mixture.mean[run, :2])
            ones.append(run[i])
            others.append(run[j])
    if not ones:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    one, other = np.concatenate(ones), np.concatenate(others)
    fits = (one != other) & (np.abs(area[one] - area[other]) <= alike)
    one, other = one[fits], other[fits]
    apart = mixture.mean[other] - mixture.mean[one]
    d2 = np.einsum("ni,ni->n", apart, np.linalg.solve(cov[one], apart[:, :, None])[:, :, 0])
    close = d2 < threshold
    # Below the threshold under either covariance: the pair must be there both ways round.
    both = set(zip(one[close].tolist(), other[close].tolist(), strict=True))
    mutual = [(i, j) for i, j in both if (j, i) in both]
    table = np.array(sorted(mutual), np.intp).reshape(-1, 2)
    return table[:, 0], table[:, 1]
