"""Box 3 of 4, the PMBM update (Pang & Radha 2021, Sec. 2.6; Williams 2015, Sec. IV).

case                          existence                   state
undetected, PPP component     w <- (1 - P_D) w            unchanged, rather hidden
first detection by z          e / (lambda_c + e)          moment-matched Kalman updates
known track, missed           r (1 - P_D) / (1 - r P_D)   unchanged, rather hidden
known track, detected         1                           Kalman update
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pmbm.filter.association import Association
from pmbm.filter.density import (
    BEFORE,
    MISSED,
    STATE,
    Density,
    Globals,
    Index,
    Locals,
    Mixture,
)
from pmbm.filter.hypotheses.gating import GatedPairs
from pmbm.filter.hypotheses.gaussian import moments
from pmbm.filter.hypotheses.weights import normalised
from pmbm.filter.identity.recycling import ids_of_new
from pmbm.filter.models.sensor import ObservationModel
from pmbm.filter.scan import Scan
from pmbm.types import FloatArray


def update(
    density: Density, scan: Scan, association: Association, sensor: ObservationModel
) -> Density:
    """The density given the scan: Bayes' rule under every association hypothesis."""
    H, n = len(density.local), len(association.known.row)
    table = association.hypotheses
    # Candidates: a missed version of every local hypothesis, a detected one of every pair, and a
    # new track of every measurement.  Those that some hypothesis uses stay.
    candidates = Locals.joined(
        _missed(density.local, association, sensor),
        _detected(density, scan, association, sensor),
        _first_detected(density, scan, association, sensor),
    )
    used, member = np.unique(table.member, return_inverse=True)
    new = used[used >= H + n] - H - n
    return Density(
        undetected=_still_undetected(density.undetected, association),
        local=candidates.take(used),
        hypotheses=Globals(table.cluster, table.log_weight, table.start, member.reshape(-1)),
        track_id=np.concatenate([density.track_id, ids_of_new(density, scan, association, new)]),
        detections_seen=density.detections_seen + len(scan),
        undetected_settled=density.undetected_settled,
    )


def _still_undetected(ppp: Mixture, association: Association) -> Mixture:
    detection = association.detection_undetected
    with np.errstate(divide="ignore"):
        log_weight = ppp.log_weight + np.log1p(-detection)
    return Mixture(log_weight, *association.undetected_if_missed, ppp.recycled_from)


def _missed(local: Locals, association: Association, sensor: ObservationModel) -> Locals:
    mean, cov = association.known_if_missed
    return replace(
        local,
        existence=association.existence_if_missed,
        mean=mean,
        cov=cov,
        history=_remember(local.history, MISSED),
        marks=sensor.detection.if_missed(local.marks, association.detection),
    )


def _detected(
    density: Density, scan: Scan, association: Association, sensor: ObservationModel
) -> Locals:
    local, known = density.local, association.known
    row, measurement = known.row, known.measurement
    before = local.marks.take(row)
    told = replace(before, source=scan.source_after(before.source, measurement))
    return Locals(
        local.track[row],
        np.ones(len(row)),
        known.mean,
        known.cov,
        sensor.boxed(local.box[row], scan.box[measurement]),
        scan.label[measurement] if sensor.describes else local.label[row],
        density.detections_seen + measurement,
        local.shown[row],
        _remember(local.history[row], measurement),
        sensor.detection.if_detected(told, scan.confidence[measurement]),
        local.record[row] + scan.said[measurement],
    )


def _first_detected(
    density: Density, scan: Scan, association: Association, sensor: ObservationModel
) -> Locals:
    """A Bernoulli for each measurement: the object that it may be the first detection of.

    Its state is the fused distribution over the gated PPP components, weighted by w P_D N(z).
    Where no component is in the gate, r = 0 and the state says where the measurement was.
    """
    mean, cov = _fused(association.undetected, scan, sensor)
    every = np.arange(len(scan))
    L = density.local.history.shape[1]
    return Locals(
        len(density.track_id) + every,
        np.exp(association.log_birth_evidence - association.log_new),
        mean,
        cov,
        scan.box,
        scan.label,
        density.detections_seen + every,
        np.zeros(len(scan), bool),
        _remember(np.full((len(scan), L), BEFORE, np.int32), every),
        sensor.detection.first(scan.source_if_first(every), scan.confidence),
        scan.said,
    )


def _fused(
    pairs: GatedPairs, scan: Scan, sensor: ObservationModel
) -> tuple[FloatArray, FloatArray]:
    """Means (M,4) and covariances (M,4,4) of the objects that the measurements may be the first
    detections of."""
    mean = np.zeros((len(scan), STATE))
    mean[:, :2] = scan.position
    cov = np.zeros((len(scan), STATE, STATE))
    cov[:, :2, :2] = cov[:, 2:4, 2:4] = scan.covariance(sensor.R)
    pairs = pairs.take(np.argsort(pairs.measurement, kind="stable"))
    found, first = np.unique(pairs.measurement, return_index=True)
    if len(found):
        weight = np.exp(normalised(pairs.log_weight, pairs.measurement))
        mean[found], cov[found] = moments(weight, pairs.mean, pairs.cov, first)
    return mean, cov


def _remember(history: np.ndarray, measurement: Index | int) -> np.ndarray:
    """The history (n,L) one step on, without its oldest entry; measurement (n,), or one for all."""
    if not history.shape[1]:
        return history
    after = np.empty_like(history)
    after[:, :-1] = history[:, 1:]
    after[:, -1] = measurement
    return after
