"""What several sensors are worth: both against each alone and against their tracks fused, on paired
seeds; what the loss of one costs; and what a wrong belief about one costs.

python -m pytest tests/statistical/test_sensors_proof.py -m slow -s       prints the tables
"""

import os
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pmbm import PMBMConfig, PMBMTracker, evaluate, run
from pmbm.by_sensor import OneSensor, TracksPerSensor
from pmbm.filter import DetectionChain, FixedDetection, Sensor
from pmbm.geometry import wrap_angle
from pmbm.sim.scenario.scenario import Scenario, load_scenario
from pmbm.types import TrackSequence

sys.path.insert(0, str(Path(__file__).parent))
from occlusion_trials import mean_interval

pytestmark = pytest.mark.slow

SEEDS = int(os.environ.get("PMBM_SENSOR_SEEDS", "50"))
FIRST_SEED = 20002100
LEVELS = {"blind_spot": 120, "lidar_radar": 10, "sensor_failure": 6}
FAILS_AT = 6.0
"""s, of sensor_failure at that level."""
LOSS = 0.02
"""m of GOSPA that the loss of a sensor may cost beyond never having had it."""


def detected(probability):
    return DetectionChain(base=FixedDetection(probability=probability))


LIDAR = Sensor(position_sd=0.4, clutter_rate=10.0, detection=detected(0.85))
RADAR = Sensor(
    range_sd=0.35,
    azimuth_sd=0.0105,
    radial_velocity_sd=0.3,
    clutter_rate=4.0,
    detection=detected(0.85),
    describes=False,
)
ROOF = Sensor(position_sd=0.4, clutter_rate=2.0)
SENSORS = {
    "blind_spot": {"front": ROOF, "rear": replace(ROOF, clutter_rate=1.0)},
    "lidar_radar": {"lidar": LIDAR, "radar": RADAR},
    "sensor_failure": {"lidar": LIDAR, "radar": RADAR},
}
"""What the tracker assumes of each sensor: rounded from its profile."""


@cache
def recordings(name):
    scenario = load_scenario(f"{name}@{LEVELS[name]:g}")
    return [scenario.record(seed) for seed in range(FIRST_SEED, FIRST_SEED + SEEDS)]


def fused(sensors):
    config = PMBMConfig(sensors=sensors)
    return lambda site: PMBMTracker(config, site)


def alone(sensor, sensors):
    return lambda site: OneSensor(sensor, "pmbm", {"sensors": sensors}, site)


def apart(sensors):
    return lambda site: TracksPerSensor("pmbm", {"sensors": sensors}, site=site)


def scores(scenes, make, since=0.0, looks=None):
    """GOSPA, IDF1 and id switches (SEEDS,3) of a tracker from a time on, in all frames or in those
    in which the sensor of the name `looks` does."""
    found = []
    for one in scenes:
        tracks = run(make(one.site), one)
        times = {step.time for step in one.detections if looks in (None, step.sensor)}
        kept = [k for k, step in enumerate(tracks) if step.time >= since and step.time in times]
        late = TrackSequence(steps=[tracks[k] for k in kept], frame=tracks.frame[kept])
        values = evaluate(one, late).scalars()
        found.append([values["gospa"], values["idf1"], values["id_switches"]])
    return np.array(found, float)


def table(title, rows, first):
    """Rows of means, and of differences from the first with their 95 % intervals."""
    lines = [f"\n{title}: {SEEDS} seeds from {FIRST_SEED}"]
    for name, values in rows.items():
        line = f"  {name:44s} GOSPA {values[:, 0].mean():6.3f}  IDF1 {values[:, 1].mean():.3f}  "
        line += f"switches {values[:, 2].mean():5.2f}"
        if name != first:
            for k, what in ((0, "GOSPA"), (1, "IDF1")):
                mean, low, high = mean_interval(values[:, k] - rows[first][:, k])
                line += f"   {what} {mean:+.3f} [{low:+.3f}, {high:+.3f}]"
        lines.append(line)
    return "\n".join(lines)


