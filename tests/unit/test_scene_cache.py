"""Scenes on disk: the same bits as simulated, whatever happens to the files."""

import concurrent.futures
import multiprocessing
import os
import platform
import subprocess
import sys
import time

import click.testing
import numpy as np
import pytest

from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.sim import schema
from pmbm.sim.scenario import cache
from pmbm.sim.scenario.scenario import load_scenario, simulate, simulated_scene


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("PMBM_CACHE", str(tmp_path / "cache"))
    simulated_scene.cache_clear()
    yield tmp_path / "cache"
    simulated_scene.cache_clear()


def scenario(name="roundabout", seconds=1.0):
    whole = load_scenario(name)
    return type(whole)({**whole.document, "duration": seconds}, whole.file)


def again(source, seed=0, **options):
    """The scene without help from this process's memory."""
    simulated_scene.cache_clear()
    return source.scene(seed, **options)


def everything(scene):
    return (
        scene.truth_digest(),
        scene.sensor_pose.tobytes(),
        dict(scene.object_name),
        dict(scene.provenance),
        scene.name,
        scene.rate,
    )


@pytest.mark.parametrize("name", ["roundabout", "merge", "truck_occlusion"])
def test_what_is_read_is_what_was_simulated(folder, name, monkeypatch):
    source = scenario(name)
    first = source.scene(3)
    assert len(list(folder.iterdir())) == 1
    monkeypatch.setattr("pmbm.sim.scenario.scenario.simulate", None)
    assert everything(again(source, 3)) == everything(first)


def test_a_detector_sweep_simulates_once(folder):
    source = scenario("misses_iid")
    for level in source.levels:
        source.record(0, level=level)
    assert len(list(folder.iterdir())) == 1


def test_everything_that_matters_is_in_the_key(folder, monkeypatch):
    source = scenario()
    again(source, 0)
    again(source, 1)
    again(source, 0, trial=1)
    again(scenario(seconds=1.1), 0)
    monkeypatch.setattr(cache, "bits_key", lambda: "another machine")
    again(source, 0)
    monkeypatch.setattr(cache, "_code_hash", lambda: "another version")
    again(source, 0)
    assert len(list(folder.iterdir())) == 6


@pytest.mark.skipif(platform.machine() != "x86_64", reason="kernels are named for x86-64")
def test_machines_whose_last_bits_differ_have_different_keys():
    """The linear algebra library picks its kernels by the processor's model."""
    product = "import numpy as np; v = np.sin(np.arange(100.0)); print(np.dot(v, v[::-1]).hex());"
    said = {
        kernel: subprocess.run(
            [
                sys.executable,
                "-c",
                product + "from pmbm.sim.scenario.cache import bits_key; print(bits_key())",
            ],
            env={**os.environ, "OPENBLAS_CORETYPE": kernel},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for kernel in ("Prescott", "Haswell")
    }
    (bits, key), (other_bits, other_key) = said.values()
    if bits == other_bits:
        pytest.skip("numpy is built on a library without such a choice")
    assert key != other_key


def test_corrupt_entries_are_made_again(folder):
    source = scenario()
    first = everything(source.scene(0))
    (file,) = folder.iterdir()
    good = file.read_bytes()
    flipped = bytearray(good)
    for place in np.random.default_rng(0).integers(0, len(good), 40).tolist():
        flipped = bytearray(good)
        flipped[place] ^= 1 << (place % 8)
        file.write_bytes(flipped)
        assert cache._read(file) is None
    for spoiled in (b"", good[:20], good[:-15], bytes(flipped), good + b"x"):
        file.write_bytes(spoiled)
        assert everything(again(source)) == first
        assert file.read_bytes() == good


def _simulate(folder, seed, results):
    import os

    os.environ["PMBM_CACHE"] = str(folder)
    results.put(scenario().scene(seed).truth_digest())


def test_writers_and_readers_in_threads_do_not_meet(folder):
    scene = simulate(scenario(seconds=0.5).form, 0)
    path = folder / "any-0-0-key.npz"
    expected = scene.truth_digest()

    def work(_):
        cache._write(path, scene)
        return cache._read(path).truth_digest()

    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        assert set(pool.map(work, range(64))) == {expected}
    assert list(folder.iterdir()) == [path]


@pytest.mark.slow
def test_writers_in_processes_do_not_meet(folder):
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    workers = [context.Process(target=_simulate, args=(folder, 5, results)) for _ in range(3)]
    for worker in workers:
        worker.start()
    digests = {results.get(timeout=60) for _ in workers}
    for worker in workers:
        worker.join(60)
        assert worker.exitcode == 0
    assert len(digests) == 1
    (file,) = folder.iterdir()  # one entry, and no half-written file beside it
    assert cache._read(file).truth_digest() in digests


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("PMBM_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(InputError, match="PMBM_CACHE cannot be written"):
        scenario().scene(0)
    monkeypatch.delenv("PMBM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert len(scenario().scene(1)) == 10  # the platform's folder is done without


def test_the_cache_does_not_grow_without_end(folder, monkeypatch):
    source = scenario(seconds=0.2)
    for seed in range(4):
        source.scene(seed)
        time.sleep(0.01)
    again(source, 0)  # used last
    sizes = [entry.bytes for entry in cache.entries()]
    monkeypatch.setattr(cache, "LARGEST_BYTES", max(sizes) * 2)
    cache._shrink()
    assert {0, 3} == {entry.seed for entry in cache.entries()}


def test_scripted_scenes_are_not_kept(folder):
    scenario("empty_clutter").scene(0)
    assert not folder.exists()


def test_the_command_shows_lists_and_clears(folder, capsys):
    def run(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(["cache", *arguments])
        assert ended.value.code == 0
        return capsys.readouterr().out

    assert "scenes  0" in run()
    for seed in (7, 8):
        scenario("roundabout", 0.2).scene(seed)
    scenario("merge", 0.2).scene(9)
    assert "scenes  3" in run()
    listed = run("list", "roundabout")
    assert "roundabout" in listed
    assert "merge" not in listed
    assert "'roundabuot' is kept; did you mean 'roundabout'?" in run("list", "roundabuot")
    assert "deleted 0 scenes" in run("clear", "--older-than", "1")
    assert "deleted 1 scenes" in run("clear", "merge")
    assert "deleted 2 scenes" in run("clear")
    assert list(folder.iterdir()) == []


def test_help_has_an_example():
    from pmbm.cli import group

    for arguments in (["cache"], ["cache", "list"], ["cache", "clear"], ["scenarios"]):
        result = click.testing.CliRunner().invoke(group, [*arguments, "--help"])
        assert result.exit_code == 0
        assert "Example" in result.output


def test_a_scene_that_fails_is_not_kept(folder):
    document = {
        "name": "bang",
        "stresses": "a test of its own",
        "scene": {
            "kind": "road",
            "roads": {"main": {"start": [0.0, 0.0], "end": [500.0, 0.0]}},
            "sensor": {"pose": [50.0, 9.0, 0.0]},
            "actors": {
                "a": {"road": "main", "speed": 20.0, "driver": "cruise"},
                "b": {"road": "main", "position": 30.0, "speed": 0.0, "driver": "cruise"},
            },
        },
    }
    bang = type(scenario())(document)
    with pytest.raises(InputError, match="refuses crashes"):
        bang.scene(0)
    assert not folder.exists()
    assert simulate(schema.parse({**document, "duration": 0.2}), 0) is not None
