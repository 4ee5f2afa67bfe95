"""The pytest plugin: scenarios and trackers as markers, outcomes and a regression gate as fixtures.

It loads into every pytest run of an environment, so it imports nothing but pytest until a test
uses it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pmbm.testing import Outcome, TrackingGate

_REPLAY = "pmbm_replay"
_BASELINE = "pmbm_baseline"


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
        "--pmbm-tracker",
        default=None,
        metavar="NAME",
        help="the tracker of every scenario test, instead of what its marker says: a shipped one, "
        "MODULE:FACTORY or exec:COMMAND",
    )
    group.addoption(
        "--pmbm-replay",
        type=int,
        default=None,
        metavar="TRIAL",
        help="run this trial alone, and write its replay",
    )
    group.addoption(
        "--pmbm-update-baselines",
        action="store_true",
        help="store the trackers under test as the new baselines of tracking_gate",
    )
    group.addoption(
        "--pmbm-report-dir",
        default="pmbm-reports",
        metavar="DIR",
        help="where replays of failing scenario tests go (default: pmbm-reports)",
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "scenario(*names, trials=10, seed=0, level=None): run the test over trials of each of "
        "these scenarios (names, files, or sources)",
    )
    config.addinivalue_line(
        "markers", "tracker(*factories): run the test with each of these trackers"
    )

    pytest.mark.__dict__["tracker"] = _TrackerMark()


class _TrackerMark:
    """`pytest.mark.tracker`.  pytest takes a mark that is called with one class or function for a
    decorator of that very thing; here it is the tracker to test."""

    def __call__(self, *factories: Any) -> pytest.MarkDecorator:
        return pytest.mark.__getattr__("tracker").with_args(*factories)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "outcome" not in metafunc.fixturenames:
        return
    scenario = metafunc.definition.get_closest_marker("scenario")
    tracker = metafunc.definition.get_closest_marker("tracker")
    chosen = metafunc.config.getoption("--pmbm-tracker")
    trackers = (chosen,) if chosen else tracker.args if tracker else ()
    for name, given in (("scenario", scenario and scenario.args), ("tracker", trackers)):
        if not given:
            raise pytest.UsageError(
                f"{metafunc.definition.nodeid}: outcome needs @pytest.mark.{name}(...)"
            )
    assert scenario is not None
    unknown = set(scenario.kwargs) - {"trials", "seed", "level"}
    if unknown:
        raise pytest.UsageError(
            f"{metafunc.definition.nodeid}: @pytest.mark.scenario knows trials, seed and level, "
            f"not {', '.join(sorted(unknown))}"
        )
    metafunc.parametrize(
        "outcome",
        [
            (source, factory, dict(scenario.kwargs))
            for source in scenario.args
            for factory in trackers
        ],
        ids=[
            f"{_name(source)}-{_name(factory)}" for source in scenario.args for factory in trackers
        ],
        indirect=True,
    )


@pytest.fixture
def outcome(request: pytest.FixtureRequest) -> Outcome:
    """The outcome of a tracker over trials of a scenario: `outcome.mean("id_switches")`."""
    from pmbm.testing import outcome_of

    source, factory, settings = request.param
    config = request.config
    return outcome_of(
        source,
        factory,
        tracker_name=_name(factory),
        folder=request.path.parent,
        trials=config.getoption("--pmbm-trials") or settings.get("trials", 10),
        seed=settings.get("seed", 0),
        level=settings.get("level"),
        only=config.getoption("--pmbm-replay"),
    )


@pytest.fixture
def tracking_gate(request: pytest.FixtureRequest) -> Iterator[TrackingGate]:
    """Paired trials against a stored baseline, or against another tracker: `.check(...)`."""
    from pmbm.testing import TrackingGate

    config = request.config
    gate = TrackingGate(
        folder=request.path.parent,
        test=f"{request.path.stem}-{request.node.name}",
        node=request.node.nodeid,
        update=config.getoption("--pmbm-update-baselines"),
        most=config.getoption("--pmbm-trials"),
        only=config.getoption("--pmbm-replay"),
        tell=_progress(config),
    )
    yield gate
    request.node.user_properties.extend((_BASELINE, text) for text in gate.stored)


_TELL_EVERY = 5.0
"""s between two lines of progress."""


def _progress(config: pytest.Config) -> Callable[[str, int, int], None] | None:
    """A progress callback for a gate, or None where no terminal shows it."""
    import time

    reporter = config.pluginmanager.getplugin("terminalreporter")
    capture = config.pluginmanager.getplugin("capturemanager")
    if reporter is None or capture is None:
        return None
    said = time.monotonic()

    def tell(name: str, done: int, most: int) -> None:
        nonlocal said
        if time.monotonic() - said < _TELL_EVERY:
            return
        said = time.monotonic()
        with capture.global_and_fixture_disabled():
            reporter.write_line(f"pmbm: {name}: {done} of at most {most} trials")

    return tell


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    result: Any = yield
    report = result.get_result()
    subject = _subject(item)
    if report.when != "call" or subject is None:
        return
    if report.failed or item.config.getoption("--pmbm-replay") is not None:
        _attach_replay(item, report, subject)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    for title, name in (("replays of worst trials", _REPLAY), ("stored baselines", _BASELINE)):
        values = [
            value
            for reports in terminalreporter.stats.values()
            for report in reports
            if getattr(report, "when", None) in ("call", "teardown")
            for key, value in getattr(report, "user_properties", ())
            if key == name
        ]
        if values:
            terminalreporter.section(f"pmbm: {title}", sep="-")
            for value in dict.fromkeys(values):
                terminalreporter.line(value)


def _subject(item: pytest.Item) -> Any:
    """The outcome or gate that a scenario test looked at."""
    found = getattr(item, "funcargs", {})
    for name in ("outcome", "tracking_gate"):
        subject = found.get(name)
        if subject is not None and hasattr(subject, "write_replay"):
            return subject
    return None


def _attach_replay(item: pytest.Item, report: Any, subject: Any) -> None:
    """Write the worst trial's replay and say where; a replay that fails hides no failure."""
    folder = Path(item.config.invocation_params.dir) / item.config.getoption("--pmbm-report-dir")
    try:
        shown = subject.write_replay(folder, item.nodeid)
    except Exception as error:
        report.sections.append(("pmbm", f"no replay: {type(error).__name__}: {error}"))
        return
    if shown is not None:
        report.sections.append(("pmbm", shown.text))
        report.user_properties.append((_REPLAY, str(shown.file)))


def _name(thing: Any) -> str:
    """The name of a scenario or a tracker in a test's id."""
    if isinstance(thing, str):
        return thing
    name = getattr(thing, "name", None) or getattr(thing, "__qualname__", None)
    return str(name or type(thing).__name__)
