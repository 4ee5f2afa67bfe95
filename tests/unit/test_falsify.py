"""The search finds what breaks a tracker and makes it small."""

import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

from pmbm.cli.falsify import command
from pmbm.errors import InputError
from pmbm.sim import load_scenario
from pmbm.sim.search.falsify import Knob, search, swept_knobs
from pmbm.types import Tracks


def test_a_planted_corner_is_found_and_only_what_matters_stays():
    knobs = [Knob("a.x", 0.0, 10.0, 0.0), Knob("a.y", 0.0, 10.0, 1.0), Knob("z", 0, 8, 2, True)]

    def badness(document):
        table = {"a": {"x": 0.0, "y": 1.0}, "z": 2, **document}
        return 5.0 if table["a"].get("x", 0) > 7 and table["z"] > 4 else table["a"].get("y", 1) / 9

    document = {
        "a": {"y": 1.0},
        "duration": 16.0,
        "scene": {"actors": {"p": {}, "q": {"count": 9}}},
    }
    finding = search(document, badness, knobs, budget=80, limit=2.0)
    assert finding.changed.keys() == {"a.x", "z"}
    assert 7 < finding.changed["a.x"] < 8
    assert finding.changed["z"] == 5
    assert finding.document["duration"] == 2
    assert finding.document["scene"]["actors"] == {}
    assert (finding.value, finding.rest) == (5.0, 1 / 9)


def test_nothing_is_found_where_nothing_fails_and_impossible_documents_are_passed_over():
    def badness(document):
        if document["x"] > 1:
            raise InputError("impossible")
        return 0.0

    knobs = [Knob("x", 0.0, 10.0, 0.0)]
    assert search({"x": 0.0}, badness, knobs, budget=20) is None
    assert search({"x": 0.0}, badness, knobs, budget=20, limit=3.0) is None


def test_swept_parameters_are_varied_between_their_levels():
    (knob,) = swept_knobs(load_scenario("empty_clutter"))
    assert (knob.key, knob.least) == ("detector.clutter.rate", 0.0)
    assert knob.most >= 50.0


class Gullible:
    """Reports every detection as a track."""

    def step(self, detections):
        n = len(detections)
        return Tracks(
            time=detections.time,
            id=np.arange(n),
            position=detections.position,
            size=detections.size,
            yaw=detections.yaw,
            velocity=np.zeros((n, 2)),
            score=np.ones(n),
            label=detections.label,
        )


def falsify(*arguments):
    return CliRunner().invoke(command, list(arguments), catch_exceptions=False)


def test_the_command_writes_a_scenario_that_fails_again(tmp_path):
    out = tmp_path / "worst.toml"
    result = falsify(
        *("single_straight", "--tracker", f"{__name__}:Gullible", "--metric", "gospa"),
        *("--vary", "detector.clutter.rate", "0", "20", "--budget", "6"),
        *("--out", str(out)),
    )
    assert result.exit_code == 1, result.output
    document = tomllib.loads(out.read_text(encoding="utf-8"))
    assert document["detector"]["clutter"]["rate"] > 1
    assert document["duration"] < load_scenario("single_straight").form.duration
    again = load_scenario(out)
    assert again.name == "single_straight_falsified"
    assert "pmbm run" in out.read_text(encoding="utf-8")
    assert len(again.record(0).detections[0]) >= 1


def test_mistakes_are_named():
    with pytest.raises(InputError, match="'gospa'"):
        falsify("single_straight", "--metric", "gosp")
    with pytest.raises(InputError, match="clutter"):
        falsify("single_straight", "--vary", "detector.cluter.rate", "0", "3")
    with pytest.raises(
        InputError, match=r"--vary detector.clutter.rate.*LEAST below MOST, got 3 1"
    ):
        falsify("single_straight", "--vary", "detector.clutter.rate", "3", "1")
