"""What README and the documents show can be done as it stands there."""

import importlib
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest

import pmbm.cli
from pmbm.cli import COMMANDS, main
from pmbm.cli.sources import resolve
from pmbm.datasets import DATASETS, LAYOUTS, open_dataset
from pmbm.errors import InputError
from pmbm.filter import PMBMConfig
from pmbm.study.configured import from_table
from pmbm.study.file import load_study

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
IDS = [str(page.relative_to(ROOT)) for page in PAGES]
MY_PACKAGE = """
import numpy as np
from pmbm import Tracks
class MyTracker:
    def step(self, detections):
        n = len(detections)
        return Tracks(time=detections.time, id=np.arange(n), position=detections.position,
                      size=detections.size, yaw=detections.yaw, velocity=np.zeros((n, 2)),
                      score=detections.score, label=detections.label)
"""
PLACEHOLDER = re.compile(r"\b(NAME|FILE|DATASET|SCENARIO|FOLDER|STORE|\.\.\.)|\.\.\.|[<>|]")


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def commands(page):
    """Every `pmbm` command of a page: lines of its blocks, and those in the text."""
    text = page.read_text(encoding="utf-8")
    fenced = "".join(re.findall(r"```\w*\n(.*?)```", text, re.DOTALL))
    indented = "\n".join(re.findall(r"^    (pmbm (?:.*\\\n)*.*)", text, re.MULTILINE))
    lines = (fenced + "\n" + indented).replace("\\\n", " ").splitlines()
    inline = re.findall(r"`(pmbm [^`]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    found = [line.strip() for line in lines if line.strip().startswith("pmbm ")]
    return [" ".join(command.split()) for command in found + inline]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder with a tracker of their own."""
    (tmp_path / "my_package.py").write_text(MY_PACKAGE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_package", raising=False)
    return tmp_path


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=str)
def test_the_python_of_a_page_runs_from_top_to_bottom(page, folder, capsys):
    names = {}
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec"), names)
    if "region" in names:
        expected = names["tracks"][-1].undetected.expected_count(names["region"])
        assert 0 < expected < 1


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_command_takes_what_the_page_gives_it(page):
    for command in commands(page):
        line, _, _ = command.partition(" #")
        words = shlex.split(line)[1:]
        if not words or words[0].startswith("-"):
            continue
        assert words[0] in COMMANDS, command
        if PLACEHOLDER.search(line) or len(words) == 1 or "--help" in words:
            continue
        module = importlib.import_module(f"pmbm.cli.{words[0].replace('-', '_')}")
        module.command.make_context(words[0], words[1:])


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_file_that_a_page_points_to_is_there(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(
        r'src(?:set)?="([^"]+)"', text
    )
    for target in targets:
        assert target.startswith("http") or (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_file_that_a_command_reads_is_in_the_repository(page):
    """Studies and scripts are named from the root."""
    for line in [*commands(page), *re.findall(r"python ((?:studies|tests)/\S+)", page.read_text())]:
        for word in re.findall(r"(?:studies|tests|scenarios)/[\w/]+\.(?:py|toml)", line):
            assert (ROOT / word).exists(), line
        study = re.match(r"pmbm study (\S+\.toml)", line)
        assert (
            study is None
            or study[1] in ("night.toml", "mine_study.toml")
            or (ROOT / study[1]).exists()
        ), line


def test_the_files_of_the_pages_are_what_they_say(folder):
    (folder / "my_module.py").write_text(MY_PACKAGE)
    scenario = ROOT / "scenarios" / "examples" / "my_junction.toml"
    (folder / "my_junction.toml").write_text(scenario.read_text())
    (night,) = blocks(ROOT / "README.md", "toml")
    (folder / "night.toml").write_text(night)
    study = load_study(folder / "night.toml", resolve)
    assert (len(study.cells), study.gate["metric"]) == (4, "ospa")
    whole, gate = blocks(ROOT / "docs" / "guide" / "studies.md", "toml")
    (folder / "studies.toml").write_text(whole + gate)
    assert len(load_study(folder / "studies.toml", resolve).cells) == 2 * 3 * 2 * 32
    (preset,) = blocks(ROOT / "docs" / "results" / "presets.md", "toml")
    assert from_table(PMBMConfig, tomllib.loads(preset)).sensor.clutter_rate == 2.0


def test_readme_is_short():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 115
    assert len(text.split()) <= 850
    named = {command.split()[1] for command in commands(ROOT / "README.md")}
    assert {"study", "report", "gate", "picture", "init"} <= named


def test_the_index_names_every_page():
    text = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").as_posix()
        assert name == "README.md" or f"]({name})" in text, name


def test_the_table_of_speed_is_the_records(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tests" / "benchmark")
    bench = importlib.import_module("bench")
    import json

    rows = json.loads((ROOT / "reports" / "benchmarks.json").read_text())["rows"]
    page = (ROOT / "docs" / "results" / "speed.md").read_text(encoding="utf-8")
    assert page == bench.page(rows)


def test_the_layout_of_every_dataset_is_on_one_page_and_in_the_error(tmp_path):
    page = (ROOT / "docs" / "guide" / "datasets.md").read_text(encoding="utf-8")
    assert set(LAYOUTS) == set(DATASETS)
    for name, layout in LAYOUTS.items():
        assert layout.replace("<", "&lt;").replace(">", "&gt;") in page
        with pytest.raises(InputError) as caught:
            open_dataset(name, root=tmp_path / "nowhere")
        assert f"{name}: there is no such folder" in str(caught.value)
        assert layout in str(caught.value)


@pytest.mark.slow
def test_the_gate_of_readme_runs_as_it_stands(folder, capsys):
    """Beside the branch main of a repository whose tracker is the same."""
    import subprocess

    (night,) = blocks(ROOT / "README.md", "toml")
    (folder / "night.toml").write_text(night)
    settings = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    for words in (["init", "-q", "-b", "main"], ["add", "."], ["commit", "-q", "-m", "a"]):
        subprocess.run(["git", *settings, *words], cwd=folder, check=True, capture_output=True)
    (line,) = [c for c in commands(ROOT / "README.md") if c.startswith("pmbm gate")]
    with pytest.raises(SystemExit) as stop:
        main([*shlex.split(line.partition(" #")[0])[1:], "--tracker", "my_package:MyTracker"])
    assert stop.value.code == 0
    assert "pass" in capsys.readouterr().out
    assert pmbm.cli.COMMANDS
