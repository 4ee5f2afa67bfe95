"""The map of undetected objects: the PPP place by place, on a lattice fixed to the world.

With it the PPP holds, place by place, how many objects may be where nobody could have seen them
(Pang & Radha 2021, Sec. 2.2): every component is at most a few metres wide, so that what stands in
a shadow keeps its weight while what lies in plain view next to it is swept out.

The map reaches a little further than the view.  What moves off it is forgotten, and ground that it
comes to cover holds as many objects as ground did before the first frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pmbm.filter.density import Index, Mixture, MixtureColumns
from pmbm.filter.hypotheses.gaussian import moments, symmetric
from pmbm.filter.models.view import View
from pmbm.geometry import points_in_polygon
from pmbm.kernels import twin
from pmbm.types import FloatArray, Site

WIDEST = 2.0
"""m; largest standard deviation of a component's position, along any axis."""
_MARGIN = 2
"""Cells that the map reaches beyond the view, and width of the view's edge where objects enter."""
_AT_EDGE = 0.5
"""Share of the births that arise within the edge of the view: objects that drive in."""
_SAMPLES = 5
"""Points per side at which a cell is tested for being drivable."""
_LEFT_BY_SPLIT = 0.5
"""Variance that each part keeps, where a component is split that is up to twice too wide."""
_PART_SPACING = 1.75
"""Distance of the parts of a wider one, in their own standard deviations: their sum is smooth."""
_SLOW = 6.0
"""m/s; velocity components within this are one class, faster ones, either way, two others."""
_ROUND = 0.1
"""Relative difference of variances below which a Gaussian is nearly round."""
_ON_EDGE = 1e-6
"""Of a cell, or m: what lies nearer to an edge is on it, whatever the rounding."""
_ALIKE = 1e-6
"""Difference of log weights, or of distances in `WIDEST`, below which these are taken to be equal,
so that rounding decides nothing: on a lattice many are."""
_NEIGHBOURS = 8
"""At most so many components are equally near to one."""
_CODE = 1 << 31


@dataclass(frozen=True, eq=False, slots=True)
class MapCells:
    """The cells of the map around one pose.

    code (C,) : of the cells, ascending.  centre (C,2) : of their drivable parts, m.
    share (C,) : drivable share.  edge (C,) : whether objects may drive in there.
    """

    code: Index
    centre: FloatArray
    share: FloatArray
    edge: np.ndarray

    @staticmethod
    def of(site: Site, view: View, spacing: float, known: MapCells | None = None) -> MapCells:
        """The cells within the view or its margin; all of them drivable where the site does not
        say.  `known` : an earlier map of the same site, whose cells are not tested again."""
        reach = view.max_range + _MARGIN * spacing
        low = np.floor((view.pose[:2] - reach) / spacing).astype(np.int64)
        steps = np.arange(int(np.ceil(2 * reach / spacing)) + 2)
        i, j = (grid.ravel() for grid in np.meshgrid(low[0] + steps, low[1] + steps, indexing="ij"))
        centre = (np.column_stack([i, j]) + 0.5) * spacing
        outside = beyond(view, centre)
        near = outside <= _MARGIN * spacing + _ON_EDGE
        code, centre, outside = (i * _CODE + j)[near], centre[near], outside[near]
        share = np.ones(len(code))
        if site.drivable_area is not None:
            centre, share = _drivable(site.drivable_area, code, centre, spacing, known)
        edge = (outside <= _ON_EDGE) & (outside > -_MARGIN * spacing + _ON_EDGE)
        return MapCells(code, centre, share, edge)

    @property
    def cells(self) -> int:
        """Drivable cells."""
        return int(np.count_nonzero(self.share))

    def newly_covered(self, before: MapCells | None) -> FloatArray:
        """(C,) shares of the drivable ground, of cells that an earlier map did not cover."""
        new = self.share / max(self.share.sum(), 1e-300)
        if before is not None:
            new[np.isin(self.code, before.code, assume_unique=True)] = 0.0
        return new

    def births(self) -> FloatArray:
        """(C,) shares of the births, which add up to one: part at the edge, the rest over the view
        and its margin."""
        even, edge = self.share / max(self.share.sum(), 1e-300), self.share * self.edge
        if edge.sum() == 0:
            return even
        return (1 - _AT_EDGE) * even + _AT_EDGE * edge / edge.sum()

    def mixture(self, weight: FloatArray, spacing: float, speed_sd: float) -> Mixture:
        """Components of these weights (C,) in the cells; flat where the weights are."""
        rows = np.flatnonzero(weight > 0)
        mean = np.zeros((len(rows), 4))
        mean[:, :2] = self.centre[rows]
        variance = min(0.5 * spacing, WIDEST) ** 2
        cov = np.diag([variance, variance, speed_sd**2, speed_sd**2])
        return Mixture(np.log(weight[rows]), mean, np.tile(cov, (len(rows), 1, 1)))


