"""The study of what each option does on its own: one option apart from the textbook, each."""

from __future__ import annotations

import dataclasses
from operator import attrgetter
from pathlib import Path

import pytest

from pmbm.cli.sources import resolve
from pmbm.filter import PMBMConfig
from pmbm.study.file import load_study
from pmbm.tracking import make_tracker
from pmbm.types import Site

ROOT = Path(__file__).parents[2]
STUDY = ROOT / "studies" / "preset_options.toml"
PAGE = ROOT / "docs" / "results" / "presets.md"
OPTIONS = {
    "scores-first": {"scores"},
    "rising": {"sensor.detection"},
    "falling": {"sensor.detection"},
    "miss-scaled": {"sensor.miss_rule"},
    "occlusion": {"sensor.occlusion"},
    "scores-everywhere": {"scores"},
    "scores-lasting": {"scores"},
    "visibility": {"sensor.detection"},
    "exclusive": {"report.exclusive"},
}
"""Tracker of the study -> what tells it from the textbook."""


@pytest.fixture(scope="module")
def trackers():
    return load_study(STUDY, resolve).cells[0].trackers


def config_of(tracker):
    return make_tracker(tracker.bound(), Site()).config


def differences(one, other, path=""):
    """Dotted names of what two configurations differ in; a part of another kind is one name."""
    if one == other:
        return set()
    if not path or (dataclasses.is_dataclass(one) and type(one) is type(other)):
        return {
            name
            for field in dataclasses.fields(one)
            for name in differences(
                getattr(one, field.name), getattr(other, field.name), f"{path}.{field.name}"
            )
        }
    return {path.removeprefix(".")}


def test_each_is_the_textbook_but_for_its_option(trackers):
    for name, options in OPTIONS.items():
        assert differences(config_of(trackers[name]), PMBMConfig.textbook()) == options, name


def test_the_options_together_are_the_presets(trackers):
    """What the single options are set to is what the presets set them to."""
    paper, default = PMBMConfig.paper(), PMBMConfig()
    assert config_of(trackers["scores-first"]).scores == paper.scores
    assert config_of(trackers["falling"]).sensor.detection == paper.sensor.detection
    assert config_of(trackers["miss-scaled"]).sensor.miss_rule == paper.sensor.miss_rule
    for name in ("occlusion", "scores-lasting", "visibility", "exclusive"):
        config = config_of(trackers[name])
        for option in OPTIONS[name]:
            assert attrgetter(option)(config) == attrgetter(option)(default)
    assert set(trackers) == {*OPTIONS, "pmbm-textbook", "pmbm-paper", "pmbm"}


def test_the_page_shows_every_tracker_and_scenario(trackers):
    page = PAGE.read_text(encoding="utf-8")
    for name in [*trackers, *(cell.scenario for cell in load_study(STUDY, resolve).cells)]:
        assert name in page
