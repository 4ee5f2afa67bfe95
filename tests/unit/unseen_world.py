"""Undetected objects one by one: what the map of undetected objects is held against.

A particle is an object that is born, moves, dies and is looked at on its own; no Gaussian mixture,
no lattice and no bearings are involved.
"""

import numpy as np

from pmbm import Detections, PMBMConfig, Site
from pmbm.filter import BirthMap, PMBMTracker, Survival
from pmbm.filter.models.view import View

WALL = np.array([[12, -9], [13, -9], [13, 9], [12, 9]], dtype=float)
SHADOW = np.array([[13, -9.75], [39, -29.25], [39, 29.25], [13, 9.75]])
"""Behind the wall; its far corners are 48.75 m away, so the range cuts nothing of it."""
SITE = Site(occluders=(WALL,), max_range=52.0)
CAR_RADIUS = 1.6
DT = 0.1


def model(**changes):
    """The textbook with a map; changes : of the configuration, by dotted names."""
    given = {
        "birth": BirthMap(rate=6.0, initial=20.0, spacing=3.5),
        "survival": Survival(probability=0.99),
        "sensor.occlusion": True,
    }
    return PMBMConfig.textbook().changed({**given, **changes})


def births(config, site=SITE):
    """Of the first frame, and of each later one, with the sensor at the origin."""
    view = View.of(site, np.zeros(3))
    initial, memory = config.birth.births(site, view, None, config.survival, None)
    return initial, config.birth.births(site, view, DT, config.survival, memory)[0]


def tracked(config, frames, site=SITE):
    """The tracker after so many empty frames, and its report of each."""
    tracker = PMBMTracker(config, site)
    return tracker, [tracker.step(Detections.empty(time=DT * i)) for i in range(frames)]


def draw(mixture, n, rng):
    """n states from a mixture, and the mass that each stands for."""
    weight = np.exp(mixture.log_weight)
    row = rng.choice(len(weight), n, p=weight / weight.sum())
    root = np.linalg.cholesky(mixture.cov[row])
    noise = np.einsum("nij,nj->ni", root, rng.normal(size=(n, 4)))
    return mixture.mean[row] + noise, weight.sum() / max(n, 1)


def hidden_share(x, y, wall=WALL, points=24):
    """Share of a car-sized disc at each place that the wall hides from the origin."""
    i = np.arange(points)
    radius = CAR_RADIUS * np.sqrt((i + 0.5) / points)
    turn = i * np.pi * (3 - np.sqrt(5))
    px, py = x[:, None] + radius * np.cos(turn), y[:, None] + radius * np.sin(turn)
    near = wall[:, 0].min()
    far = wall[:, 0].max()
    low, high = wall[:, 1].min(), wall[:, 1].max()
    # The sight line is at these heights where it enters and leaves the wall's depth.
    with np.errstate(divide="ignore", invalid="ignore"):
        at_near, at_far = py / px * near, py / px * far
    crosses = (np.minimum(at_near, at_far) <= high) & (np.maximum(at_near, at_far) >= low)
    return ((px > near) & crosses).mean(axis=1)


def seen_by(config, x, y, site=SITE):
    inside = np.hypot(x, y) <= site.max_range
    share = np.zeros(len(x))
    behind = (x > 10) & (np.abs(y) < x + 5)
    share[behind] = hidden_share(x[behind], y[behind])
    return config.sensor.detection.probability * inside * (1 - share)


def moved(state, dt, config, rng):
    F, Q = config.motion.transition(dt)
    return state @ F.T + rng.multivariate_normal(np.zeros(4), Q, len(state))


def reference(
    config, initial, births, frames, rng, *, first=100_000, each=10_000, sees=seen_by, within=np.inf
):
    """Particles (n,4) and masses (n,) after so many frames in which nothing was detected.

    sees : P_D by config, x and y.  within : range in which objects appear, m.
    """
    state, mass = draw(initial, first, rng)
    weight = np.where(np.hypot(*state[:, :2].T) <= within, mass, 0.0)
    for frame in range(frames):
        if frame:
            state = moved(state, DT, config, rng)
            weight = weight * config.survival.over(DT)
            born, mass = draw(births, each, rng)
            state = np.concatenate([state, born])
            born_weight = np.where(np.hypot(*born[:, :2].T) <= within, mass, 0.0)
            weight = np.concatenate([weight, born_weight])
        weight = weight * (1 - sees(config, *state[:, :2].T))
        keep = weight > 1e-7
        state, weight = state[keep], weight[keep]
    return state, weight
