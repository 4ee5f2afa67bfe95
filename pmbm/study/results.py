"""A study's results as tables, for reports and for export."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmbm.errors import InputError
from pmbm.study.store import read_store
from pmbm.study.study import cell_label
from pmbm.study.summary import Summary, summarise
from pmbm.study.trial import StepTime, TrialResult

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class StudyResults:
    """What a store holds, as tables.

    name, seed, provenance, hash, document : of the study.
    total, done : trials that there are to be, and trials stored.
    digest : of the results, or None where rows are damaged.
    damaged : indices of rows whose hash does not fit; they are in no table.
    cells : one row a cell: scenario, label, and a column for each swept parameter.
    scores : one row a trial, tracker and metric: index, cell, scenario, trial, tracker, metric,
        value (NaN where undefined), and a column for each swept parameter.
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

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the swept parameters."""
        return tuple(self.cells.columns[2:])

    @property
    def trackers(self) -> tuple[str, ...]:
        return tuple(tracker["name"] for tracker in self.document["cells"][0]["trackers"])

    @property
    def failures(self) -> pd.DataFrame:
        """The rows of `outcomes` that are no results."""
        return self.outcomes[self.outcomes["outcome"] != "ok"]

    def summary(self, cell: int, reference: str | None = None) -> Summary | None:
        """Means, intervals and paired differences over a cell's trials; None without any."""
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
    score_rows: list[tuple[Any, ...]] = []
    outcome_rows: list[tuple[Any, ...]] = []
    time_rows: list[tuple[Any, ...]] = []
    trials: dict[int, list[TrialResult]] = {}
    for index, row in contents.rows.items():
        number, trial = index % len(cells), index // len(cells)
        scenario = cells[number]["scenario"]
        result, measured = json.loads(row.result), json.loads(row.time)
        where = (index, number, scenario, trial)
        outcome_rows.append(
            (
                *where,
                row.outcome,
                result.get("error"),
                row.note,
                result.get("recording"),
                measured.get("seconds"),
            )
        )
        if row.outcome != "ok":
            continue
        settings = tuple(points[number].get(name) for name in parameters)
        names = [tracker["name"] for tracker in cells[number]["trackers"]]
        scores = {name: result["scores"][name] for name in names}
        times = {name: StepTime(*measured["steps"][name]) for name in names}
        for tracker, values in scores.items():
            for metric, value in values.items():
                score_rows.append((*where, tracker, metric, value, *settings))
        for tracker, time in times.items():
            time_rows.append((index, number, tracker, time.mean, time.median, time.p99))
        trials.setdefault(number, []).append(
            TrialResult(scenario, seed, trial, result["recording"], scores, times)
        )
    place = ["index", "cell", "scenario", "trial"]
    scores_table = pd.DataFrame(
        score_rows, columns=[*place, "tracker", "metric", "value", *parameters]
    )
    scores_table["value"] = scores_table["value"].astype(float)
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
        cells=_cells(points, parameters, [cell["scenario"] for cell in cells]),
        scores=scores_table,
        outcomes=pd.DataFrame(
            outcome_rows, columns=[*place, "outcome", "error", "note", "recording", "seconds"]
        ),
        times=pd.DataFrame(
            time_rows, columns=["index", "cell", "tracker", "mean", "median", "p99"]
        ),
        trials={number: tuple(found) for number, found in trials.items()},
    )


def export(results: StudyResults, file: Path) -> None:
    """Write `scores` as CSV or Parquet, by the file's ending.

    Raises InputError for another ending, and for Parquet where pyarrow is not installed.
    """
    if file.suffix == ".csv":
        results.scores.to_csv(file, index=False)
    elif file.suffix == ".parquet":
        try:
            results.scores.to_parquet(file, index=False)
        except ImportError as error:
            raise InputError(
                "Parquet needs pyarrow", file=file, hint="pip install pyarrow, or export .csv"
            ) from error
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
