"""Cardinality: the number of reported objects against the number of true ones."""

from __future__ import annotations

from typing import Final

import numpy as np

from pmbm.metrics.core.family import Family, Tally, Work
from pmbm.metrics.core.formulas import NO_FRAMES, Ratio
from pmbm.metrics.core.result import Metric


def _count(work: Work) -> Tally:
    frames = len(work.scene)
    error = work.scene.tracks.count(frames) - work.scene.truth.count(frames)
    return Tally.of_frames({"error": error.astype(np.float64), "absolute": np.abs(error)})


FAMILY: Final = Family(
    name="cardinality",
    rule="reported minus true objects, mean over frames",
    count=_count,
    metrics=(
        Metric(
            name="cardinality_error",
            unit="objects",
            direction="none",
            series="error",
            question="Are too many or too few objects reported (reported minus true)?",
            formula=Ratio("error", "frames", NO_FRAMES),
        ),
        Metric(
            name="cardinality_error_absolute",
            unit="objects",
            direction="lower",
            series="absolute",
            question="By how many objects is the count wrong?",
            formula=Ratio("absolute", "frames", NO_FRAMES),
        ),
    ),
)
