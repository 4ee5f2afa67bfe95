"""Levels of scores: a source's latent detection quality, which lasts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.filter.models.protocols import SceneDensity
from pmbm.filter.models.scores import NoRecord, ScoredDetections
from pmbm.kernels import twin
from pmbm.score import Calibration, ScoreModel
from pmbm.types import Detections, FloatArray, Label
from pmbm.validation import Checker, equal_fields, hash_of_fields

_SUREST = 4.0
"""Log-odds beyond which a single score says no more."""
_LOOKED = 5.0
"""For how long a scene is remembered, in `prior_seconds`: scenes change, and after an empty hour
the first object must be believed at once."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoreLevels(NoRecord):
    """How sure the detector is of a source of detections: a latent quality that lasts.

    The scores of one object scatter about a level of its own, and so do those of a pole: frame
    after frame they say the same again.  The tracker learns a source's level, and the level says
    how probably the source is an object; a long life makes the level certain, not the object.  Seen
    from elsewhere a source may look surer: its level drifts.

    label : of the sources; detections of other labels count as rivals alone.  None, of any.
    calibration : log-odds of detections, whose scale the levels are on; None takes scores at their
        word.
    level (L,) : log-odds, rising.  scatter : sd of a detection's log-odds about its source's level.
    drift : sd of what a source's level changes by in a second, >= 0; 0, it never does.
    birth (L,) or (R,L) : share of new sources that have each level; adds up to one, at each of R
        distances.  What comes into view far off is mostly an object, what appears near by is not.
    birth_at (R,) or None : those distances, m from the sensor, rising; shares are linear between
        them and constant beyond.
    object (L,) : P(object | level), in [0, 1].
    clutter (L,) : shares of levels in detections that come from no lasting source; adds up to one.
        None, the log-odds say themselves how much likelier a new source is than such a detection.
    mean_objects : objects in view at a time, on average where the levels were fitted, > 0; None,
        how many a scene holds says nothing of its sources.
    prior_seconds : s of looking that this average is worth against what a scene shows, > 0.

    Poles come with the detector, objects with the scene: where many objects have been seen, an
    uncertain source is more probably another.  The scene's number has a gamma distribution, learned
    from the expected number of objects in view (`SceneDensity`) over the last five times
    `prior_seconds`.
    """

    label: int | None
    calibration: Calibration | ScoreModel | None
    level: FloatArray
    scatter: float
    birth: FloatArray
    object: FloatArray
    clutter: FloatArray | None
    birth_at: FloatArray | None = None
    drift: float = 0.0
    mean_objects: float | None = None
    prior_seconds: float = 30.0

    def __post_init__(self) -> None:
        door = Checker(self, "score levels")
        levels = np.size(self.level)
        door.number("scatter", above=0.0)
        door.number("drift", at_least=0.0, at_most=1e3)
        door.number("prior_seconds", above=0.0)
        if self.mean_objects is not None:
            door.number("mean_objects", above=0.0)
        door.floats("level", (max(levels, 1),))
        if self.birth_at is None:
            door.floats("birth", (levels,))
        else:
            door.floats("birth_at", (max(np.size(self.birth_at), 1),))
            door.floats("birth", (len(self.birth_at), levels))
        door.unit_interval("object", levels)
        if self.clutter is not None:
            door.floats("clutter", (levels,))
        elif self.birth_at is not None:
            raise InputError(
                "score levels", field="clutter", expected="given beside birth_at", got=None
            )
        for name in ("level", "birth_at"):
            values = getattr(self, name)
            if values is not None and (np.diff(values) <= 0).any():
                raise InputError("score levels", field=name, expected="strictly rising", got=values)
        for name in ("birth", "clutter"):
            values = getattr(self, name)
            if values is None:
                continue
            if (values < 0).any() or np.abs(values.sum(axis=-1) - 1).max() > 1e-6:
                raise InputError(
                    "score levels", field=name, expected="shares that add up to one", got=values
                )
        if self.label is not None and self.label not in list(Label):
            raise InputError("score levels", field="label", expected="a label", got=self.label)

    __eq__ = equal_fields
    __hash__ = hash_of_fields

    @property
    def classes(self) -> int:
        """L."""
        return len(self.level)

    @property
    def needs_all_labels(self) -> bool:
        """Whether detections of other labels count, as rivals."""
        return self.label is not None

    def read(self, detections: Detections, scene: SceneDensity) -> ScoredDetections:
        """The detections that may be of these sources, and what their log-odds say.

        Raises InputError where the calibration reads raw scores and there are none.
        """
        own, log_odds = self.own(detections)
        return ScoredDetections(
            own,
            self.evidence(log_odds),
            self.birth_after(scene, None if self.birth_at is None else own.distance),
            None,
            np.zeros((len(own), 0)),
        )

    def labels(self, last: NDArray[np.int8], source: FloatArray) -> NDArray[np.int8]:
        return last

    @property
    def steady(self) -> bool:
        return self.drift == 0

    def predicted(self, source: FloatArray, dt: float) -> FloatArray:
        """Shares of levels (H,L) after `dt` seconds, from those before.

        Levels walk at random from each to its neighbours and stay between the lowest and the
        highest, so that two intervals are one of both.
        """
        if self.drift == 0:
            return source
        modes, back, rate = self._walk
        moved: FloatArray = ((source @ modes) * np.exp(dt * rate)) @ back
        return moved.clip(min=0.0)

    @cached_property
    def _walk(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Eigenvectors (L,L) of the walk's generator, their inverse, and eigenvalues (L,), 1/s."""
        gap = np.diff(self.level)
        room = np.append(gap, gap[-1:]) + np.append(gap[:1], gap)
        up, down = self.drift**2 / (gap * room[:-1]), self.drift**2 / (gap * room[1:])
        # The walk is reversible: scaled by the root of how long it stays at each level in the long
        # run, its generator is symmetric.
        root = np.exp(0.5 * np.append(0.0, np.cumsum(np.log(room[1:] / room[:-1]))))
        between = np.sqrt(up * down)
        symmetric = np.diag(between, 1) + np.diag(between, -1)
        symmetric -= np.diag(np.append(up, 0.0) + np.append(0.0, down))
        rate, vector = np.linalg.eigh(symmetric)
        return vector / root[:, None], vector.T * root, rate

    def object_share(self, scene: SceneDensity) -> FloatArray:
        """P(object | level) (L,) in this scene."""
        if self.mean_objects is None:
            return self.object
        odds = scene.abundance(self.mean_objects, self.prior_seconds) * self.object
        return odds / (odds + self._clutter_share)

    @cached_property
    def _clutter_share(self) -> FloatArray:
        return 1 - self.object

    def observed(
        self, scene: SceneDensity, in_view: Callable[[FloatArray], float], dt: float
    ) -> SceneDensity:
        if self.mean_objects is None:
            return scene
        return scene.after(dt, in_view(self.object), _LOOKED * self.prior_seconds)

    def birth_after(self, scene: SceneDensity, distance: FloatArray | None) -> FloatArray:
        """(L,) or, `distance` (M,) from the sensor, (M,L) new sources of each level, in all that
        are usual: where few objects have been seen, fewer come.  Where many have, no more do, since
        what fills a scene is known already."""
        birth = self.birth
        if self.birth_at is not None:
            assert distance is not None
            nearby = [np.interp(distance, self.birth_at, one) for one in np.eye(len(birth))]
            birth = np.array(nearby).T @ birth
        if self.mean_objects is None:
            return birth
        odds = scene.abundance(self.mean_objects, self.prior_seconds)
        return birth if odds >= 1 else birth * (odds * self.object + self._clutter_share)

    def own(self, detections: Detections) -> tuple[Detections, FloatArray]:
        """The detections that may be of these sources, N of them, and their log-odds (N,).

        Raises InputError where the calibration reads raw scores and there are none.
        """
        calibration = self.calibration or ScoreModel.trusting()
        if isinstance(calibration, ScoreModel):
            score = calibration.read(detections)
            log_odds = calibration.log_likelihood_ratio(score, within=_SUREST)
        else:
            log_odds = calibration.log_odds(detections)
        if self.label is None:
            return detections, log_odds
        own = detections.label == self.label
        return detections.take(own), log_odds[own]

    def evidence(self, log_odds: FloatArray) -> FloatArray:
        """(M,L) p(log-odds | level) / p(log-odds | clutter) of detections (M,)."""
        if self.clutter is not None:
            return _against(log_odds, self.level, self.scatter, self.clutter, False)
        return _against(log_odds, self.level, self.scatter, self.birth, True)


@twin("level_evidence")
def _against(
    log_odds: FloatArray,
    level: FloatArray,
    scatter: float,
    share: FloatArray,
    worth_their_odds: bool,
) -> FloatArray:
    """(M,L) densities of log-odds (M,) about levels (L,), over their mean with these shares (L,);
    times the odds themselves, where these are what a new source is worth against clutter."""
    apart = np.square((log_odds[:, None] - level) / scatter)
    nearest = apart.min(axis=1, initial=np.inf, keepdims=True)
    height = np.exp(0.5 * (nearest - apart))
    worth = np.exp(log_odds) if worth_their_odds else np.ones(len(log_odds))
    return height * (worth / np.maximum(height @ share, 1e-6))[:, None]


@dataclass(frozen=True, eq=False, kw_only=True)
class LastingScores(ScoreLevels):
    """The levels of sources of any label, without fitting: a score says how probably its detection
    is true, and one that stays low how probably its source is none.

    Clearly low, as likely as not, and clearly high; chosen on simulated scenes.
    """

    label: int | None = None
    calibration: Calibration | ScoreModel | None = None
    level: FloatArray = field(default_factory=lambda: np.array([-1.2, 0.0, 1.3]))
    scatter: float = 1.0
    birth: FloatArray = field(default_factory=lambda: np.array([0.6, 0.18, 0.22]))
    object: FloatArray = field(default_factory=lambda: np.array([0.15, 0.85, 0.97]))
    clutter: FloatArray | None = None
    mean_objects: float | None = 1.5
    prior_seconds: float = 1.0
