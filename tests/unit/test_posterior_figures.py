"""The figures beside the record of `make verify`: what is shown is what was given."""

from __future__ import annotations

import numpy as np

from pmbm.reports.drawing import save
from pmbm.reports.posterior_figures import (
    cost_figure,
    errors_figure,
    reliability_figure,
    squares_figure,
    transform_figure,
)


def axes_of(figure, path):
    """The only axes, once the figure could be written."""
    save(figure, path / "figure.svg")
    assert (path / "figure.svg").read_text().startswith("<?xml")
    return figure.axes[0]


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_errors_that_are_zero_are_shown_too(tmp_path):
    axes = axes_of(errors_figure({"weights": [0.0, 1e-14], "states": [1e-12]}, 1e-9), tmp_path)
    assert legend(axes) == ["weights (2)", "states (1)", "bound 1e-09"]
    assert axes.get_xlim()[0] <= -18


def test_the_transform_is_less_the_uniform_one(tmp_path):
    axes = axes_of(transform_figure([0.9, 0.1, 0.5, 0.4], 0.05), tmp_path)
    x, y = axes.lines[-1].get_data()
    assert list(x) == [0.1, 0.4, 0.5, 0.9]
    np.testing.assert_allclose(y, [0.15, 0.1, 0.25, 0.1])


def test_a_bin_lies_where_it_was_claimed(tmp_path):
    axes = axes_of(reliability_figure([0.1, 0.9], [0.2, 0.8], [0.05, 0.1]), tmp_path)
    points = axes.containers[0].lines[0].get_data()
    np.testing.assert_allclose(points, [[0.1, 0.9], [0.2, 0.8]])


def test_samples_of_the_law_lie_on_the_diagonal(tmp_path):
    from scipy.stats import chi2

    values = chi2.ppf((np.arange(50) + 0.5) / 50, 4)
    axes = axes_of(squares_figure({"NEES": (values[::-1], 4)}), tmp_path)
    expected, found = axes.lines[0].get_data()
    np.testing.assert_allclose(found, expected)
    assert legend(axes) == ["NEES, chi-square of 4 (50)"]


def test_costs_are_differences(tmp_path):
    axes = axes_of(cost_figure({"a gate of 9": ([2.0, 4.0], [2.5, 3.0])}), tmp_path)
    assert legend(axes) == ["a gate of 9: -0.2500 on average"]
    np.testing.assert_allclose(axes.lines[-1].get_data(), [[2.0, 4.0], [0.5, -1.0]])
