"""A tracker in forty lines: each detection goes to the nearest track of the frame before."""

import numpy as np

from pmbm import Tracks

GATE = 4.0
"""Metres."""
PATIENCE = 1.0
"""Seconds that a track lives without a detection."""


class NearestTracker:
    def __init__(self):
        self.time = None
        self.next_id = 0
        self.tracks = {}  # id -> [row of detections, position, velocity, time last seen, hits]

    def step(self, detections):
        dt = 0.0 if self.time is None else detections.time - self.time
        self.time = detections.time
        for track in self.tracks.values():
            track["position"] = track["position"] + dt * track["velocity"]
        for row in np.argsort(-detections.score, kind="stable"):
            self.take(detections, int(row))
        self.tracks = {
            identity: track
            for identity, track in self.tracks.items()
            if self.time - track["seen"] <= PATIENCE
        }
        return self.report()

    def take(self, detections, row):
        """Give a detection to the nearest track that has none yet, or start a track."""
        where = detections.position[row, :2]
        free = {
            identity: np.hypot(*(track["position"] - where))
            for identity, track in self.tracks.items()
            if track["seen"] < self.time
        }
        nearest = min(free, key=free.get, default=None)
        box = detections.take([row])
        if nearest is None or free[nearest] > GATE:
            self.tracks[self.next_id] = {
                "position": where,
                "velocity": np.zeros(2),
                "seen": self.time,
                "box": box,
                "hits": 1,
            }
            self.next_id += 1
            return
        track = self.tracks[nearest]
        elapsed = self.time - track["seen"]
        measured = (where - track["box"].position[0, :2]) / elapsed
        gain = 1.0 if track["hits"] == 1 else 0.2
        track["velocity"] = (1 - gain) * track["velocity"] + gain * measured
        track.update(position=where, seen=self.time, box=box, hits=track["hits"] + 1)

    def report(self):
        """Tracks with three detections or more."""
        sure = [(identity, t) for identity, t in self.tracks.items() if t["hits"] >= 3]
        if not sure:
            return Tracks.empty(self.time)
        return Tracks(
            time=self.time,
            id=[identity for identity, _ in sure],
            position=[[*t["position"], t["box"].position[0, 2]] for _, t in sure],
            size=np.concatenate([t["box"].size for _, t in sure]),
            yaw=np.concatenate([t["box"].yaw for _, t in sure]),
            velocity=[t["velocity"] for _, t in sure],
            score=[min(0.5 + 0.1 * t["hits"], 0.99) for _, t in sure],
            label=np.concatenate([t["box"].label for _, t in sure]),
        )
