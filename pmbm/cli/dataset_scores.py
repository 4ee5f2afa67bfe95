"""A dataset's sequences scored by one of its rules: results of files, or of trackers run here."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pmbm.cli.track import tracked
from pmbm.datasets import Dataset, with_origins
from pmbm.errors import InputError, nearest_hint
from pmbm.metrics import Evaluation
from pmbm.metrics.benchmarks.rules import ScoringRule
from pmbm.seeding import tracker_seed
from pmbm.study import ConfiguredTracker, follow
from pmbm.tracking import SHIPPED_BOUNDS, joined_tracks
from pmbm.types import Label, Recording, TrackSequence


def rule_of(dataset: Dataset, name: str | None) -> ScoringRule:
    """A dataset's rule; its first where none is named.

    Raises InputError, with the nearest valid name, where there is none.
    """
    if name is None:
        return next(iter(dataset.rules.values()))
    if name not in dataset.rules:
        raise InputError(
            f"{dataset.name} has no rule '{name}'",
            field="--rule",
            hint=nearest_hint(name, dataset.rules, "rule"),
        )
    return dataset.rules[name]


def score_sequence(
    dataset: Dataset, sequence: str, kind: str, results: Path, rule: str | None
) -> Evaluation:
    """The scores of one sequence and class by a rule.

    Raises InputError for results of image boxes alone, by a rule that compares more."""
    by = rule_of(dataset, rule)
    compared = dataset.compared(sequence, kind, results)
    if compared.image_only is not None and not by.in_image:
        flat = [name for name, other in dataset.rules.items() if other.in_image]
        raise compared.image_only.located(
            hint=f"image boxes alone are what --rule {' or '.join(flat)} compares"
        )
    return by.score(compared, kind)


def score_run(
    dataset: Dataset,
    sequence: str,
    trackers: Mapping[Label, ConfiguredTracker],
    rule: str | None,
    mode: str = "online",
    recording: Recording | None = None,
) -> dict[str, Evaluation]:
    """Track one sequence, write it in the dataset's format, and score it: class -> its scores.

    recording : the sequence without its truth, where it has been read before.
    A bound sees the truth, with the detections' origins by overlap.
    """
    if any(one.factory in SHIPPED_BOUNDS for one in trackers.values()):
        tracks = _bounded(sequence, with_origins(dataset.recording(sequence)), trackers)
    else:
        recording = recording or dataset.recording(sequence, truth=False)
        tracks = tracked(sequence, recording, trackers, mode)
    with tempfile.TemporaryDirectory() as folder:
        dataset.write(sequence, tracks, Path(folder))
        return {
            kind: score_sequence(dataset, sequence, kind, Path(folder), rule)
            for kind in dataset.classes
        }


def _bounded(
    sequence: str, recording: Recording, bounds: Mapping[Label, ConfiguredTracker]
) -> TrackSequence:
    """Every label's objects by that label's bound, under their true ids."""
    seed = tracker_seed(0, sequence)
    found = {label: follow(bound, recording, seed) for label, bound in bounds.items()}
    steps = []
    for reports in zip(*(each.steps for each in found.values()), strict=True):
        own = [r.take(r.label == label) for label, r in zip(found, reports, strict=True)]
        ids = [i for tracks in own for i in tracks.id.tolist()]
        steps.append(joined_tracks(reports[0].time, own, ids))
    return replace(next(iter(found.values())), steps=tuple(steps))
