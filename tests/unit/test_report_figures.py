"""Shadows against the exact visibility of the geometry module, and pictures that can be written."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from traffic import hidden_mixture, recording, tracks

from pmbm.errors import InputError
from pmbm.geometry import corners, visible_fraction
from pmbm.types import Recording, Site
from reports.drawing import planar_intensity
from reports.figures import save, scene_picture, traffic_extent
from reports.shadows import field_of_view, hidden_region, shadow


@given(
    x=st.floats(-30, 30),
    y=st.floats(-30, 30),
    yaw=st.floats(-3, 3),
    length=st.floats(1, 15),
    width=st.floats(0.5, 3),
    seed=st.integers(0, 10**6),
)
@settings(max_examples=25)
def test_a_shadow_is_where_small_things_are_invisible(x, y, yaw, length, width, seed):
    outline = corners([[x, y, 0]], [[length, width, 1]], [yaw])[0]
    solid = shapely.Polygon(outline)
    if shapely.distance(solid, shapely.Point(0, 0)) < 0.5:
        return
    shade = shadow(outline, (0.0, 0.0), 100.0)
    points = np.random.default_rng(seed).uniform(-60, 60, (40, 2))
    tiny = corners(np.column_stack([points, np.zeros(40)]), np.full((40, 3), 1e-4), np.zeros(40))
    for point, box in zip(points, tiny, strict=True):
        place = shapely.Point(point)
        if shapely.distance(shade.boundary, place) < 1e-2 or shapely.contains(solid, place):
            continue
        seen = visible_fraction(box[None], np.zeros(2), [outline])[0]
        assert shapely.contains(shade, place) == (seen == 0)


def test_nothing_is_hidden_from_an_eye_inside():
    square = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    assert shadow(square, (0.0, 0.0), 10.0).is_empty


def test_the_field_of_view_is_a_sector():
    site = Site(fov_centre=0.5, fov_half_angle=0.6, max_range=20.0)
    view = field_of_view(site, (3.0, 4.0, 0.2))
    assert view.area == pytest.approx(0.6 * 20**2, rel=1e-3)
    inside = np.array([3 + 19 * np.cos(0.7), 4 + 19 * np.sin(0.7)])
    assert shapely.contains_xy(view, *inside)
    assert not shapely.contains_xy(view, 3 - 5, 4)
    round_view = field_of_view(Site(max_range=10.0), (0, 0, 1))
    assert round_view.area == pytest.approx(np.pi * 100, rel=1e-3)


def test_hidden_objects_of_a_scene_lie_in_its_hidden_region():
    scene = recording()
    frame = 46
    truth = scene.truth[frame]
    region = hidden_region(truth, scene.site, np.zeros(3))
    overtaker = truth.position[1, :2]
    seen = visible_fraction(
        corners(truth.position, truth.size, truth.yaw), np.zeros(2), scene.site.occluders
    )
    assert seen[0] == 1
    assert not shapely.contains_xy(region, *truth.position[0, :2])
    # A box behind another is in the region but for its own area: look just around it.
    around = shapely.Point(overtaker).buffer(3)
    share = shapely.intersection(region, around).area / around.area
    assert (seen[1] < 0.5) == (share > 0.4)


def test_the_intensity_adds_up_to_its_weights():
    x = np.linspace(-120, 120, 601)
    density = planar_intensity(hidden_mixture(), x, x)
    assert density.sum() * (x[1] - x[0]) ** 2 == pytest.approx(0.7, rel=1e-3)
    assert np.unravel_index(density.argmax(), density.shape)[0] == np.abs(x - 20).argmin()


@pytest.mark.parametrize("dark", [False, True])
def test_a_picture_is_written(tmp_path, dark):
    scene = recording(frames=40)
    by_tracker = {"careful": tracks(scene), "sloppy": tracks(scene, sloppy=True)}
    figure = scene_picture(scene, by_tracker, 30, dark=dark)
    save(figure, tmp_path / "scene.svg")
    save(figure, tmp_path / "scene.png")
    with Image.open(tmp_path / "scene.png") as image:
        assert len(image.convert("RGB").quantize(64).getcolors()) > 20
    text = (tmp_path / "scene.svg").read_text()
    ElementTree.fromstring(text)
    assert "careful" in text
    assert "sloppy" in text
    ids = [[words.get_text() for words in axes.texts] for axes in figure.axes]
    assert "999" in ids[1]  # the ghost
    assert "999" not in ids[0]
    figure = scene_picture(scene, by_tracker, 30, dark=dark)
    save(figure, tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_text() == text


def test_the_scene_alone_and_the_frame_it_chooses():
    scene = recording()
    assert len(scene_picture(scene).axes) == 1
    with pytest.raises(InputError, match="no such frame"):
        scene_picture(scene, frame=100)
    bare = Recording(name="n", truth=scene.truth, detections=(), frame=[], stamp=scene.stamp)
    assert len(scene_picture(bare).axes) == 1


def test_the_extent_holds_the_sensor_and_what_is_in_range():
    scene = recording()
    x0, y0, x1, y1 = traffic_extent(scene, 0)
    for x, y, _ in [*scene.truth[0].position, (0.0, 0.0, 0.0)]:
        assert x0 < x < x1
        assert y0 < y < y1
    assert 1 <= (x1 - x0) / (y1 - y0) <= 3 + 1e-9
