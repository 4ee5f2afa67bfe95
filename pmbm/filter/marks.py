"""Discrete marks of an object, filtered exactly like its existence: what kind it is, and whether
the detector sees it at present.

An object's kind never changes; each detection weighs it by what its score and label say.  Beside
each label stands its ghost: a persistent source of clutter that looks like it, such as a pole that
is reported as a pedestrian frame after frame.  Its existence is certain and it is no object, so
what is reported is the probability of existing and of not being a ghost.

Whether an object is seen is a two-state Markov chain, since misses come in runs: a parked van, a
bad angle, a wet windscreen.  After a miss the object is probably still unseen, so the next miss
says less about its existence.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pmbm.door import Door
from pmbm.errors import InputError
from pmbm.score import Calibration, ScoreModel
from pmbm.types import Detections, FloatArray, Label

_LABELS = len(Label)
GHOST = _LABELS
"""First column of the ghosts among the kinds: the labels come first, then their ghosts."""
_KINDS = 2 * _LABELS
_SUREST = 4.0
"""Log-odds beyond which a single score says no more."""
_LOOKED = 5.0
"""For how long a scene is remembered, in the time that what is usual is worth: scenes change, and
after an empty hour the first object must be believed at once."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Kinds:
    """What an object may be, and what each kind's detections look like.

    birth (14,) : share of new sources of detections that are of each kind: the labels, then their
        ghosts; adds up to one.
    confusion (14,7) : P(reported label | kind), each row adding up to one.
    clutter (7,) : P(reported label) of clutter that does not persist; adds up to one.
    score, ghost_score : what a score says of an object, and of a ghost, against such clutter.
    """

    birth: FloatArray
    confusion: FloatArray
    clutter: FloatArray
    score: ScoreModel
    ghost_score: ScoreModel

    def __post_init__(self) -> None:
        door = Door(self, "kinds")
        door.unit_interval("birth", _KINDS)
        door.rows("confusion", _LABELS)
        door.floats("confusion", (_KINDS, _LABELS))
        door.unit_interval("clutter", _LABELS)
        for name in ("birth", "confusion", "clutter"):
            values = getattr(self, name)
            if (values < 0).any() or np.abs(values.sum(axis=-1) - 1).max() > 1e-9:
                raise InputError(
                    "kinds", field=name, expected="shares that add up to one", got=values
                )

    @staticmethod
    def neutral() -> Kinds:
        """Labels and scores say nothing."""
        return Kinds(
            birth=np.full(_KINDS, 1 / _KINDS),
            confusion=np.full((_KINDS, _LABELS), 1 / _LABELS),
            clutter=np.full(_LABELS, 1 / _LABELS),
            score=ScoreModel.uninformative(),
            ghost_score=ScoreModel.uninformative(),
        )

    @staticmethod
    def simple(
        *,
        ghosts: float,
        score: ScoreModel,
        mislabelled: float = 0.05,
        ghost_score: ScoreModel | None = None,
    ) -> Kinds:
        """All labels equally frequent and equally often taken for each other.

        ghosts : share of new sources that are ghosts, in [0, 1).  mislabelled : share of
        detections with another label than the source's, in [0, 1).  Ghosts' scores are those of
        clutter unless `ghost_score` says otherwise.
        """
        confusion = np.full((_KINDS, _LABELS), mislabelled / (_LABELS - 1))
        np.fill_diagonal(confusion[:GHOST], 1 - mislabelled)
        np.fill_diagonal(confusion[GHOST:], 1 - mislabelled)
        birth = np.full(_KINDS, (1 - ghosts) / _LABELS)
        birth[GHOST:] = ghosts / _LABELS
        return Kinds(
            birth=birth,
            confusion=confusion,
            clutter=np.full(_LABELS, 1 / _LABELS),
            score=score,
            ghost_score=ghost_score if ghost_score is not None else ScoreModel.uninformative(),
        )

    @property
    def object(self) -> FloatArray:
        """(14,) whether each kind is an object: labels are, their ghosts are not."""
        return np.repeat([1.0, 0.0], _LABELS)

    def evidence(self, detections: Detections) -> FloatArray:
        """(M,14) p(score, label | kind) / p(score, label | clutter) of every detection."""
        with np.errstate(divide="ignore"):
            of_label = self.confusion[:, detections.label] / np.maximum(
                self.clutter[detections.label], 1e-6
            )
        of_score = np.empty((_KINDS, len(detections)))
        of_score[:GHOST] = np.exp(self.score.log_likelihood_ratio(self.score.read(detections)))
        of_score[GHOST:] = np.exp(
            self.ghost_score.log_likelihood_ratio(self.ghost_score.read(detections))
        )
        return np.ascontiguousarray((of_label * of_score).T)


