"""Programs as trackers: what they are told, what they may answer, and what becomes of them."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from pmbm import Detections, Site, run
from pmbm.cli import main
from pmbm.errors import InputError, notes_of
from pmbm.external import program_named, protocol
from pmbm.external.program import close_programs
from pmbm.sim import load_scenario
from pmbm.study import ConfiguredTracker, Study, load_results, run_study
from pmbm.study.study import Cell
from pmbm.tracking import ByLabel, make_tracker, tracker_factory
from pmbm.types import Label, MountedSensor

HERE = Path(__file__).parent
SCHEMA = json.loads(
    (HERE.parents[1] / "docs" / "guide" / "tracker_protocol.schema.json").read_text()
)
VALID = jsonschema.Draft202012Validator(SCHEMA)


def odd(how):
    return f"exec:{shlex.join([sys.executable, '-S', str(HERE / 'odd_program.py'), how])}"


pytestmark = pytest.mark.skipif(not Path("/proc/self").exists(), reason="looks into /proc")


@pytest.fixture(autouse=True)
def _nothing_left():
    yield
    close_programs()
    assert children() == []


def processes():
    """(parent, group, command) of every process that has not ended."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, parent, group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
            command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
        if state != "Z":
            yield int(parent), int(group), command


def children():
    """Commands of the programs, and of what watches over them, that this process started."""
    commands = [command for parent, _, command in processes() if parent == os.getpid()]
    return [c for c in commands if "odd_program" in c or "kill -9 0" in c]


@pytest.fixture(scope="module")
def recording():
    return load_scenario("crossing").record(seed=4)


def few(n=3, time=0.5):
    return Detections(
        time=time,
        position=np.arange(3.0 * n).reshape(n, 3) / 7,
        size=np.full((n, 3), 1.7),
        yaw=np.linspace(-3, 3, n),
        score=np.full(n, 0.4),
        label=np.arange(n) % 7,
        sensor_pose=[1.0, 2.0, 0.3],
    )


def test_what_a_program_is_told_is_what_the_schema_says():
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    full = Site(
        occluders=(triangle,), drivable_area=(triangle,), sensors=(MountedSensor(name="radar"),)
    )
    for site in (Site(), full):
        VALID.validate(json.loads(protocol.greeting(site, 2**32 - 1, {"a.b": [1, "c"]})))
    radar = replace(few(), sensor="radar", radial_velocity=np.ones(3), sensor_velocity=[1.0, 2.0])
    for detections in (few(), few(0), Detections.empty(1.0), radar):
        VALID.validate(json.loads(protocol.frame_line(3, detections)))


def test_numbers_travel_to_the_bit():
    rng = np.random.default_rng(0)
    detections = few(50)
    noisy = Detections(
        time=0.1 + 0.2,
        position=rng.standard_normal((50, 3)) * 1e5,
        size=rng.random((50, 3)) + 1e-9,
        yaw=detections.yaw,
        score=rng.random(50),
        label=detections.label,
    )
    told = json.loads(protocol.frame_line(0, noisy))
    n = len(noisy)
    answer = {"type": "tracks", "step": 0, "id": list(range(n)), "vx": [0] * n, "vy": [0.5] * n}
    answer |= {name: told[name] for name in protocol._BOX} | {
        "covariance": [np.eye(4).tolist()] * n
    }
    answer |= {"score": told["score"], "label": told["label"], "seconds": 0.25}
    VALID.validate(answer)
    tracks, seconds = protocol.read_tracks(json.dumps(answer).encode(), 0, told["time"])
    assert (tracks.time, seconds) == (0.1 + 0.2, 0.25)
    for name in ("position", "size", "yaw", "score", "label"):
        np.testing.assert_array_equal(getattr(tracks, name), getattr(noisy, name))
    np.testing.assert_array_equal(tracks.covariance, np.broadcast_to(np.eye(4), (n, 4, 4)))


def test_labels_of_the_schema_are_those_of_the_code():
    assert SCHEMA["$defs"]["label"]["enum"] == [label.name.lower() for label in Label]


def test_one_program_follows_one_recording_after_another(recording):
    factory = tracker_factory(odd("well"))
    first = run(make_tracker(factory, recording.site, 1), recording)
    again = run(make_tracker(factory, recording.site, 2), recording)
    assert [len(t) for t in first] == [len(d) for d in recording.detections]
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.position, b.position)
    assert len([line for line in children() if "odd_program" in line]) == 1


