"""What a source's detections have said, in the filter, fitted, and at its operating point."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mark_builders import frame, street
from scipy.stats import binom

from pmbm.cli.detector import Detector, read_detectors
from pmbm.errors import InputError
from pmbm.filter import PMBMConfig, PMBMTracker, Report
from pmbm.filter.models.score_record import (
    WEIGHTS,
    RecordWeights,
    ScoreRecord,
    features,
    record_by_life,
)
from pmbm.fitting.score_record import (
    ModeRows,
    Rows,
    fit_records,
    neutral_config,
    pooled_records,
    quantile_scale,
    rows,
    score_scale,
)
from pmbm.metrics.benchmarks.operating_point import (
    Sweep,
    honest_spread,
    operating_point,
    sweep,
)
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.metrics.benchmarks.trackeval import SimilarityScore
from pmbm.metrics.core.scene import pair_overlap
from pmbm.types import CLUTTER, Detections, GroundTruth, Label, Tracks

MIDDLE = np.where(np.arange(7) == Label.CAR, 1.0, 0.0)
SPREAD = np.where(np.isin(np.arange(7), [Label.CAR, Label.PEDESTRIAN]), 2.0, 0.0)


def weights(**changes):
    return RecordWeights(
        **{
            "offset": -0.5,
            "score": 1.2,
            "count": 0.4,
            "detected": 0.9,
            "distance": 0.3,
            "distance_squared": -0.2,
            "rival": -1.5,
            **changes,
        }
    )


def record(online=None, **changes):
    given = {"label": Label.CAR, "middle": MIDDLE, "spread": SPREAD, **changes}
    return ScoreRecord(**given, online=online or weights())


def tracker(online=None, **changes):
    scores = record(online, **changes)
    config = replace(
        PMBMConfig.textbook(), scores=scores, report=Report(above=0.0, exclusive=False)
    ).changed({"sensor.clutter_rate": 1e-9, "sensor.position_sd": 0.1})
    return PMBMTracker(config)


def test_the_record_is_that_of_the_formula():
    """Three detections at 20 m, written out: recent mean, number, share of frames, distance."""
    one = tracker(memory=0.5)
    given = [3.0, 0.0, 2.0]
    for k, raw in enumerate(given):
        tracks = one.step(frame(0.1 * k, [[20.0, 0.0]], raw))
    scaled = [(raw - 1.0) / 2.0 for raw in given]
    weight = [math.exp(-0.4), math.exp(-0.2), 1.0]
    recent = sum(w * s for w, s in zip(weight, scaled, strict=True)) / sum(weight)
    away = (20.0 - 30.0) / 15.0
    log_odds = -0.5 + 1.2 * recent + 0.4 * math.log(3 / 5) + 0.9
    log_odds += 0.3 * away - 0.2 * away**2
    row = int(np.argmax(one.density.hypothesis_probability()))
    existence = one.density.local.existence[row]
    assert tracks.score[0] == pytest.approx(existence / (1 + math.exp(-log_odds)), rel=1e-3)
    assert one.inspect().object[0] == pytest.approx(tracks.score[0])


def test_a_miss_changes_no_mean_but_how_steadily_it_is_detected():
    one = tracker()
    for k in range(3):
        one.step(frame(0.1 * k, [[20.0, 0.0]], 2.0))
    before = features(one.density.local.record, np.full(len(one.density.local), 20.0)).max(axis=0)
    one.step(frame(0.3, np.zeros((0, 2)), np.zeros(0)))
    after = features(one.density.local.record, np.full(len(one.density.local), 20.0)).max(axis=0)
    steadily = WEIGHTS.index("detected")
    assert (before[steadily], after[steadily]) == pytest.approx((1.0, 0.75))
    after[steadily] = before[steadily]
    assert after == pytest.approx(before)


def test_a_whole_life_is_told_by_its_end_and_half_a_memory_later():
    """Records at .1 s with a memory of .4 s: two steps later, and all else as at the end."""
    told = np.arange(25.0).reshape(5, 5)
    found = record_by_life(told, np.array([0.0, 0.1, 0.2, 0.3, 0.4]), 0.4)
    assert (found[:, :3] == told[[2, 3, 4, 4, 4], :3]).all()
    assert (found[:, 3:] == told[4, 3:]).all()
    one = record(batch=weights(offset=3.0, detected=0.0), memory=0.4)
    by_life = one.share_by_life(told, np.full(5, 20.0), 0.1 * np.arange(5))
    assert by_life == pytest.approx(one.batch.share(features(found, np.full(5, 20.0))))
    assert record().share_by_life(told, np.full(5, 20.0), 0.1 * np.arange(5)) == pytest.approx(
        weights().share(features(record_by_life(told, 0.1 * np.arange(5), 1.0), np.full(5, 20.0)))
    )


@pytest.mark.parametrize(
    ("label", "away", "expected"),
    [
        (Label.PEDESTRIAN, 0.5, math.log1p(math.exp(3 * 0.75)) / 3),
        (Label.PEDESTRIAN, 0.9, 0.0),
        (Label.TRUCK, 0.5, 0.0),
    ],
    ids=["at its place", "apart", "of an unknown scale"],
)
def test_a_rival_counts_by_its_score_at_the_same_place(label, away, expected):
    one = tracker()
    both = frame(0.0, [[20.0, 0.0], [20.0 + away, 0.0]], [3.0, 1.5], label=[Label.CAR, label])
    one.step(both)
    told = features(one.density.local.record, np.full(len(one.density.local), 20.0))
    assert told[:, WEIGHTS.index("rival")] == pytest.approx(expected)


def test_a_long_life_at_one_score_is_no_certainty():
    """The same score a hundred times says what it said at first: only `count` speaks."""
    one = tracker(weights(count=0.0, detected=0.0))
    scores = [one.step(frame(0.1 * k, [[20.0, 0.0]], 1.2)).score[0] for k in range(100)]
    assert scores[-1] == pytest.approx(scores[9], abs=1e-3)
    assert scores[-1] < 0.5


def test_without_raw_scores_it_is_refused():
    with pytest.raises(InputError, match="reads raw scores"):
        tracker().step(frame(0.0, [[20.0, 0.0]]))
    with pytest.raises(InputError, match="spread is above 0"):
        record(label=Label.TRUCK)


TRUE = np.array([-1.0, 2.0, 0.3, 0.6, -0.4, 0.2, -1.0])


def simulated(rng, weights, n=20_000):
    x = rng.normal(0, 1, (n, len(WEIGHTS)))
    x[:, 0] = 1.0
    existence = rng.uniform(0.3, 1.0, n)
    share = 1 / (1 + np.exp(-x @ weights))
    online = Rows(x, existence, rng.random(n) < existence * share)
    return ModeRows(online, Rows(x, np.ones(n), rng.random(n) < share))


def values(one):
    return np.array([getattr(one, name) for name in WEIGHTS])


def test_weights_are_found_again():
    rng = np.random.default_rng(0)
    told = ModeRows(simulated(rng, TRUE).online, simulated(rng, -TRUE).batch)
    found = fit_records({Label.CAR: told}, (MIDDLE, SPREAD))[Label.CAR]
    assert values(found.online) == pytest.approx(TRUE, abs=0.1)
    assert values(found.batch) == pytest.approx(-TRUE, abs=0.1)


def test_few_objects_borrow_from_labels_like_theirs():
    """Thirty rows of one label alone, and beside twenty thousand of another of the same weights."""
    rng = np.random.default_rng(1)
    few, many = simulated(rng, TRUE, 30), simulated(rng, TRUE)
    spread = np.ones(7)
    alone = fit_records({Label.CYCLIST: few}, (MIDDLE, spread))[Label.CYCLIST]
    both = fit_records({Label.CYCLIST: few, Label.PEDESTRIAN: many}, (MIDDLE, spread))
    apart = fit_records({Label.CYCLIST: few, Label.CAR: many}, (MIDDLE, spread))
    error = [
        np.abs(values(one.online) - TRUE).sum()
        for one in (alone, both[Label.CYCLIST], apart[Label.CYCLIST])
    ]
    assert error[1] < 0.5 * error[0]
    assert error[2] == pytest.approx(error[0], rel=1e-3)


def test_few_sequences_do_not_overrule_what_other_detectors_say_and_many_do():
    rng = np.random.default_rng(2)
    others = [simulated(rng, TRUE), simulated(rng, TRUE, 2000)]
    before = pooled_records({Label.CAR: others}, (MIDDLE, SPREAD))
    assert values(before[Label.CAR].online) == pytest.approx(TRUE, abs=0.2)
    own = TRUE + 1.0
    told = simulated(rng, own, 5_000)
    for mode, few in (("online", 1), ("batch", 3)):
        held, free = (
            values(
                getattr(
                    fit_records({Label.CAR: told}, (MIDDLE, SPREAD), before, sequences=n)[
                        Label.CAR
                    ],
                    mode,
                )
            )
            for n in (few, 30)
        )
        assert np.abs(held - TRUE).sum() < 0.5 * np.abs(own - TRUE).sum()
        assert np.abs(free - own).sum() < 0.15 * np.abs(own - TRUE).sum()


def street_config():
    return PMBMConfig.textbook().changed({"sensor.clutter_rate": 1.0, "sensor.position_sd": 0.1})


def test_rows_of_a_street_tell_its_cars_from_its_poles():
    made = [street(seed) for seed in range(4)]
    scale = score_scale(made, {Label.CAR: street_config()})
    config = neutral_config(street_config(), Label.CAR, scale)
    found = ModeRows.joined([rows(one, Label.CAR, config) for one in made[:3]])
    fitted = fit_records({Label.CAR: found}, scale)[Label.CAR]
    one = PMBMTracker(replace(config, scores=fitted), made[3].site)
    for detections in made[3].detections:
        tracks = one.step(detections)
    cars = made[3].truth[-1].position[:, :2]
    apart = np.hypot(*(tracks.position[:, None, :2] - cars).transpose(2, 0, 1))
    assert (made[3].origin[-1] == CLUTTER).any()
    assert len(tracks)
    assert (apart.min(axis=1) < 1.0).all()


def test_the_scale_is_told_by_what_lasts_without_labels():
    """Rescaled scores give the rescaled scale, truth or none; what lasts is above what does not."""
    made = [street(seed) for seed in range(3)]
    middle, spread = score_scale(made, {Label.CAR: street_config()})
    again = [
        replace(
            one,
            truth=tuple(frame.take(np.zeros(0, np.intp)) for frame in one.truth),
            origin=None,
            detections=tuple(replace(d, raw_score=3 * d.raw_score - 5) for d in one.detections),
        )
        for one in made
    ]
    found = score_scale(again, {Label.CAR: street_config()})
    assert found[0][Label.CAR] == pytest.approx(3 * middle[Label.CAR] - 5)
    assert found[1][Label.CAR] == pytest.approx(3 * spread[Label.CAR])
    assert spread[Label.CAR] > 0


def test_nothing_true_is_nothing_to_fit_to():
    none = Rows(np.ones((3, len(WEIGHTS))), np.ones(3), np.zeros(3, bool))
    with pytest.raises(InputError, match="0 true of 3 rows"):
        fit_records({Label.CAR: ModeRows(none, none)}, (MIDDLE, SPREAD))


def compared():
    """Two frames, two objects: both found at .9 and .6, then one, and a false report at .7."""

    def boxes(x):
        n = len(x)
        return {
            "position": np.column_stack([x, np.zeros(n), np.zeros(n)]),
            "size": np.tile([4.0, 2.0, 1.5], (n, 1)),
            "yaw": np.zeros(n),
            "velocity": np.zeros((n, 2)),
            "label": np.zeros(n, np.int8),
        }

    truth = [
        GroundTruth(
            time=0.1 * k,
            id=np.array([0, 1]),
            visibility=np.ones(2),
            observable=np.ones(2, bool),
            crashed=np.zeros(2, bool),
            **boxes([0.0, 20.0]),
        )
        for k in range(2)
    ]
    tracks = [
        Tracks(time=0.0, id=np.array([5, 6]), score=np.array([0.9, 0.6]), **boxes([0.0, 20.0])),
        Tracks(time=0.1, id=np.array([5, 7]), score=np.array([0.9, 0.7]), **boxes([0.0, 50.0])),
    ]
    return ComparedSequence(truth=tuple(truth), tracks=tuple(tracks), excused=np.zeros(4, bool))


def test_an_operating_point_by_hand():
    by = SimilarityScore(lambda scene, _: pair_overlap(scene), 0.25, "3D IoU of at least .25")
    thresholds = np.array([0.0, 0.65, 0.8])
    found = sweep(by, compared(), thresholds)
    # All: one missed, one false.  Above .65: two missed, one false.  Above .8: two missed.
    assert found.errors.tolist() == [2, 3, 2]
    assert found.truths == 4
    point = operating_point([found], thresholds)
    assert (point.mota, point.best, point.regret) == (0.5, 0.5, 0.0)
    assert point.reported == pytest.approx(0.775)
    assert point.true == pytest.approx(0.75)
    said = np.log([0.9, 0.6, 0.9, 0.3])
    assert point.log_loss == pytest.approx(-said.mean())
    assert point.low is None
    assert (point.spread, point.honest_spread) == (None, None)


def reports(*tracks):
    """One sequence's reports: of each track its rows, and the probability of each."""
    score = np.concatenate([np.full(rows, p) for rows, p in tracks])
    id = np.repeat(np.arange(len(tracks)), [rows for rows, _ in tracks])
    return Sweep(np.array([0]), 1, score, np.ones(len(score), bool), id)


