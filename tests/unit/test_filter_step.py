"""The compiled step against the plain filter: every table of every step, from one state each."""

from __future__ import annotations

import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from filter_problems import bernoullis
from mark_builders import delivery

from pmbm import PMBMConfig, Site, Tracks, kernels
from pmbm.filter import (
    BirthMap,
    BroadBirth,
    DetectionChain,
    DetectionFromScores,
    EveryScore,
    FixedDetection,
    ObjectClasses,
    Reduction,
    Report,
    Sensor,
    State,
    compiled,
    tracker,
)
from pmbm.filter.density import Density, Globals, Mixture, starts
from pmbm.filter.hypotheses.clusters import factor, merge_equal
from pmbm.filter.hypotheses.weights import normalised
from pmbm.filter.models.score_record import RecordWeights, ScoreRecord
from pmbm.labels import Label
from pmbm.score import ScoreModel
from pmbm.sim import load_scenario

native = pytest.importorskip("pmbm._native", reason="installed without a compiler")

CONFIGS = {
    "default": PMBMConfig(),
    "textbook": PMBMConfig.textbook(),
    "paper": PMBMConfig.paper(),
    "map": PMBMConfig(birth=BirthMap()),
    "every score": PMBMConfig(scores=EveryScore()),
    "classes": PMBMConfig(
        scores=ObjectClasses.simple(persistent_clutter=0.2, score=ScoreModel.trusting())
    ),
    "chain of scores": PMBMConfig(
        sensor=Sensor(detection=DetectionChain(base=DetectionFromScores(rising=True)))
    ),
    "boxes and history": PMBMConfig(
        birth=BroadBirth(merge_below=0.0),
        sensor=Sensor(detection=FixedDetection(), occlusion=False, box_gain=0.4),
        report=Report(exclusive=False, history=4),
    ),
    "record": PMBMConfig(
        scores=ScoreRecord(
            label=Label.CAR,
            middle=np.zeros(7),
            spread=np.ones(7),
            online=RecordWeights(offset=-1.0, score=2.0, detected=1.0),
        )
    ),
    "one table": PMBMConfig.textbook().changed(
        {"reduction.clustering": False, "reduction.max_hypotheses": 50}
    ),
    "few of everything": PMBMConfig().changed(
        {
            "reduction.max_hypotheses": 5,
            "reduction.max_tracks": 8,
            "reduction.max_undetected": 10,
            "reduction.recycle_below": 0.2,
        }
    ),
}
SCENARIOS = (
    "crossing",
    "truck_occlusion",
    "intersection_buildings",
    "duplicates",
    "blind_spot",
)
LIDAR = Sensor(position_sd=0.4, clutter_rate=10.0)
RADAR = Sensor(
    range_sd=0.35, azimuth_sd=0.0105, radial_velocity_sd=0.3, clutter_rate=4.0, describes=False
)
SEVERAL = {
    "default": PMBMConfig(sensors={"lidar": LIDAR, "radar": RADAR}),
    "map": PMBMConfig(birth=BirthMap(), sensors={"lidar": LIDAR, "radar": RADAR}),
    "positions of a radar, most of them in no gate, and no track given up": PMBMConfig(
        sensors={"lidar": LIDAR, "radar": replace(RADAR, radial_velocity_sd=None, gate=0.5)},
        reduction=Reduction(recycle_below=0.0),
    ),
    "round positions and radial velocities": PMBMConfig(
        sensor=Sensor(position_sd=1.0, radial_velocity_sd=0.3, box_gain=0.3),
        scores=EveryScore(),
        reduction=Reduction(recycle_below=0.2),
    ),
    "paper": replace(PMBMConfig.paper(), sensors={"radar": RADAR}),
}
"""Models of a lidar and a radar."""
EVERYDAY = 25
"""Steps of each recording that the everyday test looks at."""


def tables(advanced):
    """The columns of a density, and of what is said of its tracks, by name; what was recycled from
    nothing is that everywhere."""
    density = advanced.density
    ppp, local, table = density.undetected, density.local, density.hypotheses
    none = np.zeros(len(ppp))
    recycled = ppp.recycled_from
    columns = (none - 1, none, none) if recycled is None else recycled.columns()
    found = dict(zip(("track", "share", "recycled"), columns, strict=True))
    for part, names in (
        (ppp, ("log_weight", "mean", "cov")),
        (
            local,
            ("track", "existence", "mean", "cov", "box", "label", "newest", "shown", "history"),
        ),
        (local, ("record",)),
        (advanced.marginal, ("existence", "of_class", "best")),
        (advanced, ("inside",)),
        (local.marks, ("source", "confidence", "detectable")),
        (table, ("cluster", "log_weight", "start", "member")),
        (density, ("track_id", "detections_seen", "undetected_settled")),
    ):
        kind = "Advanced" if part is advanced else type(part).__name__
        found |= {f"{kind}.{name}": np.asarray(getattr(part, name)) for name in names}
    return found


