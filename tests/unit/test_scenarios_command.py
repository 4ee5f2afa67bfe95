"""`pmbm scenarios`: what ships, one scenario in words and as a picture, the schema."""

import json

import pytest

from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.sim import load_scenario, scenario_names


@pytest.fixture
def run(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(["scenarios", *map(str, arguments)])
        printed = capsys.readouterr()
        return ended.value.code, printed.out, printed.err

    return call


def test_the_list_has_every_scenario(run):
    code, out, _ = run()
    assert code == 0
    for name in scenario_names():
        assert name in out


def test_one_scenario_is_described_and_drawn(run, tmp_path):
    from PIL import Image

    code, out, _ = run("truck_occlusion", "--level", "4", "--out", tmp_path / "new")
    assert code == 0
    scenario = load_scenario("truck_occlusion")
    assert scenario.stresses in out
    assert "0, 0.75, 1.5, 2.5, 4 s" in out
    assert "at level    4" in out
    assert "no significant improvement" in out
    (picture,) = (tmp_path / "new").iterdir()
    with Image.open(picture) as image:
        assert image.width > 800
        assert len(image.convert("RGB").getcolors(1 << 24)) > 8


def test_a_factor_that_is_not_monotone_says_why(run, tmp_path):
    _, out, _ = run("frame_rate", "--out", tmp_path)
    assert "not monotone: more frames also bring more clutter" in out


def test_the_schema_is_json(run):
    code, out, _ = run("--schema")
    assert code == 0
    assert json.loads(out)["properties"]["stresses"]["minLength"] == 10


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["crosing"], ["no scenario 'crosing'", "'crossing'"]),
        (["crossing", "--level", "7"], ["no such level", "5.0, 3.0, 2.0, 1.0", "7.0"]),
        (["crossing@hard"], ["no such level", "'hard'"]),
        (["nowhere.toml"], ["nowhere.toml"]),
        (["crossing", "--out", "/proc/nowhere"], ["/proc/nowhere"]),
    ],
)
def test_mistakes_end_in_one_line_and_code_2(run, arguments, words):
    code, _, err = run(*arguments)
    assert code == 2
    assert err.count("\n") == 1
    for word in words:
        assert word in err


def test_a_name_may_carry_its_level():
    scenario = load_scenario("truck_occlusion@4")
    assert scenario.name == "truck_occlusion@4"
    assert scenario.default_level == 4.0
    with pytest.raises(InputError, match="no such level"):
        load_scenario("truck_occlusion@5")
