"""Stored baselines: a tracker's value in every trial, as a small JSON file in the repository."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmbm.durable import replace_text
from pmbm.errors import BaselineMismatch, InputError, nearest_hint
from pmbm.metrics.catalogue import definition
from pmbm.provenance import SCHEMA_VERSION, provenance
from pmbm.study import estimate
from pmbm.wording import four_digits

if TYPE_CHECKING:
    from pmbm.regression.metric import GatedMetric

Trials = tuple[tuple[str, float], ...]
"""Of each trial: the recording's digest and the tracker's value."""


@dataclass(frozen=True)
class StoredBaseline:
    """A baseline tracker's values, trial by trial.

    The values serve only over the very same recordings: traffic differs in its last bits between
    kinds of machines, and then the trackers would be compared over different worlds.

    metric, bounds, seed : what the values are.
    tracker, code : whose they are: its name, and a digest of its sources.
    scenarios : name -> trials.
    accept : the command that writes the file anew, for messages.
    """

    metric: str
    bounds: tuple[float, float]
    seed: int
    tracker: str
    code: str
    scenarios: Mapping[str, Trials] = field(repr=False)
    file: str = ""
    accept: str = ""

    def trials(self, scenario: str) -> Trials:
        if scenario not in self.scenarios:
            raise self._mismatch(
                f"scenario '{scenario}' has no stored baseline",
                nearest_hint(scenario, self.scenarios, "stored scenario"),
            )
        return self.scenarios[scenario]

    def value(self, scenario: str, trial: int, recording: str) -> float:
        """The baseline's value in a trial.

        Raises BaselineMismatch where it was measured over another recording.
        """
        stored, value = self.trials(scenario)[trial]
        if not recording.startswith(stored):
            raise self._mismatch(
                f"trial {trial} of '{scenario}' is another recording than the baseline's (another "
                "machine, simulator or detector)",
                "run both trackers side by side with --against GITREF or --against MODULE:FACTORY",
            )
        return value

    def check(self, metric: GatedMetric, seed: int) -> None:
        """Raise BaselineMismatch unless the values are those of this metric and seed."""
        __tracebackhide__ = True
        for name, stored, wanted in (
            ("metric", self.metric, metric.name),
            ("bounds", self.bounds, metric.bounds),
            ("seed", self.seed, seed),
        ):
            if stored != wanted:
                raise self._mismatch(f"the baseline's {name} is {stored}, not {wanted}", "")

    def _mismatch(self, problem: str, hint: str) -> BaselineMismatch:
        accept = f"store a new one: {self.accept}" if self.accept else ""
        return BaselineMismatch(
            problem, file=self.file, hint=", or ".join(filter(None, (hint, accept)))
        )

    def mean(self, scenario: str) -> float:
        """Mean of the metric over a scenario's trials, as people know it."""
        return sum(self._shown(scenario)) / len(self.scenarios[scenario])

    def _shown(self, scenario: str) -> list[float]:
        """The metric's values as people know it: trials hold losses."""
        sign = -1.0 if definition(self.metric).direction == "higher" else 1.0
        return [sign * value for _, value in self.scenarios[scenario]]

    def write(self, file: Path) -> None:
        """Write JSON whose floats read back to the same bits: first what a person reviews (whose
        values these are; of each scenario the mean, its interval, trials, a digest), then the
        trials, in two lines a scenario."""
        head = {
            "schema": SCHEMA_VERSION,
            "metric": self.metric,
            "tracker": self.tracker,
            "scenarios": {name: self._summary(name) for name in sorted(self.scenarios)},
            "bounds": list(self.bounds),
            "seed": self.seed,
            "code": self.code,
            "provenance": {key: provenance()[key] for key in ("versions", "platform")},
        }
        rows = []
        for name in sorted(self.scenarios):
            trials = self.scenarios[name]
            recordings = json.dumps([digest[:_DIGEST] for digest, _ in trials])
            values = json.dumps([value for _, value in trials], allow_nan=False)
            rows.append(
                f' {json.dumps(name)}: {{\n  "recordings": {recordings},\n  "values": {values}\n }}'
            )
        top = json.dumps(head, indent=1, allow_nan=False).removesuffix("\n}")
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_text(file, f'{top},\n "trials": {{\n' + ",\n".join(rows) + "\n }\n}\n")

    def _summary(self, name: str) -> dict[str, Any]:
        found = estimate(self._shown(name), definition(self.metric).scale)
        ends = (found.mean, found.low, found.high)
        mean, low, high = (None if end is None else four_digits(end) for end in ends)
        trials = self.scenarios[name]
        summary = {"mean": mean, "interval": [low, high], "trials": len(trials)}
        return {**summary, "digest": _digest_of_trials(trials)}


def _digest_of_trials(trials: Trials) -> str:
    rows = [[digest[:_DIGEST], value] for digest, value in trials]
    return hashlib.sha256(json.dumps(rows, allow_nan=False).encode()).hexdigest()[:_DIGEST]


_DIGEST = 16
"""Hexadecimal digits kept of a recording's digest: enough against chance."""


def load_baseline(file: Path, accept: str = "") -> StoredBaseline:
    """The baseline in a file.

    Raises BaselineMismatch where there is none, InputError where it cannot be read.
    """
    __tracebackhide__ = True  # In a failing test, the test's own line says enough.
    try:
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BaselineMismatch(
            "no stored baseline", file=file, hint=f"store one: {accept}" if accept else None
        ) from None
    try:
        return _parsed(json.loads(text), file, accept)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"not a stored baseline: {type(error).__name__} {error}",
            file=file,
            hint=f"store a new one: {accept}" if accept else None,
        ) from None


def _parsed(document: Any, file: Path, accept: str) -> StoredBaseline:
    if document["schema"] != SCHEMA_VERSION:
        raise ValueError(f"schema {document['schema']}, not {SCHEMA_VERSION}")
    low, high = document["bounds"]
    if "trials" not in document:
        raise ValueError("written by an earlier version")
    scenarios = {}
    for name, rows in document["trials"].items():
        pairs = zip(rows["recordings"], rows["values"], strict=True)
        trials = tuple((_hex(digest), float(value)) for digest, value in pairs)
        if _digest_of_trials(trials) != document["scenarios"][name]["digest"]:
            raise ValueError(f"the trials of '{name}' do not fit their digest")
        scenarios[str(name)] = trials
    return StoredBaseline(
        metric=str(document["metric"]),
        bounds=(float(low), float(high)),
        seed=int(document["seed"]),
        tracker=str(document["tracker"]),
        code=str(document["code"]),
        scenarios=scenarios,
        file=str(file),
        accept=accept,
    )


def _hex(digest: str) -> str:
    if len(digest) < _DIGEST or int(digest, 16) < 0:
        raise ValueError(f"digest {digest!r}")
    return digest
