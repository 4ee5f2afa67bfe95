"""The shadow test against dense ray casting, and the laws it obeys."""

import numpy as np
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from pmbm.geometry import corners, to_world, visible_fraction

RAYS = 800


def cast_rays(outlines, sensor, occluders):
    """The same share by brute force: a ray sees the outline whose first hit is nearest."""
    shapes = [shapely.Polygon(outline) for outline in [*outlines, *occluders]]
    origin = shapely.Point(sensor)
    shares = []
    for index, outline in enumerate(outlines):
        if shapes[index].intersects(origin):
            shares.append(1.0)
            continue
        towards = np.asarray(outline) - sensor
        bearing = np.arctan2(towards[:, 1], towards[:, 0])
        mean = np.arctan2(*towards.mean(axis=0)[::-1])
        offset = np.angle(np.exp(1j * (bearing - mean)))
        angle = mean + np.linspace(offset.min(), offset.max(), 2 * RAYS + 1)[1::2]
        end = sensor + 1e4 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rays = shapely.linestrings(np.stack([np.broadcast_to(sensor, end.shape), end], axis=1))
        nearest = np.full(RAYS, np.inf)
        for other, shape in enumerate(shapes):
            if other == index or shape.intersects(origin):
                continue
            hit = shapely.distance(origin, shapely.intersection(rays, shape))
            nearest = np.fmin(nearest, hit)
        own = shapely.distance(origin, shapely.intersection(rays, shapes[index]))
        shares.append(np.mean(~(nearest < own - 1e-9)))
    return np.array(shares)


def convex_hulls(draw, count, reach):
    hulls = []
    for _ in range(count):
        points = draw(
            st.lists(
                st.tuples(st.floats(-reach, reach), st.floats(-reach, reach)),
                min_size=3,
                max_size=7,
            )
        )
        hull = shapely.MultiPoint(points).convex_hull
        assume(hull.geom_type == "Polygon" and hull.area > 0.1)
        ring = np.array(hull.exterior.coords)[:-1]
        hulls.append(ring if draw(st.booleans()) else ring[::-1])
    return hulls


@st.composite
def views(draw, reach=25.0):
    seed = draw(st.integers(0, 2**32 - 1))
    count = draw(st.integers(0, 7))
    rng = np.random.default_rng(seed)
    boxes = corners(
        rng.uniform(-reach, reach, (count, 3)),
        rng.uniform(0.5, 12.0, (count, 3)),
        rng.uniform(-np.pi, np.pi, count),
    )
    sensor = rng.uniform(-reach / 2, reach / 2, 2)
    return boxes, sensor, convex_hulls(draw, draw(st.integers(0, 2)), reach)


@given(views())
def test_equals_dense_ray_casting_also_where_boxes_overlap(view):
    boxes, sensor, occluders = view
    exact = visible_fraction(boxes, sensor, occluders)
    assert exact.shape == (len(boxes),)
    assert ((exact >= 0) & (exact <= 1)).all()
    # Each end of a visible stretch may cut one ray; a convex outline makes few stretches.
    np.testing.assert_allclose(exact, cast_rays(boxes, sensor, occluders), atol=8 / RAYS)


@given(views(), st.floats(-4, 4), st.floats(-50, 50), st.floats(-50, 50))
def test_moves_with_the_world(view, turn, x, y):
    boxes, sensor, occluders = view
    pose = (x, y, turn)
    moved = visible_fraction(
        to_world(boxes, pose), to_world(sensor, pose), [to_world(o, pose) for o in occluders]
    )
    np.testing.assert_allclose(moved, visible_fraction(boxes, sensor, occluders), atol=1e-8)


@given(views(), st.randoms(use_true_random=False))
def test_order_does_not_matter(view, random):
    boxes, sensor, occluders = view
    order = list(range(len(boxes)))
    random.shuffle(order)
    mixed = visible_fraction(boxes[order], sensor, occluders[::-1])
    straight = visible_fraction(boxes, sensor, occluders)
    np.testing.assert_allclose(mixed, straight[order], atol=1e-12)


@given(views())
def test_more_occluders_never_show_more(view):
    boxes, sensor, occluders = view
    everything = visible_fraction(boxes, sensor, occluders)
    without = visible_fraction(boxes, sensor, occluders[:-1])
    assert (everything <= without + 1e-12).all()
    if len(boxes) > 1:
        fewer = visible_fraction(boxes[:-1], sensor, occluders)
        assert (everything[:-1] <= fewer + 1e-12).all()


def box(x, y, length=4.0, width=2.0, yaw=0.0):
    return corners([[x, y, 0.8]], [[length, width, 1.6]], [yaw])[0]


def test_by_hand():
    front, behind, aside = box(10, 0), box(20, 0), box(0, 20)
    np.testing.assert_array_equal(visible_fraction([front, behind, aside], (0, 0)), [1.0, 0.0, 1.0])
    # Behind the sensor, across the cut of the angle at pi.
    np.testing.assert_array_equal(visible_fraction([box(-10, 0), box(-20, 0)], (0, 0)), [1.0, 0.0])
    # The near box covers bearings from 0 up: exactly the upper half of a square face on.
    share = visible_fraction([box(20, 0, 2, 2), box(10, 1.5, 1, 3)], (0, 0))
    np.testing.assert_allclose(share, [0.5, 1.0], atol=1e-12)
    # Two shadows that overlap count once.
    wall = np.array([[5.0, 0.0], [5.0, 9.0], [6.0, 9.0], [6.0, 0.0]])
    twice = visible_fraction(
        [box(20, 0, 2, 2)], (0, 0), [wall, wall + np.array([2.0, 0.0]), wall[::-1]]
    )
    np.testing.assert_allclose(twice, [0.5], atol=1e-12)


def test_nothing_there_coincident_boxes_and_a_sensor_inside():
    assert visible_fraction(np.zeros((0, 4, 2)), (0, 0), [box(3, 0)]).shape == (0,)
    np.testing.assert_array_equal(visible_fraction([box(9, 1), box(9, 1)], (0, 0)), [1.0, 1.0])
    np.testing.assert_array_equal(
        visible_fraction([box(0, 0), box(10, 0)], (0, 0), [box(0, 0, 40, 40)]), [1.0, 1.0]
    )


def test_a_crossing_outline_hides_only_where_it_is_nearer():
    # Thin boxes crossing like an X 10 m ahead: each is seen on its near side alone.
    share = visible_fraction(
        [box(10, 0, 12, 1e-4, np.pi / 4), box(10, 0, 12, 1e-4, -np.pi / 4)], (0, 0)
    )
    reach = 6 / np.sqrt(2)
    near, far = np.arctan2(reach, 10 - reach), np.arctan2(reach, 10 + reach)
    np.testing.assert_allclose(share, near / (near + far), atol=1e-4)
