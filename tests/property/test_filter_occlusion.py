"""What the filter expects to see behind other tracks, against the exact shadow test."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from pmbm.filter.density import Density, Globals, Locals, Mixture
from pmbm.filter.occlusion import Shadows, box_rays, outline_rays
from pmbm.geometry import corners, visible_fraction

BEARING = 2 * np.pi / 1440


def density_of(boxes, existence):
    """One hypothesis with one track a box: (x, y, length, width, yaw)."""
    boxes = np.asarray(boxes, dtype=float)
    n = len(boxes)
    local = Locals(
        np.arange(n),
        np.asarray(existence, dtype=float),
        np.column_stack([boxes[:, :2], np.zeros((n, 2))]),
        np.tile(1e-12 * np.eye(4), (n, 1, 1)),
        np.column_stack([np.zeros(n), boxes[:, 2:4], np.ones(n), boxes[:, 4]]),
        np.zeros(n, np.int8),
        np.zeros((n, 0), np.int32),
    )
    table = Globals(np.zeros(1, np.intp), np.zeros(1), np.array([0, n]), np.arange(n))
    return Density(Mixture.empty(), local, table, np.arange(n), n)


def expected(boxes, existence, occluders=()):
    density = density_of(boxes, existence)
    return Shadows.of(density, np.zeros(2), occluders).visible_share(density.local)


def outline(box):
    x, y, length, width, yaw = box
    return corners([[x, y, 0]], [[length, width, 1]], [yaw])


@st.composite
def apart(draw):
    """Boxes that neither meet each other nor surround the sensor."""
    n = draw(st.integers(1, 5))
    boxes = []
    for _ in range(n):
        distance = draw(st.floats(12, 60))
        bearing = draw(st.floats(-np.pi, np.pi))
        boxes.append(
            (
                distance * np.cos(bearing),
                distance * np.sin(bearing),
                draw(st.floats(0.5, 14)),
                draw(st.floats(0.5, 3)),
                draw(st.floats(-np.pi, 3.1)),
            )
        )
    reach = [np.hypot(b[2], b[3]) / 2 for b in boxes]
    for i in range(n):
        for j in range(i):
            gap = np.hypot(boxes[i][0] - boxes[j][0], boxes[i][1] - boxes[j][1])
            assume(gap > reach[i] + reach[j])
    return boxes


@given(apart())
def test_certain_tracks_hide_what_the_exact_shadow_test_says(boxes):
    exact = visible_fraction(np.concatenate([outline(b) for b in boxes]), np.zeros(2))
    extent = [np.diff(box_rays(np.zeros(2), np.array([b[:2]]), box5(b)).first)[0] for b in boxes]
    # Each object's bearings are counted in whole steps: two ends, and two ends of each shadow.
    error = 2 * len(boxes) / np.maximum(extent, 1)
    assert (np.abs(expected(boxes, np.ones(len(boxes))) - exact) <= error).all()


def box5(b):
    return np.array([[0.0, b[2], b[3], 1.0, b[4]]])


@given(apart(), st.data())
def test_doubtful_tracks_hide_in_expectation(boxes, data):
    r = np.array(data.draw(st.lists(st.floats(0.1, 1), min_size=len(boxes), max_size=len(boxes))))
    # By hand: the expectation over who exists, each object looked at as if it exists itself.
    mean = np.zeros(len(boxes))
    for exists in np.ndindex(*(2,) * len(boxes)):
        there = np.array(exists, bool)
        for i in range(len(boxes)):
            others = np.delete(there, i)
            probability = np.prod(np.where(others, np.delete(r, i), 1 - np.delete(r, i)))
            certain = np.where(there, 1.0, 0.0)
            certain[i] = 1.0
            if there[i]:
                mean[i] += probability * expected(boxes, certain)[i]
    assert np.allclose(expected(boxes, r), mean, atol=1e-7)


@given(apart(), st.floats(-np.pi, np.pi))
def test_turning_the_world_changes_nothing_but_the_rounding_of_bearings(boxes, turn):
    steps = round(turn / BEARING)
    turn = steps * BEARING
    cos, sin = np.cos(turn), np.sin(turn)
    turned = [
        (cos * x - sin * y, sin * x + cos * y, length, width, yaw + turn)
        for x, y, length, width, yaw in boxes
    ]
    here, there = expected(boxes, np.ones(len(boxes))), expected(turned, np.ones(len(boxes)))
    extent = [np.diff(box_rays(np.zeros(2), np.array([b[:2]]), box5(b)).first)[0] for b in boxes]
    assert (np.abs(here - there) <= 2 * len(boxes) / np.maximum(extent, 1)).all()


def test_a_car_behind_a_truck_by_hand():
    truck, car = (10.0, 0.0, 2.6, 14.0, 0.0), (30.0, 0.0, 4.5, 1.9, 0.0)
    assert np.allclose(expected([truck, car], [1.0, 1.0]), [1.0, 0.0], atol=1e-8)
    assert np.allclose(expected([truck, car], [0.25, 1.0]), [1.0, 0.75])
    assert np.allclose(expected([truck, car], [0.04, 1.0]), [1.0, 1.0])


def test_a_wall_hides_what_stands_behind_it_and_not_what_stands_before_it():
    wall = np.array([[19.0, -10.0], [20.0, -10.0], [20.0, 10.0], [19.0, 10.0]])
    near, far = (10.0, 0.0, 4.5, 1.9, 0.0), (30.0, 0.0, 4.5, 1.9, 0.0)
    assert np.allclose(expected([near], [1.0], [wall]), [1.0])
    assert np.allclose(expected([far], [1.0], [wall]), [0.0], atol=1e-8)
    beside = (30.0, 40.0, 4.5, 1.9, 0.0)
    assert np.allclose(expected([beside], [1.0], [wall]), [1.0])


def test_a_hypothesis_is_never_hidden_by_its_own_track():
    density = density_of([(20.0, 0.0, 4.5, 1.9, 0.0)], [1.0])
    shadows = Shadows.of(density, np.zeros(2))
    other = density_of([(30.0, 0.0, 4.5, 1.9, 0.0)], [1.0]).local
    assert np.allclose(shadows.visible_share(other), [1.0])


def test_an_uncertain_position_is_hidden_in_part():
    boxes = [(10.0, 0.0, 2.6, 6.0, 0.0), (20.0, 10.0, 4.5, 1.9, 0.0)]
    density = density_of(boxes, [1.0, 1.0])
    shadows = Shadows.of(density, np.zeros(2))
    density.local.cov[1] = np.diag([9.0, 9.0, 1.0, 1.0])
    share = shadows.visible_share(density.local)[1]
    assert 0.3 < share < 0.9
    assert expected(boxes, [1.0, 1.0])[1] == 1.0


def test_rays_of_a_box_and_of_its_outline_agree():
    box = (15.0, 7.0, 8.0, 3.0, 0.4)
    a = box_rays(np.zeros(2), np.array([box[:2]]), box5(box))
    b = outline_rays(np.zeros(2), [outline(box)[0]])
    assert a.bearing.tolist() == b.bearing.tolist()
    assert np.allclose(a.distance, b.distance)


def test_a_sensor_inside_an_outline_sees_through_it():
    around = outline((0.0, 0.0, 10.0, 10.0, 0.2))[0]
    assert len(outline_rays(np.zeros(2), [around]).bearing) == 0
    assert np.allclose(expected([(0.1, 0.0, 5.0, 3.0, 0.1), (9.0, 0, 4, 2, 0)], [1, 1]), 1.0)
