"""The intensity of undetected objects as the page keeps it, against the mixture itself."""

import base64
import json
import zlib
from dataclasses import replace

import numpy as np
import pytest
import shapely
from traffic import hidden_mixture, recording, tracks

from pmbm.geometry import normal_in_polygon
from pmbm.reports.encode import encode_replay
from pmbm.reports.hidden_grid import (
    CODES,
    DECADES,
    LOWEST,
    MOST_CELLS,
    cell_masses,
    coded,
    hidden_grid,
)
from pmbm.reports.values import ReplayPage
from pmbm.types import GaussianMixture, TrackSequence


def mixture(*parts):
    """Of (weight, x, y, variance x, variance y, covariance)."""
    cov = np.zeros((len(parts), 4, 4))
    for k, (_, _, _, xx, yy, xy) in enumerate(parts):
        cov[k] = np.diag([xx, yy, 1.0, 1.0])
        cov[k, 0, 1] = cov[k, 1, 0] = xy
    return GaussianMixture(
        log_weight=np.log([part[0] for part in parts]),
        mean=[[part[1], part[2], 0.0, 0.0] for part in parts],
        cov=cov,
    )


NARROW = (0.3, 3.3, -2.1, 0.04, 0.04, 0.0)
LATTICE = (0.4, -5.2, 4.4, 3.06, 4.0, 0.3)
SLANTED = (0.5, 8.0, 13.0, 40.0, 25.0, -18.0)
BROAD = (2.0, 1.0, 0.0, 900.0, 900.0, 0.0)


@pytest.mark.parametrize("part", [NARROW, LATTICE, SLANTED, BROAD])
def test_cells_hold_what_the_mixture_has_there(part):
    cell, n, low = 1.9, 60, np.array([-57.0, -57.0])
    masses = cell_masses(mixture(part), low, cell, n)
    box = low + cell * np.array([[0, 0], [n, 0], [n, n], [0, n]])
    assert masses.sum() == pytest.approx(mixture(part).expected_count(box), rel=2e-3)
    # Some cells with the most in them, and a block that cuts through the component.
    one = mixture(part)
    for flat in np.argsort(-masses.ravel())[:4]:
        j, i = divmod(int(flat), n)
        corners = low + cell * np.array([[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]])
        exact = part[0] * normal_in_polygon(corners, one.mean[:, :2], one.cov[:, :2, :2])[0]
        assert masses[j, i] == pytest.approx(exact, rel=0.02, abs=1e-5)
    i, j = (int(v) for v in np.floor((np.array(part[1:3]) - low) / cell))
    block = low + cell * np.array([[i - 5, j - 7], [i + 1, j - 7], [i + 1, j + 1], [i - 5, j + 1]])
    assert masses[j - 7 : j + 1, i - 5 : i + 1].sum() == pytest.approx(
        one.expected_count(block), rel=5e-3
    )


def test_components_add_up_wherever_they_lie():
    parts = [NARROW, LATTICE, SLANTED, BROAD, (9.0, 500.0, 0.0, 4.0, 4.0, 0.0)]
    low = np.array([-30.0, -30.0])
    together = cell_masses(mixture(*parts), low, 1.5, 40)
    alone = sum(cell_masses(mixture(part), low, 1.5, 40) for part in parts)
    assert together == pytest.approx(alone)
    assert cell_masses(GaussianMixture.empty(), low, 1.5, 40).sum() == 0


def test_codes_are_within_half_a_step():
    intensity = np.geomspace(LOWEST, 1.0, 1000)
    code = coded(intensity)
    back = LOWEST * 10 ** (DECADES * (code.astype(float) - 1) / (CODES - 1))
    assert np.abs(np.log10(back / intensity)).max() <= 0.5001 * DECADES / (CODES - 1)
    assert code[0] == 1
    assert code[-1] == 255
    assert coded(np.array([0.0, 1e-9, 50.0])).tolist() == [0, 0, 255]


def test_the_page_has_the_grid_around_the_sensor():
    scene = recording(frames=12)
    data = encode_replay(ReplayPage(recording=scene, tracks={"a": tracks(scene, undetected=True)}))
    told = data["trackers"][0]["undetected"]
    raw = np.frombuffer(zlib.decompress(base64.b64decode(data["blob"])), np.uint8)
    n, steps = told["side"], told["rows"]
    change = raw[told["codes"] : told["codes"] + steps * n * n].reshape(steps, n, n)
    code = np.cumsum(change, axis=0, dtype=np.uint8)
    grid = hidden_grid(scene, tracks(scene, undetected=True), np.array(data["centre"]))
    np.testing.assert_array_equal(code, grid.code)
    low = grid.corner[7] * grid.cell + data["centre"]
    width = n * grid.cell
    assert (low <= -scene.site.max_range).all()
    assert (low + width >= scene.site.max_range).all()
    density = np.where(code[7] > 0, LOWEST * 10 ** (DECADES * (code[7] - 1.0) / (CODES - 1)), 0)
    region = shapely.Polygon([(42, 8), (54, 9), (56, 17), (44, 18)])
    cells = shapely.box(
        *(low[k] + grid.cell * (np.indices((n, n))[1 - k] + d) for d in (0, 1) for k in (0, 1))
    )
    counted = (density * shapely.area(shapely.intersection(cells, region))).sum()
    exact = hidden_mixture().expected_count(np.array(region.exterior.coords)[:-1])
    assert counted == pytest.approx(exact, rel=0.02)


def test_the_layer_of_another_run_takes_the_place_of_its_own():
    scene = recording(frames=6)
    plain, mapped = tracks(scene), tracks(scene, undetected=True)
    data = encode_replay(ReplayPage(recording=scene, tracks={"a": plain}, maps={"a": mapped}))
    assert data["trackers"][0]["undetected"]["rows"] == 6
    assert (
        encode_replay(ReplayPage(recording=scene, tracks={"a": plain}))["trackers"][0]["undetected"]
        is None
    )


def test_the_layer_is_bounded_however_many_components_and_steps():
    rng = np.random.default_rng(5)
    scene = recording(frames=300)
    many = mixture(
        *((0.003, *rng.uniform(-80, 80, 2), *rng.uniform(1, 4, 2), 0.0) for _ in range(60))
    )
    steps = [replace(step, undetected=many) for step in tracks(scene)]
    sequence = TrackSequence(steps=steps, frame=range(300))
    grid = hidden_grid(scene, sequence, np.zeros(2))
    assert grid.code.size <= MOST_CELLS
    bare = len(json.dumps(encode_replay(ReplayPage(recording=scene, tracks={"a": tracks(scene)}))))
    full = len(json.dumps(encode_replay(ReplayPage(recording=scene, tracks={"a": sequence}))))
    assert full - bare < 100_000
