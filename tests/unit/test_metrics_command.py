"""`pmbm metrics` lists every metric with its question."""

from pathlib import Path

import pytest

from pmbm.cli import main
from pmbm.metrics import DEFAULT_METRICS


def pmbm(*arguments):
    """The exit code."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    return stop.value.code


def test_every_metric_is_listed(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    assert pmbm("metrics") == 0
    text = capsys.readouterr().out
    for name in (*DEFAULT_METRICS, "tgospa", "siap_ambiguity"):
        assert name.removesuffix("_observable") in text


def test_one_metric_is_told_alone(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    assert pmbm("metrics", "id_kept", "tgospa") == 0
    text = capsys.readouterr().out
    assert "come back under its old id" in text
    assert "by name" in text
    assert "mota" not in text


def test_an_unknown_metric_names_the_nearest(capsys):
    assert pmbm("metrics", "gopsa") == 2
    assert "did you mean 'gospa'?" in capsys.readouterr().err


def test_the_page_is_what_is_printed(capsys, tmp_path):
    page = Path(__file__).parents[2] / "docs" / "metrics.md"
    assert pmbm("metrics", "--markdown", "-") == 0
    assert capsys.readouterr().out == page.read_text(encoding="utf-8")
    assert pmbm("metrics", "--markdown", str(tmp_path / "page.md")) == 0
    assert (tmp_path / "page.md").read_bytes() == page.read_bytes()