@dataclass(frozen=True, eq=False, kw_only=True)
class Levels:
    """How sure the detector is of a source of detections, as a trait that lasts.

    The scores of one object scatter about a level of its own, and so do those of a pole: frame
    after frame they say the same again.  The tracker learns a source's level, and the level says
    how probably the source is an object; a long life makes the level certain, not the object.  Seen
    from elsewhere a source may look surer: its level drifts.

    label : of the sources; detections of other labels count as rivals alone.  None, of any.
    calibration : log-odds of detections, whose scale the levels are on.
    level (L,) : log-odds, rising.  scatter : sd of a detection's log-odds about its source's level.
    drift : sd of what a source's level changes by in a second, >= 0; 0, it never does.
    birth (L,) or (R,L) : share of new sources that have each level; adds up to one, at each of R
        distances.  What comes into view far off is mostly an object, what appears near by is not.
    birth_at (R,) or None : those distances, m from the sensor, rising; shares are linear between
        them and constant beyond.
    object (L,) : P(object | level), in [0, 1].
    clutter (L,) : shares of levels in detections that come from no lasting source; adds up to one.
        None, the log-odds say themselves how much likelier a new source is than such a detection.
    usual : objects in view at a time, on average where the levels were fitted, > 0; None, how many
        a scene holds says nothing of its sources.
    memory : s of looking that this average is worth against what a scene shows, > 0.

    Poles come with the detector, objects with the scene: where many objects have been seen, an
    uncertain source is more probably another.  The scene's number has a gamma distribution, learned
    from the expected number of objects in view (`Seen`) over the last five times `memory`.
    """

    label: int | None
    calibration: Calibration | ScoreModel
    level: FloatArray
    scatter: float
    birth: FloatArray
    object: FloatArray
    clutter: FloatArray | None
    birth_at: FloatArray | None = None
    drift: float = 0.0
    usual: float | None = None
    memory: float = 30.0

    def __post_init__(self) -> None:
        door = Door(self, "levels")
        levels = np.size(self.level)
        door.number("scatter", above=0.0)
        door.number("drift", at_least=0.0, at_most=1e3)
        door.number("memory", above=0.0)
        if self.usual is not None:
            door.number("usual", above=0.0)
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
            raise InputError("levels", field="clutter", expected="given beside birth_at", got=None)
        for name in ("level", "birth_at"):
            values = getattr(self, name)
            if values is not None and (np.diff(values) <= 0).any():
                raise InputError("levels", field=name, expected="strictly rising", got=values)
        for name in ("birth", "clutter"):
            values = getattr(self, name)
            if values is None:
                continue
            if (values < 0).any() or np.abs(values.sum(axis=-1) - 1).max() > 1e-6:
                raise InputError(
                    "levels", field=name, expected="shares that add up to one", got=values
                )
        if self.label is not None and self.label not in list(Label):
            raise InputError("levels", field="label", expected="a label", got=self.label)

    @staticmethod
    def at_their_word(scores: ScoreModel) -> Levels:
        """For sources of any label: a score says how probably its detection is true, and one that
        stays low how probably its source is none.

        Clearly low, as likely as not, and clearly high; chosen on simulated scenes.
        """
        return Levels(
            label=None,
            calibration=scores,
            level=np.array([-1.2, 0.0, 1.3]),
            scatter=1.0,
            birth=np.array([0.6, 0.18, 0.22]),
            object=np.array([0.15, 0.85, 0.97]),
            clutter=None,
            usual=1.5,
            memory=1.0,
        )

    def after(self, share: FloatArray, dt: float | FloatArray) -> FloatArray:
        """Shares of levels (H,L) after `dt` seconds, one for all or (H,), from those before.

        Levels walk at random from each to its neighbours and stay between the lowest and the
        highest, so that two intervals are one of both.
        """
        if self.drift == 0:
            return share
        modes, back, rate = self._walk
        moved: FloatArray = ((share @ modes) * np.exp(np.multiply.outer(dt, rate))) @ back
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

    def object_after(self, seen: Seen) -> FloatArray:
        """(L,) P(object | level) in a scene of which so much has been seen."""
        if self.usual is None:
            return self.object
        odds = seen.abundance(self.usual, self.memory)
        return odds * self.object / (odds * self.object + 1 - self.object)

    def birth_after(self, seen: Seen, distance: FloatArray) -> FloatArray:
        """(L,) or, `distance` (M,) from the sensor, (M,L) new sources of each level, in all that
        are usual: where few objects have been seen, fewer come.  Where many have, no more do, since
        what fills a scene is known already."""
        birth = self.birth
        if self.birth_at is not None:
            nearby = [np.interp(distance, self.birth_at, one) for one in np.eye(len(birth))]
            birth = np.array(nearby).T @ birth
        if self.usual is None:
            return birth
        odds = min(1.0, seen.abundance(self.usual, self.memory))
        return birth * (odds * self.object + 1 - self.object)

    def own(self, detections: Detections) -> tuple[Detections, FloatArray]:
        """The detections that may be of these sources, N of them, and their log-odds (N,).

        Raises InputError where the calibration reads raw scores and there are none.
        """
        if isinstance(self.calibration, ScoreModel):
            score = self.calibration.read(detections)
            log_odds = self.calibration.log_likelihood_ratio(score).clip(-_SUREST, _SUREST)
        else:
            log_odds = self.calibration.log_odds(detections)
        if self.label is None:
            return detections, log_odds
        own = detections.label == self.label
        return detections.take(own), log_odds[own]

    def evidence(self, log_odds: FloatArray) -> FloatArray:
        """(M,L) p(log-odds | level) / p(log-odds | clutter) of detections (M,)."""
        apart = np.square((log_odds[:, None] - self.level) / self.scatter)
        nearest = apart.min(axis=1, initial=np.inf, keepdims=True)
        height = np.exp(0.5 * (nearest - apart))
        if self.clutter is not None:
            return height / np.maximum(height @ self.clutter, 1e-6)[:, None]
        return height * (np.exp(log_odds) / np.maximum(height @ self.birth, 1e-6))[:, None]


