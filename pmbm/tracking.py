"""The tracker protocol, and running a tracker over a recording."""

from __future__ import annotations

import functools
import inspect
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pmbm.errors import InputError, Verbatim, nearest_hint
from pmbm.external.program import EXEC, program_hint, program_named
from pmbm.named_modules import import_named, missing_hint
from pmbm.seeding import seeded
from pmbm.types import Detections, Label, Recording, Site, Tracks, TrackSequence


@runtime_checkable
class Tracker(Protocol):
    """Anything with `step`: called once per delivery of detections, empty ones too, in order of
    time.  A fresh tracker is made for every recording, so there is nothing to reset."""

    def step(self, detections: Detections, /) -> Tracks: ...


TrackerFactory = Callable[..., Tracker]
"""Makes a fresh tracker; one that takes a parameter `site` is given the recording's, and one that
takes `seed` a whole number that differs from trial to trial."""

_AT_A_TRACK = 5.0
"""m from a track within which a detection that tells no class is taken for its."""
_SAME_TIME = 1e-6
"""s by which a report's time may differ from that of its detections: rounding."""

SHIPPED_TRACKERS = {
    "pmbm": "pmbm.filter:PMBMTracker",
    "pmbm-textbook": "pmbm.filter:PMBMTracker.textbook",
    "pmbm-paper": "pmbm.filter:PMBMTracker.paper",
    "argoverse": "pmbm.baselines:ArgoverseTracker",
    "waymo": "pmbm.baselines:WaymoTracker",
    "probabilistic_kf": "pmbm.baselines:ProbabilisticKFTracker",
}
"""Names that commands and study files may use; any other tracker is named MODULE:FACTORY, or
exec:COMMAND where it is a program."""


SHIPPED_BOUNDS = {"clairvoyant": "pmbm.baselines:clairvoyant"}
"""Names of what bounds every tracker, for wherever whole recordings are tracked."""


@dataclass(frozen=True)
class Bound:
    """What no tracker is expected to beat: its `tracks` are made from a whole recording, truth and
    origins included, which `run` keeps from trackers.  As a factory it refuses: there is nothing to
    step."""

    tracks: Callable[..., TrackSequence]

    def __call__(self) -> Tracker:
        raise InputError(
            "a bound reads the truth: it runs in studies, `pmbm run` and `pmbm compare` only",
            expected="a tracker",
        )


def tracker_factory(name: str) -> TrackerFactory:
    """The factory behind a shipped name, MODULE:FACTORY or exec:COMMAND; of a bound's name, the
    bound.

    Raises InputError, with the nearest valid name, where there is none.
    """
    if name.startswith(EXEC):
        return program_named(name)
    home = SHIPPED_BOUNDS.get(name) or SHIPPED_TRACKERS.get(name, name)
    module_name, _, attribute = home.partition(":")
    if not attribute:
        raise InputError(
            f"no tracker '{name}'",
            expected="a shipped tracker, MODULE:FACTORY or exec:COMMAND",
            hint=program_hint(name) or nearest_hint(name, SHIPPED_TRACKERS, "tracker"),
        )
    try:
        factory: Any = import_named(module_name)
        for part in attribute.split("."):
            factory = getattr(factory, part)
    except (ImportError, AttributeError) as error:
        hint = program_hint(name) or missing_hint(error, module_name)
        raise InputError(f"tracker '{name}' cannot be imported: {error}", hint=hint) from error
    if not callable(factory):
        raise InputError(f"tracker '{name}'", expected="a factory", got=type(factory).__name__)
    return Bound(factory) if name in SHIPPED_BOUNDS else factory


def make_tracker(factory: TrackerFactory, site: Site, seed: int = 0) -> Tracker:
    """A fresh tracker for one recording; the factory gets `site` and `seed` where it takes them and
    no `functools.partial` has set them."""
    try:
        takes = set(inspect.signature(factory).parameters)
    except (TypeError, ValueError):
        takes = set()
    if isinstance(factory, functools.partial):
        takes -= set(factory.keywords)
    offered = {"site": site, "seed": seed}
    return factory(**{name: value for name, value in offered.items() if name in takes})


