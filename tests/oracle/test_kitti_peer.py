"""The image rule of KITTI beside TrackEval's own reader, preprocessing and metrics, on random files
full of overlaps that are exactly the thresholds."""

from __future__ import annotations

import contextlib
import io
import json
import warnings

import numpy as np
import pytest

from pmbm.cli import main

CALIBRATION = "".join(f"P{i}: 700 0 600 0 0 700 180 0 0 0 1 0\n" for i in range(4))
EVERYDAY, MANY = range(12), range(12, 150)
SHARED = {"MOTA": "MOTA", "MOTP": "MOTP", "FP": "CLR_FP", "FN": "CLR_FN", "IDS": "IDSW",
          "FRAG": "Frag", "HOTA": "HOTA", "DetA": "DetA", "AssA": "AssA"}  # fmt: skip


def problem(seed):
    """Rows of labels and results.  Boxes have decimal coordinates; of some pairs the shift is a
    third of the width, an IoU of 1/2, and some results lie half inside a region.  Objects and
    regions stand far apart, so that no two matchings are equally good."""
    rng = np.random.default_rng([seed, 5])
    labels, results = [], []
    for frame in range(int(rng.integers(2, 12))):
        track = 0
        for i in range(int(rng.integers(1, 5))):
            width = 3 * rng.integers(100, 2000) / 100
            height = rng.integers(2600, 12000) / 100
            left, top = 150 * i + rng.integers(0, 5000) / 100, rng.integers(0, 9000) / 100
            kind = rng.choice(["Car", "Car", "Van"])
            occluded, truncated = rng.choice([0, 0, 3]), rng.choice([0, 0, 0, 1])
            if rng.random() < 0.85:
                labels.append(row(frame, i, kind, truncated, occluded, left, top, width, height))
            if rng.random() < 0.85:
                shift = width / 3 if rng.random() < 0.6 else rng.integers(0, 400) / 100
                name = 10 + i + (100 if rng.random() < 0.1 else 0)
                results.append(row(frame, name, "Car", -1, -1, left + shift, top, width, height, 1))
        for j in range(int(rng.integers(0, 3))):
            left, top = 800 + 200 * j + rng.integers(0, 5000) / 100, rng.integers(0, 9000) / 100
            width, height = 2 * rng.integers(500, 4000) / 100, rng.integers(2400, 9000) / 100
            labels.append(row(frame, -1, "DontCare", -1, -1, left, top, width, height))
            track = 500 + 10 * frame + j
            shift = width / 2 if rng.random() < 0.7 else rng.integers(0, 2000) / 100
            results.append(row(frame, track, "Car", -1, -1, left + shift, top, width, height, 1))
    return labels, results


def row(frame, track, kind, truncated, occluded, left, top, width, height, score=None):
    box = f"{left:.2f} {top:.2f} {left + width:.2f} {top + height:.2f}"
    solid = "-1 -1 -1 -1000 -1000 -1000 -10" if kind == "DontCare" else "1.5 1.6 4 1 1.7 22 -1.5"
    line = f"{frame} {track} {kind} {truncated} {occluded} -1.5 {box} {solid}"
    return line + ("\n" if score is None else f" {score}\n")


def by_trackeval(folder):
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import trackeval

        dataset = trackeval.datasets.Kitti2DBox(
            {
                "GT_FOLDER": str(folder / "kitti"),
                "TRACKERS_FOLDER": str(folder / "trackers"),
                "CLASSES_TO_EVAL": ["car"],
                "SPLIT_TO_EVAL": "training",
                "PRINT_CONFIG": False,
            }
        )
        raw = dataset.get_raw_seq_data("ours", "0000")
        data = dataset.get_preprocessed_seq_data(raw, "car")
        quiet = {"PRINT_CONFIG": False}
        found = {
            **trackeval.metrics.CLEAR(quiet).eval_sequence(data),
            **trackeval.metrics.HOTA().eval_sequence(data),
        }
        return {ours: np.mean(found[theirs]) for ours, theirs in SHARED.items()}, data


@pytest.mark.parametrize(
    "seeds",
    [pytest.param(EVERYDAY, id="few"), pytest.param(MANY, id="many", marks=pytest.mark.slow)],
)
def test_as_trackeval_scores_files(tmp_path, capsys, seeds):
    at_the_threshold = 0
    for seed in seeds:
        folder = tmp_path / str(seed)
        labels, results = problem(seed)
        for place, lines in (
            ("kitti/label_02", labels),
            ("trackers/ours/data", results),
            ("kitti/calib", [CALIBRATION]),
        ):
            (folder / place).mkdir(parents=True)
            (folder / place / "0000.txt").write_text("".join(lines))
        frames = 1 + max(int(line.split()[0]) for line in labels + results)
        seqmap = folder / "kitti" / "evaluate_tracking.seqmap.training"
        seqmap.write_text(f"0000 empty 000000 {frames:06d}\n")
        theirs, data = by_trackeval(folder)
        with pytest.raises(SystemExit) as stop:
            main(["evaluate", "kitti", "--root", str(folder / "kitti"), "--results",
                  str(folder / "trackers" / "ours" / "data"), "--rule", "iou2d", "--classes", "Car",
                  "--json", "-"])  # fmt: skip
        assert stop.value.code == 0
        ours = json.loads(capsys.readouterr().out)["scores"]["Car"]["all"]
        if not data["num_gt_dets"] or not data["num_tracker_dets"]:
            continue  # One side is empty, where the program returns early.
        at_the_threshold += sum(
            int((np.abs(table - 0.5) < 1e-12).sum()) for table in data["similarity_scores"]
        )
        for name, value in theirs.items():
            # Its mean over no match is 0, ours is undefined.
            assert (ours[name] or 0.0) == pytest.approx(value, abs=1e-9), (seed, name)
    assert at_the_threshold > len(seeds)