@pytest.mark.parametrize("name", ["blind_spot", "lidar_radar"])
def test_two_sensors_are_better_than_either_and_than_their_tracks_fused(name, verified, capsys):
    scenes, sensors = recordings(name), SENSORS[name]
    rows = {"both": scores(scenes, fused(sensors))}
    rows |= {f"{one} alone": scores(scenes, alone(one, sensors)) for one in sensors}
    rows["tracks of each, fused"] = scores(scenes, apart(sensors))
    with capsys.disabled():
        print(table(name, rows, "both"))
    for rival in list(rows)[1:]:
        gain, low, high = mean_interval(rows[rival][:, 0] - rows["both"][:, 0])
        identity, worst, best = mean_interval(rows["both"][:, 1] - rows[rival][:, 1])
        verified(
            id="sensors_gain",
            what=f"{name}: GOSPA of {rival} less that of both sensors in one filter, m, 95 % "
            f"interval {low:.3f} to {high:.3f}; IDF1 of both less, {identity:.3f}, {worst:.3f} to "
            f"{best:.3f}; {SEEDS} paired seeds",
            figure=f"{gain:.3f}",
            bound=0.0,
            verdict=low > 0,
        )
        assert low > 0
        assert best > 0


@pytest.mark.filterwarnings("ignore:at .* is taken for blind:pmbm.errors.InputWarning")
def test_a_sensor_that_fails_costs_no_more_than_doing_without_it(verified, capsys):
    """After the radar has fallen silent, or blind, against the lidar alone all along, in the frames
    in which the lidar looks: a silent radar makes none, and between them the lidar alone reports
    what it said last, in view or not."""
    sensors = SENSORS["sensor_failure"]
    silent = recordings("sensor_failure")
    unfailing = recordings_unfailing()
    blind = [blinded(one) for one in unfailing]
    clutter = [with_clutter_alone(one) for one in unfailing]
    useless = {**sensors, "radar": replace(sensors["radar"], detection=detected(0.01))}
    false_boxes = "both, the radar delivering false boxes alone"
    rows = {
        name: scores(scenes, tracker, FAILS_AT, looks="lidar")
        for name, scenes, tracker in (
            ("lidar alone", silent, alone("lidar", sensors)),
            ("both, the radar silent", silent, fused(sensors)),
            ("both, the radar blind (empty deliveries)", blind, fused(sensors)),
            (false_boxes, clutter, fused(sensors)),
            (f"{false_boxes}, as the tracker is told", clutter, fused(useless)),
        )
    }
    with capsys.disabled():
        print(table(f"sensor_failure, from {FAILS_AT:g} s on", rows, "lidar alone"))
    for name in list(rows)[1:]:
        cost, low, high = mean_interval(rows[name][:, 0] - rows["lidar alone"][:, 0])
        # Its misses may as well mean that objects are hidden from it: nothing makes up for them.
        unnoticed = name == false_boxes
        verified(
            id="sensors_failure",
            what=f"GOSPA after the failure, {name}, less that of the lidar alone, m, 95 % interval "
            f"{low:.3f} to {high:.3f}; {SEEDS} paired seeds",
            figure=f"{cost:.3f}",
            bound=None if unnoticed else LOSS,
            verdict="report" if unnoticed else high <= LOSS,
        )
        assert unnoticed or high <= LOSS


def recordings_unfailing():
    scenario = load_scenario("sensor_failure@0")
    return [scenario.record(seed) for seed in range(FIRST_SEED, FIRST_SEED + SEEDS)]


def blinded(recording):
    """The radar goes on delivering, and sees nothing."""
    detections = [
        one.take(np.zeros(len(one), bool))
        if one.sensor == "radar" and one.time >= FAILS_AT
        else one
        for one in recording.detections
    ]
    return replace(recording, detections=detections, origin=None)


def with_clutter_alone(recording):
    """The radar goes on delivering false boxes, and sees nothing."""
    detections = [
        one.take(origin < 0) if one.sensor == "radar" and one.time >= FAILS_AT else one
        for one, origin in zip(recording.detections, recording.origin, strict=True)
    ]
    return replace(recording, detections=detections, origin=None)


def misplaced(recording, sensor, metres, degrees):
    """The vehicle believes this sensor to be mounted elsewhere, and turned."""

    def moved(one):
        if one.sensor != sensor:
            return one
        pose, turn = one.sensor_pose, np.deg2rad(degrees)
        said = pose + np.array([-metres * np.sin(pose[2]), metres * np.cos(pose[2]), turn])
        offset = one.position[:, :2] - pose[:2]
        cos, sin = np.cos(turn), np.sin(turn)
        place = said[:2] + offset @ np.array([[cos, sin], [-sin, cos]])
        return replace(
            one,
            position=np.column_stack([place, one.position[:, 2]]),
            yaw=wrap_angle(one.yaw + turn),
            sensor_pose=said,
        )

    return replace(recording, detections=[moved(one) for one in recording.detections], origin=None)


