"""The pytest plugin: scenarios and trackers as markers, outcomes and a regression gate as fixtures.

It loads into every pytest run of an environment, so it imports nothing but pytest until a test
uses it.
"""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("pmbm", "tracking in controlled traffic")
    group.addoption(
        "--pmbm-trials",
        type=int,
        default=None,
        metavar="N",
        help="trials of every scenario test, instead of what its marker says",
    )
    group.addoption(
        "--pmbm-update-baselines",
        action="store_true",
        help="store the trackers under test as the new baselines of tracking_gate",
    )
    group.addoption(
        "--pmbm-report-dir",
        default=None,
        metavar="DIR",
        help="where replays of failing scenario tests go (default: pmbm-reports)",
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "scenario(*names, trials=10, seed=0): run the test over trials of these scenarios",
    )
    config.addinivalue_line(
        "markers", "tracker(factory, ...): the tracker under test, as a factory or a name"
    )
