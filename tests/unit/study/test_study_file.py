"""Study files, the trials they stand for, and the hash that identifies them."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from study_worlds import Convoy, Echo

from pmbm.cli import main, sources
from pmbm.errors import InputError
from pmbm.filter import PMBMTracker
from pmbm.study import ConfiguredTracker
from pmbm.study.code import code_version
from pmbm.study.configured import config_of, merged
from pmbm.study.design import grid, latin_hypercube
from pmbm.study.file import json_schema, load_study
from pmbm.types import Site


def resolve(name, overrides):
    if name != "convoy" and not name.endswith("own.toml"):
        raise InputError(f"no scenario '{name}'", hint="did you mean 'convoy'?")
    return Convoy(**overrides)


def written(tmp_path, text):
    file = tmp_path / "night.toml"
    file.write_text(text)
    return file


def load(tmp_path, text):
    return load_study(written(tmp_path, text), resolve)


SMALL = """
scenarios = ["convoy"]
trackers = ["study_worlds:Echo"]
trials = 3
"""


def test_a_small_file(tmp_path):
    study = load(tmp_path, SMALL)
    assert (study.name, len(study), study.seed) == ("night", 3, 0)
    result = study.run(2)
    assert (result.source, result.seed, result.trial) == ("convoy", 0, 2)
    assert result.recording == Convoy().record(0, 2).digest()


def test_a_full_file(tmp_path):
    study = load(
        tmp_path,
        """
name = "full"
scenarios = ["convoy", "own.toml"]
trackers = ["pmbm", "tight", "study_worlds:Echo"]
trials = 10
seed = 4
metrics = ["ospa", "mota"]

[tracker.tight]
factory = "pmbm"
parameters = { reduction = { gate = 9.0 } }

[sweep.grid]
noise = [0.1, 0.5]
"tracker.pmbm.sensor.detection.base.probability" = [0.8, 0.9, 0.95]

[limits]
seconds = 60
megabytes = 2000

