"""A study's results as tables, for reports and for export."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pmbm.durable import replace_bytes, replace_text
from pmbm.errors import InputError
from pmbm.study.store import read_store
from pmbm.study.study import cell_label
from pmbm.study.summary import Summary, summarise
from pmbm.study.trial import StepTime, TrackerError, TrialResult
from pmbm.types import FloatArray
from pmbm.wording import counted

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class StudyResults:
    """The results in a store, as tables.

    name, seed, provenance, hash, document : of the study.
    total, done : trials that there are to be, and trials stored.
    digest : of the results, or None where rows are damaged.
    damaged : indices of rows whose hash does not fit; they are in no table.
    cells : one row a cell: scenario, label, and a column for each swept parameter.
    scores : one row a trial, tracker and metric: index, cell, scenario, trial, tracker, metric,
        value (NaN where undefined), and a column for each swept parameter; scenario, tracker and
        metric are categorical.
    outcomes : one row a trial: index, cell, scenario, trial, outcome, error, note, recording,
        seconds (wall clock of the trial).
    times : one row a trial and tracker: index, cell, tracker, and CPU seconds per step: mean,
        median, p99.
    """

    name: str
    seed: int
    hash: str
    document: Mapping[str, Any]
    provenance: Mapping[str, Any]
    total: int
    done: int
    digest: str | None
    damaged: tuple[int, ...]
    cells: pd.DataFrame
    scores: pd.DataFrame
    outcomes: pd.DataFrame
    times: pd.DataFrame
    trials: Mapping[int, tuple[TrialResult, ...]]

    def __repr__(self) -> str:
        return f"StudyResults('{self.name}': {self.done} of {counted(self.total, 'trial')})"

    def _repr_html_(self) -> str:
        means = self.scores.pivot_table(
            index=["scenario", *self.parameters, "metric"],
            columns="tracker",
            values="value",
            observed=True,
            sort=False,
        )
        return f"<p>{escape(repr(self))}: means</p>{means.to_html(float_format='{:.4g}'.format)}"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the swept parameters."""
        return tuple(self.cells.columns[2:])

    @property
    def trackers(self) -> tuple[str, ...]:
        return tuple(tracker["name"] for tracker in self.document["cells"][0]["trackers"])

    @property
    def failures(self) -> pd.DataFrame:
        """The rows of `outcomes` that are no results, or not those of every tracker."""
        return self.outcomes[self.outcomes["outcome"] != "ok"]

    def summary(self, cell: int, reference: str | None = None) -> Summary | None:
        """Means, intervals and paired differences over a cell's trials, or None without any."""
        trials = self.trials.get(cell)
        return summarise(trials, reference) if trials else None


def load_results(file: Path | str) -> StudyResults:
    """The results in a store, also while the study still runs.

    Raises InputError where it is no store or damaged beyond its rows.
    """
    import pandas as pd

    contents = read_store(Path(file))
    cells = contents.document["cells"]
    seed = contents.document["seed"]
    points = [dict(cell["point"]) for cell in cells]
    parameters = list(dict.fromkeys(key for point in points for key in point))
    columns = _Columns()
    outcome_rows: list[tuple[Any, ...]] = []
    time_rows: list[tuple[Any, ...]] = []
    trials: dict[int, list[TrialResult]] = {}
    names = [[tracker["name"] for tracker in cell["trackers"]] for cell in cells]
    for index, row in contents.rows.items():
        number, trial = index % len(cells), index // len(cells)
        scenario = cells[number]["scenario"]
        result, measured = json.loads(row.result), json.loads(row.time)
        errors = result.get("errors", {})
        raised = [f"tracker '{name}' raised {text}" for name, text in errors.items()]
        outcome_rows.append(
            (
                *(index, number, scenario, trial, row.outcome),
                *("; ".join(raised) or result.get("error"), row.note),
                *(result.get("recording"), measured.get("seconds")),
            )
        )
        if "scores" not in result:
            continue
        scores = {name: result["scores"][name] for name in names[number]}
        times = {n: StepTime(*measured["steps"][n]) for n in names[number] if n not in errors}
        for tracker, values in scores.items():
            columns.add(index, tracker, values)
        for tracker, time in times.items():
            time_rows.append((index, number, tracker, time.mean, time.median, time.p99))
        trials.setdefault(number, []).append(
            TrialResult(
                *(scenario, seed, trial, result["recording"], scores, times),
                {name: TrackerError(text, row.note) for name, text in errors.items()},
            )
        )
    cells_table = _cells(points, parameters, [cell["scenario"] for cell in cells])
    return StudyResults(
        name=contents.about["name"],
        seed=seed,
        hash=contents.hash,
        document=contents.document,
        provenance=contents.about["provenance"],
        total=contents.about["trials"] * len(cells),
        done=len(contents.rows),
        digest=None if contents.damaged else contents.digest(),
        damaged=contents.damaged,
        cells=cells_table,
        scores=columns.table(cells_table),
        outcomes=pd.DataFrame(
            outcome_rows,
            columns=[
                *("index", "cell", "scenario", "trial", "outcome"),
                *("error", "note", "recording", "seconds"),
            ],
        ),
        times=pd.DataFrame(
            time_rows, columns=["index", "cell", "tracker", "mean", "median", "p99"]
        ),
        trials={number: tuple(found) for number, found in trials.items()},
    )


