"""Measures the project's speed against its bars: `make bench`, or `bench.py ID...` for some.

Times are CPU times of one thread, rivals run frame by frame with ours, figures are medians over
seeds, and what is compared is ratios: the same step takes twice the time on another day.  Writes
benchmarks.json and benchmarks.md; bars that were not measured anew keep their last figures.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")


@dataclass(frozen=True)
class Bar:
    """What has to be reached: at most `bound`, or at least where `at_least`."""

    module: str
    what: str
    bound: float
    stretch: float | None = None
    at_least: bool = False

    def met(self, figure: float, bound: float) -> bool:
        return figure >= bound if self.at_least else figure <= bound


def at_most(module: str, what: str, bound: float, stretch: float | None = None) -> Bar:
    return Bar(module, what, bound, stretch)


def at_least(module: str, what: str, bound: float, stretch: float | None = None) -> Bar:
    return Bar(module, what, bound, stretch, at_least=True)


BARS = {
    "a50": at_most("race", "step / floor, 50 objects", 3, 1),
    "a200": at_most("race", "step / floor, 200 objects", 2, 1),
    "a1000": at_most("race", "step / floor2, 1000 objects", 1.6, 1),
    "b_slope": at_most("race", "log-log slope of time per frame, 10^3 to 10^5 objects", 1.15, 1.05),
    "b_memory": at_most("race", "peak memory at 10^5 objects, MB", 350, 250),
    "b_million": at_most("race", "the same slope, 10^5 to 10^6 objects, 5 frames", 1.15, 1.05),
    "b_million_memory": at_most("race", "peak memory at 10^6 objects, GB", 4, 2.5),
    "c10": at_least("race", "filterpy + linear_sum_assignment / ours, 10 objects", 3, 8),
    "c50": at_least("race", "filterpy + linear_sum_assignment / ours, 50 objects", 6, 12),
    "c200": at_least("race", "filterpy + linear_sum_assignment / ours, 200 objects", 12, 20),
    "d_stonesoup": at_least("race", "Stone Soup GNN / ours, 50 objects", 150, 300),
    "d_motpy": at_least("race", "motpy / ours, 50 objects", 15, 30),
    "d_norfair": at_least("race", "norfair / ours, 50 objects", 8, 15),
    "d_lmb_gibbs": at_least("race", "Rust LMB filter, Gibbs / ours, 50 objects", 1),
    "d_lmb_murty": at_least("race", "Rust LMB filter, Murty / ours, 50 objects", 1),
    "e": at_most("race", "200 objects 5 m apart / 15 m apart", 6, 3),
    "f": at_least("kernel", "scipy reference / compiled kernel, gated 100 x 200, K = 100", 100),
    "g50": at_least("traffic", "stock highway-env / our road, bit-identical, 50 cars", 8, 12),
    "g200": at_least("traffic", "stock highway-env / our road, bit-identical, 200 cars", 25, 45),
    "h": at_least("traffic", "simulating anew / cached, 10 detector configurations", 5),
    "i_clear": at_most("metrics", "CLEAR and identity / TrackEval, 200 frames of 60 objects", 2),
    "i_ospa": at_most("metrics", "OSPA / a plain scipy loop, 200 frames of 60 objects", 1),
    "j_import": at_most("startup", "import pmbm / import numpy", 2),
    "j_plugin": at_most("startup", "numpy and highway_env imported by the pytest plugin", 0),
    "k": at_most("startup", "first `pmbm run` to its first result, s", 15),
    "m_frame": at_most("programs", "a frame of 50 boxes around the C++ program, ms", 0.5),
    "m_study": at_most("programs", "a study, tracker as a Python program / in process", 1.3),
    "t_record": at_most("trial", "recording a trial / that of commit e340b31", 0.45, 0.28),
    "t_step": at_most("trial", "following a trial / that of commit e340b31", 0.25, 0.10),
    "t_trial": at_most("trial", "a whole trial / that of commit e340b31", 0.42, 0.25),
    "m_map": at_most("trial", "following with the map / that of commit e340b31", 0.4, 0.2),
    "s_study": at_least("trial", "trials a CPU second of a study / commit e340b31's", 2.5, 4),
    "l_compiled": at_most("latency", "99th percentile of a step, compiled kernel, ms", 2, 1),
    "l_reference": at_most("latency", "99th percentile of a step, plain kernel, ms", 50),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("ids", nargs="*", metavar="ID", help=f"of {', '.join(BARS)}")
    parser.add_argument("--out", type=Path, default=Path("reports"))
    parser.add_argument("--page", type=Path, help="write the record's page, and measure nothing")
    options = parser.parse_args()
    unknown = [name for name in options.ids if name not in BARS]
    if unknown:
        parser.error(f"no bar {unknown[0]}; there are {', '.join(BARS)}")
    file = options.out / "benchmarks.json"
    rows = {row["id"]: row for row in json.loads(file.read_text())["rows"]} if file.exists() else {}
    if options.page is not None:
        options.page.write_text(page(list(rows.values())), encoding="utf-8")
        return
    for name in options.ids or BARS:
        try:
            rows[name] = _row(name)
        except LookupError as missing:
            print(f"skip  {name:12} {missing}", flush=True)
            continue
        print(_line(rows[name]), flush=True)
        _write(options.out, [rows[known] for known in BARS if known in rows])
    if any(row["verdict"] == "fail" for row in rows.values()):
        sys.exit(1)


def _row(name: str) -> dict[str, Any]:
    bar = BARS[name]
    figure, details = _measured(bar.module, name)
    met = bar.met(figure, bar.bound)
    return {
        "id": name,
        "what": bar.what,
        "figure": _rounded(figure),
        "bound": bar.bound,
        "stretch": bar.stretch,
        "at_least": bar.at_least,
        "verdict": "pass" if met else "fail",
        "stretch_met": bar.stretch is not None and bar.met(figure, bar.stretch),
        "details": _rounded(details),
    }


def _measured(module_name: str, name: str) -> tuple[float, dict[str, Any]]:
    """From the module's function of that name, or from its table of rows."""
    module = importlib.import_module(module_name)
    if hasattr(module, name):
        return getattr(module, name)()
    (row,) = [row for row in _rows(module_name) if row["id"] == name]
    return row["figure"], {"seeds": row["seeds"]}