@pytest.mark.filterwarnings("ignore:at .* the mounts:pmbm.errors.InputWarning")
def test_a_sensor_wrongly_believed(verified, capsys):
    """What is lost where the tracker's belief about one sensor is wrong."""
    scenes, sensors = recordings("lidar_radar"), SENSORS["lidar_radar"]
    right = "both, rightly believed"
    rows = {right: scores(scenes, fused(sensors))}
    for name, model in sensors.items():
        noisy = {
            field: 2.0 * getattr(model, field)
            for field in ("position_sd", "range_sd", "azimuth_sd", "radial_velocity_sd")
            if getattr(model, field) is not None
        }
        wrong = {
            "twice its noise": replace(model, **noisy),
            "half its P_D": replace(model, detection=detected(0.425)),
        }
        for what, belief in wrong.items():
            rows[f"{name} believed to have {what}"] = scores(
                scenes, fused({**sensors, name: belief})
            )
        elsewhere = [misplaced(one, name, 1.0, 2.0) for one in scenes]
        off = f"{name} mounted 1 m and 2 degrees off"
        (other,) = sensors.keys() - {name}
        sure = {**sensors, other: replace(sensors[other], align=False)}
        believed = {each: replace(one, align=False) for each, one in sensors.items()}
        rows[off] = scores(elsewhere, fused(sensors))
        rows[f"{off}, the {other}'s mount sure"] = scores(elsewhere, fused(sure))
        rows[f"{off}, none aligned"] = scores(elsewhere, fused(believed))
    rows |= {f"{one} alone": scores(scenes, alone(one, sensors)) for one in sensors}
    with capsys.disabled():
        print(table("lidar_radar, wrong beliefs", rows, right))
    for name in list(rows)[1:]:
        cost, low, high = mean_interval(rows[name][:, 0] - rows[right][:, 0])
        verified(
            id="sensors_believed",
            what=f"GOSPA, {name}, less that of right beliefs, m, 95 % interval {low:.3f} to "
            f"{high:.3f}; {SEEDS} paired seeds",
            figure=f"{cost:.3f}",
            verdict="report",
        )
    for name in sensors:
        off = f"{name} mounted 1 m and 2 degrees off"
        _, low, _ = mean_interval(rows[f"{off}, none aligned"][:, 0] - rows[off][:, 0])
        assert low > 0


SECOND = {
    "one more alike": ({}, {}),
    "a radar": ({"detector": {"profile": "radar"}}, {"second": RADAR}),
}


@pytest.mark.parametrize("other", SECOND)
def test_what_a_second_sensor_costs(other, verified, capsys):
    """Two sensors, each at the rate of the one: CPU time of steps in all, and by local hypothesis
    that they look at.  Of a radar, with three components and a covariance of each measurement, it
    is reported alone."""
    document = {**load_scenario("density").document, "duration": 5.0}
    described, models = SECOND[other]
    second = {"mount": [2.0, 0.0, 0.0], **described}
    several = {**document, "sensors": {"first": {}, "second": second}}
    for objects in (10, 50):
        one, two = (Scenario(each).at(objects).record(1) for each in (document, several))
        alone_s, alone_n = min(cost(one) for _ in range(5))
        both_s, both_n = min(cost(two, models) for _ in range(5))
        in_all, each = both_s / alone_s, (both_s / both_n) / (alone_s / alone_n)
        with capsys.disabled():
            print(f"\n{other}, {objects} objects: {in_all:.2f} in all, {each:.2f} a hypothesis")
        what = (
            f"CPU time of two sensors, the second {other}, each at the rate of the one, over that "
            f"of one, {objects} objects; {each:.2f} a local hypothesis that a step looks at, of "
            f"which there are {both_n / alone_n:.2f} times as many"
        )
        if other == "a radar":
            verified("sensors_cost", what, round(in_all, 2))
            continue
        verified("sensors_cost", what, round(in_all, 2), 3.2, bool(in_all <= 3.2 and each <= 2.2))
        assert in_all <= 3.2
        assert each <= 2.2


def cost(recording, models=None):
    """CPU time of all steps, s, and the local hypotheses after each, added up."""
    config = PMBMConfig(sensors=models or {})
    tracker, seconds, hypotheses = PMBMTracker(config, recording.site), 0.0, 0
    for delivery in recording.handed_over():
        start = time.process_time()
        tracker.step(recording.detections[delivery])
        seconds += time.process_time() - start
        hypotheses += len(tracker.density.local)
    return seconds, hypotheses
