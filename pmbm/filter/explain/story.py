"""A track's life in plain words: births, detections, misses, doubts, reports, recycling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from pmbm.errors import InputError
from pmbm.filter.density import MISSED
from pmbm.filter.explain.inspection import IN_THE_OPEN, OCCLUDER, Inspection
from pmbm.types import Detections, Label, Tracks

_NAMED = 20
"""Ids that an error lists before it says how many more there are."""
_RIVAL = 0.1
"""An explanation of a step is worth telling above this probability."""


@dataclass(frozen=True, kw_only=True)
class _Moment:
    """The changes that one step made to the track.

    what : "born", "detected", "missed" or "gone".  existence : before (predicted) and after.
    why : of a miss, what stood in the way, as far as is known.
    rivals : (probability, explanation) of the step, the likeliest first.
    """

    time: float
    what: str
    existence: tuple[float, float]
    reported: bool
    detection: float = 0.0
    why: str = ""
    rivals: tuple[tuple[float, str], ...] = ()
    detail: str = ""


def tell(
    track_id: int,
    inspections: Sequence[Inspection],
    steps: Sequence[Tracks],
    detections: Sequence[Detections],
    *,
    recycle_below: float,
) -> str:
    """The life of a track, a line for each stretch of steps alike, and why it is or is not
    reported at the end.

    inspections, steps, detections : of every step from the first on, the tracker keeping at least
        one step of association history.  recycle_below : the tracker's threshold, to tell tracks
        that were recycled from those whose hypotheses lost.

    Raises InputError, naming the ids that there were, where no step knew the track.
    """
    moments = [
        moment
        for at in zip(inspections, steps, detections, strict=True)
        if (moment := _moment(track_id, *at, recycle_below)) is not None
    ]
    if not moments:
        raise InputError(
            "no such track", field="track id", got=track_id, hint=_known(inspections, steps)
        )
    lines = [f"Track {track_id}"]
    for _, alike in groupby(moments, key=lambda m: (m.what, m.why, m.reported)):
        lines.append("  " + _stretch(list(alike)))
    lines.append("  " + _ending(track_id, inspections[-1], steps[-1]))
    return "\n".join(lines)


def _moment(
    track_id: int, seen: Inspection, tracks: Tracks, frame: Detections, recycle_below: float
) -> _Moment | None:
    """The changes that the step made to the track, or None where the density does not hold it."""
    looked = seen.sensor_view
    at = np.flatnonzero(looked.track_id == track_id)
    now = np.flatnonzero(seen.track_id == track_id)
    reported = bool((tracks.id == track_id).any())
    if not len(at) and not len(now):
        return None
    before = float(looked.existence[at[0]]) if len(at) else 0.0
    after = float(seen.existence[now[0]]) if len(now) else 0.0
    rivals = _explanations(seen, int(now[0])) if len(now) else []
    if not len(at):
        return _Moment(
            time=seen.time,
            what="born",
            existence=(0.0, after),
            reported=reported,
            detail=_birth(rivals, frame),
        )
    missing = dict(rivals).get(MISSED, 0.0)
    return _Moment(
        time=seen.time,
        what="gone" if not len(now) else "missed" if missing > 0.5 else "detected",
        existence=(before, after),
        reported=reported,
        detection=float(looked.detection[at[0]]),
        why=_obstacle(seen, int(now[0]), int(looked.hidden_by[at[0]])) if missing > 0.5 else "",
        rivals=tuple((p, _words(taken, frame)) for taken, p in rivals if p >= _RIVAL),
        detail=_parting(float(looked.existence_if_missed[at[0]]), recycle_below),
    )


def _explanations(seen: Inspection, track: int) -> list[tuple[int, float]]:
    """(measurement taken or MISSED, probability given the track) of the last step, likeliest
    first."""
    rows = np.flatnonzero(seen.hypothesis_track == track)
    taken = seen.history[rows, -1]
    share: dict[int, float] = {}
    for measurement, p in zip(taken.tolist(), seen.probability[rows].tolist(), strict=True):
        share[measurement] = share.get(measurement, 0.0) + p
    total = sum(share.values()) or 1.0
    return sorted(((m, p / total) for m, p in share.items()), key=lambda item: -item[1])


def _birth(rivals: Sequence[tuple[int, float]], frame: Detections) -> str:
    taken = next((m for m, _ in rivals if m >= 0), None)
    if taken is None:
        return "taken up again"
    label = Label(int(frame.label[taken])).name.lower()
    x, y = frame.position[taken, :2]
    return (
        f"born from {_words(taken, frame)}, a {label} of score {frame.score[taken]:.2f} "
        f"at ({x:z.1f}, {y:z.1f}) m"
    )


def _words(taken: int, frame: Detections) -> str:
    return "missed" if taken < 0 else f"detection {taken} of {len(frame)}"


def _parting(left: float, recycle_below: float) -> str:
    if left < recycle_below:
        return (
            f"recycled: what is left, {left:.3g}, is below {recycle_below:g} and went back to the "
            "undetected objects"
        )
    return "dropped: every hypothesis that held it became too improbable"


def _stretch(moments: Sequence[_Moment]) -> str:
    """A line about steps of one kind."""
    first, last = moments[0], moments[-1]
    when = f"{first.time:g} s" if first is last else f"{first.time:g} to {last.time:g} s"
    text = first.detail if first.what in ("born", "gone") else first.what
    if len(moments) > 1:
        text += f" {len(moments)} times"
    if first.what == "missed":
        text += f", P_D {_range([m.detection for m in moments])}{first.why}"
    before, after = first.existence[0], last.existence[1]
    if first.what == "born":
        text += f"; exists with {_small(after)}"
    else:
        went = "rises" if after > before else "falls" if after < before else "stays"
        text += f"; existence {went} from {_small(before)} to {_small(after)}"
    doubtful = min(moments, key=lambda m: m.rivals[0][0] if len(m.rivals) > 1 else 1.0)
    if len(doubtful.rivals) > 1:
        options = ", ".join(f"{p:.2f} {words}" for p, words in doubtful.rivals)
        text += f"; at {doubtful.time:g} s hypotheses compete: {options}"
    return f"{when:>14}  {text}{'' if first.reported else '; not reported'}"


def _obstacle(seen: Inspection, track: int, hidden_by: int) -> str:
    if seen.in_view[track] <= 0.5:
        return ", outside the field of view"
    if hidden_by == OCCLUDER:
        return ", hidden behind a static occluder"
    return "" if hidden_by == IN_THE_OPEN else f", hidden behind track {hidden_by}"


def _small(probability: float) -> str:
    return f"{probability:.3f}" if probability == 0 or probability >= 5e-4 else f"{probability:.1e}"


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.2f}", f"{max(values):.2f}"
    return low if low == high else f"{low} to {high}"


def _ending(track_id: int, seen: Inspection, tracks: Tracks) -> str:
    """Whether it is reported at the end, and why."""
    head = f"At {seen.time:g} s it is"
    if (tracks.id == track_id).any():
        return "\n  ".join([f"{head} reported.", *seen.story(track_id).splitlines()])
    now = np.flatnonzero(seen.track_id == track_id)
    if not len(now):
        return f"{head} not reported: it is not in the tracker's mind any more."
    track = int(now[0])
    reasons = []
    if seen.object[track] <= seen.report_above:
        reasons.append(
            f"the probability that it exists and is no persistent clutter, "
            f"{seen.object[track]:.3f}, is not above {seen.report_above:g}"
        )
    if seen.in_view[track] <= 0.5:
        reasons.append(
            f"it is probably outside the field of view (inside with {seen.in_view[track]:.2f})"
        )
    if not reasons:
        reasons.append("another track is reported at its place")
    return f"{head} not reported: {' and '.join(reasons)}."


def _known(inspections: Sequence[Inspection], steps: Sequence[Tracks]) -> str:
    reported = sorted({int(i) for tracks in steps for i in tracks.id})
    doubtful = sorted({int(i) for seen in inspections for i in seen.track_id} - set(reported))
    return f"reported were {_listed(reported)}; never reported were {_listed(doubtful)}"


def _listed(ids: Sequence[int]) -> str:
    more = f" and {len(ids) - _NAMED} more" if len(ids) > _NAMED else ""
    return (", ".join(map(str, ids[:_NAMED])) or "none") + more
