"""Processes of a cluster add up to the same bytes, also where one of them is killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason='dask is not installed: pip install "sassgis[cluster]"')

import dask
from helpers.local_cluster import local_cluster
from helpers.map_sums_state import assert_same
from helpers.worker_tasks import Task, work

from sassgis.errors import InputError, OutputError
from sassgis.settings.map_run import BlockRows, MapRun
from sassgis.simulation.accumulators import Progress
from sassgis.simulation.cluster import Cluster, cluster
from sassgis.simulation.loop import TerrainTooSmall, simulate_map
from sassgis.simulation.workers import task_map
from sassgis.terrain.prepare import Plan


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


def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sassgis.simulation.cluster._CONNECT_S", 0.5)
    refused = pytest.raises(InputError, match="--scheduler: no scheduler answers")
    with refused as caught, cluster("tcp://127.0.0.1:9"):
        pass
    assert "\n" not in str(caught.value)


def test_other_versions_are_refused_at_once_and_at_every_task(
    two: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = str(two._client.scheduler.address)
    with cluster(address) as again:
        assert list(again.in_order(product, 5, [1, 2])) == [5, 10]
    answer = {"tcp://node:1": "0.0.1 (abc)"}
    monkeypatch.setattr("distributed.Client.run", lambda *_, **__: answer)
    refused = pytest.raises(InputError, match="tcp://node:1 of the cluster has another version")
    with refused, cluster(address):
        pass
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


@pytest.mark.battery
def test_what_a_stopped_worker_has_at_work_is_done_by_another_one(tmp_path: Path) -> None:
    task = Task("a", "working", tmp_path, number=signal.SIGSTOP)
    # By default five minutes.
    with dask.config.set({"distributed.scheduler.worker-ttl": "2s"}), local_cluster(2) as two:
        (found,) = two.in_order(work, "common", [task])
    assert found.startswith("common a ") and len(task.struck) == 1
