"""The compiled step against the plain filter: every table of every step, from one state each."""

from __future__ import annotations

import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from pmbm import PMBMConfig, Tracks, kernels
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
