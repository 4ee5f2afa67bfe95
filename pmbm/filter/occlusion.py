"""What other objects and walls hide: the expected visible share of a track, seen from the sensor.

The sensor's surroundings are cut into narrow bearings.  Every track believed to exist, and every
static occluder, covers the bearings between its outermost corners, at the distance where the ray
meets it.  A bearing of an object is open with the probability that none of the nearer boxes exists,
the product of their 1 - r, and the object's visible share is the mean over its bearings.

This is what lets a track behind a truck keep its existence: nothing was seen there because nothing
could be seen there (Pang & Radha 2021, Sec. 2.2, the motivating example).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from pmbm.filter.density import Density, Index, Locals, ragged
from pmbm.filter.estimation import marginals
from pmbm.types import FloatArray

_BEARINGS = 1440
_STEP = 2 * np.pi / _BEARINGS
_FAR = 1e5
"""m; no ray reaches further."""
_IGNORED_EXISTENCE = 0.05
"""Tracks that exist less probably hide nothing: most are clutter, seen once."""
_CERTAIN = 1 - 1e-9
_VAGUE = 1.0
"""m; of tracks whose position has a wider standard deviation, where they are hidden counts, too."""
_MOVES = 2.0
"""Of a missed track's visible share: the share of Bayes' shift that its place moves by.  Measured
on development seeds of truck_occlusion and long_occlusion: ids are kept about as often as with the
whole shift, and places are as good as with none."""
_CAR_SD = 0.8
"""m; standard deviation, along any axis, of a point drawn evenly from a car's outline."""
_HALVES = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])


def _normal_points(count: int) -> FloatArray:
    """Points (count,2) of equal weight that stand for a standard normal: its quantiles along both
    axes, paired as evenly as a golden lattice does, with its mean and covariance."""
    i = np.arange(count)
    turn = np.mod((i + 0.5) * (np.sqrt(5) - 1) / 2, 1.0)
    point = ndtri(np.column_stack([(i + 0.5) / count, turn]))
    point -= point.mean(axis=0)
    root = np.linalg.cholesky(point.T @ point / count)
    return np.linalg.solve(root, point.T).T


_NODES = _normal_points(24)