def test_trackers_side_by_side_have_a_program_each():
    factories = {label: tracker_factory(odd("well")) for label in (Label.CAR, Label.TRUCK)}
    both = ByLabel(factories)
    assert len([line for line in children() if "odd_program" in line]) == 2
    assert len(both.step(few(7))) == 2


WRONG = {
    "exit": "step 2: ended with exit code 3",
    "crash": "step 2: died of SIGSEGV",
    "hang": "step 2: gave no answer within 0.5 s",
    "late": "step 2: gave no answer within 0.5 s",
    "close": "step 2: closed its output",
    "flood": "step 2: wrote a line of more than 67108864 bytes",
    "twice": "step 2: answered more than one line",
    "astray": "step 2: answered more than one line (frame 2): got '42 boxes left'; what",
    "behind": "step 2: an answer out of order (frame 2, field step): expected 2, got 1",
    "nan": "step 2: an answer with NaN in it",
    "null": "step 2: not a number (frame 2, field y, rows 0): expected a finite number, got 'null'",
    "text": "step 2: not a number (frame 2, field yaw, rows 0)",
    "huge": "step 2: ",
    "short": "step 2: columns of different lengths (frame 2, field z)",
    "missing": "step 2: a missing column (frame 2, field score)",
    "unknown": "step 2: an unknown column (frame 2, field velocity)",
    "same-id": "step 2: tracks at t = ",
    "negative-id": "step 2: tracks at t = ",
    "flat": "step 2: tracks at t = ",
    "no-label": "step 2: an unknown label (frame 2, field label)",
    "words": "step 2: an answer that is not JSON",
    "list": "step 2: an answer of another type",
    "protocol": "greeting: another protocol (field protocol): expected 1, got 2",
    # What comes unasked may come with the answer, or be taken for it.
    "banner": ("greeting: answered more", "greeting: an answer that is not JSON"),
    "early": ("answered more", "step 0: an answer of another type"),
}  # fmt: skip


@pytest.mark.parametrize("how", WRONG)
def test_what_goes_wrong_is_one_error_with_the_programs_last_words(how, recording):
    factory = ConfiguredTracker(odd(how), (("deadline", 0.5),))
    if how == "flood":
        factory = ConfiguredTracker(odd(how))
    start = time.monotonic()
    with pytest.raises(InputError) as caught:
        run(factory(recording.site, 7), recording)
    assert time.monotonic() - start < 5.0
    said = str(caught.value)
    assert said.startswith(f"tracker '{odd(how)}', ")
    wanted = WRONG[how]
    assert any(text in said for text in ([wanted] if isinstance(wanted, str) else wanted)), said
    if how not in ("protocol", "banner", "early"):
        assert caught.value.frame == 2
        assert notes_of(caught.value)[0].splitlines()[-1].strip() == f"about to {how}"
    # What ended it does not reach the next recording.
    run(ConfiguredTracker(odd("well"))(recording.site), recording)


def test_a_program_that_talks_much_blocks_nothing(recording):
    tracks = run(ConfiguredTracker(odd("chatter"))(recording.site), recording)
    assert len(tracks) == len(recording.detections)


def test_a_large_frame_goes_through_and_back():
    tracker = tracker_factory(odd("well"))(Site())
    assert len(tracker.step(few(20_000))) == 20_000


def test_a_tracker_whose_program_has_ended_says_so():
    tracker = ConfiguredTracker(odd("exit"))(Site())
    for step in range(2):
        tracker.step(few(time=step))
    for what in ("exit code 3", "has ended before"):
        with pytest.raises(InputError, match=what):
            tracker.step(few(time=2))


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("exec:", "names no program"),
        ("exec:./no_such_program", "no program './no_such_program'"),
        ("exec:'unended", "No closing quotation"),
    ],
)
def test_what_cannot_be_started_is_found_at_the_door(name, problem):
    with pytest.raises(InputError, match=problem):
        tracker_factory(name)


@pytest.mark.parametrize("name", ["exe:/bin/sh run", "/bin/sh run"])
def test_a_command_without_exec_is_recognised(name):
    with pytest.raises(InputError, match="did you mean 'exec:/bin/sh run'"):
        tracker_factory(name)


def test_a_file_that_is_not_executable_is_named(tmp_path):
    file = tmp_path / "tracker"
    file.write_text("")
    with pytest.raises(InputError, match="chmod"):
        tracker_factory(f"exec:{file}")
    file.chmod(0o755)
    with pytest.raises(InputError, match="cannot be started"):
        tracker_factory(f"exec:{file}")(Site())


