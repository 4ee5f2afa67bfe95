"""Box 2 of 4, data association (Pang & Radha 2021, Sec. 2.3).

Every measurement is a known track's, a new object's, or clutter.  A *parent* is a global
hypothesis before the scan; its *children* say, on top of it, which measurement each track takes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pmbm.filter.config import Reduction
from pmbm.filter.density import Density, Globals
from pmbm.filter.hypotheses.branching import branch
from pmbm.filter.hypotheses.gating import GatedPairs, gated_pairs, log_density
from pmbm.filter.hypotheses.weights import log_of, log_of_each
from pmbm.filter.models.sensor import ObservationModel
from pmbm.filter.scan import Scan
from pmbm.types import FloatArray

LOG_TINY = -700.0
"""Stands in for log 0 in weights, so that what nothing explains gets the smallest weight there is
and a step never fails."""


@dataclass(frozen=True, eq=False, slots=True)
class Association:
    """Everything that one scan says about the hypotheses.

    hypotheses : the children, over the candidates: rows 0 .. H-1 are the local hypotheses, missed;
        then come the detected ones of the pairs `known`, then a new track of each measurement.
    dropped : how many children were too unlikely to be kept.
    known, undetected : pairs of local hypotheses, and of PPP components, and measurements.
    log_missed (H,) : log(1 - r P_D).  existence_if_missed (H,) : r of a missed track.
    known_if_missed : means (H,4) and covariances (H,4,4) of missed tracks.
    detection (H,), detection_undetected (P,) : P_D of local hypotheses and of PPP components.
    undetected_if_missed : means (P,4) and covariances (P,4,4) of PPP components after the scan.
    log_e (M,) : of e = sum of w P_D N(z) over gated PPP components; -inf where none is.
    log_birth_evidence (M,) : log e, with what the scores say.
    log_new (M,) : log(lambda_c + e), likewise.
    """

    hypotheses: Globals
    dropped: int
    known: GatedPairs
    undetected: GatedPairs
    log_missed: FloatArray
    existence_if_missed: FloatArray
    known_if_missed: tuple[FloatArray, FloatArray]
    detection: FloatArray
    detection_undetected: FloatArray
    undetected_if_missed: tuple[FloatArray, FloatArray]
    log_e: FloatArray
    log_birth_evidence: FloatArray
    log_new: FloatArray


def associate(
    density: Density, scan: Scan, sensor: ObservationModel, reduction: Reduction
) -> Association:
    """Gate, price and rank the association hypotheses of a scan.

    reduction : its gate and clustering, and `max_hypotheses`: a parent of weight w has at most
        ceil(max_hypotheses w) children, its best.  Those that weigh up to `prune_hypothesis` of its
        best child, or of its cluster, would be pruned and are not kept.
    """
    local, ppp, z = density.local, density.undetected, scan.position
    measured = z, scan.covariance(sensor.R), reduction.gate, scan.radar
    detection, detection_if_seen, known_if_missed = sensor.of_tracks(local)
    log_prior = log_of_each(local.existence * detection_if_seen)
    known = gated_pairs(local.mean, local.cov, log_prior, *measured)
    existence_if_missed, not_seen = sensor.missed(local.existence, detection)
    log_missed = np.log(np.maximum(not_seen, math.exp(LOG_TINY)))

    detection_undetected, undetected_if_seen, if_missed = sensor.of_undetected(ppp.mean, ppp.cov)
    log_detected = ppp.log_weight + log_of_each(undetected_if_seen)
    undetected = gated_pairs(ppp.mean, ppp.cov, log_detected, *measured)
    log_e = log_density(undetected, len(z))
    factors = scan.factors()
    log_birth_evidence = log_e + log_of_each(factors[:, 0]) + log_of_each(scan.ratio_if_first())
    log_clutter = log_of(sensor.clutter) + log_of_each(factors[:, 1])
    ratio = scan.ratio_if_known(local.marks.source, known.row, known.measurement)
    known = known.weighted(np.maximum(log_of_each(ratio), LOG_TINY))
    log_new = np.maximum(np.logaddexp(log_birth_evidence, log_clutter), LOG_TINY)

    hypotheses, dropped = branch(
        density.hypotheses,
        known,
        log_missed,
        log_new,
        max_hypotheses=reduction.max_hypotheses,
        negligible=reduction.prune_hypothesis,
        clustering=reduction.clustering,
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
        log_birth_evidence,
        log_new,
    )
