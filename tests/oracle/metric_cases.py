"""Reading the tracking problems whose scores are known."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from pmbm.metrics.core.scene import BoxRows, ScoredScene

HERE = Path(__file__).parent


def case_folder() -> Path:
    """The folder of cases: `PMBM_METRIC_CASES`, or the copy beside the tests."""
    return Path(os.environ.get("PMBM_METRIC_CASES") or HERE / "metrics")


def case_files() -> list[Path]:
    """Every file of the folder that holds cases."""
    return sorted(path for path in case_folder().glob("*.json") if path.name != "MANIFEST.json")


def load(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def scene_of_case(
    case: dict[str, Any], label: str | None = "VEHICLE", dt: float | None = None
) -> ScoredScene:
    """The scene of a case, of one class or (None) of all; ids numbered in their text order."""
    return ScoredScene(
        time=np.arange(case["frames"]) * (dt or case["dt"]),
        truth=_boxes(case["gt"], case["gt_columns"], label),
        tracks=_boxes(case["trk"], case["trk_columns"], label),
    )


def _boxes(frames: list[Any], columns: list[str], label: str | None) -> BoxRows:
    at = {name: place for place, name in enumerate(columns)}
    number = {
        name: n for n, name in enumerate(sorted({row[at["id"]] for rows in frames for row in rows}))
    }
    classes = sorted({row[at["cls"]] for rows in frames for row in rows})
    rows = sorted(
        (
            (k, number[row[at["id"]]], row)
            for k, frame in enumerate(frames)
            for row in frame
            if label is None or row[at["cls"]] == label
        ),
        key=lambda entry: entry[:2],
    )

    def column(*names: str) -> np.ndarray:
        return np.array([[row[at[name]] for name in names] for _, _, row in rows], float).reshape(
            len(rows), len(names)
        )

    n = len(rows)
    return BoxRows(
        frame=np.array([k for k, _, _ in rows], np.int64),
        id=np.array([i for _, i, _ in rows], np.int64),
        position=column("x", "y", "z"),
        size=column("l", "w", "h"),
        yaw=column("yaw")[:, 0],
        velocity=column("vx", "vy"),
        label=np.array([classes.index(row[at["cls"]]) for _, _, row in rows], np.int8),
        score=column("score")[:, 0] if "score" in at else np.ones(n),
        observable=np.ones(n, np.bool_),
        covariance=np.full((n, 4, 4), np.nan),
    )
