"""The paired jackknife: intervals of differences over a dataset's sequences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pmbm.errors import InputError
from pmbm.intervals import FEWEST, SAME, jackknife_reach
from pmbm.metrics import Evaluation, combine


@dataclass(frozen=True)
class Difference:
    """The difference of two trackers' metric over all sequences.

    value : None where either is undefined.
    low, high : 95 % interval; None where there is none, with the `reason`.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    reason: str | None = None


def jackknife_difference(
    first: Sequence[Evaluation],
    second: Sequence[Evaluation],
    metric: str,
    *,
    length: str = "truths",
) -> Difference:
    """`metric` of `first` less that of `second`, sequence by sequence of the same recordings, with
    Student's t over what each sequence, left out of both, changes (Efron & Tibshirani 1993, ch.
    11), see `pmbm.intervals.jackknife`.

    Whole sequences are left out: frames of one are not independent.  The value is that of the
    sequences counted as one, never a mean of ratios.

    length : the metric of `first` that says how much a sequence weighs.

    Raises InputError where the two differ in length or are empty.
    """
    if len(first) != len(second) or not first:
        raise InputError(
            "a paired comparison needs the same sequences of both, one at least",
            expected=len(first),
            got=len(second),
        )
    pairs = [
        (Evaluation((one[metric],)), Evaluation((other[metric],)))
        for one, other in zip(first, second, strict=True)
    ]

    def difference(rows: Sequence[tuple[Evaluation, Evaluation]]) -> float | None:
        a, b = (combine([row[side] for row in rows])[metric].value for side in (0, 1))
        return None if a is None or b is None else a - b

    value = difference(pairs)
    if value is None:
        return Difference(None, reason="undefined")
    lengths = [float(one[length].value or 0.0) for one in first]
    holding = sum(each > 0 for each in lengths)
    if holding < FEWEST:
        where = f"objects in {holding} of {len(pairs)} sequences, fewer than {FEWEST}"
        return Difference(value, reason=f"{where}: no interval")
    left = [difference(pairs[:k] + pairs[k + 1 :]) for k in range(len(pairs))]
    without = [each for each in left if each is not None]
    if len(without) < len(left):
        return Difference(value, reason="undefined without one of the sequences: no interval")
    if first[0][metric].definition.scale.step is not None:
        # A total is that of so many objects: what others give is that of as many.
        objects = sum(lengths)
        without = [
            each * objects / (objects - own) for each, own in zip(without, lengths, strict=True)
        ]
    if max(without) - min(without) <= SAME:
        return Difference(value, reason="equal without any one sequence: no interval")
    reach = jackknife_reach(without, lengths)
    return Difference(value, value - reach, value + reach)