@cache
def _rows(module_name: str) -> list[dict[str, Any]]:
    return importlib.import_module(module_name).rows()


def _rounded(value: Any) -> Any:
    """Three significant digits: what the spread between runs leaves."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.3g}") if isinstance(value, float) else value


def _line(row: dict[str, Any]) -> str:
    bound = f"{'>=' if row['at_least'] else '<='} {row['bound']:g}"
    return f"{row['verdict']:5} {row['id']:12} {row['figure']:>9g} ({bound})  {row['what']}"


def _write(folder: Path, rows: list[dict[str, Any]]) -> None:
    from pmbm.assignment import kernel
    from pmbm.durable import replace_text
    from pmbm.provenance import provenance

    folder.mkdir(parents=True, exist_ok=True)
    record = {"provenance": provenance(kernel=kernel()), "rows": rows}
    replace_text(folder / "benchmarks.json", json.dumps(record, indent=1) + "\n")
    replace_text(folder / "benchmarks.md", page(rows))


def page(rows: list[dict[str, Any]]) -> str:
    """The record as a page of Markdown."""
    lines = [
        "# Speed",
        "",
        "Ratios of CPU time, rivals and ours frame by frame on the same detections, on one",
        "machine; `make bench` measures them into reports/benchmarks.json, and",
        "`python tests/benchmark/bench.py --page docs/results/speed.md` prints this page from it.",
        "",
        "| bar | figure | must | stretch | |",
        "|---|---:|---:|---:|---|",
    ]
    for row in rows:
        sign = "≥" if row["at_least"] else "≤"
        stretch = "" if row["stretch"] is None else f"{sign} {row['stretch']:g}"
        lines.append(
            f"| {row['what']} | {row['figure']:g} | {sign} {row['bound']:g} | {stretch} "
            f"| {row['verdict']} |"
        )
    lines += ["", "| bar | in detail |", "|---|---|"]
    for row in rows:
        details = ", ".join(f"{key} {value}" for key, value in row["details"].items())
        lines.append(f"| {row['id']} | {details} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