def beyond(view: View, points: FloatArray) -> FloatArray:
    """(M,) distance of points (M,2) from the view's boundary, m: negative inside."""
    offset = points - view.pose[:2]
    range_ = np.hypot(offset[:, 0], offset[:, 1])
    outside = range_ - view.max_range
    if view.half_angle >= np.pi:
        return outside
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - view.pose[2] - view.centre
    off = np.abs(np.mod(bearing + np.pi, 2 * np.pi) - np.pi) - view.half_angle
    # From the nearer straight edge, or from the sensor where that is nearer still.
    side = range_ * np.where(np.abs(off) < np.pi / 2, np.sin(off), np.sign(off))
    return np.maximum(outside, side)


def reduce_map(
    mixture: Mixture, view: View, spacing: float, *, most: int, negligible: float, fine_above: float
) -> tuple[Mixture, float]:
    """The mixture with components that are narrow and not too many, and the mass that was dropped.

    What has moved off the map and what is lighter than `negligible` is dropped.  What is too wide
    is split; components of one cell (and one class of velocity, in cells that hold more than
    `fine_above` objects) become one, and so do, beyond `most` components, the lightest with their
    nearest neighbours: all of these keep mass, mean and covariance of the whole.
    """
    columns, dropped = _settled(
        mixture.columns(),
        view.pose,
        view.centre,
        view.half_angle,
        view.max_range,
        spacing,
        _log(negligible),
        fine_above,
        (WIDEST, _MARGIN, _LEFT_BY_SPLIT, _PART_SPACING, _SLOW, _ROUND, _ON_EDGE),
    )
    return capped(Mixture.of_columns(columns), most), dropped


@twin("settled")
def _settled(
    columns: MixtureColumns,
    pose: FloatArray,
    centre: float,
    half_angle: float,
    max_range: float,
    spacing: float,
    log_negligible: float,
    fine_above: float,
    constants: tuple[float, ...],
) -> tuple[MixtureColumns, float]:
    """Columns of the mixture that is dropped, split and merged so, and the mass dropped.

    constants : of this module, for the compiled twin.
    """
    mixture, view = Mixture.of_columns(columns), View(pose, centre, half_angle, max_range)
    on_map = beyond(view, mixture.mean[:, :2]) <= _MARGIN * spacing + _ON_EDGE
    stays = on_map & (mixture.log_weight > log_negligible)
    narrow = narrowed(mixture.take(np.flatnonzero(stays)))
    # At the edge objects only come and go; what they do there later is of no use.
    inner = beyond(view, narrow.mean[:, :2]) <= -_MARGIN * spacing + _ON_EDGE
    settled = merged_by_cell(narrow, spacing, fine_above, inner)
    return settled.columns(), float(np.exp(mixture.log_weight[~stays]).sum())


def narrowed(mixture: Mixture, widest: float = WIDEST) -> Mixture:
    """Every component whose position is wider than `widest` along its longest axis, in parts along
    an axis, again until all are narrow.

    The parts have the mass, mean and covariance of the whole; of a component at most twice as wide
    as it may be they have five moments.  Each has the velocity that goes with its place.
    """
    done = []
    while len(mixture):
        longest, variance, axis = _longest(mixture.cov)
        parts = np.ceil(np.sqrt(longest) / widest * (1 - 1e-9)).astype(np.intp)
        done.append(mixture.take(np.flatnonzero(parts <= 1)))
        pieces = []
        for count in np.unique(parts[parts > 1]).tolist():
            rows = np.flatnonzero(parts == count)
            along = np.einsum("pij,pj->pi", mixture.cov[rows, :, :2], axis[rows])
            along /= np.sqrt(variance[rows])[:, None]
            pieces.append(_split(mixture.take(rows), along, count))
        mixture = _joined(pieces)
    return _joined(done)


def _split(mixture: Mixture, along: FloatArray, ratio: int) -> Mixture:
    """Components in parts along one axis each; `along` (P,4) is how the whole state moves with one
    standard deviation of the position along it.

    ratio : of the widths before and after, at most.
    """
    left = _LEFT_BY_SPLIT * (2 / ratio) ** 2
    if ratio == 2:
        node, weight = np.sqrt(3 * (1 - left)) * np.arange(-1, 2), np.array([1, 4, 1]) / 6
    else:
        step = _PART_SPACING * math.sqrt(left)
        node = step * np.arange(-math.ceil(3 / step), math.ceil(3 / step) + 1)
        weight = np.exp(-0.5 * node**2 / (1 - left))
        weight /= weight.sum()
        node *= math.sqrt((1 - left) / (weight @ node**2))
    cov = symmetric(mixture.cov - (1 - left) * along[:, :, None] * along[:, None, :])
    mixture = replace(mixture, cov=cov)
    mean = mixture.mean[None] + node[:, None, None] * along
    log_weight = mixture.log_weight + np.log(weight)[:, None]
    parts = mixture.take(np.tile(np.arange(len(mixture)), len(node)))
    return replace(parts, log_weight=log_weight.ravel(), mean=mean.reshape(-1, 4))


