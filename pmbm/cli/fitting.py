"""What of a tracker is fitted to recordings and not searched for: noise, and what scores say."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from pmbm.baselines import fit_statistics
from pmbm.errors import InputError
from pmbm.filter import ObjectClasses
from pmbm.score import ScoreModel
from pmbm.study import ConfiguredTracker
from pmbm.types import CLUTTER, Label, Recording

_PERSISTENT_CLUTTER: Final = 0.3
"""Share of new sources that are taken for persistent clutter; results hardly depend on it."""


def fitted_tracker(
    tracker: ConfiguredTracker, recordings: Iterable[Recording], label: Label | None = None
) -> ConfiguredTracker:
    """The tracker with what recordings of known origins show, of one label or of all: of the
    probabilistic Kalman filter its variances, of the PMBM filter what a score says, and that
    clutter may persist.

    Raises InputError for other trackers, and where there is too little to fit to.
    """
    fits = {"probabilistic_kf": _noise, "pmbm": _scores}
    if tracker.factory not in fits:
        raise InputError(
            f"nothing of '{tracker.factory}' can be fitted",
            field="--fit",
            expected=f"--tracker {' or '.join(fits)}",
        )
    found = fits[tracker.factory](recordings, label)
    fitted = ConfiguredTracker(
        tracker.factory, tuple({**dict(tracker.parameters), **found}.items())
    )
    fitted.bound()
    return fitted


def fitted_noise(
    recordings: Iterable[Recording], labels: Sequence[Label]
) -> dict[Label, dict[str, Any]]:
    """The variances of the probabilistic Kalman filter by label, as a file has them.

    Raises InputError where there is too little of one of them to fit to.
    """
    fitted = fit_statistics(recordings)
    for label in labels:
        if label not in fitted:
            raise InputError(f"too few detections of true objects to fit noise to: {label.name}")
    return {label: _plain(fitted[label]) for label in labels}


def _noise(recordings: Iterable[Recording], label: Label | None) -> dict[str, Any]:
    if label is not None:
        found = fitted_noise(recordings, [label])
    else:
        found = {one: _plain(variances) for one, variances in fit_statistics(recordings).items()}
    if not found:
        raise InputError("too few detections of true objects to fit noise to", field="--fit")
    return {"noise": {one.name: variances for one, variances in found.items()}}


def _scores(recordings: Iterable[Recording], label: Label | None) -> dict[str, Any]:
    score, true, mistaken = [np.zeros(0)], [np.zeros(0, bool)], [np.zeros(0, bool)]
    for recording in recordings:
        if recording.origin is None:
            raise InputError("the origin of the detections is unknown", field="--fit")
        for detections, origin, frame in zip(
            recording.detections, recording.origin, recording.frame.tolist(), strict=True
        ):
            own = label is None or detections.label == label
            rows = np.flatnonzero(np.broadcast_to(own, len(detections)))
            real = rows[origin[rows] != CLUTTER]
            score.append(detections.score[rows])
            true.append(origin[rows] != CLUTTER)
            of_truth = recording.truth[frame].label[origin[real]]
            mistaken.append(detections.label[real] != of_truth)
    wrong = np.concatenate(mistaken)
    classes = ObjectClasses.simple(
        persistent_clutter=_PERSISTENT_CLUTTER,
        score=ScoreModel.fit_isotonic(np.concatenate(score), np.concatenate(true)),
        mislabelled=float((wrong.sum() + 1) / (len(wrong) + 2)),
    )
    return {"scores": {"kind": "classes", **_plain(classes)}}


def _plain(value: Any) -> Any:
    """As a file has it: dataclasses as tables, arrays as lists, to the digits that matter; shares
    in full, since they have to add up."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if isinstance(value, np.ndarray):
        adds_up = np.allclose(value.sum(axis=-1), 1.0) if value.size else False
        return value.tolist() if adds_up else [float(f"{x:.5g}") for x in value.tolist()]
    return value
