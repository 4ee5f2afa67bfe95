"""`pmbm picture`, as a user calls it."""

import xml.etree.ElementTree as ElementTree

import pytest
from PIL import Image
from short_road import short_road

from pmbm.cli import main

QUICK = short_road(1.0)


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(QUICK)
    return "short.toml"


def call(*arguments):
    with pytest.raises(SystemExit) as leave:
        main(list(arguments))
    return leave.value.code


@pytest.mark.parametrize("kind", ["scene", "hidden", "errors"])
def test_every_kind_is_drawn(scene, tmp_path, kind):
    assert call("picture", scene, "--kind", kind) == 0
    with Image.open(tmp_path / "reports" / f"short-{kind}.png") as image:
        assert image.width > 1000


def test_vector_pictures(scene, tmp_path):
    arguments = ("--tracker", "pmbm", "--tracker", "argoverse", "--frame", "5", "--dark")
    assert call("picture", scene, *arguments, "--out", "docs/a.svg") == 0
    text = (tmp_path / "docs" / "a.svg").read_text()
    ElementTree.fromstring(text)
    assert "argoverse" in text


def test_what_cannot_be_drawn_is_one_line(scene, capsys):
    assert call("picture", scene, "--out", "a.bmp") == 2
    assert call("picture", scene, "--frame", "99") == 2
    assert call("picture", scene, "--kind", "hidden", "--tracker", "argoverse") == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 3
    assert ".svg or .png" in lines[0]
    assert "no such frame" in lines[1]
    assert "no intensity" in lines[2]
