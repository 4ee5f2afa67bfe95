"""The Poisson multi-Bernoulli mixture filter (Pang & Radha, ICASSP 2021).

Letters used in this folder alone:

    F, Q     how a state moves over one interval, and the noise added, over [x, y, vx, vy]
    H, R     what of it is measured ([x, y]), and the measurement's covariance
    P, S     covariance of a state, and of a measurement expected from it: S = H P H' + R
    K, W     Kalman gain, and the same for whitened innovations: K = W L^-1 with S = L L'
    r        probability that an object exists
    w        weight of a hypothesis or of a component; all are kept as logs
    P_D, P_S probability of being detected, and of living on
    e        expected density of first detections at a measurement: sum of w P_D N(z)
    lambda_c density of clutter, per m^2 and frame
"""

from __future__ import annotations

from pmbm.filter.config import PMBMConfig
from pmbm.filter.inspection import Inspection
from pmbm.filter.marks import Kinds, Levels, Visibility
from pmbm.filter.smoothing import smooth
from pmbm.filter.tracker import PMBMTracker

__all__ = ["Inspection", "Kinds", "Levels", "PMBMConfig", "PMBMTracker", "Visibility", "smooth"]
