"""The Waymo baseline, the probabilistic Kalman filter and the clairvoyant, worked out by hand."""

import copy
import pickle

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from pmbm.baselines import (
    BoxNoise,
    ClairvoyantConfig,
    ProbabilisticKFConfig,
    ProbabilisticKFTracker,
    WaymoConfig,
    WaymoTracker,
    clairvoyant,
    fit_statistics,
)
from pmbm.datasets import with_origins
from pmbm.errors import InputError
from pmbm.tracking import Tracker, tracker_factory
from pmbm.types import CLUTTER, Detections, GroundTruth, Label, Recording

CAR = (4.0, 2.0, 1.5)


def frame(k, *boxes):
    """Detections at frame `k` (10 Hz) of boxes (x, y, z, yaw, score, label), the tail optional."""
    full = [(*box, *(0.0, 0.0, 0.75, 0.0, 0.9, Label.CAR)[len(box) :]) for box in boxes]
    return Detections(
        time=k / 10,
        position=np.array([box[:3] for box in full]).reshape(-1, 3),
        size=np.array([CAR for _ in full]).reshape(-1, 3),
        yaw=[box[3] for box in full],
        score=[box[4] for box in full],
        label=np.array([box[5] for box in full], dtype=np.int64),
    )


def drive(tracker, frames):
    return [tracker.step(detections) for detections in frames]


class TestWaymo:
    def test_by_name_and_nothing_for_nothing(self):
        tracker = tracker_factory("waymo")()
        assert isinstance(tracker, WaymoTracker)
        assert isinstance(tracker, Tracker)
        assert [len(t) for t in drive(tracker, [frame(k) for k in range(4)])] == [0] * 4

    def test_shown_from_the_third_hit_and_never_while_coasting(self):
        seen = {0, 1, 3, 4, 6, 7}
        frames = [frame(k, *([(0.0,)] if k in seen else [])) for k in range(8)]
        outputs = drive(WaymoTracker(), frames)
        assert [len(t) for t in outputs] == [0, 0, 0, 1, 1, 0, 1, 1]
        assert len({t.id[0] for t in outputs if len(t)}) == 1

    def test_dies_after_two_frames(self):
        hits = [frame(k, (0.0,)) for k in range(3)]
        for gap, kept in ((2, True), (3, False)):
            misses = [frame(k) for k in range(3, 2 + gap)]
            again = [frame(k, (0.0,)) for k in range(2 + gap, 5 + gap)]
            outputs = drive(WaymoTracker(), hits + misses + again)
            assert (outputs[-1].id.tolist() == outputs[2].id.tolist()) is kept

    @pytest.mark.parametrize(("lift", "same"), [(1.2, True), (1.227, True), (1.228, False)])
    def test_overlap_is_of_volumes(self, lift, same):
        """Boxes 1.5 m high, lifted by h: IoU (1.5 - h)/(1.5 + h); .1 at h = 27/22 = 1.227."""
        tracker = WaymoTracker(WaymoConfig(min_hits=2))
        outputs = drive(tracker, [frame(0, (0.0,)), frame(1, (0.0, 0.0, 0.75 + lift))])
        assert len(outputs[-1]) == same

    def test_score_threshold_and_flip(self):
        outputs = drive(WaymoTracker(), [frame(k, (0.0, 0.0, 0.75, 0.0, 0.49)) for k in range(4)])
        assert len(outputs[-1]) == 0
        yaws = [0.2, 0.2, 0.2 - np.pi, 0.2]
        outputs = drive(
            WaymoTracker(), [frame(k, (0, 0, 0.75, y, 0.5)) for k, y in enumerate(yaws)]
        )
        np.testing.assert_allclose(outputs[-1].yaw, [0.2])


def plain_noise(**changes):
    values = {
        "initial": [0.25] * 7 + [1.0] * 4,
        "process": [0.01] * 4 + [0.0] * 3 + [0.01] * 4,
        "measurement": [0.25] * 7,
    }
    return BoxNoise(**{key: np.array(value) for key, value in {**values, **changes}.items()})


