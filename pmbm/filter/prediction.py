"""Box 1 of 4, PMBM prediction (Pang & Radha 2021, Sec. 2.5)."""

from __future__ import annotations

import numpy as np

from pmbm import compiled
from pmbm.filter.density import Density, Locals, Mixture
from pmbm.filter.models import Transition
from pmbm.filter.weights import log_of
from pmbm.types import FloatArray


def predict(
    density: Density, transition: Transition, birth: Mixture, *, merge_births: bool = False
) -> Density:
    """The density one interval later: detected and undetected objects move on independently, both
    survive with P_S, and newly born objects join the undetected ones.

    Association hypotheses and their weights stay as they are: prediction tells nothing about them.

    merge_births : whether births that come again and again at one place are one component.
    """
    ppp, local = density.undetected, density.local
    moved = _moved(ppp.mean, ppp.cov, transition)
    survivors = Mixture(ppp.log_weight + log_of(transition.survival), *moved, ppp.origin)
    return Density(
        _merged(birth, survivors) if merge_births else Mixture.joined(survivors, birth),
        Locals(
            local.track,
            local.existence * transition.survival,
            *_moved(local.mean, local.cov, transition),
            local.box,
            local.label,
            local.history,
            local.confidence,
            _kinds(local.kind, transition),
            _seen(local.seen, transition),
        ),
        density.hypotheses,
        density.track_id,
        density.detections_seen,
        density.undetected_settled,
    )


def _merged(birth: Mixture, survivors: Mixture) -> Mixture:
    """The births, and the survivors after them.

    Survivors that begin with the births of the interval before, as they do while the sensor stands
    still, take in the new ones place by place; weight, mean and covariance of the sum are kept.
    """
    n = len(birth)
    if not np.array_equal(birth.mean, survivors.mean[:n]):
        return Mixture.joined(birth, survivors)
    log_weight, cov = survivors.log_weight.copy(), survivors.cov.copy()
    log_weight[:n] = np.logaddexp(log_weight[:n], birth.log_weight)
    share = np.exp(birth.log_weight - log_weight[:n])
    cov[:n] += share[:, None, None] * (birth.cov - cov[:n])
    origin = None if survivors.origin is None else survivors.origin.diluted(share)
    return Mixture(log_weight, survivors.mean, cov, origin)


def _kinds(kind: FloatArray | None, transition: Transition) -> FloatArray | None:
    if kind is None or transition.levels is None:
        return kind
    return transition.levels.after(kind, transition.dt)


def _seen(seen: FloatArray | None, transition: Transition) -> FloatArray | None:
    if seen is None or transition.visibility is None:
        return seen
    return transition.visibility.after(seen, transition.dt)


def _moved(
    mean: FloatArray, cov: FloatArray, transition: Transition
) -> tuple[FloatArray, FloatArray]:
    """F m and F P F' + Q.  F P F' of all rows is one matrix product on the flattened P."""
    F, Q = transition.F, transition.Q
    if compiled.native is not None:
        means, covs = compiled.native.move(mean, cov, F, Q)
        return means.reshape(-1, 4), covs.reshape(-1, 4, 4)
    both_sides = (F[:, None, :, None] * F[:, None, :]).reshape(16, 16)
    moved = (cov.reshape(-1, 16) @ both_sides.T).reshape(-1, 4, 4) + Q
    return mean @ F.T, 0.5 * (moved + moved.transpose(0, 2, 1))
