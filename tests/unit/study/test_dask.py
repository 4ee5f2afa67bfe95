"""The same study on a Dask cluster: equal digests, and a worker killed on the way."""

import os
import signal

import pytest
from study_worlds import Convoy, Trouble

from pmbm.errors import InputError
from pmbm.study import Cell, ConfiguredTracker, Study, read_store, run_study

distributed = pytest.importorskip("distributed", reason="Dask is not installed")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


def study(source, trials=8):
    trackers = {"echo": ConfiguredTracker("study_worlds:Echo")}
    cells = (Cell("scene", {}, source, trackers),)
    return Study(name="s", cells=cells, trials=trials, metrics=("ospa",))


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        yield cluster


def test_the_digest_is_that_of_a_serial_run(tmp_path, cluster):
    one = study(Convoy(frames=3))
    run_study(one, tmp_path / "serial.sqlite", jobs=0)
    done = run_study(one, tmp_path / "dask.sqlite", scheduler=cluster.scheduler_address)
    assert (done.done, done.failed) == (8, 0)
    assert (
        read_store(tmp_path / "dask.sqlite").digest()
        == read_store(tmp_path / "serial.sqlite").digest()
    )


def test_a_worker_killed_on_the_way_costs_no_trial(tmp_path, cluster):
    source = Trouble(frames=3, how=tuple((trial, "slow") for trial in range(12)))
    one = study(source, trials=12)
    killed = []

    def kill_one(progress):
        if progress.done == 3 and not killed:
            with distributed.Client(cluster) as client:
                pid = next(iter(client.run(os.getpid).values()))
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    file = tmp_path / "dask.sqlite"
    done = run_study(one, file, scheduler=cluster.scheduler_address, tell=kill_one)
    assert killed
    assert (done.done, done.failed) == (12, 0)
    run_study(one, tmp_path / "serial.sqlite", jobs=0)
    assert read_store(file).digest() == read_store(tmp_path / "serial.sqlite").digest()


def test_a_scheduler_that_does_not_answer_is_named(tmp_path):
    with pytest.raises(InputError, match="no scheduler answers there"):
        run_study(study(Convoy(frames=3)), tmp_path / "s.sqlite", scheduler="tcp://127.0.0.1:9")
