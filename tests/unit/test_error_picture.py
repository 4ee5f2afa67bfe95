"""The picture of decomposed errors shows what the metrics say."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from metric_builders import run_of

from pmbm.errors import InputError
from pmbm.reports.figures import error_picture, save
from pmbm.types import TrackSequence


def sequence(steps):
    return TrackSequence(steps=tuple(steps), frame=np.arange(len(steps)))


@pytest.fixture
def scored():
    truth = [{1: (k, 0), 2: (k, 20)} for k in range(6)]
    recording, good = run_of(truth, truth)
    _, bad = run_of(truth, [{7: (k + 1, 0), 8: (k, 60)} for k in range(6)])
    return recording, {"good": sequence(good), "bad": sequence(bad)}


def test_rows_share_a_scale_that_holds_the_worst(scored):
    figure = error_picture(*scored)
    axes = figure.axes
    assert len(axes) == 4
    # One metre off, one missed, one false: 1 + 8 + 8.
    for panel in axes[::2]:
        assert panel.get_ylim()[0] == 0
        assert panel.get_ylim()[1] >= 17
    widths = [[bar.get_width() for bar in panel.patches] for panel in axes[1::2]]
    np.testing.assert_allclose(widths, [[0, 0, 0], [1, 8, 8]], atol=1e-12)
    assert axes[1].get_xlim()[1] >= 17
    assert axes[1].get_title(loc="left") == "mean GOSPA 0.00 m"
    assert axes[3].get_title(loc="left") == "mean GOSPA 4.12 m"


def test_the_picture_is_written_and_written_alike(scored, tmp_path):
    for name in ("one.svg", "two.svg"):
        save(error_picture(*scored), tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
    ElementTree.parse(tmp_path / "one.svg")
    text = (tmp_path / "one.svg").read_text()
    for words in ("good", "bad", "missed objects", "false tracks", "time, s"):
        assert words in text


def test_without_trackers_there_is_nothing_to_draw(scored):
    with pytest.raises(InputError, match="nothing to draw"):
        error_picture(scored[0], {})