@dataclass(frozen=True, eq=False, slots=True)
class Rays:
    """The bearings that B convex outlines cover: n rays, grouped by outline.

    first (B+1,) : rays of outline b are first[b] .. first[b + 1] - 1, at consecutive bearings.
    bearing (n,) : index of the bearing.  distance (n,) : where the ray first meets the outline, m.
    """

    first: Index
    bearing: Index
    distance: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Glimpse:
    """What can be seen of N Gaussians over places of undetected objects, each taken at k points.

    Of a car-sized object as many bearings are open as of its points, so the Gaussians
    are those of a point drawn from the object: a little wider than those of its centre.

    visible (N,k) : probability that nothing hides the point.
    node (N,k,2) : the point, from the mean, m.  S (N,2,2) : covariance of the points.
    """

    visible: FloatArray
    node: FloatArray
    S: FloatArray

    def share(self) -> FloatArray:
        """(N,) expected visible share."""
        return self.visible.mean(axis=1)

    def if_missed(
        self, mean: FloatArray, cov: FloatArray, in_the_open: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Means (N,4) and covariances (N,4,4) of objects that were missed, P_D (N,) in the open:
        those of what is left when each point has lost the share that would have been seen."""
        shift, spread = self._left(in_the_open)
        gain = self._gain(cov)
        return mean + np.einsum("nij,nj->ni", gain, shift), self._with(cov, gain, spread)

    def of_tracks_if_missed(
        self, mean: FloatArray, cov: FloatArray, in_the_open: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The same of tracks, which hold their course better than white noise lets one believe.

        Their velocity stays as it is, and their place moves by a share of what Bayes' rule says:
        the whole where half of the points are visible or more, less in proportion where most are
        hidden.  The covariance is that around the place.
        """
        shift, spread = self._left(in_the_open)
        held = 1 - np.minimum(_MOVES * self.share(), 1.0)[:, None]
        spread = spread + (held * shift)[:, :, None] * (held * shift)[:, None, :]
        gain = self._gain(cov)
        mean = mean.copy()
        mean[:, :2] += np.einsum("nij,nj->ni", gain[:, :2], (1 - held) * shift)
        return mean, self._with(cov, gain, spread)

    def _left(self, in_the_open: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (N,2), from that before, and covariance (N,2,2) of the points that were missed."""
        left = 1 - in_the_open[:, None] * self.visible
        left /= np.maximum(left.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        shift = np.einsum("nk,nki->ni", left, self.node)
        apart = self.node - shift[:, None]
        return shift, np.einsum("nk,nki,nkj->nij", left, apart, apart)

    def _gain(self, cov: FloatArray) -> FloatArray:
        """(N,4,2) how far the states move with the points."""
        gain = np.linalg.solve(self.S, cov[:, :2, :]).astype(np.float64, copy=False)
        return gain.transpose(0, 2, 1)

    def _with(self, cov: FloatArray, gain: FloatArray, spread: FloatArray) -> FloatArray:
        """Covariances (N,4,4) of states whose points have the covariance `spread`."""
        cov = cov + gain @ (spread - self.S) @ gain.transpose(0, 2, 1)
        return 0.5 * (cov + cov.transpose(0, 2, 1))


@dataclass(frozen=True, eq=False, slots=True)
class Shadows:
    """Everything around the sensor that may hide something.

    origin (2,) : of the sensor.
    rays : of the outlines, the tracks' first.  track_row : track -> its outline, or -1.
    log_open (B,) : log of the probability that the outline is not there.
    key (n,), log_open_before (n+1,) : rays sorted by bearing, then distance, and the running sum of
        their `log_open`.
    """

    origin: FloatArray
    rays: Rays
    track_row: Index
    log_open: FloatArray
    key: FloatArray
    log_open_before: FloatArray

    @staticmethod
    def of(density: Density, origin: FloatArray, occluders: Sequence[FloatArray] = ()) -> Shadows:
        """The shadows of a density's tracks, as likely as these exist, and of static occluders."""
        marginal = marginals(density)
        solid = np.flatnonzero(marginal.existence > _IGNORED_EXISTENCE)
        row = marginal.best[solid]
        local = density.local
        tracks = box_rays(origin, local.mean[row, :2], local.box[row])
        walls = outline_rays(origin, occluders)
        rays = Rays(
            np.concatenate([tracks.first, tracks.first[-1] + walls.first[1:]]),
            np.concatenate([tracks.bearing, walls.bearing]),
            np.concatenate([tracks.distance, walls.distance]),
        )
        log_open = np.concatenate(
            [
                np.log1p(-np.minimum(marginal.existence[solid], _CERTAIN)),
                np.full(len(occluders), np.log1p(-_CERTAIN)),
            ]
        )
        key = _key(rays.bearing, rays.distance)
        order = np.argsort(key, kind="stable")
        of_ray = np.repeat(log_open, np.diff(rays.first))[order]
        track_row = np.full(len(density.track_id), -1, np.intp)
        track_row[solid] = np.arange(len(solid))
        return Shadows(
            origin, rays, track_row, log_open, key[order], np.concatenate([[0.0], of_ray.cumsum()])
        )

    def of_tracks(self, local: Locals) -> tuple[FloatArray, Index, Glimpse]:
        """Expected visible share (H,) of each local hypothesis; and of those whose place is little
        known, their rows and what is seen of them point by point.  A track never hides itself."""
        visible = self._share_of_bearings(local)
        rows = np.flatnonzero(local.cov[:, 0, 0] + local.cov[:, 1, 1] > 2 * _VAGUE**2)
        vague = local.take(rows)
        cos, sin = np.cos(vague.box[:, 4]), np.sin(vague.box[:, 4])
        turn = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
        own = turn * (vague.box[:, None, 1:3] ** 2 / 12) @ turn.transpose(0, 2, 1)
        glimpse = self._glimpse(vague.mean, vague.cov[:, :2, :2] + own, self.track_row[vague.track])
        visible[rows] = glimpse.share()
        return visible, rows, glimpse

    def visible_share(self, local: Locals) -> FloatArray:
        """(H,) expected visible share of each local hypothesis."""
        return self.of_tracks(local)[0]

    def _share_of_bearings(self, local: Locals) -> FloatArray:
        """(H,) expected share of each local hypothesis's bearings that nothing nearer covers.

        The bearings are widened by one standard deviation of the position across the line of
        sight, so that an object that may or may not stand in a shadow is hidden in part.
        """
        target = box_rays(
            self.origin, local.mean[:, :2], local.box, widen=_across(self.origin, local)
        )
        if not len(self.key) or not len(target.bearing):
            return np.ones(len(local))
        count = np.diff(target.first)
        row = np.repeat(np.arange(len(local)), count)
        own = self.track_row[local.track][row]
        open_rays = np.bincount(
            row, self._open(target.bearing, target.distance, own), minlength=len(local)
        )
        return np.where(count > 0, open_rays / np.maximum(count, 1), 1.0)

    def undetected(self, mean: FloatArray, cov: FloatArray) -> Glimpse:
        """What is seen of objects that have no track, for Gaussians (N,4), (N,4,4)."""
        return self._glimpse(mean, cov[:, :2, :2] + _CAR_SD**2 * np.eye(2))

    def _glimpse(self, mean: FloatArray, spread: FloatArray, own: Index | None = None) -> Glimpse:
        """What is seen of Gaussians (N,4) whose points have the covariance `spread` (N,2,2).

        own (N,) : their own outlines, which do not hide them, or -1.
        """
        offset = mean[:, :2] - self.origin
        range_ = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
        line = offset / range_[:, None]
        # Columns: across the line of sight, along it.
        turn = np.stack([np.stack([-line[:, 1], line[:, 0]], axis=1), line], axis=2)
        S = turn.transpose(0, 2, 1) @ spread @ turn
        sd = np.sqrt(S[:, 0, 0])
        slope = S[:, 0, 1] / sd
        rest = np.sqrt(np.maximum(S[:, 1, 1] - slope**2, 0.0))
        side = sd[:, None] * _NODES[:, 0]
        depth = slope[:, None] * _NODES[:, 0] + rest[:, None] * _NODES[:, 1]
        ahead = range_[:, None] + depth
        angle = np.arctan2(line[:, 1], line[:, 0])[:, None] + np.arctan2(side, ahead)
        bearing = np.mod(np.floor(angle / _STEP).astype(np.intp), _BEARINGS).ravel()
        own = None if own is None else np.repeat(own, side.shape[1])
        visible = self._open(bearing, np.hypot(side, ahead).ravel(), own).reshape(side.shape)
        node = np.stack([side, depth], axis=2) @ turn.transpose(0, 2, 1)
        return Glimpse(visible, node, turn @ S @ turn.transpose(0, 2, 1))

    def _open(self, bearing: Index, distance: FloatArray, own: Index | None = None) -> FloatArray:
        """(n,) probability that nothing stands nearer than `distance` at these bearings (n,), but
        for the outline `own` (n,), -1 for none."""
        if not len(self.key):
            return np.ones(len(bearing))
        nearer = np.searchsorted(self.key, _key(bearing, distance), side="left")
        start = np.searchsorted(self.key, np.arange(_BEARINGS, dtype=np.float64), side="left")
        log_open = self.log_open_before[nearer] - self.log_open_before[start[bearing]]
        if own is not None:
            log_open -= self._by_itself(bearing, distance, own)
        return np.exp(np.minimum(log_open, 0.0))

    def _by_itself(self, bearing: Index, distance: FloatArray, own: Index) -> FloatArray:
        """(n,) what a track's own outline would take from its rays: to be given back."""
        first = np.minimum(self.rays.first[own], len(self.key) - 1)
        offset = np.mod(bearing - self.rays.bearing[first], _BEARINGS)
        covers = (own >= 0) & (offset < self.rays.first[own + 1] - self.rays.first[own])
        at = np.where(covers, first + offset, 0)
        nearer = covers & (_key(bearing, self.rays.distance[at]) < _key(bearing, distance))
        return np.where(nearer, self.log_open[own], 0.0)


def box_rays(
    origin: FloatArray, centre: FloatArray, box: FloatArray, widen: FloatArray | None = None
) -> Rays:
    """Rays of upright boxes: centre (B,2), box (B,5) as z, length, width, height, yaw.

    widen (B,) : metres added on either side, across the line of sight; where the ray then misses
        the box it meets it at the distance of the centre.  A box around the sensor has no rays.
    """
    offset = centre - origin
    cos, sin = np.cos(box[:, 4]), np.sin(box[:, 4])
    half_length, half_width = 0.5 * box[:, 1], 0.5 * box[:, 2]
    # The sensor in each box's own frame.
    x = -(offset[:, 0] * cos + offset[:, 1] * sin)
    y = offset[:, 0] * sin - offset[:, 1] * cos
    range_ = np.hypot(offset[:, 0], offset[:, 1])
    middle = np.arctan2(offset[:, 1], offset[:, 0])
    local = _HALVES * box[:, None, 1:3]
    corner_x = offset[:, None, 0] + local[..., 0] * cos[:, None] - local[..., 1] * sin[:, None]
    corner_y = offset[:, None, 1] + local[..., 0] * sin[:, None] + local[..., 1] * cos[:, None]
    turn = np.arctan2(corner_y, corner_x) - middle[:, None]
    turn = np.mod(turn + np.pi, 2 * np.pi) - np.pi
    low, high = turn.min(axis=1), turn.max(axis=1)
    if widen is not None:
        margin = np.arctan2(widen, np.maximum(range_, 1e-9))
        low, high = np.maximum(low - margin, -3.0), np.minimum(high + margin, 3.0)
    inside = (np.abs(x) <= half_length) & (np.abs(y) <= half_width)

    # Bearings whose centre lies within the extent; at least the one that the middle lies in.
    begin = np.ceil((middle + low) / _STEP - 0.5).astype(np.intp)
    end = np.floor((middle + high) / _STEP - 0.5).astype(np.intp)
    thin = end < begin
    begin = np.where(thin, np.floor(middle / _STEP).astype(np.intp), begin)
    count = np.where(inside, 0, np.where(thin, 1, end - begin + 1))
    bearing = ragged(begin, count)
    row = np.repeat(np.arange(len(box)), count)
    angle = (bearing + 0.5) * _STEP - box[row, 4]
    along_x, along_y = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        enter_x = (-np.sign(along_x) * half_length[row] - x[row]) / along_x
        leave_x = (np.sign(along_x) * half_length[row] - x[row]) / along_x
        enter_y = (-np.sign(along_y) * half_width[row] - y[row]) / along_y
        leave_y = (np.sign(along_y) * half_width[row] - y[row]) / along_y
    enter, leave = np.fmax(enter_x, enter_y), np.fmin(leave_x, leave_y)
    meets = (enter <= leave) & (enter > 0)
    distance = np.where(meets, enter, range_[row])
    first = np.concatenate([[0], np.cumsum(count)])
    return Rays(first, np.mod(bearing, _BEARINGS), distance)


def outline_rays(origin: FloatArray, outlines: Sequence[FloatArray]) -> Rays:
    """Rays of convex polygons (V,2); one around the sensor has none."""
    count, bearings, distances = [0], [np.zeros(0, np.intp)], [np.zeros(0)]
    for outline in outlines:
        corner = outline - origin
        middle = np.arctan2(*corner.mean(axis=0)[::-1])
        turn = np.mod(np.arctan2(corner[:, 1], corner[:, 0]) - middle + np.pi, 2 * np.pi) - np.pi
        begin = int(np.ceil((middle + turn.min()) / _STEP - 0.5))
        end = int(np.floor((middle + turn.max()) / _STEP - 0.5))
        bearing = np.arange(begin, end + 1)
        angle = (bearing[:, None] + 0.5) * _STEP
        ray = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        edge = np.roll(corner, -1, axis=0) - corner
        # origin + t ray = corner + s edge, by Cramer's rule.
        with np.errstate(divide="ignore", invalid="ignore"):
            area = ray[..., 0] * edge[:, 1] - ray[..., 1] * edge[:, 0]
            t = (corner[:, 0] * edge[:, 1] - corner[:, 1] * edge[:, 0]) / area
            s = (corner[:, 0] * ray[..., 1] - corner[:, 1] * ray[..., 0]) / area
            t = np.where((s >= 0) & (s <= 1) & (t > 0), t, _FAR)
        surrounds = turn.max() - turn.min() > np.pi
        nearest = t.min(axis=1)
        keep = (nearest < _FAR) & (not surrounds)
        count.append(int(keep.sum()))
        bearings.append(np.mod(bearing[keep], _BEARINGS))
        distances.append(nearest[keep])
    return Rays(np.cumsum(count), np.concatenate(bearings), np.concatenate(distances))


def _across(origin: FloatArray, local: Locals) -> FloatArray:
    """(H,) standard deviation of the position across the line of sight, m."""
    offset = local.mean[:, :2] - origin
    range_ = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
    normal = np.stack([-offset[:, 1], offset[:, 0]], axis=1) / range_[:, None]
    cov = local.cov[:, :2, :2]
    return np.sqrt(np.maximum(np.einsum("hi,hij,hj->h", normal, cov, normal), 0.0))


def _key(bearing: Index, distance: FloatArray) -> FloatArray:
    """Sorts by bearing, then by distance."""
    return bearing + np.minimum(distance, 0.999 * _FAR) / _FAR
