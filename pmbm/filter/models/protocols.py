"""The protocols of the model's parts, and their members by name.

Letters of the shapes: D = `STATE`, the size of a state [x, y, vx, vy]; H local hypotheses (or rows
of them); M measurements; N Gaussians; K classes of sources that scores tell apart, 1 where none.

A new member is one file with a frozen dataclass, and one line below, whose name a file writes as
`kind`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from pmbm.errors import InputError, nearest_hint
from pmbm.types import Detections, FloatArray, Site

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pmbm.filter.density import Marks, Mixture
    from pmbm.filter.models.motion import Survival
    from pmbm.filter.models.scores import ScoredDetections
    from pmbm.filter.models.view import View


@dataclass(frozen=True)
class Members:
    """The members of a protocol, by the names that files have for them.

    homes : kind -> MODULE:CLASS.
    """

    homes: Mapping[str, str]

    def of_kind(self, kind: object) -> type:
        """The class of a kind.

        Raises InputError with the nearest valid name.
        """
        home = self.homes.get(kind) if isinstance(kind, str) else None
        if home is None:
            raise InputError(
                "unknown kind", field="kind", got=kind, hint=nearest_hint(kind, self.homes, "kind")
            )
        module, _, name = home.partition(":")
        found: type = getattr(importlib.import_module(f"pmbm.filter.models.{module}"), name)
        return found

    def kind_of(self, member: object) -> str | None:
        """The kind of a member, or None where it has no name in files."""
        for kind, home in self.homes.items():
            if home.partition(":")[2] == type(member).__name__:
                return kind
        return None


@runtime_checkable
class Motion(Protocol):
    """A motion model of single objects."""

    def transition(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """F (D,D) and Q (D,D) over `dt` seconds."""


@runtime_checkable
class Birth(Protocol):
    """A birth model, and the detail in which undetected objects are kept.

    A birth model may remember something from frame to frame (`memory`, None before the first).
    """

    @property
    def place_by_place(self) -> bool:
        """Whether undetected objects are kept in components so narrow that what hides one of them
        can be told; otherwise nothing hides them."""

    def births(
        self, site: Site, view: View, dt: float | None, survival: Survival, memory: Any
    ) -> tuple[Mixture, Any]:
        """Objects that appeared during `dt` seconds and are alive, and the memory after it; `dt`
        None, those in view before the first frame."""

    def joined(self, survivors: Mixture, births: Mixture) -> Mixture:
        """The undetected objects that lived on, and those that were born."""

    def reduced(
        self, predicted: Mixture, view: View, survival: Survival, memory: Any, prune: float
    ) -> tuple[Mixture, float]:
        """The predicted mixture in the detail that it is kept in, and the expected number of
        objects that this dropped; `prune` : the reduction's weight of what may be dropped."""

    def thresholds(self, prune: float) -> tuple[float, float]:
        """Of box 4: the weight up to which components are pruned, where the reduction's is `prune`,
        and the squared Mahalanobis distance below which they are merged; 0 is never."""


@runtime_checkable
class Detection(Protocol):
    """A model of P_D, the probability that an object in view is detected where nothing hides it."""

    def of_undetected(self) -> float:
        """P_D of objects that were never detected."""

    def of_tracks(self, marks: Marks) -> FloatArray:
        """P_D (H,) of local hypotheses."""

    def confidence(self, detections: Detections) -> FloatArray:
        """(M,) what a track may remember of each detection."""

    def predicted(self, marks: Marks, dt: float) -> Marks:
        """Marks `dt` seconds later."""

    def if_missed(self, marks: Marks, P_D: FloatArray) -> Marks:
        """Marks of objects that were missed, whose P_D (H,) was this."""

    def if_detected(self, marks: Marks, confidence: FloatArray) -> Marks:
        """Marks of objects that were detected, with the confidence (H,) of the detections."""

    def first(self, source: FloatArray, confidence: FloatArray) -> Marks:
        """Marks of objects detected for the first time, whose classes are `source` (H,K)."""

    def never_detected(self, source: FloatArray) -> Marks:
        """Marks of objects of these classes (H,K) that this sensor has not detected yet, but
        another has."""