def test_how_far_from_their_mean_honest_reports_come_by_chance():
    """Tracks are true as a whole: what is drawn is few, however many rows they have."""
    # True or not, half of all rows is the difference: nothing is left to chance.
    assert honest_spread([reports((100, 0.5))] * 2) == pytest.approx((0.5, 0.5))
    # One track of .9 in 1000 rows: .1 off in nine cases of ten, .9 in the tenth.
    assert honest_spread([reports((1000, 0.9))]) == pytest.approx((0.1, 0.9))
    # Its rows say .8 and 1: the track is true with their mean.
    mixed = replace(reports((50, 0.8), (50, 1.0)), id=np.zeros(100, int))
    assert honest_spread([mixed]) == pytest.approx((0.1, 0.9))
    # Every row a track of its own: binomial, by scipy.
    alone = replace(reports((400, 0.8)), id=np.arange(400))
    off = np.abs(binom(400, 0.8).rvs(size=200_000, random_state=1) / 400 - 0.8)
    assert honest_spread([alone]) == pytest.approx(tuple(np.quantile(off, [0.5, 0.95])), abs=0.003)


def test_what_chance_makes_of_few_tracks_stands_beside_what_is_measured():
    thresholds = np.array([0.0])
    point = operating_point([reports((100, 0.9)), reports((100, 0.9)), reports((99, 0.1))],
                            thresholds)  # fmt: skip
    assert point.spread == pytest.approx(0.1)
    # Of two tracks of .9 at least one is false in 19 % of all cases: then .64 or more.
    assert point.honest_spread == pytest.approx((0.1, np.sqrt((0.9**2 + 0.1**2) / 2)))