def test_a_study_hash_covers_the_files_of_the_command(tmp_path):
    program = tmp_path / "tracker"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    weights = tmp_path / "weights.bin"
    weights.write_text("1")
    before = program_named(f"exec:{program} {weights}").digest()
    weights.write_text("2")
    assert program_named(f"exec:{program} {weights}").digest() != before
    study = study_of(f"exec:{program} {weights}")
    assert f"exec:{program} {weights}" in study.document["code"]["sources"]


def study_of(name, trials=2, parameters=(), **more):
    source = load_scenario("single_straight")
    tracker = ConfiguredTracker(name, parameters)
    cell = Cell("single_straight", {}, source, {"odd": tracker})
    return Study(name="s", cells=(cell,), trials=trials, metrics=("ospa",), **more)


def test_failures_are_outcomes_of_a_study(tmp_path):
    file = tmp_path / "s.sqlite"
    done = run_study(study_of(odd("crash"), trials=3), file, jobs=0)
    assert (done.done, done.failed) == (3, 3)
    rows = load_results(file).failures
    for trial, row in enumerate(rows.to_dict("records")):
        assert row["trial"] == trial
        assert "step 2: died of SIGSEGV (frame 2)" in row["error"]
        assert row["note"].splitlines()[-1].strip() == "about to crash"


def test_failures_have_equal_digests_whatever_was_said(tmp_path):
    digests = set()
    for name in ("a", "b"):
        file = tmp_path / f"{name}.sqlite"
        run_study(study_of(odd("exit")), file, jobs=0)
        digests.add(load_results(file).digest)
        close_programs()
    assert len(digests) == 1


def test_a_studys_time_limit_reaches_a_program(tmp_path):
    file = tmp_path / "s.sqlite"
    run_study(study_of(odd("hang"), trials=1, time_limit=1.0), file, jobs=0)
    (row,) = load_results(file).failures.to_dict("records")
    assert row["outcome"] == "timeout"
    assert "about to hang" in row["note"]


def test_a_command_says_it_in_few_lines(capsys, tmp_path):
    with pytest.raises(SystemExit) as caught:
        main(["run", "single_straight", "--tracker", odd("exit"), "--out", str(tmp_path)])
    assert caught.value.code == 1
    said = capsys.readouterr().err
    assert "raised in trial 0: InputError: tracker" in said
    assert "step 2: ended with exit code 3 (frame 2)" in said
    assert "about to exit" in said


PASSING = HERE.parent / "examples" / "my_program" / "passing.toml"


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (("gate", "single_straight", "--against", "argoverse", "--margin", "1"), 1),
        (("falsify", PASSING, "--budget", "2"), 2),
    ],
)
def test_a_gate_and_a_search_take_no_failure_for_a_result(command, code, capsys, tmp_path):
    if command[0] == "falsify":
        command = (*command, "--out", tmp_path / "worst.toml")
    with pytest.raises(SystemExit) as caught:
        main([*map(str, command), "--tracker", odd("exit")])
    assert caught.value.code == code
    said = "".join(capsys.readouterr())
    assert "trial 0" in said
    assert "step 2: ended with exit code 3" in said
    assert "about to exit" in said
    assert not (tmp_path / "worst.toml").exists()


DRIVER = """
import sys
sys.path.insert(0, {here!r})
from pathlib import Path
from test_external import odd, study_of
from pmbm.study import run_study
if __name__ == "__main__":
    run_study(study_of(odd("children") + " {mark}", trials=50), Path({file!r}), jobs=2)
"""


def test_a_killed_study_leaves_no_program(tmp_path):
    script, mark = tmp_path / "driver.py", f"of-process-{os.getpid()}"
    file = str(tmp_path / "s.sqlite")
    script.write_text(DRIVER.format(here=str(HERE), mark=mark, file=file))
    driver = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.PIPE)
    groups = set()
    deadline = time.monotonic() + 60.0
    while len(groups) < 2:
        assert time.monotonic() < deadline
        assert driver.poll() is None, driver.stderr.read().decode()
        time.sleep(0.1)
        groups = {group for _, group, command in processes() if mark in command}
    os.kill(driver.pid, signal.SIGKILL)
    driver.wait()
    driver.stderr.close()
    deadline = time.monotonic() + 10.0
    while left := [command for _, group, command in processes() if group in groups]:
        assert time.monotonic() < deadline, left
        time.sleep(0.1)
