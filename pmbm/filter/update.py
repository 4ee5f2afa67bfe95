"""Box 3 of 4, the PMBM update (Pang & Radha 2021, Sec. 2.6; Williams 2015, Sec. IV).

case                          existence                   state
undetected, PPP component     w <- (1 - P_D) w            unchanged, rather hidden
first detection by z          e / (lambda_c + e)          moment-matched Kalman updates
known track, missed           r (1 - P_D) / (1 - r P_D)   unchanged, rather hidden
known track, detected         1                           Kalman update
"""

from __future__ import annotations

import numpy as np

from pmbm import compiled
from pmbm.filter.association import Association
from pmbm.filter.density import (
    BEFORE,
    MISSED,
    Density,
    Globals,
    Index,
    Locals,
    Mixture,
)
from pmbm.filter.gaussian import corrected, corrected_cov, corrected_mean, gain, moments
from pmbm.filter.models import Sensor
from pmbm.filter.resumption import ids_of_new
from pmbm.filter.scan import Scan
from pmbm.filter.weights import normalised
from pmbm.types import FloatArray


def update(density: Density, scan: Scan, association: Association, sensor: Sensor) -> Density:
    """The density given the scan: Bayes' rule under every association hypothesis."""
    H, n = len(density.local), len(association.known.row)
    table = association.hypotheses
    # Candidates: a missed version of every local hypothesis, a detected one of every pair, and a
    # new track of every measurement.  Those that no hypothesis uses are not worked out.
    missed, detected, new, member = _used(table.member, H, n, len(scan))
    local = Locals.joined(
        _missed(density.local, association, sensor, missed),
        _detected(density.local, scan, association, sensor, detected),
        _first_detected(density, scan, association, sensor, new),
    )
    return Density(
        undetected=_still_undetected(density.undetected, association),
        local=local,
        hypotheses=Globals(table.cluster, table.log_weight, table.start, member),
        track_id=np.concatenate([density.track_id, ids_of_new(density, scan, association, new)]),
        detections_seen=density.detections_seen + len(scan),
        undetected_settled=density.undetected_settled,
    )


def _used(member: Index, H: int, n: int, M: int) -> tuple[Index, Index, Index, Index]:
    """Of candidates H missed, n detected and M new, those that are members (E,) of a hypothesis,
    and what the members are called among these."""
    if compiled.native is not None:
        missed, detected, new, renumbered = compiled.native.used(member, H, n, M)
        return missed, detected, new, renumbered
    used = np.zeros(H + n + M, bool)
    used[member] = True
    return (
        np.flatnonzero(used[:H]),
        np.flatnonzero(used[H : H + n]),
        np.flatnonzero(used[H + n :]),
        (np.cumsum(used) - 1)[member],
    )


def _still_undetected(ppp: Mixture, association: Association) -> Mixture:
    detection = association.detection_undetected
    with np.errstate(divide="ignore"):
        log_weight = ppp.log_weight + np.log1p(-detection)
    return Mixture(log_weight, *association.undetected_if_missed, ppp.origin)


def _missed(local: Locals, association: Association, sensor: Sensor, rows: Index) -> Locals:
    mean, cov = association.known_if_missed
    seen = sensor.seen_if_missed(local.seen, association.detection)
    history = _remember(local.history, MISSED)
    return Locals(
        local.track,
        association.existence_if_missed,
        mean,
        cov,
        local.box,
        local.label,
        history,
        local.confidence,
        local.kind,
        seen,
    ).take(rows)


def _detected(
    local: Locals, scan: Scan, association: Association, sensor: Sensor, pairs: Index
) -> Locals:
    known = association.known
    row, measurement = known.row[pairs], known.measurement[pairs]
    mean, cov = corrected(local.mean, local.cov, known.innovation, row, known.y[pairs], sensor.R)
    confidence = None if local.confidence is None else local.confidence[row]
    return Locals(
        local.track[row],
        np.ones(len(pairs)),
        mean,
        cov,
        sensor.boxed(local.box[row], scan.box[measurement]),
        scan.label[measurement],
        _remember(local.history[row], measurement),
        confidence=sensor.remembered(confidence, scan.confidence, measurement),
        kind=None if local.kind is None else scan.kind_after(local.kind[row], measurement),
        seen=sensor.seen_if_detected(None if local.seen is None else local.seen[row]),
    )


def _first_detected(
    density: Density, scan: Scan, association: Association, sensor: Sensor, measurements: Index
) -> Locals:
    """A Bernoulli for each measurement: the object that it may be the first detection of.

    Its state is the fused distribution over the gated PPP components, weighted by w P_D N(z).
    Where no component is in the gate, r = 0 and the state says where the measurement was.
    """
    mean, cov = _fused(density.undetected, scan, association, sensor, measurements)
    L = density.local.history.shape[1]
    return Locals(
        len(density.track_id) + measurements,
        np.exp(association.log_first - association.log_new)[measurements],
        mean,
        cov,
        scan.box[measurements],
        scan.label[measurements],
        _remember(np.full((len(measurements), L), BEFORE, np.int32), measurements),
        confidence=None if scan.confidence is None else scan.confidence[measurements],
        kind=None if scan.kinds is None else scan.kind_first(measurements),
        seen=sensor.seen_if_detected(sensor.seen_usually(len(measurements))),
    )


def _fused(
    ppp: Mixture, scan: Scan, association: Association, sensor: Sensor, measurements: Index
) -> tuple[FloatArray, FloatArray]:
    """Means (n,4) and covariances (n,4,4) of the objects that these measurements (n,) may be the
    first detections of."""
    n = len(measurements)
    mean = np.zeros((n, 4))
    mean[:, :2] = scan.position[measurements]
    cov = np.zeros((n, 4, 4))
    cov[:, :2, :2] = cov[:, 2:, 2:] = sensor.R
    priced = association.undetected
    z = np.ascontiguousarray(scan.position[measurements])
    if compiled.native is not None:
        components = *priced.innovation.columns(), priced.log_height, ppp.mean, ppp.cov
        log_e = association.log_e[measurements]
        compiled.native.fuse(*components, sensor.R, z, log_e, priced.gate, mean, cov)
        return mean, cov
    pairs = priced.pairs(z)
    if len(pairs.row):
        W = gain(ppp.cov, priced.innovation)
        after = corrected_cov(ppp.cov, W, sensor.R, priced.innovation)
        order = np.argsort(pairs.measurement, kind="stable")
        component, target = pairs.row[order], pairs.measurement[order]
        first = np.flatnonzero(np.diff(target, prepend=-1))
        seen = target[first]
        mean[seen], cov[seen] = moments(
            np.exp(normalised(pairs.log_weight[order], target)),
            corrected_mean(ppp.mean[component], W[component], pairs.y[order]),
            after[component],
            first,
        )
    return mean, cov


def _remember(history: np.ndarray, measurement: Index | int) -> np.ndarray:
    """The history (n,L) one step on, without its oldest entry; measurement (n,), or one for all."""
    if not history.shape[1]:
        return history
    after = np.empty_like(history)
    after[:, :-1] = history[:, 1:]
    after[:, -1] = measurement
    return after
