"""The page about pages says what is so."""

import re
from pathlib import Path

from pmbm.cli import COMMANDS

PAGE = (Path(__file__).parents[2] / "docs" / "guide" / "reports.md").read_text(encoding="utf-8")


def test_the_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    names = {}
    exec(compile(example, "docs/guide/reports.md", "exec"), names)
    assert names["cell"]._repr_html_().startswith("<iframe")
    assert (tmp_path / "scene.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_the_commands_and_options_exist():
    import importlib

    for line in re.findall(r"`pmbm ([^`]+)`", PAGE):
        name, *words = line.split()
        assert name in COMMANDS
        command = importlib.import_module(f"pmbm.cli.{name}").command
        known = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known
