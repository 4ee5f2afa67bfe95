"""A Stone Soup tracker behind the protocol: global nearest neighbour, constant velocity."""

import datetime

import numpy as np

from pmbm import Tracks

START = datetime.datetime(2000, 1, 1)


class StoneSoupTracker:
    """Feeds a Stone Soup tracker frame by frame.  Needs `pip install stonesoup`."""

    def __init__(self):
        from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
        from stonesoup.deleter.time import UpdateTimeDeleter
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.initiator.simple import SimpleMeasurementInitiator
        from stonesoup.measures import Mahalanobis
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition.linear import (
            CombinedLinearGaussianTransitionModel,
            ConstantVelocity,
        )
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.state import GaussianState
        from stonesoup.updater.kalman import KalmanUpdater

        self.model = LinearGaussian(ndim_state=4, mapping=(0, 2), noise_covar=0.1 * np.eye(2))
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(2.0)] * 2)
        updater = KalmanUpdater(self.model)
        hypothesiser = DistanceHypothesiser(
            KalmanPredictor(motion), updater, Mahalanobis(), missed_distance=4
        )
        self.associator = GNNWith2DAssignment(hypothesiser)
        self.updater = updater
        self.deleter = UpdateTimeDeleter(datetime.timedelta(seconds=1))
        prior = GaussianState(np.zeros((4, 1)), np.diag([0.0, 100.0, 0.0, 100.0]))
        self.initiator = SimpleMeasurementInitiator(prior, self.model)
        self.tracks, self.names, self.boxes = set(), {}, {}

    def step(self, detections):
        from stonesoup.types.detection import Detection

        now = START + datetime.timedelta(seconds=detections.time)
        rows = {
            Detection(
                xy.reshape(2, 1), timestamp=now, measurement_model=self.model, metadata={"row": row}
            )
            for row, xy in enumerate(detections.position[:, :2])
        }
        used = set()
        for track, hypothesis in self.associator.associate(self.tracks, rows, now).items():
            if hypothesis:
                track.append(self.updater.update(hypothesis))
                used.add(hypothesis.measurement)
            else:
                track.append(hypothesis.prediction)
        self.tracks -= self.deleter.delete_tracks(self.tracks, timestamp=now)
        self.tracks |= self.initiator.initiate(rows - used, now)
        for track in self.tracks:
            measured = getattr(track[-1], "hypothesis", None)
            if measured is not None:
                row = measured.measurement.metadata["row"]
                self.boxes[track.id] = detections.take([row])
        sure = sorted(
            (t for t in self.tracks if len(t) >= 3),
            key=lambda t: self.names.setdefault(t.id, len(self.names)),
        )
        if not sure:
            return Tracks.empty(detections.time)
        boxes = [self.boxes[t.id] for t in sure]
        states = np.array([t.state_vector[:, 0] for t in sure], dtype=float)
        return Tracks(
            time=detections.time,
            id=[self.names[t.id] for t in sure],
            position=np.column_stack([states[:, [0, 2]], [b.position[0, 2] for b in boxes]]),
            size=np.concatenate([b.size for b in boxes]),
            yaw=np.concatenate([b.yaw for b in boxes]),
            velocity=states[:, [1, 3]],
            score=np.full(len(sure), 0.9),
            label=np.concatenate([b.label for b in boxes]),
        )