class ByLabel:
    """A tracker of its own for every label, run side by side; reports are joined under new ids.

    factories : label -> factory of its tracker; detections of other labels are not looked at.
    site, seed : handed to the factories that take them.

    For detectors whose classes do not compete, and for parameters that differ between classes.

    Of several sensors, one that tells no classes (a radar) adds to what others have found: each of
    its boxes goes to the tracker that reported the nearest track, within 5 m; none begins a track.
    """

    def __init__(
        self, factories: Mapping[Label, TrackerFactory], site: Site | None = None, seed: int = 0
    ) -> None:
        site = site or Site()
        self.trackers = {
            Label(label): make_tracker(factory, site, seed) for label, factory in factories.items()
        }
        self._ids: dict[tuple[Label, int], int] = {}
        self._reports: list[tuple[Label, Tracks]] = []

    def step(self, detections: Detections, /) -> Tracks:
        """Every tracker sees its own label's detections, or, where it has an attribute
        `takes_all_labels` that says so, all; all that they report, joined.

        Raises InputError where time runs backwards.
        """
        if detections.sensor and (detections.label == Label.OTHER).all():
            detections = self._classed(detections)
        reports = []
        for label, tracker in self.trackers.items():
            tracks = tracker.step(seen_by(tracker, label, detections))
            reports.append((label, tracks))
        self._reports = reports
        names = [(label, i) for label, tracks in reports for i in tracks.id.tolist()]
        ids = [self._ids.setdefault(name, len(self._ids)) for name in names]
        return joined_tracks(detections.time, [tracks for _, tracks in reports], ids)

    def _classed(self, detections: Detections) -> Detections:
        """Detections that tell no classes, with the label whose tracker reported the nearest track
        last; those that lie at none keep theirs."""
        label = detections.label.copy()
        nearest = np.full(len(label), _AT_A_TRACK)
        for each, tracks in self._reports:
            place = tracks.position[:, :2] + (detections.time - tracks.time) * tracks.velocity
            offset = detections.position[:, None, :2] - place
            apart = np.hypot(offset[..., 0], offset[..., 1]).min(axis=1, initial=np.inf)
            label[apart < nearest] = each
            nearest = np.minimum(nearest, apart)
        return replace(detections, label=label)


def seen_by(tracker: Tracker, label: Label, detections: Detections) -> Detections:
    """The detections that the tracker of a label is to be given."""
    if getattr(tracker, "takes_all_labels", False):
        return detections
    return detections.take(detections.label == label)


def joined_tracks(time: float, parts: Sequence[Tracks], ids: Sequence[int]) -> Tracks:
    """The tracks of several reports as one, under these ids; covariances are kept where all give
    them."""
    full = [tracks for tracks in parts if len(tracks)]
    if not full:
        return Tracks.empty(time)
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(tracks, name) for tracks in full])
        for name in ("position", "size", "yaw", "velocity", "score", "label")
    }
    if all(tracks.covariance is not None for tracks in full):
        columns["covariance"] = np.concatenate([tracks.covariance for tracks in full])
    return Tracks(time=time, id=np.array(ids, dtype=np.int64), **columns)


def track(factory: TrackerFactory, recording: Recording, seed: int) -> TrackSequence:
    """The tracks of a fresh tracker over a recording, or those of a bound.

    seed : what `random` and `numpy.random` start from, and what the factory gets where it takes
        one, see `tracker_seed`: equal seeds give equal tracks, whatever ran before.

    Raises InputError as `run` does.
    """
    with seeded(seed):
        if isinstance(factory, Bound):
            return factory.tracks(recording)
        return run(make_tracker(factory, recording.site, seed), recording)


def run(tracker: Tracker, recording: Recording, *, record: bool = False) -> TrackSequence:
    """Step `tracker` through the deliveries of `recording`.

    A delivery older than the last step (a late frame) is dropped and counted; those of several
    sensors come as `Recording.handed_over` has them, and of several steps in one frame the last
    report counts.  The tracker is handed `Detections` alone: truth and origins are out of its
    reach.  With `record=True` what its `inspect()` gives after each step is kept.

    Raises InputError where the tracker has no `step`, or gives something that is not `Tracks` or
    not of the detections' time, and names the frame in one that `step` raises.
    """
    if not callable(getattr(tracker, "step", None)):
        raise InputError(
            "not a tracker",
            expected="an object with step(detections) -> Tracks",
            got=type(tracker).__name__,
        )
    steps: dict[int, Tracks] = {}
    seconds: dict[int, float] = {}
    inspections: dict[int, Any] = {}
    given = recording.handed_over().tolist()
    for delivery in given:
        detections, frame = recording.detections[delivery], int(recording.frame[delivery])
        start = time.process_time()
        try:
            tracks = tracker.step(detections)
        except InputError as error:
            raise error.located(frame=frame) from error
        # A tracker that runs in another process says what its step took there.
        elsewhere = getattr(tracker, "step_seconds", None)
        taken = time.process_time() - start if elsewhere is None else elsewhere
        seconds[frame] = seconds.get(frame, 0.0) + taken
        if not isinstance(tracks, Tracks):
            raise InputError(
                f"{type(tracker).__name__}.step returned something else than Tracks",
                frame=frame,
                expected="pmbm.Tracks",
                got=type(tracks).__name__,
            )
        if not abs(tracks.time - detections.time) <= _SAME_TIME:
            raise InputError(
                f"{type(tracker).__name__}.step returned tracks of another time",
                frame=frame,
                field="time",
                expected=f"that of the detections, {detections.time:g} s",
                got=Verbatim(f"{tracks.time:g} s"),
            )
        steps[frame] = tracks
        if record and hasattr(tracker, "inspect"):
            inspections[frame] = tracker.inspect()
    return TrackSequence(
        steps=tuple(steps.values()),
        frame=np.array(list(steps), dtype=np.int64),
        seconds=np.array(list(seconds.values())),
        dropped=len(recording.detections) - len(given),
        inspections=tuple(inspections.values()) if inspections else None,
    )
