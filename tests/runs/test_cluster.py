"""Processes of a cluster add up to the same bytes, also where one of them is killed."""

from __future__ import annotations

import operator
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed", reason='dask is not installed: pip install "sassgis[cluster]"')

import dask
from distributed import Client
from helpers.local_cluster import local_cluster
from helpers.map_sums_state import assert_same
from helpers.worker_tasks import Task, work

from sassgis.errors import InputError, OutputError
from sassgis.settings.map_run import BlockRows, MapRun
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.cluster import Cluster, cluster
from sassgis.simulation.loop import TerrainTooSmall, simulate_map
from sassgis.simulation.workers import task_map
from sassgis.terrain.plan import Plan


@pytest.fixture(scope="module")
def two() -> Iterator[Cluster]:
    with local_cluster(2) as made:
        yield made


def pids(two: Cluster) -> list[int]:
    return list(two._client.run(os.getpid).values())


@pytest.mark.battery
def test_a_killed_process_changes_no_bit(two: Cluster, job: MapRun, planned: Plan) -> None:
    whole = simulate_map(job, planned)
    killed: list[int] = []

    def kill(progress: Progress, _chunks: int, _rows: BlockRows) -> None:
        if progress.chunks == 2:
            killed.append(pids(two)[0])
            os.kill(killed[0], signal.SIGKILL)

    assert_same(simulate_map(job, planned, jobs=two, chunk_points=4, on_chunk=kill), whole)
    assert killed and killed[0] not in pids(two)


def product(common: int, task: int) -> int:
    if task == 13:
        raise TerrainTooSmall((True, False, False, True))
    return common * task


def test_results_come_in_order_and_errors_as_they_are(two: Cluster) -> None:
    with task_map(7, two) as run:
        assert list(run(product, range(12))) == [7 * k for k in range(12)]
        with pytest.raises(TerrainTooSmall) as caught:
            list(run(product, [13]))
    assert caught.value.sides == (True, False, False, True)
    # What was common before is not common now.
    with task_map(3, two) as run:
        assert list(run(product, [2])) == [6]


def test_the_same_scheduler_by_its_address(two: Cluster) -> None:
    address = str(two._client.scheduler.address)
    with cluster(address) as again:
        assert list(again.in_order(product, 5, [1, 2])) == [5, 10]


def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sassgis.simulation.cluster._CONNECT_S", 0.5)
    refused = pytest.raises(InputError, match="--scheduler: no scheduler answers")
    with refused as caught, cluster("tcp://127.0.0.1:9"):
        pass
    assert "\n" not in str(caught.value)


def test_other_versions_are_refused(two: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:

    def answers(*_arguments: Any, **_options: Any) -> dict[str, str]:
        return {"tcp://node:1": "0.0.1 (abc)"}

    monkeypatch.setattr("distributed.Client.run", answers)
    refused = pytest.raises(InputError, match="tcp://node:1 of the cluster has another version")
    with refused, cluster(str(two._client.scheduler.address)):
        pass


def test_every_task_asks_for_the_version(two: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(two, "_version", "0.0.1 (abc)")
    with pytest.raises(InputError, match="has another version"):
        list(two.in_order(product, 1, [1]))


def test_a_lost_cluster_is_one_line() -> None:
    with local_cluster(1) as made:
        rows = made.in_order(product, 2, [1, 2])
        assert next(rows) == 2
        made._client.shutdown()
        with pytest.raises(OutputError, match="the cluster was lost") as caught:
            list(made.in_order(product, 3, [1, 2]))
    assert "\n" not in str(caught.value)


def started(*words: str) -> subprocess.Popen[bytes]:
    """A scheduler or worker as a user starts it."""
    return subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:], "--no-dashboard"],
        stderr=subprocess.DEVNULL,
    )  # fmt: skip


@contextmanager
def by_hand(port: int, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A scheduler and a worker of it; gives the scheduler."""
    scheduler = started("scheduler", "--host", "127.0.0.1", "--port", str(port))
    own = ("--nworkers", "1", "--nthreads", "1", "--local-directory", str(folder))
    worker = started("worker", f"tcp://127.0.0.1:{port}", *own)
    try:
        with Client(f"tcp://127.0.0.1:{port}", timeout=120.0) as client:
            client.wait_for_workers(1, timeout=120.0)
        yield scheduler
    finally:
        for process in (worker, scheduler):
            process.terminate()
            process.wait()


@pytest.mark.battery
def test_a_scheduler_that_is_killed_and_comes_back(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """One line and nothing else; the same call goes on with the next one at the same address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    with by_hand(port, tmp_path) as scheduler, cluster(address) as made:
        rows = made.in_order(operator.mul, 2, range(10_000))
        assert next(rows) == 0
        scheduler.kill()
        scheduler.wait()
        with (
            by_hand(port, tmp_path) as _,
            pytest.raises(OutputError, match="the cluster was lost") as caught,
        ):
            list(rows)
    assert "\n" not in str(caught.value)
    with by_hand(port, tmp_path), cluster(address) as made:
        assert list(made.in_order(operator.mul, 2, range(3))) == [0, 2, 4]
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.battery
def test_what_a_stopped_worker_has_at_work_is_done_by_another_one(tmp_path: Path) -> None:
    task = Task("a", "working", tmp_path, number=signal.SIGSTOP)
    # By default five minutes.
    with dask.config.set({"distributed.scheduler.worker-ttl": "2s"}), local_cluster(2) as two:
        (found,) = two.in_order(work, "common", [task])
    assert found.startswith("common a ") and len(task.struck) == 1