def test_a_detector_is_told_by_its_scores_and_their_number():
    here = Detector((-2.0, -1.0, 0.0, 2.0, 4.0), 5.0)
    assert here.differs(Detector((-2.1, -1.2, 0.3, 2.2, 4.5), 4.0)) is None
    assert "not from" in here.differs(Detector((-0.5, 1.0, 4.0, 9.0, 13.0), 5.0))
    assert "boxes a frame" in here.differs(Detector((-2.0, -1.0, 0.0, 2.0, 4.0), 30.0))
    assert here.differs(Detector((), 0.0)) is None
    with pytest.raises(InputError, match="not a detector's table"):
        read_detectors({"Car": {"scores": 3}}, ["Car"])


def test_the_detector_of_recordings_is_that_of_all_their_frames():
    made = street(0)
    scores = np.concatenate([one.raw_score for one in made.detections])
    found = Detector.of([made], Label.CAR)
    assert found.scores[2] == pytest.approx(np.median(scores), rel=1e-3)
    assert found.boxes == pytest.approx(len(scores) / len(made.detections), rel=1e-3)
    assert Detector.of([made], Label.CYCLIST).scores == ()


def test_no_detections_have_no_scale():
    made = street(0)
    empty = tuple(Detections.empty(one.time) for one in made.detections)
    bare = replace(made, detections=empty, origin=None)
    middle, spread = quantile_scale([bare], [Label.CAR])
    assert not middle.any()
    assert not spread.any()
