"""The study of what each option does on its own: one option apart from the textbook, each."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from pmbm.cli.sources import resolve
from pmbm.filter import PMBMConfig, Visibility
from pmbm.study import Study
from pmbm.tracking import make_tracker
from pmbm.types import Site

ROOT = Path(__file__).parents[2]
STUDY = ROOT / "studies" / "preset_options.toml"
PAGE = ROOT / "docs" / "presets.md"
NEUTRAL = Visibility(unseen=1.0, stay_seen=0.97, stay_unseen=0.8)
OPTIONS = {
    "scores-first": {"scores"},
    "rising": {"detection_from_scores"},
    "falling": {"detection_from_scores"},
    "miss-scaled": {"miss_rule"},
    "occlusion": {"occlusion"},
    "scores-everywhere": {"scores"},
    "scores-lasting": {"scores"},
    "visibility": {"visibility", "detection_probability"},
    "exclusive": {"exclusive"},
}
"""Tracker of the study -> what tells it from the textbook."""


@pytest.fixture(scope="module")
def trackers():
    return Study.load(STUDY, resolve).cells[0].trackers


def config_of(tracker):
    return make_tracker(tracker.bound(), Site()).config


def test_each_is_the_textbook_but_for_its_option(trackers):
    textbook = PMBMConfig.textbook(visibility=NEUTRAL)
    for name, options in OPTIONS.items():
        config = config_of(trackers[name])
        differ = {
            field.name
            for field in dataclasses.fields(PMBMConfig)
            if getattr(config, field.name) != getattr(textbook, field.name)
        }
        assert differ == options, name


def test_the_options_together_are_the_presets(trackers):
    """What the single options are set to is what the presets set them to."""
    paper, default = PMBMConfig.paper(), PMBMConfig()
    assert config_of(trackers["scores-first"]).scores == paper.scores
    assert config_of(trackers["falling"]).detection_from_scores == paper.detection_from_scores
    assert config_of(trackers["miss-scaled"]).miss_rule == paper.miss_rule
    for name in ("occlusion", "scores-lasting", "visibility", "exclusive"):
        config = config_of(trackers[name])
        for option in OPTIONS[name]:
            assert getattr(config, option) == getattr(default, option)
    assert set(trackers) == {*OPTIONS, "pmbm-textbook", "pmbm-paper", "pmbm"}


def test_the_page_shows_every_tracker_and_scenario(trackers):
    page = PAGE.read_text(encoding="utf-8")
    for name in [*trackers, *(cell.scenario for cell in Study.load(STUDY, resolve).cells)]:
        assert name in page
