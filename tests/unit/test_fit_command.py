"""`pmbm fit-detector` on a small folder in KITTI's layout, and profiles as files."""

import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from pmbm.cli.fit_detector import command
from pmbm.errors import InputError
from pmbm.sim.detector.model import load_profile, shipped_profiles
from pmbm.sim.toml_tables import toml_text

KITTI = Path(__file__).parents[1] / "data" / "kitti"


def fit(tmp_path, *extra):
    arguments = ["kitti", "--root", str(KITTI / "training"), "--out", str(tmp_path)]
    arguments += ["--detections", str(KITTI / "detections_ab3dmot"), "--trials", "1", *extra]
    return CliRunner().invoke(command, arguments, catch_exceptions=False)


def test_a_profile_and_a_page_come_out(tmp_path):
    result = fit(tmp_path, "--name", "mine")
    assert result.exit_code == 0, result.output
    model = load_profile(tmp_path / "mine.toml")
    assert model.name == "mine"
    assert "kitti: 0000" in model.provenance
    page = (tmp_path / "mine.html").read_text(encoding="utf-8")
    assert "The model over the data" in page
    assert page.count("<img") >= 5
    assert "http" not in page.replace("http-equiv", "").split("<main>")[0]


def test_mistakes_are_named(tmp_path):
    with pytest.raises(InputError, match="'kitti'"):
        CliRunner().invoke(
            command,
            ["kiti", "--root", str(KITTI), "--detections", "x", "--out", str(tmp_path)],
            catch_exceptions=False,
        )


@pytest.mark.parametrize("name", shipped_profiles())
def test_a_profile_written_as_toml_reads_back(name, tmp_path):
    model = load_profile(name)
    path = tmp_path / "copy.toml"
    path.write_text(toml_text(model.plain()), encoding="utf-8")
    assert load_profile(path) == model


def test_toml_text_holds_every_kind_of_value():
    document = {
        "text": 'a "quoted"\nline, ünï',
        "yes": True,
        "whole": 3,
        "real": 1e-9,
        "list": [1.5, 2.5],
        "curve": {"at": [0.0, 1.0], "value": [2.0, 3.0]},
        "table": {"inner": {"x": 1}, "y": 2.0},
        "tables": [{"a": 1, "b": {"c": "d"}}, {"a": 2}],
        "odd key": 1,
    }
    assert tomllib.loads(toml_text(document)) == document
