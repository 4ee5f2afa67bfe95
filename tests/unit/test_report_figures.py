"""Shadows against the exact visibility of the geometry module, and pictures that can be written."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy import stats
from traffic import hidden_mixture, recording, tracks

from pmbm.errors import InputError
from pmbm.geometry import corners, visible_fraction
from pmbm.reports.drawing import planar_intensity
from pmbm.reports.figures import (
    expected_in,
    hidden_counts,
    hidden_traffic_picture,
    save,
    scene_picture,
    traffic_extent,
)
from pmbm.reports.shadows import field_of_view, hidden_region, shadow
from pmbm.types import Recording, Site


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
    assert np.unravel_index(density.argmax(), density.shape)[0] == np.abs(x - 13).argmin()


def test_the_expected_number_in_a_region_is_scipys():
    mixture = hidden_mixture()
    want = sum(
        np.exp(w) * stats.multivariate_normal(m[:2], c[:2, :2]).cdf([54, 17], lower_limit=[-60, 8])
        for w, m, c in zip(mixture.log_weight, mixture.mean, mixture.cov, strict=True)
    )
    assert expected_in(mixture, shapely.box(-60, 8, 54, 17)) == pytest.approx(want, rel=1e-3)
    assert expected_in(mixture, shapely.box(0, 0, 0.1, 0.1)) == 0


def test_shadows_are_counted_with_who_was_never_detected():
    """The car behind the truck counts while no detection has shown it, not after."""
    scene = recording()
    report = tracks(scene, undetected=True)[46]
    known = hidden_counts(scene, report, 46, (-60, -60, 60, 60))
    assert sum(there for *_, there in known) == 0
    # Half an object is around (48, 13): by sampling, how much of it lies in some shadow.
    region = hidden_region(scene.truth[46], scene.site, np.zeros(3))
    behind = hidden_mixture().take([0])
    draws = np.random.default_rng(4).multivariate_normal(
        behind.mean[0, :2], behind.cov[0, :2, :2], 100_000
    )
    share = shapely.contains_xy(region, *draws.T).mean()
    assert 0.2 < share < 0.8
    most = max(known, key=lambda count: count.expected)
    assert most.expected == pytest.approx(0.5 * share, rel=0.02)
    assert shapely.contains_xy(region, *most.place)
    blind = unseen(scene)
    unknown = hidden_counts(blind, report, 46, (-60, -60, 60, 60))
    assert sum(there for *_, there in unknown) == 1


def unseen(scene):
    """The same scene to a detector that finds nothing."""
    return Recording(
        name="blind",
        truth=scene.truth,
        detections=tuple(d.take([]) for d in scene.detections),
        frame=scene.frame,
        stamp=scene.stamp,
        site=scene.site,
        origin=tuple(np.zeros(0, int) for _ in scene.detections),
    )


def test_the_hidden_map_is_of_the_last_moment_that_hides_most_unknown():
    scene = recording()
    blind, sequence = unseen(scene), tracks(scene, undetected=True)
    pose = np.zeros(3)
    hidden = [
        int(((np.hypot(*(t.position[:, :2] - pose[:2]).T) <= 60) & ~t.observable).sum())
        for t in scene.truth
    ]
    last = max(k for k, count in enumerate(hidden) if count == max(hidden))
    figure = hidden_traffic_picture(blind, sequence)
    axes = figure.axes[0]
    assert axes.get_title(loc="right") == f"blind, {scene.truth[last].time:.1f} s"
    assert any(text.get_text().endswith("1 there") for text in axes.texts)
    assert "expected" in axes.get_title(loc="left")
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "never detected" in labels


def test_the_hidden_map_is_written(tmp_path):
    scene = recording()
    sequence = tracks(scene, undetected=True)
    figure = hidden_traffic_picture(scene, sequence, 46)
    words = [text.get_text() for text in figure.axes[0].texts]
    assert any("expected" in text for text in words)
    save(figure, tmp_path / "hidden.png")
    assert (tmp_path / "hidden.png").stat().st_size > 20_000
    with pytest.raises(InputError, match="no intensity"):
        hidden_traffic_picture(scene, tracks(scene), 46)


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