def check_steps(config, recording, steps):
    """Both kernels go on from the state that the compiled one has reached."""
    state, site = State.initial(config), recording.site
    for count, detections in enumerate(recording.detections[:steps]):
        if state.started and detections.time < state.time:
            continue
        # What scores are, some models read on another scale.
        detections = replace(detections, raw_score=4 * detections.score - 2)
        frame, state = tracker._next_frame(config, site, state, detections)
        if len(site.sensors) > 1 and count % 5 == 4:
            check_step(config, site, state, frame.blinded())
        state = check_step(config, site, state, frame)


def check_step(config, site, state, frame):
    """The state after it."""
    assert compiled.has(frame)
    fast = compiled.advance(native, config, site, state.density, frame)
    # Whether it goes on from what the step before it left, or from the tables of that.
    afresh = compiled.advance(native, config, site, replace(state.density), frame)
    check_columns(tables(afresh), tables(fast))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(kernels, "native", None)
        plain = tracker.advance(config, site, state.density, frame)
        _, plainly = tracker.report(config, state, frame, fast)
    dropped = plain.removed.undetected_dropped
    assert fast.removed.undetected_dropped == pytest.approx(dropped, rel=1e-9, abs=1e-12)
    assert replace(fast.removed, undetected_dropped=dropped) == plain.removed
    check_columns(tables(fast), tables(plain))
    after, reported, _ = tracker._after(config, site, state, frame)
    names = [field.name for field in fields(Tracks) if field.name != "undetected"]
    check_columns(*({name: getattr(of, name) for name in names} for of in (reported, plainly)))
    return after


def check_columns(fast, plain):
    for name in fast:
        one, other = np.asarray(fast[name]), np.asarray(plain[name])
        assert one.shape == other.shape, name
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name, equal_nan=False)
        if one.dtype.kind in "iu":
            np.testing.assert_array_equal(one, other, err_msg=name)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("name", CONFIGS)
def test_the_compiled_step_is_the_plain_one(name, scenario):
    if name == "one table" and scenario == "duplicates":
        pytest.skip("one table over so many doubtful tracks has thousands of equal weights")
    check_steps(CONFIGS[name], load_scenario(scenario).record(seed=101), EVERYDAY)


@pytest.mark.parametrize("scenario", ["lidar_radar", "sensor_failure"])
@pytest.mark.parametrize("name", SEVERAL)
def test_the_compiled_step_of_several_sensors_is_the_plain_one(name, scenario):
    recording = load_scenario(scenario).record(seed=103)
    in_order = sorted(recording.detections, key=lambda one: one.time)
    check_steps(SEVERAL[name], _With(recording.site, in_order), 2 * EVERYDAY)


def random_table(seed):
    """A mixture of a few clusters, in which some tracks move together, and the tracks (H,)."""
    random = np.random.default_rng(seed)
    cluster, weight, rows, track = [], [], [], []
    for c in range(6):
        locals_of = []
        for _ in range(random.integers(1, 6)):
            locals_of.append(len(track) + np.arange(random.integers(1, 4)))
            track += [track[-1] + 1 if track else 0] * len(locals_of[-1])
        count = int(random.integers(1, 30))
        picks = [random.integers(-1, len(own), count) for own in locals_of]
        for one, other in zip(picks[:-1:3], picks[1::3], strict=False):
            other[:] = np.minimum(other, one)
        for row in range(count):
            rows.append(
                [own[p[row]] for own, p in zip(locals_of, picks, strict=True) if p[row] >= 0]
            )
        cluster += [c] * count
        weight.append(random.dirichlet(np.ones(count)))
    member = np.array([m for row in rows for m in row], dtype=np.intp)
    table = Globals(
        np.array(cluster),
        np.log(np.concatenate(weight)),
        starts(np.array([*map(len, rows)])),
        member,
    )
    return table, np.array(track)


