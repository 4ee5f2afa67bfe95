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
from pmbm.filter.hypotheses.gating import FirstDetectionDensity
from pmbm.filter.hypotheses.gaussian import (
    Innovation,
    corrected,
    corrected_cov,
    corrected_mean,
    gain,
    moments,
)
from pmbm.filter.hypotheses.radar_pairs import UpdatedPairs
from pmbm.filter.hypotheses.weights import normalised
from pmbm.filter.identity.recycling import ids_of_new
from pmbm.filter.models.sensor import ObservationModel
from pmbm.filter.scan import Scan
from pmbm.kernels import twin
from pmbm.types import FloatArray


def update(
    density: Density, scan: Scan, association: Association, sensor: ObservationModel
) -> Density:
    """The density given the scan: Bayes' rule under every association hypothesis."""
    H, n = len(density.local), len(association.known.row)
    table = association.hypotheses
    # Candidates: a missed version of every local hypothesis, a detected one of every pair, and a
    # new track of every measurement.  Those that no hypothesis uses are not worked out.
    missed, detected, new, member = _used(table.member, H, n, len(scan))
    local = Locals.joined(
        _missed(density.local, association, sensor, missed),
        _detected(density, scan, association, sensor, detected),
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


@twin("used")
def _used(member: Index, H: int, n: int, M: int) -> tuple[Index, Index, Index, Index]:
    """Of candidates H missed, n detected and M new, those that are members (E,) of a hypothesis,
    and what the members are called among these."""
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
    return Mixture(log_weight, *association.undetected_if_missed, ppp.recycled_from)


def _missed(
    local: Locals, association: Association, sensor: ObservationModel, rows: Index
) -> Locals:
    mean, cov = association.known_if_missed
    marks = sensor.detection.if_missed(local.marks, association.detection)
    history = _remember(local.history, MISSED)
    return Locals(
        local.track,
        association.existence_if_missed,
        mean,
        cov,
        local.box,
        local.label,
        local.newest,
        local.shown,
        history,
        marks,
        local.record,
    ).take(rows)


def _detected(
    density: Density, scan: Scan, association: Association, sensor: ObservationModel, pairs: Index
) -> Locals:
    local, known = density.local, association.known
    row, measurement = known.row[pairs], known.measurement[pairs]
    if isinstance(known, UpdatedPairs):
        mean, cov = known.mean[pairs], known.cov[pairs]
    else:
        mean, cov = corrected(
            local.mean, local.cov, known.innovation, row, known.y[pairs], sensor.R
        )
    before = local.marks.take(row)
    told = replace(before, source=scan.source_after(before.source, measurement))
    return Locals(
        local.track[row],
        np.ones(len(pairs)),
        mean,
        cov,
        sensor.boxed(local.box[row], scan.box[measurement]),
        scan.label[measurement] if sensor.describes else local.label[row],
        density.detections_seen + measurement,
        local.shown[row],
        _remember(local.history[row], measurement),
        sensor.detection.if_detected(told, scan.confidence[measurement]),
        local.record[row] + scan.said[measurement],
    )


def _first_detected(
    density: Density,
    scan: Scan,
    association: Association,
    sensor: ObservationModel,
    measurements: Index,
) -> Locals:
    """A Bernoulli for each measurement: the object that it may be the first detection of.

    Its state is the fused distribution over the gated PPP components, weighted by w P_D N(z).
    Where no component is in the gate, r = 0 and the state says where the measurement was.
    """
    mean, cov = _fused(density.undetected, scan, association, sensor, measurements)
    L = density.local.history.shape[1]
    return Locals(
        len(density.track_id) + measurements,
        np.exp(association.log_birth_evidence - association.log_new)[measurements],
        mean,
        cov,
        scan.box[measurements],
        scan.label[measurements],
        density.detections_seen + measurements,
        np.zeros(len(measurements), bool),
        _remember(np.full((len(measurements), L), BEFORE, np.int32), measurements),
        sensor.detection.first(scan.source_if_first(measurements), scan.confidence[measurements]),
        scan.said[measurements],
    )


def _fused(
    ppp: Mixture,
    scan: Scan,
    association: Association,
    sensor: ObservationModel,
    measurements: Index,
) -> tuple[FloatArray, FloatArray]:
    """Means (n,4) and covariances (n,4,4) of the objects that these measurements (n,) may be the
    first detections of."""
    density = association.undetected
    if isinstance(density, UpdatedPairs):
        return _fused_pairs(density, scan, measurements)
    z = np.ascontiguousarray(scan.position[measurements])
    return _fuse(
        *density.innovation.columns(),
        density.log_height,
        ppp.mean,
        ppp.cov,
        sensor.R,
        z,
        association.log_e[measurements],
        density.gate,
    )


@twin("fuse")
def _fuse(
    expected: FloatArray,
    l11: FloatArray,
    l21: FloatArray,
    l22: FloatArray,
    log_height: FloatArray,
    mean_of: FloatArray,
    cov_of: FloatArray,
    R: FloatArray,
    z: FloatArray,
    log_e: FloatArray,
    threshold: float,
) -> tuple[FloatArray, FloatArray]:
    """Moments of what the components (P,) in whose gate each z (n,2) lies become by it."""
    n = len(z)
    mean = np.zeros((n, STATE))
    mean[:, :2] = z
    cov = np.zeros((n, STATE, STATE))
    cov[:, :2, :2] = cov[:, 2:4, 2:4] = R
    density = FirstDetectionDensity(Innovation(expected, l11, l21, l22), log_height, threshold)
    pairs = density.pairs(z)
    if len(pairs.row):
        W = gain(cov_of, density.innovation)
        after = corrected_cov(cov_of, W, R, density.innovation)
        order = np.argsort(pairs.measurement, kind="stable")
        component, target = pairs.row[order], pairs.measurement[order]
        first = np.flatnonzero(np.diff(target, prepend=-1))
        found = target[first]
        mean[found], cov[found] = moments(
            np.exp(normalised(pairs.log_weight[order], target)),
            corrected_mean(mean_of[component], W[component], pairs.y[order]),
            after[component],
            first,
        )
    return mean, cov


def _fused_pairs(
    pairs: UpdatedPairs, scan: Scan, measurements: Index
) -> tuple[FloatArray, FloatArray]:
    """`_fused` by a radar's measurements: moments of the components' updates."""
    assert scan.radar is not None
    mean = np.zeros((len(scan), STATE))
    mean[:, :2] = scan.position
    cov = np.zeros((len(scan), STATE, STATE))
    cov[:, :2, :2] = cov[:, 2:4, 2:4] = scan.radar.R
    if len(pairs.row):
        ordered = pairs.take(np.argsort(pairs.measurement, kind="stable"))
        first = np.flatnonzero(np.diff(ordered.measurement, prepend=-1))
        found = ordered.measurement[first]
        weight = np.exp(normalised(ordered.log_weight, ordered.measurement))
        mean[found], cov[found] = moments(weight, ordered.mean, ordered.cov, first)
    return mean[measurements], cov[measurements]


def _remember(history: np.ndarray, measurement: Index | int) -> np.ndarray:
    """The history (n,L) one step on, without its oldest entry; measurement (n,), or one for all."""
    if not history.shape[1]:
        return history
    after = np.empty_like(history)
    after[:, :-1] = history[:, 1:]
    after[:, -1] = measurement
    return after
