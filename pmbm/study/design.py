"""The points of a sweep: grids and Latin hypercubes over named parameters."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from pmbm.errors import InputError

Point = dict[str, Any]


def grid(levels: Mapping[str, Sequence[Any]]) -> list[Point]:
    """Every combination of the levels, the last parameter fastest; one empty point for none."""
    for name, values in levels.items():
        if not values:
            raise InputError("no levels", field=f"sweep.grid.{name}", expected="at least one")
    return [
        dict(zip(levels, values, strict=True)) for values in itertools.product(*levels.values())
    ]


def latin_hypercube(
    ranges: Mapping[str, tuple[float, float]], samples: int, seed: int
) -> list[Point]:
    """`samples` points, each parameter's range cut into so many slices with one point in each
    (McKay, Beckman, Conover, Technometrics 21, 1979)."""
    from scipy.stats import qmc

    for name, (low, high) in ranges.items():
        if not low < high:
            raise InputError(
                "bad range",
                field=f"sweep.latin_hypercube.ranges.{name}",
                expected="[low, high], low < high",
                got=[low, high],
            )
    unit = qmc.LatinHypercube(len(ranges), rng=seed).random(samples)
    return [
        {
            name: low + float(u) * (high - low)
            for (name, (low, high)), u in zip(ranges.items(), row, strict=True)
        }
        for row in unit
    ]
