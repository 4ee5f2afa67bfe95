"""What a preset knows of the detector that it was fitted to, and whether other detections are of
the same kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pmbm.cli import warn
from pmbm.datasets import class_of_label
from pmbm.errors import InputError
from pmbm.filter.models.score_record import ScoreRecord
from pmbm.score import raw_scores
from pmbm.types import Label, Recording, Site
from pmbm.wording import four_digits

if TYPE_CHECKING:
    from pmbm.datasets import Dataset
    from pmbm.study.configured import ConfiguredTracker

_QUANTILES: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
_OTHER: Final = 0.25
"""Mean shift of the quantiles, in the distance from the lowest to the highest, and shift of the
lowest, in that from it to the middle, beyond which scores are another detector's."""
_RATE: Final = 4.0
"""Factor of boxes per frame beyond which they are another detector's."""
_ENOUGH: Final = 200
"""Boxes from which on their scores can be compared."""
_LOOKED_AT: Final = 5
"""Sequences whose detections are compared."""
_LASTING: Final = 30.0
_AWAY: Final = np.linspace(5.0, 70.0, 14)
"""Detections of a source, and m from the sensor, by which it is asked what could be reported."""


@dataclass(frozen=True)
class Detector:
    """The detections of one class.

    scores : quantiles .05, .25, .5, .75, .95 of the raw scores.  boxes : per frame.
    """

    scores: tuple[float, ...]
    boxes: float

    @staticmethod
    def of(recordings: Sequence[Recording], label: Label) -> Detector:
        """Of all detections of a label; no scores where there are none."""
        scores = raw_scores(recordings, label)
        frames = sum(len(recording.detections) for recording in recordings)
        quantiles = np.quantile(scores, _QUANTILES).tolist() if len(scores) else []
        return Detector(
            tuple(map(four_digits, quantiles)), four_digits(len(scores) / max(frames, 1))
        )

    def table(self) -> dict[str, Any]:
        return {"scores": list(self.scores), "boxes": self.boxes}

    def differs(self, other: Detector) -> str | None:
        """The differences of another's detections from these in a few words; None where there are
        none."""
        if len(self.scores) < len(_QUANTILES) or len(other.scores) < len(_QUANTILES):
            return None
        here, there = np.array(self.scores), np.array(other.scores)
        whole, low = here[-1] - here[0], here[2] - here[0]
        apart = np.abs(there - here)
        if apart.mean() > _OTHER * whole or apart[0] > _OTHER * low:
            return (
                f"scores from {there[0]:.3g} over {there[2]:.3g} to {there[-1]:.3g}, "
                f"not from {here[0]:.3g} over {here[2]:.3g} to {here[-1]:.3g}"
            )
        if not 1 / _RATE < other.boxes / max(self.boxes, 1e-9) < _RATE:
            return f"{other.boxes:.3g} boxes a frame, not {self.boxes:.3g}"
        return None


def heed_detector(
    dataset: Dataset,
    sequences: Sequence[str],
    config: Path,
    told: Any,
    others: Mapping[str, Any],
    trackers: Mapping[Label, ConfiguredTracker],
) -> None:
    """Warn where the detections are not of the kind that a preset was fitted to, by the first few
    sequences.

    told : what the preset's file, `config`, says of its detector; others : what those say that ship
        for other detectors, by name.

    Raises InputError where the preset would report none of a class whatever came.
    """
    known = read_detectors(told, dataset.classes, config)
    if not known:
        return
    recordings = [dataset.recording(name, truth=False) for name in sequences[:_LOOKED_AT]]
    seen = {}
    kinds = class_of_label(dataset)
    for label, kind in kinds.items():
        here = Detector.of(recordings, label)
        if here.boxes * sum(len(one.detections) for one in recordings) >= _ENOUGH:
            seen[kind] = here
    fitting = [
        name
        for name, table in others.items()
        if not _differences(read_detectors(table, dataset.classes), seen)
    ]
    hint = "pmbm fit-tracker fits one to these; with --unlabelled, without labels"
    if fitting:
        hint = f"--config {fitting[0]} looks like these; {hint}"
    labels = {kind: label for label, kind in kinds.items()}
    for kind, how in _differences(known, seen).items():
        if _hopeless(trackers[labels[kind]], seen[kind]):
            raise InputError(
                f"{kind}: the preset is of another detector, and would report nothing: {how}",
                file=config,
                hint=hint,
            )
        warn(f"{kind}: the preset is of another detector: {how}; {hint}")


def _differences(known: Mapping[str, Detector], seen: Mapping[str, Detector]) -> dict[str, str]:
    """The differences of each class that differs."""
    found = {kind: known[kind].differs(here) for kind, here in seen.items() if kind in known}
    return {kind: how for kind, how in found.items() if how is not None}


def _hopeless(tracker: ConfiguredTracker, here: Detector) -> bool:
    """Whether even a source whose scores are all high is reported nowhere."""
    made: Any = tracker(Site())
    scores = getattr(made.config, "scores", None)
    if not isinstance(scores, ScoreRecord):
        return False
    best = (here.scores[-1] - scores.middle[scores.label]) / scores.spread[scores.label]
    record = np.tile([best, 1.0, 0.0, _LASTING, _LASTING - 1], (len(_AWAY), 1))
    return bool((scores.recorded_share(record, _AWAY) <= made.config.report.above).all())


def read_detectors(
    value: Any, kinds: Sequence[str], file: Path | None = None
) -> Mapping[str, Detector]:
    """The detector of each class that a preset's table describes and that is known.

    Raises InputError for a table that is none.
    """
    found = {}
    try:
        for kind in kinds:
            if kind in value:
                own = value[kind]
                scores = tuple(float(one) for one in own["scores"])
                found[kind] = Detector(scores, float(own["boxes"]))
    except (TypeError, KeyError, ValueError):
        raise InputError(
            "not a detector's table",
            file=file,
            field="detector",
            expected="[detector.CLASS] with scores = [...] and boxes",
        ) from None
    return found