def merged_by_cell(
    mixture: Mixture, spacing: float, fine_above: float, may_be_fine: np.ndarray | bool = True
) -> Mixture:
    """One component per cell, or, where a cell holds more than `fine_above` objects, per cell and
    class of velocity, with the moments of those that it replaces.

    may_be_fine : whether the latter holds of every component, or of each (P,).
    """
    cell = np.floor(mixture.mean[:, :2] / spacing + _ON_EDGE).astype(np.int64)
    cell = cell[:, 0] * _CODE + cell[:, 1]
    v = mixture.mean[:, 2:]
    fast = 1 + (v > _SLOW).astype(np.int64) - (v < -_SLOW)
    order = np.argsort(cell, kind="stable")
    first = _runs(cell[order])
    held = np.add.reduceat(np.exp(mixture.log_weight[order]), first) if len(first) else first
    row = np.empty(len(mixture), np.int64)
    row[order] = np.repeat(np.arange(len(first)), np.diff(first, append=len(order)))
    kind = (3 * fast[:, 0] + fast[:, 1]) * ((held > fine_above)[row] & may_be_fine)
    return _merged(mixture, 9 * row + kind)


def capped(mixture: Mixture, most: int) -> Mixture:
    """At most so many components: each of the lightest joins the nearest of the others, the first
    of those that are equally near."""
    if len(mixture) <= most:
        return mixture
    from scipy.spatial import cKDTree

    order = np.argsort(-np.rint(mixture.log_weight / _ALIKE), kind="stable")
    place = mixture.mean[:, :2]
    group = np.empty(len(mixture), np.int64)
    group[order[:most]] = np.arange(most)
    tree, lightest = cKDTree(place[order[:most]]), order[most:]
    distance, found = tree.query(place[lightest], k=np.arange(1, min(_NEIGHBOURS, most) + 1))
    near = distance <= distance[:, :1] + _ALIKE * WIDEST
    group[lightest] = np.where(near, found, most).min(axis=1)
    return _merged(mixture, group)


def _merged(mixture: Mixture, key: Index) -> Mixture:
    """Components of equal keys (P,) as one each, with weight, mean and covariance of their sum."""
    if not len(mixture):
        return mixture
    order = np.argsort(key, kind="stable")
    first = _runs(key[order])
    count = np.diff(first, append=len(order))
    log_weight = mixture.log_weight[order]
    top = np.maximum.reduceat(log_weight, first)
    weight = np.exp(log_weight - np.repeat(top, count))
    total = np.add.reduceat(weight, first)
    mean, cov = moments(
        weight / np.repeat(total, count), mixture.mean[order], mixture.cov[order], first
    )
    before = mixture.recycled_from
    after = None if before is None else before.merged(order, first, weight)
    return Mixture(top + np.log(total), mean, symmetric(cov), after)


def _runs(key: Index) -> Index:
    """Where the runs of equal values begin in a sorted key."""
    if not len(key):
        return np.zeros(0, np.intp)
    return np.concatenate([[0], np.flatnonzero(np.diff(key)) + 1])


def _longest(cov: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The largest variance (P,) of the position along any axis; and the variance (P,) along an axis
    (P,2) along which it is widest, or nearly so.

    Of Gaussians that are nearly round it is the world's first axis, so that rounding does not turn
    it; one along the world's second always points the same way.
    """
    a, b, d = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    least = 0.5 * _ROUND * (a + d)
    between, tilt = np.where(np.abs(a - d) > least, a - d, 0), np.where(np.abs(b) > least, b, 0)
    angle = 0.5 * np.arctan2(2 * tilt, between)
    cos, sin = np.cos(angle), np.sin(angle)
    variance = a * cos * cos + 2 * b * cos * sin + d * sin * sin
    largest = 0.5 * (a + d) + np.hypot(0.5 * (a - d), b)
    return largest, variance, np.column_stack([cos, sin])


def _drivable(
    area: tuple[FloatArray, ...],
    code: Index,
    centre: FloatArray,
    spacing: float,
    known: MapCells | None,
) -> tuple[FloatArray, FloatArray]:
    """Centre (C,2) of each cell's drivable part, and its share (C,) of the cell."""
    share = np.zeros(len(code))
    new = np.ones(len(code), bool)
    centre = centre.copy()
    if known is not None and len(known.code):
        at = np.minimum(np.searchsorted(known.code, code), len(known.code) - 1)
        new = known.code[at] != code
        old = np.flatnonzero(~new)
        share[old], centre[old] = known.share[at[old]], known.centre[at[old]]
    rows = np.flatnonzero(new)
    step = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5) * spacing
    offset = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    point = centre[rows][:, None] + offset
    inside = np.zeros(point.shape[:2], bool)
    for polygon in area:
        inside |= points_in_polygon(point.reshape(-1, 2) + _ON_EDGE, polygon).reshape(inside.shape)
    share[rows] = inside.mean(axis=1)
    count = np.maximum(inside.sum(axis=1), 1)
    centre[rows] += (inside[:, :, None] * offset).sum(axis=1) / count[:, None]
    return centre, share


def _joined(parts: list[Mixture]) -> Mixture:
    return Mixture.joined(*parts) if parts else Mixture.empty()


def _log(value: float) -> float:
    return math.log(value) if value > 0 else -math.inf
