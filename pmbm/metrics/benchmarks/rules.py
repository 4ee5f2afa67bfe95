"""Rules of benchmarks: what they compare, how that is scored, and which figures are shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from pmbm.arrays import BoolArray, FloatArray
from pmbm.errors import InputError
from pmbm.metrics.core.formulas import Total
from pmbm.metrics.core.result import (
    Counts,
    Direction,
    Evaluation,
    Formula,
    Metric,
    MetricValue,
    Undefined,
    combine,
)
from pmbm.types import GroundTruth, Tracks


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparedSequence:
    """One sequence and class as the dataset's own rules compare them, frame by frame, in whatever
    frame its boxes are given; rows of a frame in order of id.

    truth, tracks : F frames each; truth that does not count is not observable.
    excused (K,) : over all tracks in order; where unmatched, not false.
    truth_image (N,4), tracks_image (K,4) : left, top, right, bottom in the image, pixels, or None.
    hard (N,) or None : of the more difficult kind.
    sensor (F,3) or None : the sensor's place in the world.
    confidence (K,) or None : the tracks' scores as written, where they are no probabilities.
    image_only : the refusal of the first track that has an image box alone, whose place and size
        here are stand-ins, by rules that compare more; None where all have places.
    """

    truth: tuple[GroundTruth, ...]
    tracks: tuple[Tracks, ...]
    excused: BoolArray
    truth_image: FloatArray | None = None
    tracks_image: FloatArray | None = None
    hard: BoolArray | None = None
    sensor: FloatArray | None = None
    confidence: FloatArray | None = None
    image_only: InputError | None = None


@dataclass(frozen=True)
class ScoringRule:
    """A named rule of a dataset.

    score : one sequence of a class (by the dataset's name).
    says : what the rule compares, in a few words.
    shown : the benchmark's name of a figure -> its name among the metrics.
    in_image : whether it compares image boxes alone.
    """

    score: Callable[[ComparedSequence, str], Evaluation]
    says: str
    shown: Mapping[str, str]
    in_image: bool = False

    def figures(self, sequences: Sequence[Evaluation]) -> dict[str, float | None]:
        """The shown figures of several sequences together, counted as one."""
        whole = combine(sequences)
        return {short: _figure(whole[name]) for short, name in self.shown.items()}

    def reasons(self, sequences: Sequence[Evaluation]) -> dict[str, str]:
        """The reasons why figures are undefined, by figure."""
        whole = combine(sequences)
        found = {short: whole[name].reason for short, name in self.shown.items()}
        return {short: reason for short, reason in found.items() if reason is not None}


def _figure(value: MetricValue) -> float | None:
    whole = value.unit in ("boxes", "events")
    return int(value.value) if whole and value.value is not None else value.value


def benchmark_metrics(
    variant: str, *rows: tuple[str, str, Direction, str, Formula]
) -> tuple[Metric, ...]:
    """A benchmark's metrics from rows of name, unit, direction, meaning and formula."""
    return tuple(
        Metric(
            name=name,
            variant=variant,
            unit=unit,
            direction=direction,
            question=meaning,
            formula=formula,
        )
        for name, unit, direction, meaning, formula in rows
    )


def benchmark_evaluation(
    metrics: Sequence[Metric], counts: Counts, parameters: Mapping[str, Any], recordings: int
) -> Evaluation:
    """A benchmark's metrics of these counts.  Raises InputError where nothing was counted."""
    if not recordings:
        raise InputError("nothing to evaluate", expected="at least one run")
    return Evaluation(
        tuple(metric.value(counts, parameters=parameters) for metric in metrics),
        recordings=recordings,
    )


def or_undefined(value: float | None, reason: str) -> float | Undefined:
    """The value; undefined, with this reason, where it is None."""
    return Undefined(reason) if value is None else float(value)


TRUTHS: Final[tuple[str, str, Direction, str, Formula]] = (
    "truths",
    "boxes",
    "none",
    "boxes of truth",
    Total("truths"),
)
ERRORS: Final = {
    "FP": "false_positives",
    "FN": "misses",
    "IDS": "id_switches",
    "FRAG": "fragmentations",
}
"""Figures that most benchmarks show."""
