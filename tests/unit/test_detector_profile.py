"""Profiles: what ships, what a file may say, and what is refused by name."""

import pickle

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.labels import Label
from pmbm.sim.detector.clutter import ClutterModel
from pmbm.sim.detector.knobs import Curve
from pmbm.sim.detector.model import DetectorModel, load_profile, shipped_profiles
from pmbm.sim.detector.objects import ObjectModel


@pytest.mark.parametrize("name", shipped_profiles())
def test_what_ships_loads_and_comes_back_from_its_plain_form(name):
    model = load_profile(name)
    assert model.name == name
    assert model.provenance
    assert load_profile(model.plain()) == model
    assert pickle.loads(pickle.dumps(model)) == model


def test_the_expected_profiles_ship():
    assert {"perfect", "nominal", "harsh"} <= set(shipped_profiles())
    nominal = load_profile("nominal")
    assert nominal.clutter.rate == 2.0
    assert nominal.of(Label.CAR).probability(np.array([30.0]), np.ones(1)) == [0.95]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"clutter": {"rate": -1}}, ["clutter.rate", "at least 0", "-1"]),
        (
            {"objects": {"detection_probability": 1.3}},
            ["objects.detection_probability", "at most 1", "1.3"],
        ),
        ({"object": {}}, ["unknown key", "'objects'"]),
        ({"clutter": {"rat": 1}}, ["clutter.rat", "'rate'"]),
        ({"clutter": {"labels": {"carr": 1.0}}}, ["clutter.labels.carr", "'car'"]),
        ({"clutter": {"labels": {"car": 0}}}, ["clutter.labels", "above 0"]),
        ({"label": {"truk": {}}}, ["label.truk", "'truck'"]),
        ({"label": {"truck": {"radialnoise": 1}}}, ["label.truck.radialnoise", "'radial_noise'"]),
        ({"label": {"truck": 3}}, ["label.truck", "a table", "3"]),
        ({"clutter": {"rate": "2"}}, ["clutter.rate", "number", "'2'"]),
        ({"clutter": {"rate": True}}, ["clutter.rate", "number", "True"]),
        ({"clutter": {"rate": float("nan")}}, ["clutter.rate", "nan"]),
        ({"clutter": 3}, ["clutter", "a table", "3"]),
        (
            {"clutter": {"aligned_share": 0.7, "across_share": 0.4}},
            ["clutter", "across_share", "at most 1", "0.4"],
        ),
        ({"clutter": {"label": {"car": {"rate": 3}}}}, ["clutter.label.car.rate", "unknown key"]),
        ({"clutter": {"label": {"car": {"score_mean": 3}}}}, ["label.car.score_mean", "at most 1"]),
        ({"objects": {"typical_size": [4, -2, 1]}}, ["objects.typical_size", "above 0", "-2"]),
        ({"objects": {"typical_size": [4, 2]}}, ["objects.typical_size"]),
        ({"sensor": {"late_by": 1.5}}, ["sensor.late_by", "whole number", "1.5"]),
        ({"score_temperature": 0}, ["score_temperature", "above 0", "0"]),
        ({"objects": {"radial_noise": {"at": [1, 0], "value": [1, 2]}}}, ["radial_noise", "incr"]),
        ({"objects": {"radial_noise": {"att": [1], "value": [1]}}}, ["radial_noise.att", "'at'"]),
        ({"objects": {"radial_noise": {"at": [1]}}}, ["radial_noise.value", "missing"]),
        ({"objects": {"radial_noise": {"at": [1], "value": [1, 2]}}}, ["radial_noise", "1 number"]),
        ({"objects": {"radial_noise": "wide"}}, ["objects.radial_noise", "wide"]),
    ],
)
def test_mistakes_are_refused_by_key(overrides, words):
    with pytest.raises(InputError) as caught:
        load_profile("nominal", overrides)
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_is_named_and_its_mistake_too(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[clutter]\nrate = -2.0\n")
    with pytest.raises(InputError, match=r"mine\.toml.*clutter\.rate"):
        load_profile(path)
    path.write_text("[clutter\nrate = 2.0\n")
    with pytest.raises(InputError, match=r"line 1.*mine\.toml"):
        load_profile(path)
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(InputError, match=r"mine\.toml"):
        load_profile(str(path))
    with pytest.raises(InputError, match=r"absent\.toml"):
        load_profile(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="'nominal'"):
        load_profile("nominl")


def test_values_made_in_python_pass_the_same_door():
    with pytest.raises(InputError, match="flip_probability"):
        ObjectModel(flip_probability=1.5)
    with pytest.raises(InputError, match="rate"):
        ClutterModel(rate=-1.0)
    with pytest.raises(InputError, match="score_temperature"):
        DetectorModel(score_temperature=-1.0)


def test_a_label_refines_and_an_override_of_objects_speaks_for_all(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        "[objects]\nradial_noise = 0.5\nyaw_noise = 0.1\n[label.truck]\nradial_noise = 0.9\n"
    )
    model = load_profile(path)
    at = np.array([10.0])
    assert model.of(Label.TRUCK).radial_noise(at) == 0.9
    assert model.of(Label.TRUCK).yaw_noise(at) == 0.1
    assert model.of(Label.CAR).radial_noise(at) == 0.5
    both = load_profile(path, {"objects": {"radial_noise": 0.2}})
    assert both.of(Label.TRUCK).radial_noise(at) == both.of(Label.CAR).radial_noise(at) == 0.2
    one = load_profile(path, {"objects": {"yaw_noise": 0.3}, "label": {"truck": {"yaw_noise": 0}}})
    assert (one.of(Label.TRUCK).yaw_noise(at), one.of(Label.CAR).yaw_noise(at)) == (0.0, 0.3)


def test_a_curve_is_linear_between_and_constant_beyond():
    curve = Curve(at=(10, 20), value=(1, 0))
    assert curve(np.array([0.0, 10.0, 15.0, 20.0, 90.0])).tolist() == [1.0, 1.0, 0.5, 0.0, 0.0]


def test_clutter_of_a_label_refines_the_shared_table():
    base = {"clutter": {"score_mean": 0.4, "label": {"car": {"size_spread": [0.2, 0.2, 0.2]}}}}
    model = load_profile(base)
    assert model.clutter.of(Label.CAR).score_mean == Curve.constant(0.4)
    assert model.clutter.of(Label.CAR).size_spread == (0.2, 0.2, 0.2)
    assert model.clutter.of(Label.TRUCK).size_spread == (0.1, 0.1, 0.1)
    changed = load_profile(base, {"clutter": {"size_spread": [0.0, 0.0, 0.0]}})
    assert changed.clutter.of(Label.CAR).size_spread == (0.0, 0.0, 0.0)
    assert load_profile(changed.plain()) == changed
