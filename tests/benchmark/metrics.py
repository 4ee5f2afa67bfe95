"""Speed of the metrics beside TrackEval's and a plain scipy loop, on the same problems."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from pmbm.metrics.core.clear_matching import clear_matches, gated_pairs
from pmbm.metrics.core.scene import BoxRows, ScoredScene
from pmbm.metrics.families.clear import clear_counts
from pmbm.metrics.families.identity import identity_counts
from pmbm.metrics.families.ospa import ospa_series

FRAMES, OBJECTS, SEEDS = 200, 60, range(5)
CUTOFF, ORDER, GATE = 10.0, 2.0, 2.0


def i_clear() -> tuple[float, dict[str, Any]]:
    """CPU time of CLEAR MOT and identity over TrackEval's, 200 frames of 60 objects; median of
    five seeds.  Ours starts from positions, TrackEval from similarities made beforehand."""
    import trackeval

    quiet = {"PRINT_CONFIG": False}
    clear, identity = trackeval.metrics.CLEAR(quiet), trackeval.metrics.Identity(quiet)

    def ours(scene: ScoredScene) -> int:
        counts = clear_counts(scene, clear_matches(scene, GATE))
        assert counts.truths == FRAMES * OBJECTS
        return identity_counts(scene, gated_pairs(scene, GATE)).true_positives

    def theirs(data: dict[str, Any]) -> int:
        clear.eval_sequence(data)
        return int(identity.eval_sequence(data)["IDTP"])

    return _ratio(ours, theirs, _trackeval_data)


def i_ospa() -> tuple[float, dict[str, Any]]:
    """CPU time of OSPA over that of a loop over frames with `cdist` and `linear_sum_assignment`,
    200 frames of 60 objects; median of five seeds.  Both start from positions."""

    def ours(scene: ScoredScene) -> float:
        return round(float(ospa_series(scene, CUTOFF, ORDER).distance.sum()), 9)

    def theirs(frames: list[tuple[np.ndarray, np.ndarray]]) -> float:
        sum_of_distances = 0.0
        for truth, tracks in frames:
            cost = np.minimum(cdist(truth, tracks), CUTOFF) ** ORDER
            rows, columns = linear_sum_assignment(cost)
            size = max(cost.shape)
            total = cost[rows, columns].sum() + CUTOFF**ORDER * abs(len(truth) - len(tracks))
            sum_of_distances += (total / size) ** (1 / ORDER)
        return round(float(sum_of_distances), 9)

    return _ratio(ours, theirs, _point_frames)


def _ratio(
    ours: Callable[[ScoredScene], Any],
    theirs: Callable[[Any], Any],
    prepared: Callable[[ScoredScene], Any],
) -> tuple[float, dict[str, Any]]:
    """Median ratio of CPU times over seeds; both must give the same answer."""
    ratios, own, rival = [], [], []
    for seed in SEEDS:
        data = prepared(random_scene(seed))
        answers = []
        seconds = []
        for work, problem in ((theirs, data), (ours, random_scene(seed))):
            start = time.process_time()
            answers.append(work(problem))
            seconds.append(time.process_time() - start)
        assert answers[0] == answers[1], answers
        rival.append(seconds[0])
        own.append(seconds[1])
        ratios.append(seconds[1] / seconds[0])
    return float(np.median(ratios)), {
        "ours_ms": round(1e3 * float(np.median(own)), 2),
        "rival_ms": round(1e3 * float(np.median(rival)), 2),
        "ratio_min": round(min(ratios), 3),
        "ratio_max": round(max(ratios), 3),
        "frames": FRAMES,
        "objects": OBJECTS,
        "seeds": len(SEEDS),
    }


def random_scene(seed: int) -> ScoredScene:
    """60 objects of which a tracker finds nine in ten, with six false boxes a frame, and renames
    one in a hundred."""
    rng = np.random.default_rng([seed, FRAMES, OBJECTS])
    position = rng.uniform(-60, 60, (OBJECTS, 2))
    velocity = rng.normal(0, 3, (OBJECTS, 2))
    truth_position, track_position, track_frame, track_id = [], [], [], []
    name, fresh = np.arange(OBJECTS), OBJECTS
    for k in range(FRAMES):
        here = position + 0.1 * k * velocity
        truth_position.append(here)
        renamed = np.flatnonzero(rng.random(OBJECTS) < 0.01)
        name[renamed] = fresh + np.arange(len(renamed))
        fresh += len(renamed)
        found = np.flatnonzero(rng.random(OBJECTS) < 0.9)
        false = rng.poisson(OBJECTS / 10)
        track_position.append(here[found] + rng.normal(0, 0.3, (len(found), 2)))
        track_position.append(rng.uniform(-60, 60, (false, 2)))
        track_id.extend([*name[found], *range(fresh, fresh + false)])
        track_frame.extend([k] * (len(found) + false))
        fresh += false
    truth_frame = np.repeat(np.arange(FRAMES), OBJECTS)
    truth_id = np.tile(np.arange(OBJECTS), FRAMES)
    return ScoredScene(
        time=np.arange(FRAMES) * 0.1,
        truth=_boxes(truth_frame, truth_id, np.concatenate(truth_position)),
        tracks=_boxes(np.array(track_frame), np.array(track_id), np.concatenate(track_position)),
    )


def _boxes(frame: np.ndarray, name: np.ndarray, position: np.ndarray) -> BoxRows:
    n = len(frame)
    order = np.lexsort((name, frame))
    return BoxRows(
        frame=frame[order].astype(np.int64),
        id=name[order].astype(np.int64),
        position=np.column_stack([position, np.zeros(n)])[order],
        size=np.ones((n, 3)),
        yaw=np.zeros(n),
        velocity=np.zeros((n, 2)),
        label=np.zeros(n, np.int8),
        score=np.ones(n),
        observable=np.ones(n, np.bool_),
        covariance=np.full((n, 4, 4), np.nan),
    )


def _point_frames(scene: ScoredScene) -> list[tuple[np.ndarray, np.ndarray]]:
    return [
        (
            scene.truth.position[scene.truth.frame == k, :2],
            scene.tracks.position[scene.tracks.frame == k, :2],
        )
        for k in range(len(scene))
    ]


def _trackeval_data(scene: ScoredScene) -> dict[str, Any]:
    from pmbm.metrics.families.hota import distance_similarity

    similarity = distance_similarity(scene.pairs.distance_xyz, 2 * GATE)
    truth = [np.flatnonzero(scene.truth.frame == k) for k in range(len(scene))]
    tracks = [np.flatnonzero(scene.tracks.frame == k) for k in range(len(scene))]
    return {
        "num_timesteps": len(scene),
        "num_gt_dets": len(scene.truth),
        "num_tracker_dets": len(scene.tracks),
        "num_gt_ids": len(scene.truth.ids),
        "num_tracker_ids": len(scene.tracks.ids),
        "gt_ids": [scene.truth.index[rows] for rows in truth],
        "tracker_ids": [scene.tracks.index[rows] for rows in tracks],
        "similarity_scores": [
            similarity[scene.pairs.frame == k].reshape(len(truth[k]), len(tracks[k]))
            for k in range(len(scene))
        ],
    }


if __name__ == "__main__":
    for bar in (i_clear, i_ospa):
        figure, details = bar()
        print(f"{bar.__name__}: {figure:.3f} {details}")
