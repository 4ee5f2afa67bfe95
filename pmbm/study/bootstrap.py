"""How sure a difference over a dataset's sequences is: the paired bootstrap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmbm.errors import InputError
from pmbm.metrics import Evaluation, combine


@dataclass(frozen=True)
class Difference:
    """One tracker's metric over all sequences less another's.

    value : None where either is undefined.
    low, high : 95 % interval; None where most resamples have no value.
    """

    value: float | None
    low: float | None
    high: float | None


def bootstrap_difference(
    first: Sequence[Evaluation],
    second: Sequence[Evaluation],
    metric: str,
    *,
    resamples: int = 10_000,
    seed: int = 0,
) -> Difference:
    """`metric` of `first` less that of `second`, sequence by sequence of the same recordings, with
    the percentile interval over resamples of the sequences (Efron & Tibshirani 1993, ch. 13).

    Whole sequences are drawn, with replacement, the same for both: frames of one sequence are not
    independent.  A resample's value is that of its sequences counted as one, never a mean of
    ratios; one without truth has none, and is left out.

    Raises InputError where the two differ in length or are empty.
    """
    if len(first) != len(second) or not first:
        raise InputError(
            "a paired bootstrap needs the same sequences of both, one at least",
            expected=len(first),
            got=len(second),
        )
    pairs = [
        (Evaluation((one[metric],)), Evaluation((other[metric],)))
        for one, other in zip(first, second, strict=True)
    ]

    def difference(rows: Sequence[int]) -> float | None:
        a, b = (combine([pairs[row][side] for row in rows])[metric].value for side in (0, 1))
        return None if a is None or b is None else a - b

    drawn = np.random.default_rng(seed).integers(len(pairs), size=(resamples, len(pairs)))
    # Which sequences a resample holds matters, not their order: few of them differ.
    kinds, times = np.unique(np.sort(drawn, axis=1), axis=0, return_counts=True)
    values = [difference(rows) for rows in kinds.tolist()]
    defined = np.repeat(
        [value for value in values if value is not None],
        [n for value, n in zip(values, times.tolist(), strict=True) if value is not None],
    )
    low = high = None
    if len(defined) > resamples / 2:
        low, high = (float(end) for end in np.quantile(defined, (0.025, 0.975)))
    return Difference(difference(range(len(pairs))), low, high)