[gate]
margin = 0.1
""",
    )
    assert len(study.cells) == 2 * 6
    assert len(study) == 120
    cell = study.cells[4]
    assert cell.scenario == "convoy"
    swept = "sensor.detection.base.probability"
    assert cell.point == {"noise": 0.5, f"tracker.pmbm.{swept}": 0.9}
    assert cell.source == Convoy(noise=0.5)
    assert cell.label == f"convoy [noise = 0.5, tracker.pmbm.{swept} = 0.9]"
    assert cell.trackers["pmbm"].parameters == ((swept, 0.9),)
    assert cell.trackers["tight"](site=Site()).config.reduction.gate == 9.0
    assert isinstance(cell.trackers["study_worlds:Echo"](site=Site()), Echo)
    assert (study.time_limit, study.memory_limit, study.gate["margin"]) == (60, 2000, 0.1)


def test_indices_grow_all_cells_together_and_stay(tmp_path):
    few = load(tmp_path, SMALL.replace('["convoy"]', '["convoy", "own.toml"]'))
    many = replace(few, trials=50)
    assert [(few.cell(i).scenario, few.trial(i)) for i in range(4)] == [
        ("convoy", 0),
        ("own.toml", 0),
        ("convoy", 1),
        ("own.toml", 1),
    ]
    assert all(
        (few.cell(i).label, few.trial(i)) == (many.cell(i).label, many.trial(i))
        for i in range(len(few))
    )
    assert few.hash == many.hash


CHANGES = {
    "seed": ("trials = 3", "trials = 3\nseed = 1"),
    "metrics": ("trials = 3", 'trials = 3\nmetrics = ["ospa"]'),
    "tracker": ("study_worlds:Echo", "study_worlds:biased"),
    "sweep": ("trials = 3", "trials = 3\n[sweep.grid]\nnoise = [0.2]"),
    "parameter": (
        'trackers = ["study_worlds:Echo"]\ntrials = 3',
        'trackers = ["e"]\ntrials = 3\n[tracker.e]\nfactory = "study_worlds:Echo"\n'
        "parameters = { bias = 0.5 }",
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_changes_a_result_changes_the_hash(tmp_path, change):
    old, new = CHANGES[change]
    assert old in SMALL
    assert load(tmp_path, SMALL).hash != load(tmp_path, SMALL.replace(old, new)).hash


def test_the_source_itself_is_in_the_hash(tmp_path):
    @dataclass(frozen=True)
    class Document(Convoy):
        document: object = None

    def hash_of(**values):
        return load_study(written(tmp_path, SMALL), lambda *_: Document(**values)).hash

    assert hash_of(document={"a": 1}) == hash_of(document={"a": 1})
    assert hash_of(document={"a": 1}) != hash_of(document={"a": 2})
    assert hash_of() != hash_of(noise=0.9)


def test_the_code_is_in_the_hash(tmp_path, monkeypatch):
    (tmp_path / "mine_for_hashing.py").write_text("def make(): pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    before = code_version(["mine_for_hashing"])["sources"]
    assert set(before) == {"mine_for_hashing", "pmbm", "pmbm.sim"}
    (tmp_path / "mine_for_hashing.py").write_text("def make(): return 1\n")
    after = code_version(["mine_for_hashing"])["sources"]
    assert before["mine_for_hashing"] != after["mine_for_hashing"]
    assert before["pmbm"] == after["pmbm"]


def test_the_hash_is_the_same_in_another_process(tmp_path):
    file = written(tmp_path, SMALL)
    code = (
        "import sys; sys.path[:0] = sys.argv[2:]\n"
        "from study_worlds import Convoy\nfrom pmbm.study.file import load_study\n"
        "print(load_study(sys.argv[1], lambda name, overrides: Convoy(**overrides)).hash)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(file), *sys.path],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONHASHSEED": "77", "PATH": ""},
    )
    assert done.stdout.strip() == load(tmp_path, SMALL).hash


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("trials = 3", "missing key .*field scenarios"),
        (SMALL + "sceds = 1", "unknown key .*sceds.*did you mean 'seed'"),
        (SMALL + "[gate]\nmargn = 1.0", "gate.margn.*did you mean 'margin'"),
        (SMALL + "[sweep]\ngird = {}", "sweep.gird.*did you mean 'grid'"),
        (SMALL.replace("3", '"3"'), "field trials.*expected a whole number.*got '3'"),
        (SMALL.replace("3", "0"), "field trials.*at least 1"),
        (SMALL.replace("convoy", "convey"), "no scenario 'convey'.*did you mean 'convoy'"),
        (SMALL.replace("study_worlds:Echo", "pmbn"), "no tracker 'pmbn'.*did you mean 'pmbm'"),
        (SMALL + 'metrics = ["opsa"]', "opsa.*did you mean 'ospa'"),
        (SMALL.replace('["convoy"]', '["convoy", "convoy"]'), "named twice"),
        (SMALL + "[sweep.grid]\nnoise = []", "no levels.*sweep.grid.noise"),
        (SMALL + '[tracker.pmbm]\nfactory = "pmbm"', "configured, but not in trackers"),
        (SMALL + '[sweep.grid]\n"tracker.pmbm.gate" = [1.0]', "no tracker 'pmbm' in this study"),
        (
            SMALL.replace("study_worlds:Echo", "pmbm")
            + '[tracker.pmbm]\nfactory = "pmbm"\nparameters = { reduction = { gaet = 1.0 } }',
            "no 'gaet'.*reduction.gaet.*did you mean 'gate'",
        ),
        (
            SMALL.replace("study_worlds:Echo", "pmbm")
            + '[tracker.pmbm]\nfactory = "pmbm"\nparameters = { reduction = { gate = -1.0 } }',
            "reduction.gate.*got -1",
        ),
        (
            SMALL + "[sweep.latin_hypercube]\nsamples = 2\nranges = { noise = [2.0, 1.0] }",
            "low < high",
        ),
        ("scenarios = [", "not TOML"),
    ],
)
def test_a_bad_file_is_named_with_its_key(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as caught:
        load(tmp_path, text)
    assert "night.toml" in str(caught.value)


def test_no_file():
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        load_study("nowhere.toml", resolve)


def test_a_grid_is_every_combination():
    assert grid({"a": [1, 2], "b": ["x", "y"]}) == [
        {"a": 1, "b": "x"},
        {"a": 1, "b": "y"},
        {"a": 2, "b": "x"},
        {"a": 2, "b": "y"},
    ]
    assert grid({}) == [{}]


def test_a_hypercube_has_one_point_in_every_slice():
    points = latin_hypercube({"a": (0.0, 1.0), "b": (-10.0, 10.0)}, 16, seed=3)
    assert points == latin_hypercube({"a": (0.0, 1.0), "b": (-10.0, 10.0)}, 16, seed=3)
    for name, low, width in (("a", 0.0, 1 / 16), ("b", -10.0, 20 / 16)):
        slices = np.floor((np.array([p[name] for p in points]) - low) / width)
        assert sorted(slices) == list(range(16))


def test_grid_and_hypercube_meet(tmp_path):
    study = load(
        tmp_path,
        SMALL
        + "[sweep.grid]\ncars = [1, 2]\n[sweep.latin_hypercube]\nsamples = 3\n"
        + "ranges = { noise = [0.1, 0.9] }",
    )
    assert [cell.source.cars for cell in study.cells] == [1, 1, 1, 2, 2, 2]
    assert len({cell.source.noise for cell in study.cells}) == 3


def with_config_of_its_own(site, speed=1.0):
    return (site, speed)


def test_parameters_reach_the_factory():
    site = Site(max_range=33.0)
    own = ConfiguredTracker(f"{__name__}:with_config_of_its_own", (("speed", 4.0),))
    assert own(site=site) == (site, 4.0)
    pmbm = ConfiguredTracker("pmbm", (("reduction.gate", 9.0),))(site=site)
    assert isinstance(pmbm, PMBMTracker)
    assert (pmbm.config.reduction.gate, pmbm.site) == (9.0, site)
    assert ConfiguredTracker("argoverse", (("min_hits", 2),))(site=site).config.min_hits == 2
    with pytest.raises(InputError, match="did you mean 'speed'"):
        ConfiguredTracker(f"{__name__}:with_config_of_its_own", (("sped", 4.0),)).bound()


def test_the_schema_is_json():
    assert "scenarios" in json.loads(json.dumps(json_schema()))["required"]


def test_parameters_from_a_file_of_their_own(tmp_path):
    (tmp_path / "tuned.toml").write_text("[reduction]\ngate = 18.0\n[sensor]\nclutter_rate = 3.0\n")
    text = (
        'scenarios = ["convoy"]\ntrackers = ["tight"]\n'
        '[tracker.tight]\nfactory = "pmbm"\nconfig = "tuned.toml"\n'
        "parameters = { reduction = { gate = 9.0 } }\n"
    )
    study = load(tmp_path, text)
    config = study.cells[0].trackers["tight"](Site()).config
    assert (config.reduction.gate, config.sensor.clutter_rate) == (9.0, 3.0)
    before = study.hash
    (tmp_path / "tuned.toml").write_text("[sensor]\nclutter_rate = 4.0\n")
    assert load(tmp_path, text).hash != before
    for bad, message in (("nowhere.toml", "cannot read it"), ("night.toml", "PMBMConfig has no")):
        with pytest.raises(InputError, match=message):
            load(tmp_path, text.replace("tuned.toml", bad))


def test_a_table_of_the_default_kind_keeps_what_lies_under_it():
    """The lower table has no kind, so it is of the default's; the upper one says that very kind."""
    config = config_of("pmbm")
    under = {"scores": {"drift": 0.1}, "sensor": {"detection": {"prior_seconds": 3.0}}}
    lasting = {"scores": {"kind": "lasting", "scatter": 2.0}}
    assert merged(under, lasting, config)["scores"] == {**under["scores"], **lasting["scores"]}
    chain = {"sensor": {"detection": {"kind": "chain"}}}
    assert merged(under, chain, config)["sensor"]["detection"] == {
        "prior_seconds": 3.0,
        "kind": "chain",
    }
    every = {"scores": {"kind": "every"}}
    assert merged(under, every, config)["scores"] == every["scores"]


