"""`pmbm track`, from the command line to the file."""

import json
import os
import re
import shutil
import tomllib
from pathlib import Path

import pytest

from pmbm.cli import main
from pmbm.cli.track import at_cost, class_trackers, preset, shipped_detectors
from pmbm.datasets import open_dataset
from pmbm.types import Site

SAMPLE = Path(__file__).parents[1] / "data" / "kitti"


@pytest.fixture
def folder(tmp_path):
    """The sample over eight frames, an own folder of detections for each class."""
    root = tmp_path / "kitti"
    shutil.copytree(SAMPLE / "training", root)
    row = (SAMPLE / "detections_ab3dmot" / "0000.txt").read_text().splitlines()[0].split(",")
    for kind, code in (("Car", "2"), ("Cyclist", "3")):
        (root / f"dets_{kind}").mkdir()
        for name in ("0000", "0001"):
            lines = [",".join([str(k), code, *row[2:]]) for k in range(8)]
            (root / f"dets_{kind}" / f"{name}.txt").write_text("\n".join(lines) + "\n")
    (root / "pose").mkdir()
    for name in ("0000", "0001"):
        (root / "pose" / f"{name}.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 8)
    shutil.copy(root / "calib" / "0000.txt", root / "calib" / "0001.txt")
    return root


def pmbm(*arguments):
    """The exit code."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return stop.value.code


def track(root, *options, out="out", code=0):
    arguments = [
        *("track", "kitti", "--root", root, "--detections", root / "dets_{class}"),
        *("--poses", root / "pose", "--out", root / out, "--classes", "Car", "Cyclist"),
    ]
    assert pmbm(*arguments, *options) == code
    if code:
        return None
    return {path.name: path.read_text() for path in sorted((root / out).iterdir())}


def fails(root, capsys, *options):
    track(root, *options, code=2)
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert message.startswith("pmbm: ")
    return message


def test_writes_a_file_a_sequence(folder, capsys):
    config = folder / "config.toml"
    config.write_text("min_hits = 5\n")
    options = ("--tracker", "argoverse", "--config", config, "--sequences", "0000", "0001")
    files = track(folder, *options)
    assert sorted(files) == ["0000.txt", "0001.txt"]
    assert capsys.readouterr().out.split() == [str(folder / "out" / name) for name in files]
    rows = [line.split() for line in files["0000.txt"].splitlines()]
    assert [int(row[0]) for row in rows] == [4, 4, 5, 5, 6, 6, 7, 7]
    assert {(row[1], row[2]) for row in rows} == {("0", "Car"), ("1", "Cyclist")}
    assert all(len(row) == 18 for row in rows)


def test_no_label_is_needed(folder):
    shutil.rmtree(folder / "label_02")
    assert track(folder, "--tracker", "argoverse")["0000.txt"]


def test_any_number_of_jobs_writes_the_same(folder):
    alone = track(folder, out="one")
    assert track(folder, "--jobs", "2", out="two") == alone
    assert alone["0000.txt"]


def test_a_class_has_its_own_parameters(folder):
    config = folder / "config.toml"
    config.write_text("min_hits = 2\n[Cyclist]\nmin_hits = 6\n")
    files = track(folder, "--tracker", "argoverse", "--config", config, "--sequences", "0000")
    rows = [line.split() for line in files["0000.txt"].splitlines()]
    first = {
        kind: min(int(row[0]) for row in rows if row[2] == kind) for kind in ("Car", "Cyclist")
    }
    assert first == {"Car": 1, "Cyclist": 5}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("min_hitz = 2", "has no 'min_hitz'.*config.toml.*did you mean 'min_hits'"),
        ("[Car]\nmin_score = 1.3", "min_score.*at most 1, got 1.3"),
        ("Car = 3", "not a table.*config.toml, field Car"),
        ("= 3", "not valid TOML.*config.toml"),
    ],
)
def test_bad_parameters(folder, capsys, text, message):
    config = folder / "config.toml"
    config.write_text(text)
    found = fails(folder, capsys, "--tracker", "argoverse", "--config", str(config))
    assert re.search(message, found), found


def test_bad_arguments(folder, capsys):
    assert "did you mean 'argoverse'" in fails(folder, capsys, "--tracker", "argovers")
    assert "no such file" in fails(folder, capsys, "--sequences", "0002")
    assert "expected NNNN" in fails(folder, capsys, "--sequences", "../0000")
    assert "did you mean 'Cyclist'" in fails(folder, capsys, "--classes", "Cyclits")
    assert "no such option" in fails(folder, capsys, "--clases", "Car").lower()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_no_permission(folder, capsys):
    (folder / "out").mkdir(mode=0o500)
    assert "Permission denied" in fails(folder, capsys)


def test_unknown_dataset(capsys):
    assert pmbm("track", "kity", "--root", ".", "--detections", ".", "--out", ".") == 2
    assert "did you mean 'kitti'" in capsys.readouterr().err


def test_help_has_an_example(capsys):
    assert pmbm("track", "--help") == 0
    assert "pmbm track kitti --root" in capsys.readouterr().out


def test_batch_fills_what_online_had_not_reported_yet(folder):
    """Seen in all frames but the fifth; online the first frames are not reported, looking back
    they and the gap are."""
    for name in ("0000", "0001"):
        for kind in ("Car", "Cyclist"):
            path = folder / f"dets_{kind}" / f"{name}.txt"
            lines = path.read_text().splitlines()
            path.write_text("\n".join(lines[:5] + lines[6:]) + "\n")
    config = folder / "config.toml"
    config.write_text("[sensor]\nclutter_rate = 40\n[birth]\nrate = 0.2\ninitial = 0.2\n")
    frames = {}
    for mode in ("online", "batch"):
        files = track(folder, "--config", config, "--mode", mode, out=mode)
        rows = [line.split() for line in files["0000.txt"].splitlines()]
        frames[mode] = [int(row[0]) for row in rows if row[2] == "Car"]
    assert frames["batch"] == list(range(8))
    assert set(frames["online"]) < set(frames["batch"])


def test_batch_with_nothing_to_see(folder):
    for name in ("0000", "0001"):
        (folder / "dets_Cyclist" / f"{name}.txt").write_text("")
    files = track(folder, "--mode", "batch")
    assert {line.split()[2] for line in files["0000.txt"].splitlines()} <= {"Car"}


def test_only_trackers_that_can_look_back_do(folder, capsys):
    message = fails(folder, capsys, "--tracker", "argoverse", "--mode", "batch")
    assert "'argoverse' cannot look back" in message


def test_parameters_of_parameters(folder, capsys):
    config = folder / "config.toml"
    config.write_text("[Car.sensor.detection]\nundetectable = 0.2\nstay_detectabel = 0.9\n")
    found = fails(folder, capsys, "--config", config)
    assert "sensor.detection.stay_detectabel" in found
    assert "did you mean 'stay_detectable'" in found
    config.write_text('[Car.scores]\nkind = "levels"\nscatter = 0.2\n')
    found = fails(folder, capsys, "--config", config)
    assert "missing parameter" in found
    assert "scores.label" in found


PRESETS = sorted((Path(__file__).parents[2] / "pmbm" / "datasets" / "presets").glob("*.toml"))


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: path.stem)
def test_presets_are_for_trackers_that_take_them(path):
    dataset_name, _, tracker = path.stem.partition("_")
    tracker = "pmbm" if tracker.startswith("pmbm") else tracker
    # A detector may have one class alone.
    classes = tuple(tomllib.loads(path.read_text()).get("detector", ())) or None
    dataset = open_dataset(dataset_name, root=".", classes=classes)
    trackers = class_trackers(dataset, tracker, path)
    assert set(trackers) == set(dataset.labels)
    for label, configured in trackers.items():
        config = configured(Site()).config
        assert config != type(config)(), label


def test_there_are_presets():
    assert PRESETS
    assert preset("kitti", "no_such_tracker") is None
    assert preset("kitti", "../kitti_pmbm") is None
    assert preset("kitti", "pmbm", "pvrcnn") == shipped_detectors("kitti", "pmbm")["pvrcnn"]


@pytest.mark.filterwarnings("always")
def test_detections_of_a_sequence_that_is_not_there_are_said(folder, capsys):
    (folder / "dets_Car" / "0007.txt").write_text("")
    (folder / "dets_Car" / "notes.md").write_text("")
    assert sorted(track(folder, "--tracker", "argoverse")) == ["0000.txt", "0001.txt"]
    said = r"pmbm: warning: detections of 1 sequence that kitti does not have .*: 0007; expected"
    assert re.match(said, capsys.readouterr().err)
    # Who names sequences has chosen.
    track(folder, "--tracker", "argoverse", "--sequences", "0000")
    assert capsys.readouterr().err == ""


def test_parameters_on_the_command_line_go_over_the_files(folder, capsys):
    config = folder / "config.toml"
    config.write_text("min_hits = 5\n[Car]\nmin_hits = 7\n")
    options = ("--tracker", "argoverse", "--config", config, "--sequences", "0000")
    files = track(folder, *options, "--set", "min_hits=3")
    assert next(line.split()[0] for line in files["0000.txt"].splitlines()) == "2"
    capsys.readouterr()
    message = fails(folder, capsys, *options, "--set", "min_hts=3")
    assert "did you mean 'min_hits'" in message
    assert "config.toml" not in message


def test_without_a_terminal_no_bar_is_drawn(folder, capsys):
    track(folder, "--tracker", "argoverse")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("scenario", "mode", "rising"),
    [("clutter_persistent", "online", "FP"), ("clutter_persistent", "batch", "FP"),
     ("misses_iid", "online", "FN")],
)  # fmt: skip
def test_the_dearer_a_false_box_the_fewer_and_the_more_missed(
    tmp_path, capsys, scenario, mode, rising
):
    assert pmbm("export", scenario, "--seed", "7", "--out", tmp_path / "log") == 0
    place = ("table", "--root", tmp_path / "log", "--classes", "car")
    found = []
    for cost in ("0.25", "1", "4"):
        out = tmp_path / cost
        given = ("--detections", tmp_path / "log" / "detections", "--mode", mode)
        assert pmbm("track", *place, *given, "--false-cost", cost, "--out", out) == 0
        capsys.readouterr()
        assert pmbm("evaluate", *place, "--results", out, "--json", "-") == 0
        found.append(json.loads(capsys.readouterr().out)["scores"]["car"]["all"])
    false, missed = ([one[name] for one in found] for name in ("FP", "FN"))
    assert false == sorted(false, reverse=True)
    assert missed == sorted(missed)
    assert len({one[rising] for one in found}) > 1


def test_a_false_box_as_dear_as_a_missed_one_is_reported_if_probable(folder):
    """So the best expected MOTA is what the presets give."""
    dataset = open_dataset("kitti", root=folder, classes=("Car",))
    (tracker,) = class_trackers(dataset, "pmbm", preset("kitti", "pmbm")).values()
    for cost, threshold in ((1, 0.5), (3, 0.75), (1 / 3, 0.25)):
        report = at_cost(tracker, cost)(Site()).config.report
        assert (report.above, report.keep_above) == pytest.approx((threshold, threshold))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--tracker", "argoverse", "--false-cost", "2"), "argoverse' does not say how probably"),
        (("--tracker", "pmbm-paper", "--false-cost", "2"), "takes no parameters"),
        (("--false-cost", "0"), "0"),
        (("--false-cost", "nan"), "nan"),
    ],
)
def test_bad_false_costs(folder, capsys, options, message):
    assert message in fails(folder, capsys, *options)
