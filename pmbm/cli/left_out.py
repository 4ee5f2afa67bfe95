"""What a fit is worth on sequences that it was not fitted to: the data are in folds, and each is
tracked by a fit to the others."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pmbm.cli.dataset_scores import rule_of
from pmbm.cli.track import tracked
from pmbm.datasets import Dataset, class_of_label
from pmbm.errors import InputError
from pmbm.metrics import Evaluation
from pmbm.metrics.benchmarks.operating_point import OperatingPoint, Sweep, operating_point, sweep
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.metrics.benchmarks.trackeval import SimilarityScore
from pmbm.study.configured import ConfiguredTracker
from pmbm.types import Label, Recording

Tables = dict[str, dict[str, Any]]
"""Class -> its tracker's parameters, as a file has them."""
Trackers = dict[Label, ConfiguredTracker]


class Fits(Protocol):
    """A tracker, and sequences that it can be fitted to."""

    @property
    def tracker(self) -> str: ...

    @property
    def dataset(self) -> Dataset: ...

    @property
    def recordings(self) -> Mapping[str, Recording]: ...

    def fitted(self, names: Sequence[str]) -> Tables:
        """Each class's parameters, fitted to these sequences."""
        ...


@dataclass(frozen=True)
class LeftOut:
    """One class on all sequences, each tracked by a fit to others.

    figures : the rule's, by its names.
    """

    point: OperatingPoint
    figures: Mapping[str, float | None]


def folds_of(names: Sequence[str], folds: int) -> list[list[str]]:
    """The sequences in so many parts, or one by one where there are fewer."""
    return [list(names[fold::folds]) for fold in range(min(folds, len(names)))]


def fitted_to_others(fits: Fits, folds: int) -> Iterator[tuple[str, Trackers]]:
    """Every sequence with the trackers that were fitted to the other folds."""
    names = list(fits.recordings)
    for held in folds_of(names, folds):
        tables = fits.fitted([name for name in names if name not in held])
        for name in held:
            yield name, trackers_of(fits.dataset, fits.tracker, tables)


def trackers_of(dataset: Dataset, tracker: str, tables: Tables) -> Trackers:
    """The tracker of each class with its parameters."""
    return {
        label: ConfiguredTracker(tracker, tuple(tables[kind].items()))
        for label, kind in class_of_label(dataset).items()
    }


def left_out(fits: Fits, folds: int, mode: str) -> dict[str, LeftOut | None]:
    """What each class's tracker is worth on sequences that it was not fitted to, or None of a class
    without truth."""
    dataset = fits.dataset
    rule, score = rule_of(dataset, None), matching_rule(dataset)
    found: dict[str, list[tuple[Sweep, Evaluation]]] = {kind: [] for kind in dataset.classes}
    for name, trackers in fitted_to_others(fits, folds):
        for kind, one in compared_run(dataset, name, fits.recordings[name], trackers, mode).items():
            found[kind].append((sweep(score, one), score(one, kind)))
    worth: dict[str, LeftOut | None] = {}
    for kind, own in found.items():
        point = operating_point([one for one, _ in own])
        scored = [one for _, one in own]
        worth[kind] = None if point is None else LeftOut(point, rule.figures(scored))
    return worth


def compared_run(
    dataset: Dataset, name: str, recording: Recording, trackers: Trackers, mode: str = "online"
) -> dict[str, ComparedSequence]:
    """One sequence tracked by its detections alone, written in the dataset's format, and each class
    of it as the dataset's rules compare it."""
    with tempfile.TemporaryDirectory() as folder:
        dataset.write(name, tracked(name, recording, trackers, mode), Path(folder))
        return {kind: dataset.compared(name, kind, Path(folder)) for kind in dataset.classes}


def matching_rule(dataset: Dataset) -> SimilarityScore:
    """The dataset's first rule, if it counts at any threshold by one matching."""
    rule = rule_of(dataset, None).score
    if not isinstance(rule, SimilarityScore):
        raise InputError(f"{dataset.name}: its rule has no thresholds to compare", field="--folds")
    return rule
