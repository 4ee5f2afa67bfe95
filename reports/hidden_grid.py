"""The intensity of undetected objects as a small grid a step, for the page.

The grid's cells lie on one lattice fixed to the world, in a square window around the sensor that is
as wide as its range.  A cell's mean intensity is one byte, by the logarithm, so that neither the
number of a tracker's components nor their shapes matter to the page's size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pmbm.types import FloatArray, GaussianMixture, IntArray, Recording, TrackSequence

MOST_CELLS = 1_500_000
"""Of all steps together; one step has at most 160 x 160."""
_WIDEST = 160
_FINEST = 1.0
LOWEST, DECADES, CODES = 1e-6, 6.0, 255
"""Code k > 0 is an intensity of LOWEST * 10^(DECADES (k - 1) / (CODES - 1)) objects per m^2, and 0
is none: neighbouring codes are 5.6 % apart."""
_REACH = 3.5
"""Standard deviations to which a component is followed."""
_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class HiddenGrid:
    """The intensity of S steps on windows of n x n cells.

    cell : side of a cell, m; the lattice has a corner at `centre`, the replay's origin.
    frame (S,) : of the truth.  corner (S,2) : lattice indices of each window's lower left cell.
    code (S,n,n) : uint8, rows upward, columns to the right.
    """

    cell: float
    frame: IntArray
    corner: IntArray
    code: NDArray[np.uint8]


def hidden_grid(
    recording: Recording, tracks: TrackSequence, centre: FloatArray
) -> HiddenGrid | None:
    """The grid of what a tracker expects, or None where it never says.

    centre (2,) : the replay's origin in the world, m.
    """
    steps = [s for s, step in enumerate(tracks) if step.undetected is not None]
    if not steps:
        return None
    frame = tracks.frame[steps]
    width = 2 * min(recording.site.max_range, 500.0)
    n = int(np.sqrt(MOST_CELLS / len(steps)))
    n = max(8, min(n, _WIDEST, int(np.ceil(width / _FINEST)) + 2))
    # The sensor stands anywhere in the middle cell.
    cell = float(np.ceil(100 * width / (n - 2)) / 100)
    pose = {
        int(f): recording.site.carrier_pose(d)
        for f, d in zip(recording.frame, recording.detections, strict=True)
    }
    corner = np.zeros((len(steps), 2), np.int64)
    code = np.zeros((len(steps), n, n), np.uint8)
    for row, (s, f) in enumerate(zip(steps, frame.tolist(), strict=True)):
        mixture = tracks[s].undetected
        assert mixture is not None
        corner[row] = np.floor((pose[f][:2] - centre) / cell).astype(np.int64) - n // 2
        low = centre + corner[row] * cell
        code[row] = coded(cell_masses(mixture, low, cell, n) / cell**2)
    return HiddenGrid(cell, frame, corner, code)


def coded(intensity: FloatArray) -> NDArray[np.uint8]:
    """The nearest code of each intensity, objects per m^2."""
    with np.errstate(divide="ignore"):
        step = np.log10(intensity / LOWEST) * (CODES - 1) / DECADES
    return np.where(step < -0.5, 0, np.clip(np.rint(step), 0, CODES - 1) + 1).astype(np.uint8)


def decoded(code: NDArray[np.uint8]) -> FloatArray:
    """The intensity that each code stands for, objects per m^2."""
    exponent = DECADES * (code.astype(np.float64) - 1.0) / (CODES - 1)
    return np.where(code == 0, 0.0, LOWEST * 10.0**exponent)


def cell_masses(mixture: GaussianMixture, low: FloatArray, cell: float, n: int) -> FloatArray:
    """Expected objects (n,n), rows upward, in the square cells whose lower left corner is `low`.

    Every column of cells has exactly the mass that it should, shared out along y as it lies at the
    column's middle.
    """
    total = np.zeros((n + 1) ** 2)
    sd = np.sqrt(np.maximum(mixture.cov[:, [0, 1], [0, 1]], 1e-6))
    half = np.ceil(_REACH * sd.max(axis=1, initial=0.0) / cell) + 1
    # Components of like width are taken together, each on a patch of its own; broad ones on all.
    half = np.where(half > 8, 2 ** np.ceil(np.log2(half)), half)
    half = np.where(2 * half + 1 >= n, n, half).astype(np.int64)
    for reach in np.unique(half).tolist():
        rows = np.flatnonzero(half == reach)
        at_once = max(1, _AT_ONCE // (2 * reach + 1) ** 2)
        for begin in range(0, len(rows), at_once):
            part = mixture.take(rows[begin : begin + at_once])
            mean = (part.mean[:, :2] - low) / cell
            if reach == n:
                first = np.zeros((len(part), 2), np.int64)
                width = n
            else:
                first = np.floor(mean).astype(np.int64) - reach
                width = 2 * reach + 1
            mass = _patch(part, mean, cell, first, width)
            column, row = (first[:, k, None] + np.arange(width) for k in (0, 1))
            index = np.where((column >= 0) & (column < n), column, n)[:, :, None]
            index = index + (n + 1) * np.where((row >= 0) & (row < n), row, n)[:, None, :]
            total += np.bincount(index.ravel(), mass.ravel(), minlength=len(total))
    # The last row and column gather what lies outside.
    return total.reshape(n + 1, n + 1)[:n, :n]


def _patch(
    mixture: GaussianMixture, mean: FloatArray, cell: float, first: IntArray, width: int
) -> FloatArray:
    """Mass (P,width,width), by column and row, of components in the cells from `first` (P,2) on;
    `mean` (P,2) is in cells."""
    cov = mixture.cov[:, :2, :2] / cell**2
    variance = np.maximum(cov[:, 0, 0], 1e-6)
    slope = (cov[:, 0, 1] / variance)[:, None]
    rest = np.maximum(cov[:, 1, 1] - slope[:, 0] * cov[:, 0, 1], 1e-6)
    column, row = (first[:, k, None] + np.arange(width + 1) for k in (0, 1))
    mx, my = mean[:, :1], mean[:, 1:]
    columns = np.diff(ndtr((column - mx) / np.sqrt(variance)[:, None]), axis=1)
    given = my + slope * (column[:, :-1] + 0.5 - mx)
    rows = ndtr((row[:, None, :] - given[:, :, None]) / np.sqrt(rest)[:, None, None])
    weight = np.exp(mixture.log_weight)[:, None, None]
    mass: FloatArray = weight * columns[:, :, None] * np.diff(rows, axis=2)
    return mass
