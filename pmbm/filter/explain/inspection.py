"""Why the tracker says what it says: its hypotheses, told per track."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.density import BEFORE, MISSED, Density, Index, Locals, summed
from pmbm.filter.estimation import Marginals, marginals
from pmbm.filter.models.sensor import ObservationModel
from pmbm.filter.reduction import ReductionStats
from pmbm.geometry import corners
from pmbm.types import FloatArray, IntArray
from pmbm.wording import counted

IN_THE_OPEN = -1
"""In `SensorView.hidden_by`: nothing stands before the object."""
OCCLUDER = -2
"""In `SensorView.hidden_by`: a static occluder of the site does."""
_CLEARLY_VISIBLE = 0.9


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorView:
    """The visibility of the B tracks that were known before the last frame.

    track_id (B,), existence (B,) : as predicted, over all hypotheses.
    detection (B,) : P_D, if the object exists.  visible (B,) : its expected visible share.
    existence_if_missed (B,) : what a miss leaves of the existence.
    hidden_by (B,) : id of the track that hides most of it, `OCCLUDER` or `IN_THE_OPEN`.
    """

    track_id: IntArray
    existence: FloatArray
    detection: FloatArray
    visible: FloatArray
    existence_if_missed: FloatArray
    hidden_by: IntArray

    def __repr__(self) -> str:
        return f"SensorView({counted(len(self.track_id), 'track')})"


@dataclass(frozen=True, eq=False, kw_only=True)
class Inspection:
    """The tracker's mind after one step: T tracks, reported or not, and their H hypotheses.

    time : s.
    expected_undetected : expected number of objects in view that were never detected so far; tracks
        that were given up are not among them.
    track_id (T,), existence (T,) : probability that the object exists, over all hypotheses.
    object (T,) : that it exists and is no persistent clutter.
    in_view (T,) : that it is where the sensor looks.
    record (T,R) : what its detections said (`Scores`).  distance (T,) : m, from the sensor.
    report_above : what `object` must exceed for the track to be reported.
    cluster (T,) : tracks of one cluster depend on each other.
    hypothesis_track (H,) : row of the track table.  probability (H,) : of the hypothesis; those of
        a track add up to the probability that it was not clutter from the start or another's.
    hypothesis_existence (H,), mean (H,4), cov (H,4,4) : of the object, if the hypothesis holds.
    history (H,L) : measurement taken at each of the last L steps, `MISSED` or `BEFORE`.
    sensor_view : what the sensor could see of the tracks, before the frame was taken in.
    reduced : what the last step removed.
    seconds : what each part of the last step took (never part of a result).
    """

    time: float
    expected_undetected: float
    track_id: IntArray
    existence: FloatArray
    object: FloatArray
    in_view: FloatArray
    record: FloatArray
    distance: FloatArray
    report_above: float
    cluster: Index
    hypothesis_track: Index
    probability: FloatArray
    hypothesis_existence: FloatArray
    mean: FloatArray
    cov: FloatArray
    history: NDArray[np.int32]
    sensor_view: SensorView
    reduced: ReductionStats
    seconds: Mapping[str, float]

    def __repr__(self) -> str:
        return (
            f"Inspection({counted(len(self.track_id), 'track')} at {self.time:g} s, "
            f"{counted(len(self.probability), 'hypothesis', 'hypotheses')}, "
            f"{self.expected_undetected:.3g} undetected objects)"
        )

    def story(self, track_id: int) -> str:
        """One track in plain words, its likeliest hypotheses first.

        An id that the tracker does not know (any more) gives a sentence that says so.
        """
        found = np.flatnonzero(self.track_id == track_id)
        if not len(found):
            return f"Track {track_id} is not in the tracker's mind at t = {self.time:g} s."
        track = int(found[0])
        company = int((self.cluster == self.cluster[track]).sum()) - 1
        others = f"{company} other track{'' if company == 1 else 's'}"
        rows = np.flatnonzero(self.hypothesis_track == track)
        told: dict[str, float] = {}
        # Hypotheses that differ further back than is kept, or in other tracks, read alike.
        for row in rows[np.argsort(-self.probability[rows], kind="stable")].tolist():
            x, y, vx, vy = self.mean[row]
            line = (
                f"at ({x:z.1f}, {y:z.1f}) m, moving ({vx:z.1f}, {vy:z.1f}) m/s, exists with "
                f"{self.hypothesis_existence[row]:.3f}{_told(self.history[row])}"
            )
            told[line] = told.get(line, 0.0) + self.probability[row]
        lines = [
            f"Track {track_id} at t = {self.time:g} s exists with probability "
            f"{self.existence[track]:.3f}; its cluster holds {others}."
        ]
        lines += [f"  {p:.3f}: {line}" for line, p in told.items()]
        return "\n".join(lines)


def _told(history: NDArray[np.int32]) -> str:
    steps = [int(one) for one in history if one != BEFORE]
    if not steps:
        return ""
    words = ["missed" if one == MISSED else f"took {one}" for one in steps]
    return "; last steps: " + ", ".join(words)


def inspect(
    density: Density,
    marginal: Marginals,
    objects: FloatArray,
    predicted: Density,
    sensor: ObservationModel,
    occluders: Sequence[FloatArray],
    *,
    distance: FloatArray,
    time: float,
    report_above: float,
    reduced: ReductionStats,
    seconds: Mapping[str, float],
) -> Inspection:
    """The tables of a density, track by track, and of what was predicted before it.

    objects (T,) : the probability of each track to exist and be an object.
    distance (T,) : m, of each from the sensor.
    """
    local, table = density.local, density.hypotheses
    cluster = np.zeros(len(density.track_id), np.intp)
    cluster[local.track[table.member]] = np.repeat(table.cluster, np.diff(table.start))
    best, undetected = local.take(marginal.best), density.undetected
    unseen = sensor.share_in_view(undetected.mean, undetected.cov)
    return Inspection(
        time=time,
        expected_undetected=float(undetected.never_detected() @ unseen),
        track_id=density.track_id,
        existence=marginal.existence,
        object=objects,
        in_view=sensor.share_in_view(best.mean, best.cov),
        record=best.record,
        distance=distance,
        report_above=report_above,
        cluster=cluster,
        hypothesis_track=local.track,
        probability=density.hypothesis_probability(),
        hypothesis_existence=local.existence,
        mean=local.mean,
        cov=local.cov,
        history=local.history,
        sensor_view=_sensor_view(predicted, sensor, occluders),
        reduced=reduced,
        seconds=dict(seconds),
    )


def _sensor_view(
    predicted: Density, sensor: ObservationModel, occluders: Sequence[FloatArray]
) -> SensorView:
    local, tracks = predicted.local, len(predicted.track_id)
    marginal = marginals(predicted)
    mass = predicted.hypothesis_probability() * local.existence
    total = np.maximum(summed(mass, local.track, tracks), np.finfo(float).tiny)

    def averaged(value: FloatArray) -> FloatArray:
        return summed(mass * value, local.track, tracks) / total

    P_D = sensor.of_tracks(local)[0]
    share = np.ones(len(local)) if sensor.shadows is None else sensor.shadows.visible_share(local)
    visible = averaged(share)
    left, _ = sensor.missed(local.existence, P_D)
    hidden_by = np.full(tracks, IN_THE_OPEN, np.int64)
    hidden = np.flatnonzero(visible < _CLEARLY_VISIBLE)
    if sensor.shadows is not None and len(hidden):
        hidden_by[hidden] = _hiders(
            sensor.shadows.origin,
            local.take(marginal.best),
            hidden,
            np.concatenate([marginal.existence, np.ones(len(occluders))]),
            predicted.track_id,
            occluders,
        )
    return SensorView(
        track_id=predicted.track_id,
        existence=marginal.existence,
        detection=averaged(P_D),
        visible=visible,
        existence_if_missed=summed(predicted.hypothesis_probability() * left, local.track, tracks),
        hidden_by=hidden_by,
    )


def _hiders(
    origin: FloatArray,
    best: Locals,
    hidden: Index,
    existence: FloatArray,
    track_id: IntArray,
    occluders: Sequence[FloatArray],
) -> IntArray:
    """The track that hides most lines of sight to the box of each hidden track.

    A name for people to read; how much is hidden is the filter's own reckoning.
    """
    import shapely

    outline = corners(best.mean[:, :2], best.box[:, 1:4], best.box[:, 4])
    ends = np.concatenate([outline, best.mean[:, None, :2]], axis=1)[hidden].reshape(-1, 2)
    sight = shapely.linestrings(np.stack([np.broadcast_to(origin, ends.shape), ends], axis=1))
    bodies = np.array([shapely.Polygon(one) for one in [*outline, *occluders]])
    line, body = shapely.STRtree(bodies).query(sight, predicate="intersects")
    target = hidden[line // (outline.shape[1] + 1)]
    around = shapely.intersects_xy(bodies, *origin)
    hides = (target != body) & ~around[body]
    pair, which = np.unique(target[hides] * len(bodies) + body[hides], return_inverse=True)
    in_the_way = np.bincount(which, existence[body[hides]], minlength=len(pair))
    # The last to be written, for each target, is the one most in the way.
    pair = pair[np.argsort(in_the_way, kind="stable")]
    name = np.concatenate([track_id, np.full(len(occluders), OCCLUDER)])
    found = np.full(len(best), IN_THE_OPEN, np.int64)
    found[pair // len(bodies)] = name[pair % len(bodies)]
    return found[hidden]
