"""Stored baselines: a tracker's value in every trial, as a small JSON file in the repository."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmbm.durable import replace_text
from pmbm.errors import BaselineMismatch, InputError, nearest_hint
from pmbm.provenance import SCHEMA_VERSION, provenance

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
    scenarios: Mapping[str, Trials]
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

    def write(self, file: Path) -> None:
        """Write sorted JSON whose floats read back to the same bits."""
        document = {
            "schema": SCHEMA_VERSION,
            "metric": self.metric,
            "bounds": list(self.bounds),
            "seed": self.seed,
            "tracker": self.tracker,
            "code": self.code,
            "provenance": {key: provenance()[key] for key in ("versions", "platform")},
            "scenarios": {
                name: {
                    "recordings": [d[:_DIGEST] for d, _ in trials],
                    "values": [v for _, v in trials],
                }
                for name, trials in self.scenarios.items()
            },
        }
        file.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(document, sort_keys=True, indent=1, allow_nan=False)
        replace_text(file, text + "\n")


_DIGEST = 16
"""Hexadecimal digits kept of a recording's digest: enough against chance."""


def load_baseline(file: Path, accept: str = "") -> StoredBaseline:
    """The baseline in a file.

    Raises BaselineMismatch where there is none, InputError where it cannot be read.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise BaselineMismatch(
            "no stored baseline", file=file, hint=f"store one: {accept}" if accept else None
        ) from error
    try:
        return _parsed(json.loads(text), file, accept)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"not a stored baseline: {type(error).__name__} {error}",
            file=file,
            hint=f"store a new one: {accept}" if accept else None,
        ) from error


def _parsed(document: Any, file: Path, accept: str) -> StoredBaseline:
    if document["schema"] != SCHEMA_VERSION:
        raise ValueError(f"schema {document['schema']}, not {SCHEMA_VERSION}")
    low, high = document["bounds"]
    scenarios = {}
    for name, rows in document["scenarios"].items():
        pairs = zip(rows["recordings"], rows["values"], strict=True)
        scenarios[str(name)] = tuple((_hex(digest), float(value)) for digest, value in pairs)
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
