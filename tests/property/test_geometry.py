"""Laws of angles, frames and overlaps."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pmbm.geometry import centre_distance, corners, iou, to_local, to_world, wrap_angle

angle = st.floats(-1e4, 1e4)
coordinate = st.floats(-500, 500)
pose = st.tuples(coordinate, coordinate, st.floats(-np.pi, np.pi))
points = arrays(np.float64, st.tuples(st.integers(0, 6), st.just(2)), elements=coordinate)
length = st.floats(0.3, 20)


@st.composite
def boxes(draw):
    n = draw(st.integers(1, 4))
    near = st.floats(-8, 8)
    position = draw(arrays(np.float64, (n, 3), elements=near))
    size = draw(arrays(np.float64, (n, 3), elements=length))
    yaw = draw(arrays(np.float64, n, elements=st.floats(-np.pi, 3.1)))
    return position, size, yaw


@given(angle)
@example(float(np.nextafter(-np.pi, -4)))
def test_wrapped_angles_are_in_the_interval_and_point_the_same_way(a):
    w = float(wrap_angle(a))
    assert -np.pi <= w < np.pi
    assert np.isclose(np.cos(w), np.cos(a), atol=1e-9)
    assert np.isclose(np.sin(w), np.sin(a), atol=1e-9)
    assert float(wrap_angle(w)) == w


@given(points, pose)
def test_to_local_undoes_to_world(p, at):
    assert np.allclose(to_local(to_world(p, at), at), p, atol=1e-9)


@given(boxes())
def test_corners_surround_the_centre_at_the_half_diagonal(box):
    position, size, yaw = box
    c = corners(position, size, yaw)
    assert np.allclose(c.mean(axis=1), position[:, :2])
    radius = np.linalg.norm(c - position[:, None, :2], axis=-1)
    assert np.allclose(radius, np.hypot(size[:, 0], size[:, 1])[:, None] / 2)
    front = c[:, [0, 3]].mean(axis=1) - position[:, :2]
    assert np.allclose(np.arctan2(front[:, 1], front[:, 0]), np.arctan2(np.sin(yaw), np.cos(yaw)))


@given(boxes(), boxes())
def test_iou_is_symmetric_bounded_and_one_with_itself(a, b):
    for vertical in (False, True):
        ab = iou(*a, *b, vertical=vertical)
        assert ab.shape == (len(a[0]), len(b[0]))
        assert np.allclose(ab, iou(*b, *a, vertical=vertical).T, atol=1e-9)
        assert (ab >= 0).all()
        assert (ab <= 1 + 1e-9).all()
        assert np.allclose(np.diag(iou(*a, *a, vertical=vertical)), 1)


@given(boxes(), boxes(), pose)
def test_iou_does_not_depend_on_the_frame(a, b, at):
    def moved(box):
        position, size, yaw = box
        xy = to_world(position[:, :2], at)
        return np.column_stack([xy, position[:, 2]]), size, yaw + at[2]

    assert np.allclose(iou(*a, *b), iou(*moved(a), *moved(b)), atol=1e-6)


def test_iou_by_hand():
    a = (np.zeros((1, 3)), np.array([[4.0, 2.0, 2.0]]), np.zeros(1))
    half_along = (np.array([[2.0, 0, 0]]), a[1], a[2])
    assert np.isclose(iou(*a, *half_along, vertical=False)[0, 0], 4 / 12)
    half_up = (np.array([[0, 0, 1.0]]), a[1], a[2])
    assert np.isclose(iou(*a, *half_up)[0, 0], 8 / 24)
    assert np.isclose(iou(*a, *half_up, vertical=False)[0, 0], 1.0)
    crossed = (a[0], a[1], np.array([np.pi / 2]))
    assert np.isclose(iou(*a, *crossed, vertical=False)[0, 0], 4 / 12)
    assert iou(*a, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)).shape == (1, 0)


def test_distances_by_hand():
    assert centre_distance([[0, 0]], [[3, 4], [0, 0]]).tolist() == [[5, 0]]