LIMITS = {
    "nothing": {"recycle_below": 0.0},
    "prune": {"prune_hypothesis": 0.02},
    "cap": {"max_hypotheses": 3},
    "recycle": {"recycle_below": 0.4},
    "forget": {"recycle_below": 0.4, "recycle": False},
    "few tracks": {"recycle_below": 0.2, "max_tracks": 7},
    "in one": {"clustering": False, "recycle_below": 0.4, "prune_hypothesis": 0.02},
    "factor a little": {"split_below": 0.02},
    "factor": {"split_below": 0.15, "recycle_below": 0.1},
    "factor all": {"split_below": 10.0},
}
SIZES = {
    "as they are": {},
    "small tables": {"clusters.largest_table": lambda _: 60},
    "short searches": {"branching.LARGEST_SEARCH": 25},
}
"""Limits that scenes seldom reach."""


def random_state(seed, config):
    """Tracks of such a table, each a few hypotheses around a place, two places to a cluster."""
    table, track = random_table(seed)
    random, H = np.random.default_rng(seed), len(track)
    if not config.reduction.clustering:
        table = replace(table, cluster=np.zeros_like(table.cluster))
        table = replace(table, log_weight=normalised(table.log_weight, table.cluster))
    place = random.uniform(-40, 40, (track.max() + 1, 2))
    mean = np.column_stack([place[track] + random.normal(size=(H, 2)), random.normal(size=(H, 2))])
    history = np.zeros((H, 1), np.int32)
    local = replace(
        bernoullis(track, random.random(H), mean, np.tile(np.eye(4), (H, 1, 1)), history=history),
        newest=np.arange(H),
        shown=random.random(H) < 0.3,
    )
    density = Density(Mixture.empty(), local, table, 10 * np.arange(track.max() + 1), 1000)
    return replace(State.initial(config), time=0.0, density=density), place


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", LIMITS)
def test_the_compiled_step_of_any_hypotheses_is_the_plain_one(monkeypatch, name, size):
    """Clusters that stay apart, that measurements tie together, and measurements alone."""
    monkeypatch.setattr("pmbm.filter.hypotheses.clusters.WORTH_FACTORING", 8)
    for where, value in SIZES[size].items():
        monkeypatch.setattr(f"pmbm.filter.hypotheses.{where}", value)
    config = replace(PMBMConfig.textbook(), reduction=Reduction(**LIMITS[name]))
    for seed in range(6):
        state, place = random_state(seed, config)
        random = np.random.default_rng([7, seed])
        near = place[random.integers(0, len(place), random.integers(0, 9))]
        z = np.concatenate([near + random.normal(size=near.shape), random.uniform(-40, 40, (2, 2))])
        frame, state = tracker._next_frame(config, Site(), state, delivery(0.1, z))
        check_step(config, Site(), state, frame)


def test_the_reductions_had_something_to_do():
    table, track = random_table(0)
    merged = merge_equal(table)
    found = [factor(merged, track, tolerance).clusters for tolerance in (1e-9, 0.15, 10.0)]
    assert merged.clusters <= found[0] < found[1] < found[2]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["default", "textbook", "paper", "map"])
def test_the_compiled_step_is_the_plain_one_in_every_scenario(name):
    from pmbm.sim import scenario_names

    for scenario in scenario_names():
        recording = load_scenario(scenario).record(seed=102)
        check_steps(CONFIGS[name], recording, 60 if len(recording.detections[0]) < 60 else 10)


@pytest.mark.slow
@pytest.mark.skipif("PMBM_DATA" not in os.environ, reason="PMBM_DATA is not set")
@pytest.mark.parametrize("sequence", ["0004", "0012"])
def test_the_compiled_step_is_the_plain_one_on_kitti(sequence):
    from pmbm.cli.track import class_trackers, preset
    from pmbm.datasets import open_dataset
    from pmbm.tracking import seen_by

    root = Path(os.environ["PMBM_DATA"]) / "kitti"
    dataset = open_dataset(
        "kitti",
        root=root,
        detections=str(root / "detections" / "pointrcnn_{class}"),
        poses=root / "pose",
    )
    recording = dataset.recording(sequence, truth=False)
    for label, made in class_trackers(dataset, "pmbm", preset("kitti", "pmbm")).items():
        one = made(recording.site)
        own = [seen_by(one, label, frame) for frame in recording.detections]
        check_steps(one.config, _With(recording.site, own), 150)


class _With:
    def __init__(self, site, detections):
        self.site, self.detections = site, detections
