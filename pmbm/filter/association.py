"""Box 2 of 4, data association (Pang & Radha 2021, Sec. 2.3).

Every measurement is a known track's, a new object's, or clutter.  A *parent* is a global
hypothesis before the scan; its *children* say, on top of it, which measurement each track takes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pmbm import compiled
from pmbm.filter.branching import branch
from pmbm.filter.density import Density, Globals, Index, Mixture, summed
from pmbm.filter.gating import gate
from pmbm.filter.gaussian import Innovation
from pmbm.filter.models import Sensor
from pmbm.filter.scan import Scan
from pmbm.filter.weights import log_of
from pmbm.types import FloatArray

LOG_TINY = -700.0
"""Stands in for log 0 in weights, so that what nothing explains gets the smallest weight there is
and a step never fails."""


@dataclass(frozen=True, eq=False, slots=True)
class Pairs:
    """Gated pairs of a Gaussian and a measurement.

    row (n,) : of the local table, or of the PPP.  measurement (n,).
    y (n,2) : whitened innovation.
    log_weight (n,) : log(r P_D N(z)) of a local hypothesis, log(w P_D N(z)) of a PPP component.
    innovation : of every Gaussian, paired or not.
    """

    row: Index
    measurement: Index
    y: FloatArray
    log_weight: FloatArray
    innovation: Innovation

    def heavier(self, log_factor: FloatArray) -> Pairs:
        """Of weights times exp(log_factor) (n,)."""
        weight = self.log_weight + log_factor
        return Pairs(self.row, self.measurement, self.y, weight, self.innovation)


@dataclass(frozen=True, eq=False, slots=True)
class Priced:
    """What a measurement would weigh as the first detection of an undetected object.

    innovation : of the PPP components.  log_height (P,) : log of w P_D times the height of N(z).
    gate : squared distance up to which a component counts.
    """

    innovation: Innovation
    log_height: FloatArray
    gate: float

    def pairs(self, z: FloatArray) -> Pairs:
        """Gated pairs of components and measurements z (M,2)."""
        return _paired(self.innovation, self.log_height, z, self.gate)

    def log_density(self, z: FloatArray) -> FloatArray:
        """(M,) log of the sum of w P_D N(z) over the components in whose gate z lies."""
        pairs = self.pairs(z)
        if not len(pairs.row):
            return np.full(len(z), -np.inf)
        top = pairs.log_weight.max()
        return top + _log(summed(np.exp(pairs.log_weight - top), pairs.measurement, len(z)))


@dataclass(frozen=True, eq=False, slots=True)
class Association:
    """Everything that one scan says about the hypotheses.

    hypotheses : the children, over the candidates: rows 0 .. H-1 are the local hypotheses, missed;
        then come the detected ones of the pairs `known`, then a new track of each measurement.
    dropped : how many children were too unlikely to be kept.
    known : pairs of local hypotheses and measurements.
    undetected : the PPP, priced.
    log_missed (H,) : log(1 - r P_D).  existence_if_missed (H,) : r of a missed track.
    known_if_missed : means (H,4) and covariances (H,4,4) of missed tracks.
    detection (H,), detection_undetected (P,) : P_D of local hypotheses and of PPP components.
    undetected_if_missed : means (P,4) and covariances (P,4,4) of PPP components after the scan.
    log_e (M,) : of e = sum of w P_D N(z) over gated PPP components; -inf where none is.
    log_first (M,) : log e, with what the scores say.  log_new (M,) : log(lambda_c + e), likewise.
    """

    hypotheses: Globals
    dropped: int
    known: Pairs
    undetected: Priced
    log_missed: FloatArray
    existence_if_missed: FloatArray
    known_if_missed: tuple[FloatArray, FloatArray]
    detection: FloatArray
    detection_undetected: FloatArray
    undetected_if_missed: tuple[FloatArray, FloatArray]
    log_e: FloatArray
    log_first: FloatArray
    log_new: FloatArray


def associate(
    density: Density,
    scan: Scan,
    sensor: Sensor,
    *,
    gate_threshold: float,
    max_hypotheses: int,
    negligible: float = 0.0,
    clustering: bool = True,
) -> Association:
    """Gate, price and rank the association hypotheses of a scan.

    A parent of weight w has at most ceil(`max_hypotheses` w) children, its best.  Those that weigh
    up to `negligible` of its best child, or of its cluster, would be pruned and are not kept.
    """
    local, table, z = density.local, density.hypotheses, scan.position
    detection, detection_if_seen, known_if_missed = sensor.of_tracks(local)
    known = _gated(
        local.mean, local.cov, local.existence * detection_if_seen, z, sensor, gate_threshold
    )
    existence_if_missed, not_seen = sensor.missed(local.existence, detection)
    log_missed = np.log(np.maximum(not_seen, math.exp(LOG_TINY)))

    ppp = density.undetected
    detection_undetected, undetected_if_seen, if_missed = sensor.of_undetected(ppp.mean, ppp.cov)
    undetected, log_e = _first_detections(
        ppp, ppp.log_weight + _log(undetected_if_seen), z, sensor, gate_threshold
    )
    log_first, log_clutter = log_e, np.full(len(z), log_of(sensor.clutter))
    if scan.first is not None:
        log_first = log_first + _log(scan.first[:, 0])
        log_clutter = log_clutter + _log(scan.first[:, 1])
    if scan.evidence is not None:
        log_first = log_first + _log(scan.said_of_first())
        said = scan.said_of_known(local.kind, known.row, known.measurement)
        known = known.heavier(np.maximum(_log(said), LOG_TINY))
    log_new = np.maximum(np.logaddexp(log_first, log_clutter), LOG_TINY)

    hypotheses, dropped = branch(
        table,
        known,
        log_missed,
        log_new,
        max_hypotheses=max_hypotheses,
        negligible=negligible,
        clustering=clustering,
    )
    return Association(
        hypotheses,
        dropped,
        known,
        undetected,
        log_missed,
        existence_if_missed,
        known_if_missed,
        detection,
        detection_undetected,
        if_missed,
        log_e,
        log_first,
        log_new,
    )


def _log(value: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore"):
        return np.log(value)


def _gated(
    mean: FloatArray,
    cov: FloatArray,
    prior: FloatArray,
    z: FloatArray,
    sensor: Sensor,
    threshold: float,
) -> Pairs:
    """Pairs within the gate; a Gaussian that cannot be detected (0 in `prior`, r P_D) has none."""
    if compiled.native is not None:
        innovation_of, row, measurement, y, log_weight = compiled.native.gated(
            mean, cov, sensor.R, prior, np.ascontiguousarray(z), threshold
        )
        return Pairs(row, measurement, y, log_weight, Innovation(*innovation_of))
    innovation = Innovation.of(mean, cov, sensor.R)
    return _paired(innovation, _log(prior) + innovation.log_norm(), z, threshold)


def _paired(
    innovation: Innovation, log_height: FloatArray, z: FloatArray, threshold: float
) -> Pairs:
    row, measurement, y = gate(innovation, z, threshold)
    log_weight = log_height[row] - 0.5 * (y[:, 0] * y[:, 0] + y[:, 1] * y[:, 1])
    possible = log_weight > -np.inf
    if not possible.all():
        row, measurement, y = row[possible], measurement[possible], y[possible]
        log_weight = log_weight[possible]
    return Pairs(row, measurement, y, log_weight, innovation)


def _first_detections(
    ppp: Mixture, log_detected: FloatArray, z: FloatArray, sensor: Sensor, threshold: float
) -> tuple[Priced, FloatArray]:
    """The PPP as first detections see it, and log e (M,)."""
    if compiled.native is not None:
        innovation_of, log_height, log_e = compiled.native.priced(
            ppp.mean, ppp.cov, sensor.R, log_detected, np.ascontiguousarray(z), threshold
        )
        return Priced(Innovation(*innovation_of), log_height, threshold), log_e
    innovation = Innovation.of(ppp.mean, ppp.cov, sensor.R)
    priced = Priced(innovation, log_detected + innovation.log_norm(), threshold)
    return priced, priced.log_density(z)
