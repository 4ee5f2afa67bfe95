"""What an option of the KITTI preset is worth on the sequences for tuning, cross-validated.

    python studies/cross_validate_kitti.py KITTI [--mode batch] [Car.scores.drift=1.0 ...]

Threefold: what scores and misses say is fitted to two thirds of the sequences, the third is tracked
with it, and each class is scored over all three.  The fit is that of the preset as it ships, made
once in a folder (--work); options are put into what was fitted.  The sequences for reporting are
never read.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from pmbm.sim.toml_tables import toml_text

FOLDS = (("0000", "0004", "0011"), ("0002", "0007", "0017"), ("0003", "0005", "0009"))
SUMMED = ("MOTA", "IDF1", "HOTA")


def command_line() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("root", type=Path, metavar="KITTI", help="the dataset's folder")
    parser.add_argument("changes", nargs="*", metavar="CLASS.OPTION=VALUE", type=_change)
    parser.add_argument("--mode", choices=("online", "batch"), default="online")
    parser.add_argument("--work", type=Path, default=Path("cross_validation"))
    return parser


def main() -> None:
    parser = command_line()
    options = parser.parse_intermixed_args()
    options.work.mkdir(parents=True, exist_ok=True)
    for number, fold in enumerate(FOLDS):
        fitted = options.work / f"without_{number}.toml"
        if not fitted.exists():
            rest = [name for other in FOLDS if other != fold for name in other]
            _pmbm("fit-marks", "kitti", *_data(options.root), "--sequences", *rest,
                  "--together", "Pedestrian", "Cyclist", "--out", fitted)  # fmt: skip
        parameters = tomllib.loads(fitted.read_text(encoding="utf-8"))
        for path, value in options.changes:
            if path[0] not in parameters:
                parser.error(f"no class '{path[0]}'; there are {', '.join(parameters)}")
            _put(parameters, path, value)
        changed = options.work / "changed.toml"
        changed.write_text(toml_text(parameters), encoding="utf-8")
        _pmbm("track", "kitti", *_data(options.root), "--sequences", *fold, "--config", changed,
              "--mode", options.mode, "--out", options.work / "tracks")  # fmt: skip
    sequences = [name for fold in FOLDS for name in fold]
    said = _pmbm("evaluate", "kitti", *_data(options.root)[:2], "--sequences", *sequences,
                 "--results", options.work / "tracks", "--json", "-")  # fmt: skip
    for kind, scores in json.loads(said)["scores"].items():
        found = scores["all"]
        shown = "  ".join(f"{name} {found[name]:.4f}" for name in SUMMED)
        print(f"{kind:12s}{shown}  sum {sum(found[name] for name in SUMMED):.4f}")


def _change(text: str) -> tuple[list[str], Any]:
    path, equals, value = text.partition("=")
    if not equals or "." not in path:
        raise argparse.ArgumentTypeError(f"'{text}' is not CLASS.OPTION=VALUE")
    return path.split("."), tomllib.loads(f"value = {value}")["value"]


def _put(table: dict[str, Any], path: list[str], value: Any) -> None:
    for part in path[:-1]:
        table = table.setdefault(part, {})
    table[path[-1]] = value


def _data(root: Path) -> tuple[Any, ...]:
    detections = root / "detections" / "pointrcnn_{class}"
    return "--root", root, "--poses", root / "pose", "--detections", detections


def _pmbm(*arguments: Any) -> str:
    command = [sys.executable, "-m", "pmbm", *map(str, arguments)]
    done = subprocess.run(command, text=True, stdout=subprocess.PIPE)
    if done.returncode:
        # It has said why.
        sys.exit(done.returncode)
    return done.stdout


if __name__ == "__main__":
    main()
