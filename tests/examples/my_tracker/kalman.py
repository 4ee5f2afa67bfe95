"""The nearest-detection tracker with filterpy's Kalman filter in place of its velocity rule."""

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from scipy.optimize import linear_sum_assignment

from pmbm import Tracks

GATE = 4.0
PATIENCE = 1.0


class KalmanTracker:
    def __init__(self):
        self.time = None
        self.next_id = 0
        self.tracks = []

    def step(self, detections):
        dt = 0.0 if self.time is None else detections.time - self.time
        self.time = detections.time
        for track in self.tracks:
            track.predict(dt)
        seen = detections.position[:, :2]
        free = set(range(len(detections)))
        if self.tracks and free:
            ahead = np.array([track.filter.x[:2] for track in self.tracks])
            cost = np.hypot(*(ahead[:, None] - seen[None]).transpose(2, 0, 1))
            for row, column in zip(*linear_sum_assignment(np.minimum(cost, GATE)), strict=True):
                if cost[row, column] < GATE:
                    self.tracks[row].update(detections.take([column]), self.time)
                    free.discard(column)
        for row in sorted(free):
            self.tracks.append(_Track(self.next_id, detections.take([row]), self.time))
            self.next_id += 1
        self.tracks = [t for t in self.tracks if self.time - t.seen <= PATIENCE]
        sure = [t for t in self.tracks if t.hits >= 3]
        if not sure:
            return Tracks.empty(self.time)
        return Tracks(
            time=self.time,
            id=[t.id for t in sure],
            position=[[*t.filter.x[:2], t.box.position[0, 2]] for t in sure],
            size=np.concatenate([t.box.size for t in sure]),
            yaw=np.concatenate([t.box.yaw for t in sure]),
            velocity=[t.filter.x[2:] for t in sure],
            score=[min(0.5 + 0.1 * t.hits, 0.99) for t in sure],
            label=np.concatenate([t.box.label for t in sure]),
            covariance=[t.filter.P for t in sure],
        )


class _Track:
    """One object: x, y, vx, vy."""

    def __init__(self, identity, box, time):
        self.id, self.hits = identity, 1
        self.filter = KalmanFilter(dim_x=4, dim_z=2)
        self.filter.x = np.array([*box.position[0, :2], 0.0, 0.0])
        self.filter.P = np.diag([0.1, 0.1, 100.0, 100.0])
        self.filter.R = 0.1 * np.eye(2)
        self.filter.H = np.eye(2, 4)
        self.box, self.seen = box, time

    def predict(self, dt):
        self.filter.F = np.eye(4) + dt * np.eye(4, k=2)
        noise = Q_continuous_white_noise(
            dim=2, dt=max(dt, 1e-9), spectral_density=2.0, block_size=2
        )
        self.filter.Q = noise.reshape(2, 2, 2, 2).transpose(1, 0, 3, 2).reshape(4, 4)
        self.filter.predict()

    def update(self, box, time):
        self.filter.update(box.position[0, :2])
        self.box, self.seen, self.hits = box, time, self.hits + 1
