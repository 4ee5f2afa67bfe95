"""The page of the paper's tables: its commands are ones that there are, and run on the samples."""

import importlib
import re
import runpy
import shlex
import shutil
from pathlib import Path

import pytest

from pmbm.cli import COMMANDS, main
from pmbm.datasets import open_dataset

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "results" / "paper_tables.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```\n(.*?)```", PAGE, re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines()]
SAMPLES = [
    line for line in LINES if re.match(r"pmbm (track|evaluate|compare) (argoverse1|waymo)", line)
]


@pytest.mark.parametrize("line", LINES)
def test_every_command_is_one_that_there_is(line):
    program, name, *words = shlex.split(line)
    if program == "python":
        runpy.run_path(str(ROOT / name))["command_line"]().parse_intermixed_args(words)
        return
    assert program == "pmbm"
    assert name in COMMANDS
    command = importlib.import_module(f"pmbm.cli.{name.replace('-', '_')}").command
    # Parses as on the command line: unknown options, wrong values and missing ones raise.
    command.make_context(name, words)


def test_the_commands_of_the_published_tables_run_on_the_samples(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("argoverse1", "waymo"):
        shutil.copytree(ROOT / "tests" / "data" / name, tmp_path / name)
    assert len(SAMPLES) == 14
    for line in SAMPLES:
        with pytest.raises(SystemExit) as stop:
            main(shlex.split(line)[1:])
        assert stop.value.code == 0, (line, capsys.readouterr().err)
    scored = capsys.readouterr().out
    for rule in ("centres within 2 m", "3D IoU of at least .7 (vehicles) or .5"):
        assert scored.count(rule) >= 3
    dataset = open_dataset("argoverse1", root="argoverse1/val")
    (log,) = dataset.sequences()
    assert len(dataset.read(log, tmp_path / "results/argoverse1/pmbm-paper")) == 3


def test_what_it_points_to_is_there():
    for path in re.findall(r"`((?:studies|pmbm)/[a-z_/.]+)`", PAGE):
        assert (ROOT / path).exists(), path
    for line in LINES:
        if match := re.search(r"studies/[a-z_]+\.toml", line):
            assert (ROOT / match[0]).exists(), match[0]


PUBLISHED = {"63.15", "68.70", "41.70", "45.50", "65.90", "71.67", "48.31", "48.56"} | {
    *("25.92", "29.14", "36.57", "38.51")
}


def test_the_published_rows_are_marked_as_such():
    """Every figure of the paper stands under a heading that says so, and none elsewhere."""
    published, _, here = PAGE.partition("## As run here")
    sections = published.split("## ")[1:]
    assert all(section.startswith("As published") for section in sections)
    assert all(figure in published and figure not in here for figure in PUBLISHED)
