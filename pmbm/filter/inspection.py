"""Why the tracker says what it says: its hypotheses, told per track."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.density import BEFORE, MISSED, Density, Index
from pmbm.filter.estimation import marginals
from pmbm.filter.reduction import Reduced
from pmbm.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False, kw_only=True)
class Inspection:
    """The tracker's mind after one step: T tracks, reported or not, and their H hypotheses.

    time : s.  expected_undetected : expected number of objects never detected so far.
    track_id (T,), existence (T,) : probability that the object exists, over all hypotheses.
    cluster (T,) : tracks of one cluster depend on each other.
    hypothesis_track (H,) : row of the track table.  probability (H,) : of the hypothesis; those of
        a track add up to the probability that it was not clutter from the start or another's.
    hypothesis_existence (H,), mean (H,4), cov (H,4,4) : of the object, if the hypothesis holds.
    history (H,L) : measurement taken at each of the last L steps, `MISSED` or `BEFORE`.
    reduced : what the last step removed.
    seconds : what each part of the last step took (never part of a result).
    """

    time: float
    expected_undetected: float
    track_id: IntArray
    existence: FloatArray
    cluster: Index
    hypothesis_track: Index
    probability: FloatArray
    hypothesis_existence: FloatArray
    mean: FloatArray
    cov: FloatArray
    history: NDArray[np.int32]
    reduced: Reduced
    seconds: Mapping[str, float]

    def story(self, track_id: int) -> str:
        """One track in plain words, its likeliest hypotheses first.

        An id that the tracker does not know (any more) gives a sentence that says so.
        """
        found = np.flatnonzero(self.track_id == track_id)
        if not len(found):
            return f"Track {track_id} is not in the tracker's mind at t = {self.time:g} s."
        track = int(found[0])
        company = int((self.cluster == self.cluster[track]).sum()) - 1
        lines = [
            f"Track {track_id} at t = {self.time:g} s exists with probability "
            f"{self.existence[track]:.3f}; it depends on {company} other tracks."
        ]
        rows = np.flatnonzero(self.hypothesis_track == track)
        for row in rows[np.argsort(-self.probability[rows], kind="stable")].tolist():
            x, y, vx, vy = self.mean[row]
            lines.append(
                f"  {self.probability[row]:.3f}: at ({x:.1f}, {y:.1f}) m, moving "
                f"({vx:.1f}, {vy:.1f}) m/s, exists with {self.hypothesis_existence[row]:.3f}"
                f"{_told(self.history[row])}"
            )
        return "\n".join(lines)


def _told(history: NDArray[np.int32]) -> str:
    steps = [int(one) for one in history if one != BEFORE]
    if not steps:
        return ""
    words = ["missed" if one == MISSED else f"took {one}" for one in steps]
    return "; last steps: " + ", ".join(words)


def inspect(
    density: Density, time: float, reduced: Reduced, seconds: Mapping[str, float]
) -> Inspection:
    """The tables of a density, track by track."""
    local, table = density.local, density.hypotheses
    cluster = np.zeros(len(density.track_id), np.intp)
    cluster[local.track[table.member]] = np.repeat(table.cluster, np.diff(table.start))
    return Inspection(
        time=time,
        expected_undetected=float(np.exp(density.undetected.log_weight).sum()),
        track_id=density.track_id,
        existence=marginals(density).existence,
        cluster=cluster,
        hypothesis_track=local.track,
        probability=density.hypothesis_probability(),
        hypothesis_existence=local.existence,
        mean=local.mean,
        cov=local.cov,
        history=local.history,
        reduced=reduced,
        seconds=dict(seconds),
    )
