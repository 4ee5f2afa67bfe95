"""Our metrics beside TrackEval and motmetrics, run here, on random problems.

Only what they define as we do is compared; positions are random reals, so ties, which they break
by the order of objects, do not happen.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pmbm.metrics.benchmarks.trackeval import trackeval_counts, trackeval_scores
from pmbm.metrics.core.clear_matching import clear_matches, gated_pairs
from pmbm.metrics.core.scene import BoxRows, ScoredScene
from pmbm.metrics.families.clear import clear_counts
from pmbm.metrics.families.hota import distance_similarity, hota_counts
from pmbm.metrics.families.identity import identity_counts

EVERYDAY, MANY = range(12), range(12, 300)


def random_scene(seed: int) -> ScoredScene:
    """Objects on random walks that come and go; tracks that miss, swap, break and lie."""
    rng = np.random.default_rng([seed, 77])
    frames, objects = int(rng.integers(2, 30)), int(rng.integers(1, 9))
    spread, noise = rng.choice([4.0, 15.0, 40.0]), rng.choice([0.1, 0.5, 1.2])
    miss, swap, rename = rng.uniform(0, 0.5), rng.uniform(0, 0.1), rng.uniform(0, 0.15)
    position = rng.uniform(-spread, spread, (objects, 3)) * [1, 1, 0.1]
    velocity = rng.normal(0, 2, (objects, 3)) * [1, 1, 0]
    born = rng.integers(0, frames, objects) * (rng.random(objects) < 0.4)
    name, fresh = np.arange(objects) + 100, 1000
    truth: list[tuple[int, int, np.ndarray]] = []
    tracks: list[tuple[int, int, np.ndarray]] = []
    for k in range(frames):
        position = position + 0.1 * velocity
        if objects > 1 and rng.random() < swap:
            a, b = rng.choice(objects, 2, replace=False)
            name[[a, b]] = name[[b, a]]
        for i in range(objects):
            if k < born[i] or rng.random() < 0.1:
                continue
            truth.append((k, i, position[i].copy()))
            if rng.random() < rename:
                name[i], fresh = fresh, fresh + 1
            if rng.random() > miss:
                tracks.append((k, int(name[i]), position[i] + rng.normal(0, noise, 3)))
        for _ in range(rng.poisson(0.6)):
            tracks.append((k, fresh, rng.uniform(-spread, spread, 3) * [1, 1, 0.1]))
            fresh += 1
    return ScoredScene(time=np.arange(frames) * 0.1, truth=boxes(truth), tracks=boxes(tracks))


def boxes(rows: list[tuple[int, int, np.ndarray]]) -> BoxRows:
    rows = sorted(rows, key=lambda row: row[:2])
    n = len(rows)
    return BoxRows(
        frame=np.array([row[0] for row in rows], np.int64),
        id=np.array([row[1] for row in rows], np.int64),
        position=np.array([row[2] for row in rows]).reshape(n, 3),
        size=np.tile([4.5, 1.9, 1.6], (n, 1)),
        yaw=np.zeros(n),
        velocity=np.zeros((n, 2)),
        label=np.zeros(n, np.int8),
        score=np.ones(n),
        observable=np.ones(n, np.bool_),
        covariance=np.full((n, 4, 4), np.nan),
    )


def trackeval_data(scene: ScoredScene, similarity: np.ndarray) -> dict:
    """One sequence in the form TrackEval takes."""
    frames = range(len(scene))
    by_frame = [
        (
            np.flatnonzero(scene.truth.frame == k),
            np.flatnonzero(scene.tracks.frame == k),
            np.flatnonzero(scene.pairs.frame == k),
        )
        for k in frames
    ]
    return {
        "num_timesteps": len(scene),
        "num_gt_dets": len(scene.truth),
        "num_tracker_dets": len(scene.tracks),
        "num_gt_ids": len(scene.truth.ids),
        "num_tracker_ids": len(scene.tracks.ids),
        "gt_ids": [scene.truth.index[rows] for rows, _, _ in by_frame],
        "tracker_ids": [scene.tracks.index[rows] for _, rows, _ in by_frame],
        "similarity_scores": [
            similarity[pairs].reshape(len(rows), len(columns)) for rows, columns, pairs in by_frame
        ],
    }


def run_trackeval(scene: ScoredScene, similarity: np.ndarray) -> dict:
    trackeval = pytest.importorskip("trackeval")
    data = trackeval_data(scene, similarity)
    quiet = {"PRINT_CONFIG": False}
    return {
        **trackeval.metrics.HOTA().eval_sequence(data),
        **trackeval.metrics.CLEAR(quiet).eval_sequence(data),
        **trackeval.metrics.Identity(quiet).eval_sequence(data),
    }


def check_trackeval(seed: int) -> None:
    scene = random_scene(seed)
    similarity = distance_similarity(scene.pairs.distance_xyz, 4.0)
    theirs = run_trackeval(scene, similarity)
    ours = trackeval_scores(trackeval_counts(scene, similarity))
    for name, value in theirs.items():
        np.testing.assert_allclose(ours[name], value, rtol=1e-9, atol=1e-9, err_msg=name)
    # The standard HOTA and IDF1 define the same where both sides have boxes; a similarity of at
    # least a half is a distance of at most 2 m.
    if len(scene.truth) and len(scene.tracks):
        counts = hota_counts(scene, scene.pairs, similarity)
        np.testing.assert_array_equal(counts.true_positives, theirs["HOTA_TP"])
        assert identity_counts(scene, gated_pairs(scene, 2.0)).true_positives == theirs["IDTP"]


def check_motmetrics(seed: int) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module=r"motmetrics(\..*)?")
        motmetrics = pytest.importorskip("motmetrics")
        scene = random_scene(seed)
        accumulator = motmetrics.MOTAccumulator()
        for k in range(len(scene)):
            rows, columns = scene.truth.frame == k, scene.tracks.frame == k
            d = scene.pairs.distance_xyz[scene.pairs.frame == k].reshape(rows.sum(), columns.sum())
            accumulator.update(
                scene.truth.id[rows],
                scene.tracks.id[columns],
                np.where(d < 2.0, d, np.nan),
                frameid=k,
            )
        names = [
            "num_frames",
            "num_objects",
            "num_predictions",
            "num_switches",
            "num_false_positives",
            "num_misses",
            "num_fragmentations",
            "num_transfer",
            "mostly_tracked",
            "mostly_lost",
            "motp",
            "idtp",
        ]
        theirs = motmetrics.metrics.create().compute(accumulator, metrics=names).iloc[0]
    ours = clear_counts(scene, clear_matches(scene, 2.0))
    assert ours.frames == theirs["num_frames"]
    assert ours.truths == theirs["num_objects"]
    assert ours.tracks == theirs["num_predictions"]
    assert ours.switches == theirs["num_switches"]
    assert ours.false_positives == theirs["num_false_positives"]
    assert ours.misses == theirs["num_misses"]
    assert ours.fragmentations == theirs["num_fragmentations"]
    assert ours.transfers == theirs["num_transfer"]
    assert ours.mostly_tracked == theirs["mostly_tracked"]
    assert ours.mostly_lost == theirs["mostly_lost"]
    if ours.matches:
        assert ours.distance_sum / ours.matches == pytest.approx(theirs["motp"], rel=1e-9)
    assert identity_counts(scene, gated_pairs(scene, 2.0)).true_positives == theirs["idtp"]


@pytest.mark.parametrize("seed", EVERYDAY)
def test_metrics_agree_with_trackeval(seed: int):
    check_trackeval(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", MANY)
def test_metrics_agree_with_trackeval_on_many_problems(seed: int):
    check_trackeval(seed)


@pytest.mark.parametrize("seed", EVERYDAY)
def test_metrics_agree_with_motmetrics(seed: int):
    check_motmetrics(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", MANY)
def test_metrics_agree_with_motmetrics_on_many_problems(seed: int):
    check_motmetrics(seed)
