"""The tracker that the suite is about, and five that are broken in one way each.

A broken tracker is the sound one behind a wrapper, so that nothing differs but its fault.
"""

import dataclasses

import numpy as np

from pmbm import PMBMConfig, PMBMTracker
from pmbm.filter import EveryScore, IgnoreScores

EARLY = 4.0
"""Seconds in which even a tracker that never births finds the objects that are there."""
FORGETS_AFTER = 1.5
"""Seconds without a detection nearby."""
MEETING = 6.0
"""Metres between two tracks that meet."""
CROSSING = np.sin(np.deg2rad(15))
"""Sine of the angle between two paths that cross; traffic side by side does not."""
NEAR = 3.0
"""Metres from a track to a detection that may be its own."""


def sound(site):
    """PMBM with the detector's confidence taken into account."""
    return PMBMTracker(PMBMConfig(scores=EveryScore()), site)


class NeverBirths:
    """Follows what is there in the first seconds, and nothing that comes later."""

    def __init__(self, site):
        self.inner = sound(site)
        self.known = set()
        self.start = None

    def step(self, detections):
        tracks = self.inner.step(detections)
        if self.start is None:
            self.start = detections.time
        if detections.time - self.start <= EARLY:
            self.known.update(tracks.id.tolist())
        return tracks.take([i in self.known for i in tracks.id.tolist()])


class NeverDies:
    """Goes on reporting every track that ended, where it would be by now."""

    def __init__(self, site):
        self.inner = sound(site)
        self.last = {}

    def step(self, detections):
        tracks = self.inner.step(detections)
        for row in range(len(tracks)):
            self.last[int(tracks.id[row])] = (tracks.take([row]), detections.time)
        ghosts = [
            (old, detections.time - then)
            for identity, (old, then) in self.last.items()
            if identity not in tracks.id
        ]
        return joined(tracks, [coasted(old, seconds) for old, seconds in ghosts])


class ForgetsWhenHidden:
    """Drops a track that has had no detection nearby for a while; the same object gets a new
    id when it is seen again."""

    def __init__(self, site):
        self.inner = sound(site)
        self.seen = {}
        self.names = {}
        self.fresh = 10_000_000

    def step(self, detections):
        tracks = self.inner.step(detections)
        keep, names = [], []
        for row, identity in enumerate(tracks.id.tolist()):
            if len(detections):
                offset = detections.position[:, :2] - tracks.position[row, :2]
                if np.hypot(*offset.T).min() < NEAR:
                    last = self.seen.get(identity, detections.time)
                    if detections.time - last > FORGETS_AFTER:
                        self.fresh += 1
                        self.names[identity] = self.fresh
                    self.seen[identity] = detections.time
            self.seen.setdefault(identity, detections.time)
            keep.append(detections.time - self.seen[identity] <= FORGETS_AFTER)
            names.append(self.names.get(identity, identity))
        return renamed(tracks, names).take(keep)


class SwapsAtCrossings:
    """Exchanges the ids of two tracks whose paths cross while they are near."""

    def __init__(self, site):
        self.inner = sound(site)
        self.names = {}
        self.met = set()

    def step(self, detections):
        tracks = self.inner.step(detections)
        ids = tracks.id.tolist()
        for a in range(len(ids)):
            for b in range(a):
                pair = frozenset((ids[a], ids[b]))
                if pair not in self.met and crossing(tracks, a, b):
                    self.met.add(pair)
                    one, other = self.name(ids[a]), self.name(ids[b])
                    self.names[ids[a]], self.names[ids[b]] = other, one
        return renamed(tracks, [self.name(identity) for identity in ids])

    def name(self, identity):
        return self.names.get(identity, identity)


class IgnoresTheScore:
    """Takes every box for as good as any other."""

    def __init__(self, site):
        self.inner = PMBMTracker(PMBMConfig(scores=IgnoreScores()), site)

    def step(self, detections):
        return self.inner.step(detections)


def crossing(tracks, a, b):
    """Whether two tracks are near each other on paths that cross."""
    if np.hypot(*(tracks.position[a] - tracks.position[b])[:2]) > MEETING:
        return False
    u, v = tracks.velocity[a], tracks.velocity[b]
    speeds = np.hypot(*u) * np.hypot(*v)
    return speeds > 1.0 and abs(u[0] * v[1] - u[1] * v[0]) > CROSSING * speeds


def renamed(tracks, names):
    """The same tracks under other ids."""
    return dataclasses.replace(tracks, id=np.array(names, dtype=np.int64))


def coasted(track, seconds):
    """A single track, moved on at its speed."""
    moved = track.position.copy()
    moved[:, :2] += seconds * track.velocity
    return dataclasses.replace(track, position=moved, covariance=None, undetected=None)


def joined(tracks, others):
    """Tracks and further single ones, as one report."""
    if not others:
        return tracks
    parts = [dataclasses.replace(tracks, covariance=None, undetected=None), *others]
    columns = ("id", "position", "size", "yaw", "velocity", "score", "label")
    return dataclasses.replace(
        parts[0], **{name: np.concatenate([getattr(p, name) for p in parts]) for name in columns}
    )
