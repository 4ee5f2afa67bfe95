"""What docs/guide/sensors.md and studies/sensors.toml say can be done as it stands there."""

import re
import tomllib
from pathlib import Path

from pmbm import run
from pmbm.cli.sources import resolve
from pmbm.sim.scenario.scenario import Scenario, load_scenario
from pmbm.study.configured import ConfiguredTracker, follow
from pmbm.study.file import load_study

ROOT = Path(__file__).parents[2]


def test_the_page_describes_a_vehicle_that_can_be_recorded_and_tracked():
    text = (ROOT / "docs" / "guide" / "sensors.md").read_text(encoding="utf-8")
    vehicle, tracker = map(tomllib.loads, re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    recording = Scenario({**vehicle, "duration": 1.0}).record(0)
    looks = [sum(one.sensor == name for one in recording.detections) for name in ("lidar", "radar")]
    assert looks == [10, 20]
    assert recording.site.latency == 0.05
    mine = tracker["tracker"]["mine"]
    made = ConfiguredTracker(mine["factory"], tuple(mine["parameters"].items()))(recording.site)
    assert made.config.sensors["radar"].range_sd == 0.35
    tracks = run(made, recording)
    assert len(tracks) == 20
    assert max(len(one) for one in tracks) > 0


def test_the_files_of_the_page_lie_side_by_side(tmp_path):
    text = (ROOT / "docs" / "guide" / "sensors.md").read_text(encoding="utf-8")
    blocks = re.findall(r"`(\w+\.toml)`, for `pmbm .*?```toml\n(.*?)```", text, re.DOTALL)
    for name, block in blocks:
        (tmp_path / name).write_text(block)
    study = load_study(tmp_path / "mine_study.toml", resolve)
    assert [name for name, _ in blocks] == ["mine.toml", "mine_study.toml"]
    assert list(study.trackers) == ["mine", "pmbm"]


def test_the_study_of_the_page_can_be_run():
    study = load_study(ROOT / "studies" / "sensors.toml", resolve)
    scenario = load_scenario("lidar_radar")
    recording = Scenario({**scenario.document, "duration": 1.0}, scenario.file).record(0)
    for name, tracker in study.cells[0].trackers.items():
        assert len(follow(tracker, recording, 0)) == 20, name
