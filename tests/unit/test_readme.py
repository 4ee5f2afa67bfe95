"""What the README shows can be done as it stands there."""

import re
from pathlib import Path

import pytest

from pmbm.cli import COMMANDS
from pmbm.labels import Label
from pmbm.metrics import combine

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


def test_the_examples_run_one_after_another(capsys):
    names = {"combine": combine, "Label": Label}
    for block in BLOCKS:
        code = compile(block, "README.md", "exec")
        if "my_package" in block:
            continue
        exec(code, names)
        names["runs"] = [(names["recording"], names["tracks"])]
    assert "gospa" in capsys.readouterr().out
    expected = names["tracks"][-1].undetected.expected_count(names["region"])
    assert 0 < expected < 1


def test_every_command_that_it_names_exists():
    named = set(re.findall(r"(?:^|`)pmbm ([a-z-]+)", TEXT, re.MULTILINE))
    assert {"run", "study", "gate", "track", "picture"} <= named <= set(COMMANDS)


@pytest.mark.parametrize("target", sorted(set(re.findall(r"\]\(([^)#]+)\)", TEXT))))
def test_every_file_that_it_points_to_is_there(target):
    assert target.startswith("http") or (ROOT / target).exists()