@pytest.mark.parametrize(
    ("gate", "said"),
    [
        ('metric = "osp"', r"field gate.metric\); did you mean 'ospa'"),
        ('metric = "mota"', r"no bounds in a trial \(.*field gate.metric"),
        ('metric = "ospa"\nmargin = 99.0', r"field gate.margin.*range"),
        ('metric = "ospa"\nmargin = 1.0\nalpha = 0.5', "field gate.alpha"),
        ('candidate = "pmb"', r"field gate.candidate\); did you mean 'pmbm'"),
    ],
)
def test_a_study_that_no_gate_could_judge_is_refused_before_it_runs(tmp_path, capsys, gate, said):
    file = written(tmp_path, f'scenarios = ["crossing"]\n[gate]\n{gate}\n')
    with pytest.raises(SystemExit):
        main(["study", str(file)])
    assert re.search(said, capsys.readouterr().err)
    assert not file.with_suffix(".sqlite").exists()


def test_parameters_of_a_sensor_that_is_not_there_are_refused(tmp_path):
    text = """
scenarios = ["lidar_radar"]
[tracker.pmbm]
factory = "pmbm"
parameters = { "sensors.SENSOR.clutter_rate" = 3.0 }
"""
    load_study(written(tmp_path, text.replace("SENSOR", "radar")), sources.resolve)
    wrong = written(tmp_path, text.replace("SENSOR", "radra"))
    with pytest.raises(InputError, match=r"tracker.pmbm.sensors\).*did you mean 'radar'"):
        load_study(wrong, sources.resolve)
    text = text.replace("lidar_radar", "crossing").replace("SENSOR", "radar")
    none_at_all = written(tmp_path, text)
    said = r"\(crossing, .*tracker.pmbm.sensors\).*sensor\.KEY"
    with pytest.raises(InputError, match=said):
        load_study(none_at_all, sources.resolve)


