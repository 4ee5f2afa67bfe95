"""Box 1 of 4, PMBM prediction (Pang & Radha 2021, Sec. 2.5)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pmbm.filter.density import Density, Marks, Mixture
from pmbm.filter.hypotheses.gaussian import symmetric
from pmbm.filter.hypotheses.weights import log_of
from pmbm.filter.models.detection import FixedDetection
from pmbm.filter.models.protocols import Birth, Detection, Scores
from pmbm.filter.models.scores import IgnoreScores
from pmbm.types import FloatArray

_DETECTION, _SCORES = FixedDetection(), IgnoreScores()
"""Models under which nothing becomes of the marks."""


@dataclass(frozen=True, eq=False, slots=True)
class Transition:
    """The transition over one interval: F, Q and P_S.

    F (D,D), Q (D,D) over [x, y, vx, vy]; survival : P_S over the interval.
    dt : s.  detection, scores : what becomes of the marks meanwhile.
    """

    F: FloatArray
    Q: FloatArray
    survival: float
    dt: float = 0.0
    detection: Detection = _DETECTION
    scores: Scores = _SCORES


def predict(
    density: Density, transition: Transition, births: Mixture, birth: Birth | None = None
) -> Density:
    """The density one interval later: detected and undetected objects move on independently, both
    survive with P_S, and newly born objects join the undetected ones.

    Association hypotheses and their weights stay as they are: prediction tells nothing about them.

    birth : says how births and survivors are one mixture; None, one after the other.
    """
    local = density.local
    mean, cov = _moved(local.mean, local.cov, transition)
    return Density(
        predict_undetected(density.undetected, transition, births, birth),
        replace(
            local,
            existence=local.existence * transition.survival,
            mean=mean,
            cov=cov,
            marks=predict_marks(local.marks, transition),
            record=transition.scores.aged(local.record, transition.dt),
        ),
        density.hypotheses,
        density.track_id,
        density.detections_seen,
        density.undetected_settled,
    )


def predict_undetected(
    ppp: Mixture, transition: Transition, births: Mixture, birth: Birth | None = None
) -> Mixture:
    """The undetected objects one interval later, with those that were born."""
    moved = _moved(ppp.mean, ppp.cov, transition)
    survivors = Mixture(ppp.log_weight + log_of(transition.survival), *moved, ppp.recycled_from)
    return Mixture.joined(survivors, births) if birth is None else birth.joined(survivors, births)


def predict_marks(marks: Marks, transition: Transition) -> Marks:
    """The models' memories, one interval later."""
    source = transition.scores.predicted(marks.source, transition.dt)
    return transition.detection.predicted(replace(marks, source=source), transition.dt)


def _moved(
    mean: FloatArray, cov: FloatArray, transition: Transition
) -> tuple[FloatArray, FloatArray]:
    """F m and F P F' + Q."""
    F, Q = transition.F, transition.Q
    return mean @ F.T, symmetric(F @ cov @ F.T + Q)