class TestProbabilisticKF:
    def config(self, **changes):
        return ProbabilisticKFConfig(noise={Label.CAR: plain_noise()}, **changes)

    def test_by_name_and_nothing_for_nothing(self):
        tracker = tracker_factory("probabilistic_kf")()
        assert isinstance(tracker, ProbabilisticKFTracker)
        assert [len(t) for t in drive(tracker, [frame(k) for k in range(4)])] == [0] * 4

    def test_three_updates_against_filterpy_with_the_matrices_written_out(self):
        kalman = KalmanFilter(11, 7)
        kalman.x[:7, 0] = [1.0, 2.0, 0.75, 0.1, *CAR]
        kalman.F = np.eye(11)
        for place, rate in ((0, 7), (1, 8), (2, 9), (3, 10)):
            kalman.F[place, rate] = 1.0
        kalman.H = np.eye(7, 11)
        noise = plain_noise()
        kalman.P, kalman.Q, kalman.R = map(
            np.diag, (noise.initial, noise.process, noise.measurement)
        )
        tracker = ProbabilisticKFTracker(self.config(min_hits=1))
        tracker.step(frame(0, (1.0, 2.0, 0.75, 0.1)))
        for k, (x, y, yaw) in enumerate([(1.5, 2.1, 0.2), (2.1, 2.1, 0.3), (2.4, 2.3, 0.4)], 1):
            kalman.predict()
            kalman.update(np.array([x, y, 0.75, yaw, *CAR]))
            tracks = tracker.step(frame(k, (x, y, 0.75, yaw)))
            state = np.concatenate([tracks.position[0], tracks.yaw, tracks.size[0]])
            np.testing.assert_allclose(state, kalman.x[:7, 0], rtol=1e-12)
            np.testing.assert_allclose(tracks.velocity[0], 10 * kalman.x[7:9, 0], rtol=1e-12)

    @pytest.mark.parametrize(("share", "same"), [(0.999, True), (1.001, False)])
    def test_gate_on_the_mahalanobis_distance(self, share, same):
        """After one frame S of x is .25 + 1 + .01 + .25 = 1.51: the gate lies 11 of its roots
        away."""
        away = 11 * np.sqrt(1.51) * share
        outputs = drive(
            ProbabilisticKFTracker(self.config(min_hits=2)), [frame(0, (0.0,)), frame(1, (away,))]
        )
        assert len(outputs[-1]) == same

    def test_greedy_takes_the_nearest_pair_first(self):
        """Tracks at 0 and 1, detections at .55 and 5: the optimal pairing keeps the order, the
        greedy one gives 1 its nearest, and 0 the far one."""
        tracker = ProbabilisticKFTracker(self.config(min_hits=1))
        first = tracker.step(frame(0, (0.0,), (1.0,)))
        second = tracker.step(frame(1, (0.55,), (-3.0, 0.0)))
        assert second.id.tolist() == first.id.tolist()
        assert second.position[1, 0] < 1.0
        assert abs(second.position[1, 0] - 0.55) < 0.2
        assert second.position[0, 0] < -1.0

    def test_flip_and_turn_rate(self):
        yaws = 0.1 * np.arange(12) + np.pi * np.isin(np.arange(12), (3, 7, 8))
        tracker = ProbabilisticKFTracker(self.config())
        outputs = drive(tracker, [frame(k, (0, 0, 0.75, y)) for k, y in enumerate(yaws)])
        np.testing.assert_allclose(outputs[-1].yaw, [1.1], atol=0.02)

    def test_classes_have_their_own_statistics(self):
        """Two metres in a frame is in a walker's gate only if its speed is allowed to be large."""
        walker = plain_noise(initial=[1e-4] * 7 + [1e-4] * 4, measurement=[1e-4] * 7)
        config = ProbabilisticKFConfig(
            min_hits=2, noise={Label.CAR: plain_noise(), Label.PEDESTRIAN: walker}
        )
        for label, shown in ((Label.CAR, 1), (Label.PEDESTRIAN, 0)):
            boxes = [(x, 0.0, 0.75, 0.0, 0.9, label) for x in (0.0, 2.0)]
            outputs = drive(
                ProbabilisticKFTracker(config), [frame(k, box) for k, box in enumerate(boxes)]
            )
            assert len(outputs[-1]) == shown

    def test_lifecycle_and_copies(self):
        config = self.config()
        tracker = ProbabilisticKFTracker(pickle.loads(pickle.dumps(config)))
        hits = [frame(k, (0.0,)) for k in range(4)]
        assert [len(t) for t in drive(tracker, hits)] == [0, 0, 1, 1]
        twin = copy.deepcopy(tracker)
        assert len(tracker.step(frame(4))) == len(twin.step(frame(4))) == 0
        assert tracker.step(frame(5, (0.0,))).id.tolist() == [0]
        assert twin.step(frame(6, (0.0,))).id.tolist() == []

    def test_variances_as_a_file_has_them(self):
        values = {name: getattr(plain_noise(), name).tolist() for name in vars(plain_noise())}
        config = ProbabilisticKFConfig(noise={"CAR": values})
        np.testing.assert_array_equal(
            config.noise_of(Label.CAR).process, self.config().noise_of(Label.CAR).process
        )
        with pytest.raises(InputError, match=r"noise\.CARR.*did you mean 'CAR'"):
            ProbabilisticKFConfig(noise={"CARR": values})
        with pytest.raises(InputError, match=r"noise\.CAR\.measurment.*did you mean 'measurement'"):
            ProbabilisticKFConfig(noise={"CAR": {**values, "measurment": [1]}})
        with pytest.raises(InputError, match=r"noise\.CAR\.process"):
            ProbabilisticKFConfig(noise={"CAR": {"initial": [1.0] * 11, "measurement": [1] * 7}})

    def test_impossible_parameters(self):
        with pytest.raises(InputError, match="mahalanobis_gate"):
            ProbabilisticKFConfig(mahalanobis_gate=0)
        with pytest.raises(InputError, match="initial"):
            plain_noise(initial=[0.0] * 11)
        with pytest.raises(InputError, match="measurement"):
            plain_noise(measurement=[1.0] * 6)
        ten = BoxNoise.uniform(
            initial=1, initial_velocity=1, process=1, process_velocity=1, measurement=1
        )
        with pytest.raises(InputError, match=r"noise\.CAR.*11"):
            ProbabilisticKFConfig(noise={Label.CAR: ten})