@runtime_checkable
class Scores(Protocol):
    """A model of the scores and labels of detections, given their sources (Sec. 2.6)."""

    @property
    def classes(self) -> int:
        """K."""

    @property
    def needs_all_labels(self) -> bool:
        """Whether detections of other labels than the tracker's own are to be handed over."""

    def read(self, detections: Detections, scene: SceneDensity) -> ScoredDetections:
        """The detections that may come from the tracker's objects, and what they say."""

    @property
    def steady(self) -> bool:
        """Whether P(class) and records stay as they are from one frame to the next."""

    def predicted(self, source: FloatArray, dt: float) -> FloatArray:
        """P(class) (H,K) `dt` seconds later."""

    @property
    def sums(self) -> int:
        """R, the running sums of a source's record."""

    def aged(self, record: FloatArray, dt: float) -> FloatArray:
        """Records (H,R) at the next frame, `dt` seconds later, before its detections add."""

    def object_share(self, scene: SceneDensity) -> FloatArray:
        """P(object | class) (K,) in this scene."""

    def recorded_share(self, record: FloatArray, distance: FloatArray) -> FloatArray:
        """P(object | record) (T,) of sources with these records (T,R), seen from these distances
        (T,), m; 1 where records say nothing."""

    def share_by_life(
        self, record: FloatArray, distance: FloatArray, time: FloatArray
    ) -> FloatArray | None:
        """P(object) (n,) at each step of a source's life, by all of it: its records (n,R),
        distances (n,), m, and times (n,), s.  None where P(object) at the last detection has the
        evidence of all before it."""

    def observed(
        self, scene: SceneDensity, in_view: Callable[[FloatArray], float], dt: float
    ) -> SceneDensity:
        """The scene after `dt` seconds; `in_view` : the expected number of objects in view at their
        end, given P(object) (K,) of a source of each class."""

    def labels(self, last: NDArray[np.int8], source: FloatArray) -> NDArray[np.int8]:
        """(H,) the likeliest labels of sources of these classes (H,K), whose last detections had
        the labels `last` (H,)."""


@dataclass(frozen=True, slots=True)
class SceneDensity:
    """How many objects a scene has held: s of looking, and the expected number of objects in view
    summed over that time, s."""

    looked: float = 0.0
    objects: float = 0.0

    def after(self, dt: float, number: float, longest: float) -> SceneDensity:
        """With `number` objects in view for `dt` more seconds; of what is older than `longest`
        seconds a share is forgotten."""
        looked = self.looked + dt
        kept = min(1.0, longest / looked) if looked > 0 else 1.0
        return SceneDensity(kept * looked, kept * (self.objects + number * dt))

    def abundance(self, mean_objects: float, prior_seconds: float) -> float:
        """The scene's expected number of objects in view over `mean_objects`: the mean of its gamma
        distribution."""
        return (prior_seconds + self.objects / mean_objects) / (prior_seconds + self.looked)


MOTIONS = Members({"constant_velocity": "motion:ConstantVelocity"})
BIRTHS = Members({"broad": "birth:BroadBirth", "map": "birth_map:BirthMap"})
DETECTIONS = Members(
    {
        "fixed": "detection:FixedDetection",
        "from_scores": "detection:DetectionFromScores",
        "chain": "detection:DetectionChain",
    }
)
SCORES = Members(
    {
        "ignore": "scores:IgnoreScores",
        "first": "scores:FirstScore",
        "every": "scores:EveryScore",
        "lasting": "score_levels:LastingScores",
        "levels": "score_levels:ScoreLevels",
        "classes": "object_classes:ObjectClasses",
        "record": "score_record:ScoreRecord",
    }
)