class _Columns:
    """The scores of many trials as they are read, one short array a trial and tracker: rows of a
    large study would not fit into memory as Python values."""

    def __init__(self) -> None:
        self._values: list[FloatArray] = []
        self._index: list[int] = []
        self._trackers: list[str] = []
        self._metrics: list[tuple[str, ...]] = []
        self._kinds: dict[tuple[str, ...], tuple[str, ...]] = {}

    def add(self, index: int, tracker: str, values: Mapping[str, float | None]) -> None:
        kind = tuple(values)
        self._metrics.append(self._kinds.setdefault(kind, kind))
        self._trackers.append(tracker)
        self._index.append(index)
        self._values.append(np.array([*values.values()], dtype=np.float64))

    def table(self, cells: pd.DataFrame) -> pd.DataFrame:
        import pandas as pd

        lengths = [len(values) for values in self._values]
        index = np.repeat(np.array(self._index, dtype=np.int64), lengths)
        cell = index % len(cells)
        metrics = list(dict.fromkeys(name for kind in self._kinds for name in kind))
        code = {
            kind: np.array([metrics.index(name) for name in kind], np.int64) for kind in self._kinds
        }
        trackers = list(dict.fromkeys(self._trackers))
        tracker = np.array([trackers.index(name) for name in self._trackers], dtype=np.int64)
        columns: dict[str, Any] = {
            "index": index,
            "cell": cell,
            "scenario": pd.Categorical(cells["scenario"].to_numpy()[cell]),
            "trial": index // len(cells),
            "tracker": pd.Categorical.from_codes(np.repeat(tracker, lengths), pd.Index(trackers)),
            "metric": pd.Categorical.from_codes(
                np.concatenate([code[kind] for kind in self._metrics] or [np.zeros(0, np.int64)]),
                pd.Index(metrics),
            ),
            "value": np.concatenate(self._values or [np.zeros(0)]),
        }
        for name in cells.columns[2:]:
            columns[name] = cells[name].to_numpy()[cell]
        return pd.DataFrame(columns)


def export(results: StudyResults, file: Path) -> None:
    """Write `scores` as CSV or Parquet, by the file's ending.

    Raises InputError for another ending, and for Parquet where pyarrow is not installed.
    """
    if file.suffix == ".csv":
        replace_text(file, results.scores.to_csv(None, index=False))
    elif file.suffix == ".parquet":
        buffer = io.BytesIO()
        try:
            results.scores.to_parquet(buffer, index=False)
        except ImportError as error:
            raise InputError(
                "Parquet needs pyarrow", file=file, hint="pip install pyarrow, or export .csv"
            ) from error
        replace_bytes(file, buffer.getvalue())
    else:
        raise InputError("unknown format", file=file, expected=".csv or .parquet")


def _cells(
    points: Sequence[Mapping[str, Any]], parameters: Sequence[str], scenarios: Sequence[str]
) -> pd.DataFrame:
    import pandas as pd

    rows = [
        (scenario, cell_label(scenario, point), *(point.get(name) for name in parameters))
        for scenario, point in zip(scenarios, points, strict=True)
    ]
    return pd.DataFrame(rows, columns=["scenario", "label", *parameters])
