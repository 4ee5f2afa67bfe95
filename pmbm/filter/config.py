"""The configuration of the PMBM tracker, checked where it is made."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.filter.marks import Kinds, Levels, Visibility
from pmbm.score import ScoreModel

_RUNS_OF_MISSES = Visibility(unseen=0.1, stay_seen=0.97, stay_unseen=0.8)


@dataclass(frozen=True, kw_only=True)
class PMBMConfig:
    """What the tracker assumes of the world, and how much it keeps in mind.

    The defaults are those that measured best on simulated scenes; `textbook()` and `paper()` are
    the two presets beside them.

    Motion and life
    survival : P_S over `survival_interval`, in [0, 1] (Pang & Radha 2021, Sec. 2.5).
    survival_interval : s, > 0.
    spectral_density : of the white-noise acceleration, m^2/s^3, >= 0 (Sec. 2.5).

    Sensor
    measurement_sd : standard deviation of a measured position, per axis, m, > 0.
    detection_probability : P_D of an object in view, in [0, 1] (Sec. 2.6).
    clutter_rate : expected false detections per frame over the field of view, >= 0.
    occlusion : whether the other tracks, as likely as they exist, and the site's occluders hide an
        object, so that its P_D is that in the open times its expected visible share (Sec. 2.2).

    Scores (Sec. 2.6; the paper names the ideas and gives no formulas)
    scores : "ignore"; "first": they scale existence and weight of objects detected for the first
        time, r = s e / (s e + (1 - s) lambda_c), as the paper does; "everywhere": they count as
        likelihood ratios of object against clutter in every branch; "lasting": that too, and a
        source that scores low again and again is probably no object (`Levels.at_their_word`).
    score_model : what a score means; None takes scores at their word (`ScoreModel.trusting()`).
    detection_from_scores : "off"; "rising" or "falling": P_D of a track lies between
        `detection_low` and `detection_high`, after the running mean of its past scores.
    detection_low, detection_high : in [0, 1].
    newest_score : weight of the newest score in that mean, in (0, 1].
    miss_rule : "bayes"; "scaled": a miss multiplies existence and weight by 1 - P_D, as the paper
        has it.

    Marks (what real detections demand; neutral ones give the plain filter)
    kinds : what labels and scores say of what an object is, a persistent source of clutter among
        them; None, an object is what its last detection says.  Takes the place of `scores`.
    levels : what scores say of one label's sources, as a lasting trait of each; in place of
        `kinds`.
    visibility : a chain of being seen, with `detection_probability`, and not seen; None, misses
        are independent.

    Boxes (beside the filter)
    newest_box : weight, in (0, 1], of the newest detection in a track's height above ground and
        size, against all before it; 1 copies the last detection, as the paper does.  Headings are
        always the last detection's.

    Undetected objects (Sec. 2.2)
    birth_rate : expected new objects per second over the field of view, >= 0.
    initial_objects : expected number of objects in view before the first frame, >= 0.
    birth_components : Gaussians that the births are spread over, >= 1.
    birth_speed_sd : standard deviation of a new object's velocity, per axis, m/s, > 0.
    undetected_detail : None; or the spacing, in [1, 4] m, of a lattice on which undetected objects
        are kept place by place, on drivable ground where the site names it, swept out where the
        sensor sees and preserved where other objects or occluders hide them; half of the births
        arise at the edge of the view.  In place of `birth_components` and `merge_undetected`.

    Reduction (Sec. 2.7)
    gate : squared Mahalanobis distance of a measurement that may be a track's, > 0.
    max_hypotheses : global hypotheses kept per cluster, >= 1; a parent of weight w has at most
        ceil(max_hypotheses w) children.  A cluster of more than 30 tracks keeps fewer: as many as
        hold 30 max_hypotheses entries together, one entry a track, or 6000 if that is more; and so
        does one that a single frame gives more than 300,000 ways to pair tracks and detections.
    prune_hypothesis : global hypotheses of a weight up to this are dropped, in [0, 1).
    recycle_below : Bernoullis of an existence below this leave the mixture, in [0, 1].
    recycle : whether these become PPP components, or are forgotten.
    prune_undetected : PPP components of a weight up to this are dropped, >= 0.
    merge_undetected : PPP components nearer than this squared Mahalanobis distance are merged,
        >= 0; 0 is never.
    max_tracks, max_undetected : tracks and PPP components kept, >= 1.
    clustering : whether independent groups of tracks are kept apart; off, one table of global
        hypotheses spans the scene (the textbook form, for small scenes).
    split_below : groups of tracks of one cluster part where they depend on each other by less than
        this total variation, >= 0; 0 parts only tracks whose hypothesis is certain.

    Output
    report_above : a track is reported when its probability of existence exceeds this, in [0, 1].
    exclusive : whether a track is held back where another is reported at its place, the centre of
        one in the box of the other: two objects are never at one place.  The one known for longer
        is reported, if it is there more probably than not, or the whole instead of its part.
    keep_above : the batch mode keeps a track whose probability, as of its last detection, exceeds
        this, in [0, 1].
    history : steps of association history kept per hypothesis, >= 1; more than the last is to look
        at.
    """

    survival: float = 0.995
    survival_interval: float = 0.1
    spectral_density: float = 2.0
    measurement_sd: float = 0.5
    detection_probability: float = 0.95
    clutter_rate: float = 5.0
    occlusion: bool = True
    scores: Literal["ignore", "first", "everywhere", "lasting"] = "lasting"
    score_model: ScoreModel | None = None
    detection_from_scores: Literal["off", "rising", "falling"] = "off"
    detection_low: float = 0.7
    detection_high: float = 0.95
    newest_score: float = 0.3
    miss_rule: Literal["bayes", "scaled"] = "bayes"
    kinds: Kinds | None = None
    levels: Levels | None = None
    visibility: Visibility | None = _RUNS_OF_MISSES
    newest_box: float = 1.0
    birth_rate: float = 0.5
    initial_objects: float = 3.0
    birth_components: int = 7
    birth_speed_sd: float = 10.0
    undetected_detail: float | None = None
    gate: float = 20.0
    max_hypotheses: int = 200
    prune_hypothesis: float = 1e-3
    recycle_below: float = 0.01
    recycle: bool = True
    prune_undetected: float = 1e-5
    merge_undetected: float = 1.0
    max_tracks: int = 200_000
    max_undetected: int = 200_000
    clustering: bool = True
    split_below: float = 1e-3
    report_above: float = 0.5
    exclusive: bool = True
    keep_above: float = 0.5
    history: int = 1

    def __post_init__(self) -> None:
        for f in fields(self):
            _check(f.name, getattr(self, f.name), type(f.default))
        for name, choices in _CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                raise InputError(
                    "PMBM configuration",
                    field=name,
                    got=value,
                    hint=nearest_hint(value, choices, "choice"),
                )
        for name, kind in _OBJECTS.items():
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise InputError(
                    "PMBM configuration",
                    field=name,
                    expected=f"a {kind.__name__} or None",
                    got=type(value).__name__,
                )
        if self.kinds is not None and self.scores == "first":
            raise InputError(
                "PMBM configuration",
                field="scores",
                expected="another rule beside kinds, which say what scores mean everywhere",
                got=self.scores,
            )
        if self.levels is not None and (self.kinds is not None or self.scores == "first"):
            raise InputError(
                "PMBM configuration",
                field="levels",
                expected="neither kinds nor scores = 'first' beside levels, which say it all",
            )
        if self.detection_low > self.detection_high:
            raise InputError(
                "PMBM configuration",
                field="detection_low",
                expected=f"at most detection_high = {self.detection_high:g}",
                got=self.detection_low,
            )
        if self.undetected_detail is not None:
            _check("undetected_detail", self.undetected_detail, float)
        for name, (low, high, open_low, open_high) in _BOUNDS.items():
            value = getattr(self, name)
            if value is None:
                continue
            too_low = value <= low if open_low else value < low
            too_high = value >= high if open_high else value > high
            if too_low or too_high:
                left, right = "(" if open_low else "[", ")" if open_high else "]"
                raise InputError(
                    "PMBM configuration",
                    field=name,
                    expected=f"a number in {left}{low:g}, {high:g}{right}",
                    got=value,
                )

    @classmethod
    def textbook(cls, **changes: Any) -> PMBMConfig:
        """Exact Bayes with one P_D for all in view: scores ignored, nothing hides anything
        (Williams 2015; Garcia-Fernandez et al. 2018)."""
        return cls(**{**_TEXTBOOK, **changes})

    @classmethod
    def paper(cls, **changes: Any) -> PMBMConfig:
        """The three deviations of Pang & Radha (2021, Sec. 2.6) from the textbook: scores in the
        first detection, P_D from past scores, and misses that scale existence and weight.

        What each does on its own is measured by `studies/preset_options.toml`; docs/presets.md.
        """
        return cls(**{**_TEXTBOOK, **_PAPER, **changes})


_TEXTBOOK: dict[str, Any] = {
    "scores": "ignore",
    "detection_from_scores": "off",
    "miss_rule": "bayes",
    "occlusion": False,
    "visibility": None,
    "detection_probability": 0.9,
    "exclusive": False,
}
_PAPER: dict[str, Any] = {
    "scores": "first",
    "detection_from_scores": "falling",
    "miss_rule": "scaled",
}
_OBJECTS = {"score_model": ScoreModel, "kinds": Kinds, "levels": Levels, "visibility": Visibility}
_CHOICES = {
    "scores": ("ignore", "first", "everywhere", "lasting"),
    "detection_from_scores": ("off", "rising", "falling"),
    "miss_rule": ("bayes", "scaled"),
}
_PROBABILITY = (0.0, 1.0, False, False)
_POSITIVE = (0.0, np.inf, True, True)
_NOT_NEGATIVE = (0.0, np.inf, False, True)
_COUNT = (1, np.inf, False, True)
_BOUNDS: dict[str, tuple[float, float, bool, bool]] = {
    "survival": _PROBABILITY,
    "survival_interval": _POSITIVE,
    "spectral_density": _NOT_NEGATIVE,
    "measurement_sd": _POSITIVE,
    "detection_probability": _PROBABILITY,
    "clutter_rate": _NOT_NEGATIVE,
    "detection_low": _PROBABILITY,
    "detection_high": _PROBABILITY,
    "newest_score": (0.0, 1.0, True, False),
    "newest_box": (0.0, 1.0, True, False),
    "birth_rate": _NOT_NEGATIVE,
    "initial_objects": _NOT_NEGATIVE,
    "birth_components": _COUNT,
    "birth_speed_sd": _POSITIVE,
    "undetected_detail": (1.0, 4.0, False, False),
    "gate": _POSITIVE,
    "max_hypotheses": _COUNT,
    "prune_hypothesis": (0.0, 1.0, False, True),
    "recycle_below": _PROBABILITY,
    "prune_undetected": _NOT_NEGATIVE,
    "merge_undetected": _NOT_NEGATIVE,
    "max_tracks": _COUNT,
    "max_undetected": _COUNT,
    "split_below": _NOT_NEGATIVE,
    "report_above": _PROBABILITY,
    "keep_above": _PROBABILITY,
    "history": (1, np.inf, False, True),
}


def _check(name: str, value: Any, kind: type) -> None:
    """A number where a number belongs (ints may stand for floats), never NaN."""
    allowed: tuple[type, ...] = {
        float: (int, float, np.integer, np.floating),
        int: (int, np.integer),
        bool: (bool, np.bool_),
    }.get(kind, (object,))
    if allowed == (object,):
        return
    is_bool = isinstance(value, bool | np.bool_)
    if not isinstance(value, allowed) or is_bool != (kind is bool) or value != value:
        what = {float: "a number", int: "a whole number", bool: "true or false"}[kind]
        raise InputError("PMBM configuration", field=name, expected=what, got=value)
