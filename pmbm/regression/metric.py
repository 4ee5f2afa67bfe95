"""The metrics that a gate can judge: those that are bounded in every trial.

A metric without bounds (MOTA, GOSPA) can hide in one trial a disaster of any size, and no number
of trials bounds its mean; such metrics are reported beside the gate and not judged by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmbm.errors import InputError
from pmbm.metrics import evaluate
from pmbm.metrics.catalogue import definition
from pmbm.metrics.core.result import OBSERVABLE, MetricValue
from pmbm.types import Recording, TrackSequence

ALONGSIDE = ("gospa", "mota", "id_switches", "false_positives", "misses")
"""Reported beside the gated metric."""


@dataclass(frozen=True)
class GatedMetric:
    """A metric that lies in a known range in every trial.

    name : of `pmbm.metrics`; "gospa" here is GOSPA^p per true object in units of cutoff^p, each
        frame's value cut at 1 and averaged over frames.
    bounds : the range's ends, in the metric's unit.  Values outside are cut to it.
    lower_is_better : the metric's direction.
    """

    name: str
    bounds: tuple[float, float]
    lower_is_better: bool

    @property
    def value_range(self) -> float:
        return self.bounds[1] - self.bounds[0]

    def __call__(self, recording: Recording, tracks: TrackSequence) -> dict[str, float | None]:
        """The metric under "gated", always as a loss (lower is better) inside its bounds; and
        the metrics that are reported alongside.

        Raises InputError where the metric is undefined: a gate cannot leave trials out.
        """
        wanted = dict.fromkeys((self.name, *ALONGSIDE))
        found = evaluate(recording, tracks, wanted)
        value = found[self.name]
        raw = _gospa_share(value, recording, tracks) if _is_gospa(self.name) else value.value
        if raw is None:
            raise InputError(
                f"'{self.name}' is undefined in a trial: {value.reason}",
                field="metric",
                hint="gate a metric that every recording defines, such as ospa",
            )
        low, high = self.bounds
        inside = min(max(raw, low), high)
        gated = inside if self.lower_is_better else -inside
        return {"gated": gated, **found.scalars()}


def gated_metric(name: str, bounds: Sequence[float] | None = None) -> GatedMetric:
    """The metric of this name with its own bounds, or cut to the bounds given.

    Raises InputError for an unknown metric, for one without bounds, and for one without a
    direction.
    """
    entry = definition(name)
    if entry.direction == "none":
        raise InputError(
            f"'{name}' has no better and worse", field="metric", hint="gate ospa or gospa"
        )
    if bounds is not None:
        if len(bounds) != 2 or not (-np.inf < bounds[0] < bounds[1] < np.inf):
            raise InputError(
                "bad gate", field="bounds", expected="two numbers, low < high", got=bounds
            )
        known = (float(bounds[0]), float(bounds[1]))
    elif _is_gospa(name):
        known = (0.0, 1.0)
    elif math.isfinite(entry.scale.low) and math.isfinite(entry.scale.high):
        known = (entry.scale.low, entry.scale.high)
    else:
        raise InputError(
            f"'{name}' has no bounds in a trial",
            field="metric",
            hint="give bounds = [low, high], or gate gospa, ospa, ospa2",
        )
    return GatedMetric(name, known, entry.direction == "lower")


def _is_gospa(name: str) -> bool:
    return name.removesuffix(OBSERVABLE) == "gospa"


def _gospa_share(value: MetricValue, recording: Recording, tracks: TrackSequence) -> float:
    """Mean over frames of min(1, GOSPA^p / (cutoff^p objects)); a frame without objects counts
    as one with a single object, so that false tracks on an empty road cost what they are."""
    assert value.series is not None
    cutoff, order = value.parameters["cutoff"], value.parameters["order"]
    truth = [recording.truth[frame] for frame in tracks.frame.tolist()]
    observable = value.scope == "observable"
    objects = np.array([int(t.observable.sum()) if observable else len(t) for t in truth])
    share = (value.series / cutoff) ** order / np.maximum(objects, 1)
    return float(np.minimum(share, 1.0).mean()) if len(share) else 0.0