def test_a_sweep_reaches_the_rate_of_a_sensor(tmp_path):
    text = 'scenarios = ["lidar_radar"]\n[sweep.grid]\n"sensors.radar.rate" = [20, 5]\n'
    study = load_study(written(tmp_path, text), sources.resolve)
    recordings = [cell.source.record(0) for cell in study.cells]
    looks, others = (
        [
            [one.position.tolist() for one in recording.detections if one.sensor == name]
            for recording in recordings
        ]
        for name in ("radar", "lidar")
    )
    assert [len(one) for one in looks] == [240, 60]
    assert others[0] == others[1]


@pytest.mark.parametrize(
    ("swept", "said"),
    [
        ('"detector.cluter.rate" = [1.0]', r"field sweep: detector.cluter\); did you mean"),
        ('"duration" = [-1.0]', "field sweep: duration.*above 0"),
        ('"level" = [99.0]', "field sweep: level"),
        ('"sensors.radar.rate" = [5]', r"sensors.radar.rate\).*it has a single sensor"),
        ('"tracker.pmbm.reduction.gat" = [9.0]', "field tracker.pmbm.reduction.gat"),
    ],
)
def test_what_is_wrong_with_a_sweep_is_found_in_the_study_file(tmp_path, swept, said):
    file = written(tmp_path, f'scenarios = ["crossing"]\n[sweep.grid]\n{swept}\n')
    with pytest.raises(InputError, match=said) as caught:
        load_study(file, sources.resolve)
    assert caught.value.file == str(file)


def test_failures_of_one_kind_are_printed_once(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(
        'name = "short"\nstresses = "nothing, and that quickly"\nduration = 0.2\n'
        '[scene]\nkind = "scripted"\n'
    )
    (tmp_path / "broken_one.py").write_text(
        "class Broken:\n    def step(self, detections):\n        raise ValueError('no')\n"
    )
    written(tmp_path, 'scenarios = ["short.toml"]\ntrackers = ["broken_one:Broken"]\ntrials = 4\n')
    with pytest.raises(SystemExit) as stop:
        main(["study", "night.toml"])
    assert stop.value.code == 1
    first, *rest = capsys.readouterr().out.splitlines()
    assert re.search(r"trial 0 of short.toml, and in 3 more: .*no; replay: .*--replay 0$", first)
    assert len(rest) == 1
