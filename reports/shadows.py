"""Polygons of what the sensor cannot see in a frame."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import shapely
from numpy.typing import ArrayLike

from pmbm.geometry import corners, wrap_angle
from pmbm.types import FloatArray, GroundTruth, MountedSensor, Site

_ARC = 0.03
"""rad between the points of an arc."""


def field_of_view(site: Site | MountedSensor, pose: ArrayLike) -> shapely.Geometry:
    """The sector or disc that the sensor at `pose` = (x, y, yaw) looks at."""
    x, y, yaw = np.asarray(pose, dtype=np.float64)
    half = site.fov_half_angle
    steps = max(8, int(np.ceil(2 * half / _ARC)))
    angle = yaw + site.fov_centre + np.linspace(-half, half, steps + 1)
    # Outside the arc's points, not inside: the polygon contains the disc's sector.
    reach = site.max_range / np.cos(half / steps)
    arc = np.column_stack([x + reach * np.cos(angle), y + reach * np.sin(angle)])
    if half >= np.pi:
        return shapely.Polygon(arc[:-1])
    return shapely.Polygon(np.vstack([[x, y], arc]))


def shadow(polygon: ArrayLike, eye: ArrayLike, reach: float) -> shapely.Geometry:
    """The region behind a convex polygon (V,2) seen from `eye` (2,), from the line between the
    polygon's outermost corners out to at least `reach` m; empty where the polygon contains the eye.
    """
    ring = np.asarray(polygon, dtype=np.float64)
    x, y = np.asarray(eye, dtype=np.float64)
    if shapely.intersects_xy(shapely.Polygon(ring), x, y):
        return shapely.Polygon()
    angle = np.arctan2(ring[:, 1] - y, ring[:, 0] - x)
    offset = wrap_angle(angle - angle[0])
    low, high = int(offset.argmin()), int(offset.argmax())
    sweep = offset[high] - offset[low]
    steps = max(2, int(np.ceil(sweep / _ARC)))
    far = angle[0] + np.linspace(offset[low], offset[high], steps + 1)
    distance = reach / np.cos(sweep / steps / 2)
    arc = np.column_stack([x + distance * np.cos(far), y + distance * np.sin(far)])
    return shapely.make_valid(shapely.Polygon(np.vstack([ring[low], arc, ring[high]])))


def hidden_region(truth: GroundTruth, site: Site, pose: ArrayLike) -> shapely.Geometry:
    """What is in the field of view but behind an object or an occluder, without the objects'
    and occluders' own areas; of several sensors on a carrier at `pose`, what none of them sees."""
    if site.sensors:
        return _hidden_from_all(truth, site, np.asarray(pose, dtype=np.float64))
    blockers = [*corners(truth.position, truth.size, truth.yaw), *site.occluders]
    eye = np.asarray(pose, dtype=np.float64)[:2]
    reach = site.max_range * 1.1
    shades = shapely.union_all([shadow(outline, eye, reach) for outline in blockers])
    solid = shapely.union_all([shapely.Polygon(outline) for outline in blockers])
    seen = field_of_view(site, pose)
    return shapely.difference(shapely.intersection(shades, seen), solid)


def _hidden_from_all(truth: GroundTruth, site: Site, carrier: FloatArray) -> shapely.Geometry:
    blockers = [*corners(truth.position, truth.size, truth.yaw), *site.occluders]
    solid = shapely.union_all([shapely.Polygon(outline) for outline in blockers])
    seen = []
    for one in site.sensors:
        eye = one.pose_on(carrier)
        shades = [shadow(outline, eye[:2], one.max_range * 1.1) for outline in blockers]
        seen.append(shapely.difference(field_of_view(one, eye), shapely.union_all(shades)))
    hidden = shapely.difference(field_of_view(site, carrier), shapely.union_all(seen))
    return shapely.difference(hidden, solid)


def rings(region: shapely.Geometry) -> Iterable[FloatArray]:
    """Every outline of a region, holes too, each (V,2)."""
    for part in shapely.get_parts(region):
        if part.geom_type == "Polygon" and not part.is_empty:
            yield np.asarray(part.exterior.coords)
            for hole in part.interiors:
                yield np.asarray(hole.coords)
