"""Baselines fitted to a detector, beside the PMBM tracker's own fit (`pmbm.cli.fit_tracker`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmbm.cli.fitting import fitted_noise
from pmbm.cli.left_out import Tables, compared_run, folds_of, matching_rule, trackers_of
from pmbm.datasets import Dataset, class_of_label, with_origins
from pmbm.fitting.baselines import candidates, fewest_errors, report_thresholds
from pmbm.metrics.benchmarks.operating_point import sweep
from pmbm.types import FloatArray, IntArray, Label, Recording

_HAS_NOISE = "probabilistic_kf"
"""The tracker whose variances are statistics of labels and detections."""


@dataclass(frozen=True)
class BaselineFits:
    """A baseline and sequences to fit it to, with what is worked out once: each sequence tracked
    with every candidate's parameters.

    given : of each class the other parameters.
    thresholds : of each class, candidates of `report_above`.
    errors : of each class and sequence (C,T), by candidate and threshold.
    """

    tracker: str
    dataset: Dataset
    recordings: Mapping[str, Recording]
    given: Tables
    candidates: Mapping[str, Sequence[Mapping[str, float]]]
    thresholds: Mapping[str, FloatArray]
    errors: Mapping[tuple[str, str], IntArray]

    @staticmethod
    def of(
        dataset: Dataset,
        names: Sequence[str],
        tracker: str,
        given: Tables,
        folds: int,
    ) -> BaselineFits:
        """Track every sequence with each candidate; what a tracker knows of noise is then from the
        folds that the sequence is not in.

        So the choice for a fold is made on runs whose variances that fold has a share in, as
        one of several: what little it tells of the fold is in the baseline's favour.
        """
        recordings = {name: dataset.recording(name) for name in names}
        if tracker == _HAS_NOISE:
            recordings = {name: with_origins(one) for name, one in recordings.items()}
        scores = {
            kind: _scores(recordings.values(), label)
            for label, kind in class_of_label(dataset).items()
        }
        fits = BaselineFits(
            tracker=tracker,
            dataset=dataset,
            recordings=recordings,
            given=given,
            candidates={kind: candidates(own) for kind, own in scores.items()},
            thresholds={kind: report_thresholds(own) for kind, own in scores.items()},
            errors={},
        )
        errors: dict[tuple[str, str], IntArray] = {}
        for held in folds_of(names, folds) if folds > 1 else [list(names)]:
            known = fits.noise([name for name in names if name not in held] or names)
            for name in held:
                errors |= fits.counted(name, known)
        return replace(fits, errors=errors)

    def counted(self, name: str, noise: Tables) -> dict[tuple[str, str], IntArray]:
        """Errors on one sequence, see `errors`, with this knowledge of noise."""
        rule = matching_rule(self.dataset)
        found: dict[str, list[IntArray]] = {kind: [] for kind in self.candidates}
        for tables in zip(*self.candidates.values(), strict=True):
            own = {
                kind: {**self.given[kind], **noise[kind], **table}
                for kind, table in zip(self.candidates, tables, strict=True)
            }
            trackers = trackers_of(self.dataset, self.tracker, own)
            run = compared_run(self.dataset, name, self.recordings[name], trackers)
            for kind, one in run.items():
                found[kind].append(sweep(rule, one, self.thresholds[kind]).errors)
        return {(kind, name): np.array(errors) for kind, errors in found.items()}

    def noise(self, names: Sequence[str]) -> Tables:
        """Of each class, the variances that these sequences show, if the tracker has such."""
        if self.tracker != _HAS_NOISE:
            return {kind: {} for kind in self.dataset.classes}
        kinds = class_of_label(self.dataset)
        known = fitted_noise([self.recordings[name] for name in names], list(kinds))
        return {kind: {"noise": {label.name: known[label]}} for label, kind in kinds.items()}

    def fitted(self, names: Sequence[str]) -> Tables:
        """Each class's parameters: of all candidates, those of the best MOTA on these sequences."""
        known = self.noise(names)
        tables = {}
        for kind, given in self.given.items():
            errors = np.stack([self.errors[kind, name] for name in names])
            best, threshold = fewest_errors(errors)
            tables[kind] = {
                **given,
                **known[kind],
                **self.candidates[kind][best],
                "report_above": float(self.thresholds[kind][threshold]),
            }
        return tables


def _scores(recordings: Iterable[Recording], label: Label) -> FloatArray:
    """(N,) of all detections of a label; a zero where there are none."""
    found = [one.score[one.label == label] for each in recordings for one in each.detections]
    scores = np.concatenate([np.zeros(0), *found])
    return scores if len(scores) else np.zeros(1)
