"""The problems of `pmbm tune`: recordings of scenarios, or a dataset's sequences by its own
rule."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmbm.cli.dataset_scores import rule_of, score_run
from pmbm.cli.fitting import fitted_tracker
from pmbm.cli.track import class_trackers, preset
from pmbm.datasets import Dataset, chosen_sequences, open_dataset, with_origins
from pmbm.errors import InputError, nearest_hint
from pmbm.metrics import Evaluation, combine
from pmbm.metrics.catalogue import definition
from pmbm.seeding import tracker_seed
from pmbm.study import ConfiguredTracker, Estimate, Source, estimate, recorded
from pmbm.study.configured import nested
from pmbm.study.summary import paired
from pmbm.study.trial import score_tracker
from pmbm.types import Label, Recording

Spread = Callable[..., Iterable[Any]]
"""`map`, or that of a pool of processes."""
Gains = list[tuple[str, Estimate, Estimate, Estimate]]
"""Of each source, and last of the mean of several: its name, the metric with the parameters to
begin with, the metric with others, and the latter less the former, trial by trial."""


@dataclass(frozen=True)
class Simulated:
    """Recordings of scenarios, scored by the mean of one of the testbed's metrics over them.

    recordings : source after source, the same number of each.
    seeds : of each recording, for the tracker.
    tracker : with the parameters to begin with.
    where : the recordings in a few words.
    """

    sources: tuple[Source, ...]
    recordings: tuple[Recording, ...]
    seeds: tuple[int, ...]
    tracker: ConfiguredTracker
    metric: str
    maximise: bool
    where: str
    spread: Spread

    @classmethod
    def of(
        cls,
        sources: Sequence[Source],
        tracker: ConfiguredTracker,
        metric: str,
        seed: int,
        count: int,
        spread: Spread = map,
        *,
        fitted: bool = False,
    ) -> Simulated:
        """Trials 0 to `count` - 1 of a seed, of each source.

        fitted : with what can be fitted to these recordings, see `pmbm.cli.fitting`.

        Raises InputError for an unknown metric, or for one of which neither more nor less is
        better.
        """
        names = " ".join(source.name for source in sources)
        maximise = _more_is_better(metric, definition(metric).direction)
        recordings = tuple(recorded(s, seed, trial) for s in sources for trial in range(count))
        return cls(
            sources=tuple(sources),
            recordings=recordings,
            seeds=tuple(tracker_seed(seed, trial) for _ in sources for trial in range(count)),
            tracker=fitted_tracker(tracker, recordings) if fitted else tracker,
            metric=metric,
            maximise=maximise,
            where=f"{names} ({count} recordings each, seed {seed})",
            spread=spread,
        )

    def values(self, tracker: ConfiguredTracker) -> list[float | None]:
        """The metric of each recording."""
        n = len(self.recordings)
        return list(
            self.spread(_score, self.recordings, self.seeds, [tracker] * n, [self.metric] * n)
        )

    def value(self, tracker: ConfiguredTracker) -> float | None:
        """What is made better."""
        return _mean(self.values(tracker))

    def gains(self, tracker: ConfiguredTracker) -> Gains:
        """The differences that `tracker` makes on these recordings."""
        count = len(self.recordings) // len(self.sources)
        before, after = (
            [values[k : k + count] for k in range(0, len(values), count)]
            for values in (self.values(self.tracker), self.values(tracker))
        )
        names = [source.name for source in self.sources]
        scales = [definition(self.metric).scale] * len(names)
        if len(names) > 1:
            scales.append(scales[0].mean_of(len(names)))
            names.append("mean of all")
            before.append([_mean(each) for each in zip(*before, strict=True)])
            after.append([_mean(each) for each in zip(*after, strict=True)])
        return [
            (
                name,
                estimate(b, each),
                estimate(a, each),
                estimate(paired(a, b), each.of_differences),
            )
            for name, b, a, each in zip(names, before, after, scales, strict=True)
        ]

    def document(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """The file that holds these parameters."""
        return nested({**dict(self.tracker.parameters), **parameters})


@dataclass(frozen=True)
class Logged:
    """A dataset's sequences and one class, scored together by one of the dataset's rules.

    recordings : sequence -> what was recorded, without truth.
    tracker, where : as for `Simulated`.
    """

    dataset: Dataset
    recordings: Mapping[str, Recording]
    rule: str | None
    mode: str
    tracker: ConfiguredTracker
    metric: str
    maximise: bool
    where: str
    spread: Spread

    @classmethod
    def of(
        cls,
        name: str,
        options: Mapping[str, Any],
        kind: str | None,
        sequences: Sequence[str],
        tracker_name: str,
        *,
        config: Path | None = None,
        metric: str | None = None,
        rule: str | None = None,
        mode: str = "online",
        spread: Spread = map,
        fitted: bool = False,
    ) -> Logged:
        """Sequences of a dataset; all but those for reporting where none is named.

        fitted : with what can be fitted to these sequences' labels, see `pmbm.cli.fitting`.

        Raises InputError for what is unknown.
        """
        for field, given in (("--class", kind), ("--detections", options.get("detections"))):
            if given is None:
                raise InputError("missing option", field=field)
        dataset = open_dataset(name, **options, classes=(kind,))
        by = rule_of(dataset, rule)
        metric = metric or next(iter(by.shown))
        if metric not in by.shown:
            hint = nearest_hint(metric, by.shown, "metric")
            raise InputError(f"the rule has no '{metric}'", field="--metric", hint=hint)
        label = Label(dataset.labels[0])
        tracker = class_trackers(dataset, tracker_name, config or preset(name, tracker_name))[label]
        names = chosen_sequences(dataset, sequences)
        recordings = {each: dataset.recording(each, truth=False) for each in names}
        if fitted:
            labelled = (with_origins(dataset.recording(each)) for each in names)
            tracker = fitted_tracker(tracker, labelled, label)
        # Which way is better is said with a score.
        first = _score_sequence(dataset, names[0], recordings[names[0]], tracker, rule, mode)
        maximise = _more_is_better(metric, first[by.shown[metric]].direction)
        return cls(
            dataset=dataset,
            recordings=recordings,
            rule=rule,
            mode=mode,
            tracker=tracker,
            metric=metric,
            maximise=maximise,
            where=f"{name} {kind}, {by.says}, {mode}, sequences {' '.join(names)}",
            spread=spread,
        )

    def value(self, tracker: ConfiguredTracker) -> float | None:
        """What is made better."""
        tasks = [
            (self.dataset, sequence, recording, tracker, self.rule, self.mode)
            for sequence, recording in self.recordings.items()
        ]
        scored = list(self.spread(_score_sequence, *zip(*tasks, strict=True)))
        return combine(scored)[rule_of(self.dataset, self.rule).shown[self.metric]].value

    @property
    def advice(self) -> str:
        """The place to look whether the gain holds elsewhere."""
        return (
            "These sequences cannot say whether the gain holds elsewhere: compare with the "
            "defaults on others."
        )

    def document(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """The file that holds these parameters, in the table of the class."""
        return {self.dataset.classes[0]: nested({**dict(self.tracker.parameters), **parameters})}


def _score(
    recording: Recording, seed: int, tracker: ConfiguredTracker, metric: str
) -> float | None:
    return score_tracker(recording, tracker, [metric], seed=seed)[0][metric]


def _score_sequence(
    dataset: Dataset,
    sequence: str,
    recording: Recording,
    tracker: ConfiguredTracker,
    rule: str | None,
    mode: str,
) -> Evaluation:
    """The scores of one sequence and the one class."""
    trackers = {Label(dataset.labels[0]): tracker}
    (scored,) = score_run(dataset, sequence, trackers, rule, mode, recording).values()
    return scored


def _more_is_better(metric: str, direction: str) -> bool:
    if direction == "none":
        raise InputError(
            f"neither more nor less of '{metric}' is better", field="--metric", got=metric
        )
    return direction == "higher"


def _mean(values: Sequence[float | None]) -> float | None:
    """The mean; undefined where one of the values is."""
    defined = [value for value in values if value is not None]
    return sum(defined) / len(defined) if len(defined) == len(values) else None