def truth(k, rows, label=Label.CAR):
    """Ground truth at frame `k` of rows (id, x, y, yaw)."""
    n = len(rows)
    return GroundTruth(
        time=k / 10,
        id=np.array([row[0] for row in rows], dtype=np.int64),
        position=np.array([(row[1], row[2], 0.75) for row in rows]).reshape(-1, 3),
        size=np.array([CAR for _ in rows]).reshape(-1, 3),
        yaw=[row[3] for row in rows],
        velocity=np.zeros((n, 2)),
        label=np.full(n, label, dtype=np.int64),
        visibility=np.ones(n),
        observable=np.ones(n),
        crashed=np.zeros(n),
    )


def recording(truths, deliveries, origin):
    return Recording(
        name="made",
        truth=truths,
        detections=deliveries,
        frame=np.arange(len(truths)),
        stamp=np.arange(len(truths)),
        origin=origin,
    )


class TestStatistics:
    def test_recovers_what_the_data_were_drawn_with(self):
        """Constant-acceleration noise .2 m per frame^2, errors .3 m and .1 rad, a third flipped."""
        rng = np.random.default_rng(1)
        n, objects = 400, 10
        speed = np.cumsum(rng.normal(0, 0.2, (n, objects, 2)), axis=0)
        place = np.cumsum(speed, axis=0) + 1000.0 * np.arange(objects)[:, None]
        turn = np.cumsum(rng.normal(0, 0.05, (n, objects)), axis=0) * 0.1
        truths, deliveries = [], []
        for k in range(n):
            rows = [(i, *place[k, i], turn[k, i]) for i in range(objects)]
            truths.append(truth(k, rows))
            noisy = place[k] + rng.normal(0, 0.3, (objects, 2))
            yaw = turn[k] + rng.normal(0, 0.1, objects) + np.pi * (rng.random(objects) < 1 / 3)
            deliveries.append(frame(k, *[(*p, 0.75, y) for p, y in zip(noisy, yaw, strict=True)]))
        made = recording(truths, deliveries, [np.arange(objects)] * n)
        noise = fit_statistics([made])[Label.CAR]
        assert set(fit_statistics([made])) == {Label.CAR}
        samples = n * objects
        within = 5 * np.sqrt(2 / samples)
        np.testing.assert_allclose(noise.measurement[:2], 0.09, rtol=within)
        np.testing.assert_allclose(noise.measurement[3], 0.01, rtol=within)
        np.testing.assert_allclose(noise.process[:2], 0.04, rtol=within)
        np.testing.assert_allclose(noise.process[7:9], 0.04, rtol=within)
        assert noise.process[4:7].tolist() == [0, 0, 0]
        np.testing.assert_allclose(noise.initial[7:9], np.mean(speed[1:] ** 2, axis=(0, 1)))
        np.testing.assert_array_equal(noise.initial[:7], noise.measurement)
        ProbabilisticKFConfig(noise={Label.CAR: noise})

    def test_spells_are_not_joined_across_a_gap(self):
        frames = [truth(k, [(1, 10.0 * (k >= 20), 0, 0)] if k != 20 else []) for k in range(60)]
        deliveries = [frame(k, *[(p[0], p[1]) for p in frames[k].position]) for k in range(60)]
        noise = fit_statistics(
            [recording(frames, deliveries, [np.arange(len(d)) for d in deliveries])]
        )[Label.CAR]
        assert noise.process.max() == 0.0

    def test_too_little_data_and_unknown_origins(self):
        few = [truth(k, [(1, 0, 0, 0)]) for k in range(20)]
        deliveries = [frame(k, (0.0,)) for k in range(20)]
        assert fit_statistics([recording(few, deliveries, [np.zeros(1, int)] * 20)]) == {}
        with pytest.raises(InputError, match="with_origins"):
            fit_statistics([recording(few, deliveries, None)])