@dataclass(frozen=True, slots=True)
class Seen:
    """What of a scene has been seen: s looked, and the expected number of objects in view summed
    over that time, s."""

    looked: float = 0.0
    objects: float = 0.0

    def after(self, dt: float, number: float, memory: float) -> Seen:
        """With `number` objects in view for `dt` more seconds; what is more than `memory` bears is
        forgotten, a share of all."""
        looked = self.looked + dt
        kept = min(1.0, _LOOKED * memory / looked) if looked > 0 else 1.0
        return Seen(kept * looked, kept * (self.objects + number * dt))

    def abundance(self, usual: float, memory: float) -> float:
        """The scene's expected number of objects in view, in those that are usual: the mean of its
        gamma distribution."""
        return (memory + self.objects / usual) / (memory + self.looked)


@dataclass(frozen=True, kw_only=True)
class Visibility:
    """A two-state Markov chain: seen, or not seen for the time being.

    unseen : share of P_D that is left while an object is not seen, in [0, 1].
    stay_seen, stay_unseen : probability of staying in a state over `interval`, in (0, 1).
    interval : s, > 0.
    """

    unseen: float
    stay_seen: float
    stay_unseen: float
    interval: float = 0.1

    def __post_init__(self) -> None:
        if not 0 <= self.unseen <= 1:
            raise InputError("visibility", field="unseen", expected="in [0, 1]", got=self.unseen)
        for name in ("stay_seen", "stay_unseen"):
            value = getattr(self, name)
            if not 0 < value < 1:
                raise InputError("visibility", field=name, expected="in (0, 1)", got=value)
        if self.stay_seen + self.stay_unseen < 1:
            raise InputError(
                "visibility",
                field="stay_unseen",
                expected="staying at least as probable as changing",
                got=self.stay_unseen,
            )
        if not 0 < self.interval < np.inf:
            raise InputError("visibility", field="interval", expected="> 0", got=self.interval)

    @property
    def usual(self) -> float:
        """P(seen) in the long run: of an object about which nothing else is known."""
        return (1 - self.stay_unseen) / (2 - self.stay_seen - self.stay_unseen)

    @property
    def usual_share(self) -> float:
        """Share of P_D that such an object has."""
        return self.usual + (1 - self.usual) * self.unseen

    def after(self, seen: FloatArray, dt: float) -> FloatArray:
        """P(seen) (H,) after `dt` seconds, from that before."""
        memory = (self.stay_seen + self.stay_unseen - 1) ** (dt / self.interval)
        return self.usual + (seen - self.usual) * memory

    def share(self, seen: FloatArray) -> FloatArray:
        """Share (H,) of P_D that objects have, given P(seen)."""
        return seen + (1 - seen) * self.unseen

    def if_detected(self, seen: FloatArray) -> FloatArray:
        """P(seen) (H,) of objects that were detected."""
        return seen / np.maximum(self.share(seen), np.finfo(float).tiny)

    def if_missed(self, seen: FloatArray, P_D: FloatArray) -> FloatArray:
        """P(seen) (H,) of objects that exist and were missed; P_D (H,) : over both states."""
        missed_if_seen = 1 - P_D / np.maximum(self.share(seen), np.finfo(float).tiny)
        chance = 1 - P_D
        return np.divide(seen * missed_if_seen, chance, out=seen.copy(), where=chance > 0)
