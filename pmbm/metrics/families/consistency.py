"""Consistency: covariances against errors, as NEES of estimates and NIS of innovations.

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
section 5.4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from pmbm.arrays import FloatArray
from pmbm.errors import InputError
from pmbm.geometry import wrap_angle
from pmbm.intervals import FEWEST, jackknife_reach
from pmbm.metrics.core.family import Family, Tally, Work
from pmbm.metrics.core.formulas import Ratio
from pmbm.metrics.core.result import Counts, Metric, Samples, Undefined

STATE_DIMENSION: Final = 4
"""Of x, y, vx, vy."""


def normalised_squares(
    errors: ArrayLike, covariances: ArrayLike, *, angles: tuple[int, ...] = ()
) -> FloatArray:
    """e' P^-1 e of each error: NEES of state errors, NIS of innovations.

    errors (..., d); covariances (..., d, d), of the same leading shape or one that broadcasts.
    angles : components that are angles, rad; they are wrapped into [-pi, pi) first.
    Raises InputError, naming the rows, where a covariance is not positive definite.
    """
    e = np.array(errors, dtype=np.float64)
    covariance = np.asarray(covariances, dtype=np.float64)
    if not np.isfinite(e).all() or not np.isfinite(covariance).all():
        raise InputError("bad errors or covariances", field="errors", expected="finite numbers")
    for angle in angles:
        e[..., angle] = wrap_angle(e[..., angle])
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        least = np.linalg.eigvalsh(covariance)[..., 0].ravel()
        raise InputError(
            "singular covariance",
            field="covariance",
            # What fails may have a least eigenvalue barely above zero.
            rows=np.flatnonzero(least <= max(least.min(), 0.0)),
            expected="positive definite",
            got=f"smallest eigenvalue {least.min():g}",
        ) from None
    white = np.linalg.solve(factor, e[..., None])[..., 0]
    return np.einsum("...d,...d->...", white, white)


@dataclass(frozen=True, eq=False, kw_only=True)
class Consistency:
    """NEES (or NIS) of M runs over S steps against its chi-square bounds.

    run_mean (S,) : mean over runs at each step.
    step_bounds : 95 % of the means of M consistent runs lie between, at one step.
    fraction_inside : share of steps inside; about 0.95 for a consistent filter.
    mean : over runs and steps.  anees : mean / d; 1 for a consistent filter.
    bounds : 95 % of such means of consistent runs lie between; None below five runs.  Steps of one
        run are correlated, so that it is the runs that say how far their mean strays.
    """

    run_mean: FloatArray
    step_bounds: tuple[float, float]
    fraction_inside: float
    mean: float
    anees: float
    bounds: tuple[float, float] | None


def consistency(squares: ArrayLike, dimension: int) -> Consistency:
    """Judge normalised squares (M,S) of M runs and S steps, of errors of `dimension` d."""
    values = np.asarray(squares, dtype=np.float64)
    if values.ndim != 2 or values.size == 0:
        raise InputError(
            "bad normalised squares", field="squares", expected="(M >= 1, S >= 1)", got=values.shape
        )
    runs = len(values)
    run_mean = values.mean(axis=0)
    low, high = chi2_bounds(dimension, runs)
    mean = float(values.mean())
    bounds = None
    if runs >= FEWEST:
        of_runs = values.mean(axis=1)
        reach = jackknife_reach((runs * mean - of_runs) / (runs - 1), [1.0] * runs)
        bounds = (max(0.0, dimension - reach), dimension + reach)
    return Consistency(
        run_mean=run_mean,
        step_bounds=(low, high),
        fraction_inside=float(((run_mean >= low) & (run_mean <= high)).mean()),
        mean=mean,
        anees=mean / dimension,
        bounds=bounds,
    )


def chi2_bounds(dimension: int, count: int) -> tuple[float, float]:
    """The bounds of 95 % of means of `count` independent normalised squares of `dimension`."""
    # Chi-square quantiles by the incomplete gamma function; scipy.stats is slow to import.
    low, high = 2 * gammaincinv(dimension * count / 2, [0.025, 0.975]) / count
    return float(low), float(high)


@dataclass(frozen=True)
class PerDimension:
    """A formula's value per dimension of the state."""

    formula: Ratio

    def __call__(self, counts: Counts) -> float | Undefined:
        value = self.formula(counts)
        return value if isinstance(value, Undefined) else value / STATE_DIMENSION


@dataclass(frozen=True)
class NeesBounds:
    """Parts: how many estimates of how many runs; of five runs or more, where the mean of 95 % of
    as many honest ones lies, each over `divisor`.

    Estimates of one run are correlated, over frames and over the objects of a scene, so one run
    has no bounds of its own: runs are what varies.
    """

    divisor: int = 1

    def __call__(self, counts: Counts) -> Mapping[str, float]:
        nees, estimates = counts["run_nees"].values, counts["run_estimates"].values
        seen = estimates > 0
        nees, estimates = nees[seen], estimates[seen]
        parts = {"n": float(estimates.sum()), "runs": float(len(estimates))}
        if len(estimates) < FEWEST:
            return parts
        without = (nees.sum() - nees) / (estimates.sum() - estimates)
        reach = jackknife_reach(without, estimates)
        low, high = max(0.0, STATE_DIMENSION - reach), STATE_DIMENSION + reach
        return {**parts, "low": low / self.divisor, "high": high / self.divisor}


def _count(work: Work) -> Tally:
    scene, matches = work.scene, work.matches
    covariance = scene.tracks.covariance[matches.track]
    given = np.isfinite(covariance).all(axis=(1, 2))
    truth, track = matches.truth[given], matches.track[given]
    error = np.concatenate(
        [
            scene.tracks.position[track, :2] - scene.truth.position[truth, :2],
            scene.tracks.velocity[track] - scene.truth.velocity[truth],
        ],
        axis=1,
    )
    try:
        squares = normalised_squares(error, covariance[given])
    except InputError as problem:
        row = track[problem.rows[0]]
        where = {"frame": int(scene.tracks.frame[row]), "object_id": int(scene.tracks.id[row])}
        raise problem.located(**where) from None
    return Tally.of(
        {
            "nees": float(squares.sum()),
            "estimates": len(squares),
            "run_nees": Samples(np.array([squares.sum()])),
            "run_estimates": Samples(np.array([float(len(squares))])),
        },
        gate=work.parameters.gate,
        state="x, y, vx, vy",
    )


_NEES: Final = Ratio("nees", "estimates", "no matched track has a covariance")

FAMILY: Final = Family(
    name="consistency",
    rule="NEES of matched tracks; with 95 % bounds over five runs or more",
    count=_count,
    metrics=(
        Metric(
            name="nees",
            unit="1",
            direction="none",
            question="Is the reported covariance honest (4 for the state x, y, vx, vy)?",
            formula=_NEES,
            parts=NeesBounds(),
        ),
        Metric(
            name="anees",
            unit="1",
            direction="none",
            question="Is the reported covariance honest (1; above: too sure of itself)?",
            formula=PerDimension(_NEES),
            parts=NeesBounds(STATE_DIMENSION),
        ),
    ),
)
