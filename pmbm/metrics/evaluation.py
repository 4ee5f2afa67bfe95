"""Score a tracker's output against a recording's truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pmbm.labels import Label
from pmbm.metrics.catalogue import DEFAULT_METRICS, definition, family_of
from pmbm.metrics.core.family import Tally, Work
from pmbm.metrics.core.parameters import MetricParameters
from pmbm.metrics.core.result import OBSERVABLE, Evaluation, MetricValue
from pmbm.metrics.core.scene import ScoredScene, scene_of
from pmbm.types import Recording, Tracks, TrackSequence


def evaluate(
    recording: Recording,
    tracks: TrackSequence | Sequence[Tracks],
    metrics: Iterable[str] | None = None,
    *,
    parameters: MetricParameters | None = None,
    per_class: bool = False,
) -> Evaluation:
    """Score tracks against the truth of the frames that were stepped.

    tracks : what `run` gave, or one `Tracks` value per frame of truth.
    metrics : names; by default all but "tgospa" (costly), the SIAP attributes and the calibration
        of existence.  A name scores all objects; the same name with "_observable" at its end
        scores observable objects only.
    parameters : cutoffs, orders and gates.
    per_class : also score each class alone, truth and tracks of that label.

    Observable objects only: objects that are not observable in a frame are ignored there.  The
    standard CLEAR matching over all objects says which tracks follow them; those objects and those
    tracks are taken out of that frame, so that matched they count neither way and missed they are
    no miss, and the metric is computed on what is left.  The testbed's own measures of objects and
    occlusions (delay, ghost time, life, id kept, coasting) follow objects in and out of sight by
    their definition; for them the name with "_observable" is the same value.

    Raises InputError for an unknown name, unequal frames, or times that do not increase.
    """
    parameters = parameters or MetricParameters()
    if isinstance(metrics, str):
        metrics = [metrics]
    chosen = tuple(dict.fromkeys(DEFAULT_METRICS if metrics is None else metrics))
    for name in chosen:
        definition(name)
    scene = scene_of(recording, tracks)
    classes: dict[Label, Evaluation] = {}
    if per_class:
        for label in np.union1d(scene.truth.label, scene.tracks.label):
            part = scene.with_rows(scene.truth.label == label, scene.tracks.label == label)
            classes[Label(label)] = Evaluation(_values(part, chosen, parameters))
    return Evaluation(_values(scene, chosen, parameters), per_class=classes)


def _values(
    scene: ScoredScene, names: Iterable[str], parameters: MetricParameters
) -> tuple[MetricValue, ...]:
    everything = Work(scene, parameters)
    tallies: dict[tuple[str, int], Tally] = {}
    values = []
    for name in names:
        metric = definition(name)
        family = family_of(metric)
        narrowed = name.endswith(OBSERVABLE)
        work = everything.observable if narrowed and not family.follows_objects else everything
        key = (family.name, id(work))
        if key not in tallies:
            tallies[key] = family.count(work)
        tally = tallies[key]
        values.append(
            metric.value(
                tally.counts,
                scope="observable" if narrowed else "all",
                parameters=tally.parameters,
                series=None if metric.series is None else tally.series[metric.series],
            )
        )
    return tuple(values)
