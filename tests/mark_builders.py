"""Levels of scores, frames with raw scores, and a street of cars and poles."""

from __future__ import annotations

import numpy as np

from pmbm.filter import DetectionChain, FixedDetection, ScoreLevels
from pmbm.score import Calibration, ScoreModel
from pmbm.types import CLUTTER, Detections, GroundTruth, Label, Recording, Site

PLAIN = Calibration(offset=np.zeros(7), slope=np.ones(7), per_metre=np.zeros(7))


def levels(**changes):
    return ScoreLevels(
        **{
            "label": Label.CAR,
            "calibration": PLAIN,
            "level": [-2.0, 0.0, 2.0],
            "scatter": 1.0,
            "birth": [0.6, 0.2, 0.2],
            "object": [0.02, 0.5, 0.98],
            "clutter": [0.9, 0.08, 0.02],
            **changes,
        }
    )


def chained(P_D, **chain):
    """Misses in runs around one P_D."""
    return DetectionChain(base=FixedDetection(probability=P_D), **chain)


def frame(when, xy, raw=None, label=Label.CAR, score=0.5, **more):
    xy = np.reshape(np.asarray(xy, float), (-1, 2))
    n = len(xy)
    return Detections(
        time=when,
        position=np.column_stack([xy, np.ones(n)]),
        size=np.tile([4.0, 2.0, 1.5], (n, 1)),
        yaw=np.zeros(n),
        score=np.broadcast_to(score, n).copy(),
        raw_score=None if raw is None else np.broadcast_to(raw, n).astype(float),
        label=np.broadcast_to(label, n).astype(int),
        **more,
    )


def delivery(when, places, sensor="", pose=(0.0, 0.0, 0.0), radial=None, velocity=None):
    """Boxes of a sensor of that name at that pose."""
    return frame(
        when,
        places,
        score=0.9,
        sensor=sensor,
        sensor_pose=np.asarray(pose, float),
        radial_velocity=radial,
        sensor_velocity=velocity,
    )


def street(seed, frames=60, poles=6, cars=4):
    """Cars of high scores and poles of low ones, all standing, and chance clutter; with origins."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-60, 60, (cars + poles, 2))
    level = np.r_[rng.normal(3, 0.7, cars), rng.normal(-2, 0.7, poles)]
    truth, given, origin = [], [], []
    for k in range(frames):
        truth.append(
            GroundTruth(
                time=0.1 * k,
                id=np.arange(cars),
                position=np.column_stack([place[:cars], np.ones(cars)]),
                size=np.tile([4.0, 2.0, 1.5], (cars, 1)),
                yaw=np.zeros(cars),
                velocity=np.zeros((cars, 2)),
                label=np.full(cars, Label.CAR),
                visibility=np.ones(cars),
                observable=np.ones(cars, bool),
                crashed=np.zeros(cars, bool),
            )
        )
        seen = np.flatnonzero(rng.random(cars + poles) < 0.9)
        stray = rng.uniform(-80, 80, (rng.poisson(1), 2))
        where = np.concatenate([place[seen] + rng.normal(0, 0.1, (len(seen), 2)), stray])
        raw = np.r_[level[seen] + rng.normal(0, 1, len(seen)), rng.normal(-2, 1, len(stray))]
        given.append(frame(0.1 * k, where, raw))
        origin.append(np.r_[np.where(seen < cars, seen, CLUTTER), np.full(len(stray), CLUTTER)])
    return Recording(
        name="street",
        site=Site(),
        truth=tuple(truth),
        detections=tuple(given),
        frame=np.arange(frames),
        stamp=np.arange(frames),
        origin=tuple(origin),
        object_name={i: str(i) for i in range(cars)},
        provenance={},
    )


def fit_logistic(score, true, scale="score"):
    """A score model whose log-odds are linear in the score, by maximum likelihood.

    Platt's targets (Advances in Large Margin Classifiers, 1999) keep a separable sample finite.
    """
    x, y = np.asarray(score, np.float64), np.asarray(true, np.float64)
    positive, negative = y.sum(), len(y) - y.sum()
    target = np.where(y > 0, (positive + 1) / (positive + 2), 1 / (negative + 2))
    spread = max(float(x.std()), 1e-12)
    design = np.column_stack([np.ones(len(x)), (x - x.mean()) / spread])
    weight = np.zeros(2)
    for _ in range(50):
        with np.errstate(over="ignore"):
            q = 1.0 / (1.0 + np.exp(-(design @ weight)))
        curvature = design.T @ (design * (q * (1 - q))[:, None]) + 1e-9 * np.eye(2)
        step = np.linalg.solve(curvature, design.T @ (target - q))
        weight = weight + step
        if np.abs(step).max() < 1e-10:
            break
    knot = np.unique([x.min(), x.max()])
    return ScoreModel(
        knot=knot,
        log_odds=weight[0] + weight[1] * (knot - x.mean()) / spread,
        base_rate=ScoreModel.fit_isotonic(score, true).base_rate,
        scale=scale,
    )
