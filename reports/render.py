"""Results as one HTML file that opens from disk."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from pmbm.reports.encode import encode_replay
from pmbm.reports.page import render_page, script_json
from pmbm.reports.tables import Row, Table, metric_rows, metric_tables
from pmbm.reports.values import ReplayPage, Section
from pmbm.wording import counted

LAYERS = (
    ("truth", "truth"),
    ("detections", "detections"),
    ("tracks", "tracks"),
    ("trails", "trails"),
    ("velocity", "velocity, 1 s"),
    ("uncertainty", "uncertainty, 2σ"),
    ("errors", "missed, false, switched"),
    ("shadows", "shadows"),
    ("view", "field of view"),
    ("site", "site"),
    ("undetected", "undetected, expected"),
    ("identity", "colour by track"),
)


def run_page(sections: Sequence[Section], *, title: str, command: str) -> str:
    """The page of `pmbm run` and of the demo: per scenario a table and a replay.

    command : what makes the same page again.
    """
    return render_page(
        "run.html.j2",
        title=title,
        command=command,
        lede=_lede(sections),
        overview=_overview(sections),
        sections=[_section(section) for section in sections],
        layers=LAYERS,
        foot="One file: nothing is loaded from elsewhere. Intervals are Student-t, 95 %, over "
        "trials; differences are paired, trial by trial.",
    )


def replay_page(replay: ReplayPage) -> str:
    """The page of a replay alone."""
    name = replay.recording.name
    return render_page("replay.html.j2", title=name, view=replay_view(replay), layers=LAYERS)


@dataclass(frozen=True)
class ReplayView:
    """The values of a replay that the template needs."""

    name: str
    title: str
    trackers: tuple[str, ...]
    data: Markup


def replay_view(replay: ReplayPage) -> ReplayView:
    return ReplayView(
        name=replay.recording.name,
        title=replay.title,
        trackers=tuple(replay.tracks),
        data=script_json(encode_replay(replay)),
    )


@dataclass(frozen=True)
class _Overview:
    caption: str
    trackers: tuple[str, ...]
    compared: tuple[str, ...]
    reference: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class _SectionView:
    name: str
    stresses: str
    main: Table
    rest: Table | None
    note: str
    replay: ReplayView | None
    facts: tuple[tuple[str, str], ...]
    problems: tuple[str, ...]


def _overview(sections: Sequence[Section]) -> _Overview | None:
    """GOSPA of every scenario in one table, where all have the same trackers."""
    alike = {(section.summary.trackers, section.summary.reference) for section in sections}
    if len(sections) < 2 or len(alike) != 1:
        return None
    if not all("gospa" in section.summary.metrics for section in sections):
        return None
    first = sections[0].summary
    return _Overview(
        caption="GOSPA in metres: lower is better. A bar is the 95 % interval of the paired "
        "difference; left of the line the compared tracker has the smaller error.",
        trackers=first.trackers,
        compared=tuple(first.differences),
        reference=first.reference,
        rows=metric_rows([(section.name, section.summary) for section in sections], "gospa"),
    )


def _section(section: Section) -> _SectionView:
    main, rest = metric_tables(section.summary)
    return _SectionView(
        name=section.name,
        stresses=section.stresses,
        main=main,
        rest=rest,
        note=_note(section),
        replay=None if section.replay is None else replay_view(section.replay),
        facts=facts(section.provenance),
        problems=section.problems,
    )


def _note(section: Section) -> str:
    trials = section.summary.trials
    if trials == 1:
        return "One trial: no intervals. Arrows say which way is better."
    return (
        f"{trials} trials. Mean and 95 % interval, of counts with its two ends; sem is the "
        "standard error of the mean. Arrows say which way is better; a difference is coloured "
        "only where its interval excludes zero."
    )


def _lede(sections: Sequence[Section]) -> str:
    trackers = list(dict.fromkeys(name for s in sections for name in s.summary.trackers))
    trials = sorted({section.summary.trials for section in sections})
    count = "–".join(str(n) for n in dict.fromkeys([trials[0], trials[-1]]))
    plural = "" if trials[-1] == 1 else "s"
    what = counted(len(sections), "scenario")
    shown = f"{counted(len(trackers), 'tracker')}: {', '.join(trackers)}"
    return f"{what}, {count} trial{plural} each, {shown}."


def facts(mapping: Mapping[str, Any], prefix: str = "") -> tuple[tuple[str, str], ...]:
    """A nested mapping as rows of name and value."""
    rows: list[tuple[str, str]] = []
    for key, value in mapping.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            rows += facts(value, f"{name}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str)
            rows.append((name, text))
    return tuple(rows)
