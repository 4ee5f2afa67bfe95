"""One rival tracker in a process, and an environment, of its own.

Started by rivals.py as `python rival_worker.py NAME`; imports nothing of ours.  Each frame comes in
as a .npy of positions (M,2), behind its length in 8 bytes; out goes a .npy of rows (id, x, y) with
a first row (CPU seconds of the step, 0, 0), likewise.
"""

import io
import os
import struct
import sys
import time

import numpy as np

DT = 0.1
SD = 0.3
GATE = 3.0


def stonesoup():
    """Global nearest neighbour with a Kalman filter per track, as in the project's tutorials."""
    from datetime import datetime, timedelta

    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.deleter.time import UpdateTimeStepsDeleter
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.initiator.simple import MultiMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(2.0), ConstantVelocity(2.0)])
    seen = LinearGaussian(4, (0, 2), np.eye(2) * SD**2)
    predictor, updater = KalmanPredictor(motion), KalmanUpdater(seen)
    hypothesiser = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=GATE)
    associator = GNNWith2DAssignment(hypothesiser)
    deleter = UpdateTimeStepsDeleter(5)
    initiator = MultiMeasurementInitiator(
        GaussianState([[0], [0], [0], [0]], np.diag([0, 100.0, 0, 100.0])),
        deleter=UpdateTimeStepsDeleter(2),
        data_associator=GNNWith2DAssignment(hypothesiser),
        updater=updater,
        min_points=3,
    )
    start, frame, tracks = datetime(2026, 1, 1), 0, set()

    def step(positions):
        nonlocal frame, tracks
        now = start + timedelta(seconds=DT * frame)
        frame += 1
        detections = {
            Detection(np.array(p)[:, None], timestamp=now, measurement_model=seen)
            for p in positions
        }
        hypotheses = associator.associate(tracks, detections, now)
        used = set()
        for track, hypothesis in hypotheses.items():
            if hypothesis:
                track.append(updater.update(hypothesis))
                used.add(hypothesis.measurement)
            else:
                track.append(hypothesis.prediction)
        tracks -= deleter.delete_tracks(tracks)
        tracks |= initiator.initiate(detections - used, now)
        return [(t.id, *t.state_vector[[0, 2], 0].astype(float)) for t in tracks]

    return step


def motpy():
    """Boxes by intersection over union, constant velocity, as in the project's README."""
    from motpy import Detection, MultiObjectTracker

    tracker = MultiObjectTracker(
        dt=DT,
        model_spec={"order_pos": 1, "dim_pos": 2, "order_size": 0, "dim_size": 2,
                    "q_var_pos": 2.0, "r_var_pos": SD**2},
        matching_fn_kwargs={"min_iou": 0.1},
    )  # fmt: skip
    half = np.array([2.25, 0.95])

    def step(positions):
        tracker.step([Detection(box=np.concatenate([p - half, p + half])) for p in positions])
        active = tracker.active_tracks(min_steps_alive=3)
        return [(t.id, *((t.box[:2] + t.box[2:]) / 2)) for t in active]

    return step


def norfair():
    """Points by Euclidean distance, as in the project's documentation."""
    from norfair import Detection, Tracker

    tracker = Tracker(
        distance_function="euclidean",
        distance_threshold=GATE,
        hit_counter_max=5,
        initialization_delay=2,
    )

    def step(positions):
        objects = tracker.update(detections=[Detection(p[None, :]) for p in positions])
        return [(t.id, *t.estimate[0]) for t in objects]

    return step


def lmb(association):
    """A labelled multi-Bernoulli filter, told the world's rates.

    Its birth places are fixed, so that tracks are born where the last frame had a detection that
    none explains (Reuter et al., IEEE TSP 62(12), 2014).  Shown from an existence of one half on:
    its own threshold has no effect in 0.3.2.
    """
    import multisensor_lmb_filters_rs as rs

    area, clutter, spread = 120.0**2, 10.0, np.diag([SD**2, SD**2, 100.0, 100.0])
    nowhere = rs.BirthLocation(0, np.array([1e6, 1e6, 0.0, 0.0]), spread)
    filtered = rs.FilterLmb(
        # Its noise is a density over one interval: of 2 m^2/s^3, as everybody's here.
        rs.MotionModel.constant_velocity_2d(DT, 2.0**0.5, 0.99),
        rs.SensorModel.position_2d(SD, 0.9, clutter, area),
        rs.BirthModel([nowhere], 1e-9, 1e-9),
        association,
        seed=0,
    )
    frame = 0

    def step(positions):
        nonlocal frame
        filtered.step([np.ascontiguousarray(p) for p in positions], frame)
        tracks = [t for t in filtered.get_tracks() if t.existence > 1e-3]
        places = np.array([t.mu[np.argmax(t.w)] for t in tracks]).reshape(-1, 4)
        likely = places[[t.existence > 0.1 for t in tracks], :2]
        apart = np.hypot(*(positions[:, None] - likely[None]).transpose(2, 0, 1))
        free = np.flatnonzero(apart.min(axis=1, initial=np.inf) > GATE)
        born = [
            rs._TrackData(
                (frame, int(j)), 0.03, [[*positions[j], 0.0, 0.0]], [spread.tolist()], [1.0]
            )
            for j in free
        ]
        filtered.set_tracks([*tracks, *born])
        frame += 1
        return [
            (t.label, *place[:2])
            for t, place in zip(tracks, places, strict=True)
            if t.existence > 0.5
        ]

    return step


def lmb_gibbs():
    from multisensor_lmb_filters_rs import AssociatorConfig

    return lmb(AssociatorConfig.gibbs(1000))


def lmb_murty():
    from multisensor_lmb_filters_rs import AssociatorConfig

    return lmb(AssociatorConfig.murty(100))


def main():
    # Whatever a library prints goes to stderr; the pipe is for frames.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    rivals = (stonesoup, motpy, norfair, lmb_gibbs, lmb_murty)
    step = {rival.__name__: rival for rival in rivals}[sys.argv[1]]()
    numbers = {}
    while header := sys.stdin.buffer.read(8):
        (length,) = struct.unpack("<q", header)
        positions = np.load(io.BytesIO(sys.stdin.buffer.read(length)))
        begin = time.process_time()
        tracks = step(positions)
        seconds = time.process_time() - begin
        rows = [(numbers.setdefault(name, len(numbers)), x, y) for name, x, y in tracks]
        reply = io.BytesIO()
        np.save(reply, np.array([(seconds, 0.0, 0.0), *rows], dtype=float))
        out.write(struct.pack("<q", reply.tell()) + reply.getvalue())
        out.flush()


if __name__ == "__main__":
    main()