class TestClairvoyant:
    def test_true_ids_births_and_deaths_through_clutter_and_misses(self):
        present = {0: [(7, 0.0, 0, 0)], 1: [(7, 1.0, 0, 0), (9, 30, 0, 0)]}
        present |= {2: [(9, 30, 0, 0), (7, 2.0, 0, 0)], 3: [(9, 30, 0, 0)], 4: []}
        truths = [truth(k, present[k]) for k in range(5)]
        deliveries = [
            frame(0, (50.0,), (0.1,)),
            frame(1),
            frame(2, (30.2,), (2.1,)),
            frame(3, (2.9,)),
            frame(4, (30.0,)),
        ]
        origin = [[CLUTTER, 0], [], [0, 1], [CLUTTER], [CLUTTER]]
        tracks = clairvoyant(recording(truths, deliveries, [np.array(o, int) for o in origin]))
        assert [t.id.tolist() for t in tracks] == [[7], [7], [7, 9], [9], []]
        assert tracks.frame.tolist() == [0, 1, 2, 3, 4]
        np.testing.assert_allclose(tracks[0].position, [[0.1, 0.0, 0.75]])
        np.testing.assert_allclose(tracks[3].position, [[30.2, 0.0, 0.75]])
        assert all((t.score == 1).all() for t in tracks)

    def test_is_the_kalman_filter_written_out(self):
        config = ClairvoyantConfig(acceleration_density=3.0, position_sd=0.5, birth_velocity_sd=4.0)
        xs = [0.0, 0.9, 2.2, 2.8]
        truths = [truth(k, [(1, x, 0, 0)]) for k, x in enumerate(xs)]
        deliveries = [frame(k, (x,)) for k, x in enumerate(xs)]
        tracks = clairvoyant(recording(truths, deliveries, [np.zeros(1, int)] * 4), config)
        t = 0.1
        f = np.array([[1, t], [0, 1]])
        q = 3.0 * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        mean, cov = np.array([0.0, 0.0]), np.diag([0.25, 16.0])
        for k, x in enumerate(xs):
            if k:
                mean, cov = f @ mean, f @ cov @ f.T + q
                gain = cov[:, 0] / (cov[0, 0] + 0.25)
                mean, cov = mean + gain * (x - mean[0]), cov - np.outer(gain, cov[0])
            np.testing.assert_allclose(tracks[k].position[0, 0], mean[0], atol=1e-12)
            np.testing.assert_allclose(tracks[k].velocity[0, 0], mean[1], atol=1e-12)
            np.testing.assert_allclose(tracks[k].covariance[0][np.ix_([0, 2], [0, 2])], cov)

    def test_late_deliveries_are_dropped_as_a_tracker_drops_them(self):
        truths = [truth(k, [(1, float(k), 0, 0)]) for k in range(3)]
        deliveries = [frame(0, (0.0,)), frame(2, (2.0,)), frame(1, (1.0,))]
        made = Recording(
            name="late",
            truth=truths,
            detections=deliveries,
            frame=[0, 2, 1],
            stamp=np.arange(3),
            origin=[np.zeros(1, int)] * 3,
        )
        tracks = clairvoyant(made)
        assert tracks.frame.tolist() == [0, 2]
        assert tracks.dropped == 1

    def test_needs_origins(self):
        with pytest.raises(InputError, match="with_origins"):
            clairvoyant(recording([truth(0, [])], [frame(0)], None))


class TestOrigins:
    def test_pairs_of_the_same_label_that_overlap_enough(self):
        truths = [truth(0, [(1, 0.0, 0, 0), (2, 10.0, 0, 0), (3, 20.0, 0, 0)])]
        detections = frame(
            0,
            (10.5,),
            (0.2, 0, 0.75, 0, 0.9, Label.TRUCK),
            (23.0,),
            (10.2,),
            (0.4,),
        )
        made = with_origins(recording(truths, [detections], None))
        assert made.origin[0].tolist() == [CLUTTER, CLUTTER, CLUTTER, 1, 0]
        with pytest.raises(InputError, match="min_iou"):
            with_origins(made, min_iou=0.0)
