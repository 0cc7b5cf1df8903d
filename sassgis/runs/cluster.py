"""Processes of a dask cluster, on this machine or on many."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import sassgis
from sassgis.io.write.program import program_digest
from sassgis.model.errors import InputError, OutputError

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as ClusterFuture

#: Tasks handed out at a time, by process: enough that none waits, few enough for their results.
_AHEAD = 3
_CONNECT_S = 30.0


class Cluster:
    """Workers on a dask cluster.

    A worker that is lost costs time only: what it had at work is done again elsewhere, and what is
    common to the tasks is kept by the scheduler.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._sent: tuple[Any, ClusterFuture] | None = None

    def in_order(
        self, work: Callable[[Any, Any], Any], common: Any, tasks: Iterable[Any]
    ) -> Generator[Any, None, None]:
        """As ``Workers`` says.

        Raises
        ------
        OutputError
            If the cluster is lost, or a task ends every process that it is given to.
        """
        there = self._there(common)
        waiting: deque[ClusterFuture] = deque()
        try:
            for task in tasks:
                waiting.append(self._client.submit(work, there, task, pure=False))
                if len(waiting) > _AHEAD * max(len(self._client.ncores()), 1):
                    yield self._result(waiting.popleft())
            while waiting:
                yield self._result(waiting.popleft())
        finally:
            self._client.cancel(list(waiting))

    def _there(self, common: Any) -> ClusterFuture:
        """What is common to the tasks, on the cluster; sent once."""
        if self._sent is None or self._sent[0] is not common:
            # A task, not scattered data: the scheduler makes it anew where a worker is lost.
            content = pickle.dumps(common, protocol=5)
            self._sent = common, self._client.submit(pickle.loads, content, pure=False)
        return self._sent[1]

    def _result(self, future: ClusterFuture) -> Any:
        from concurrent.futures import CancelledError

        from distributed import KilledWorker

        try:
            return future.result()
        except KilledWorker:
            raise OutputError(
                "the cluster lost one process after another at the same task; memory may have run "
                "out; the same command goes on from what is saved"
            ) from None
        except (CancelledError, OSError) as error:
            raise OutputError(
                f"the cluster was lost ({' '.join(str(error).split()) or type(error).__name__}); "
                "the same command goes on from what is saved"
            ) from None


@contextmanager
def cluster(scheduler: str | None = None, processes: int | None = None) -> Iterator[Cluster]:
    """Workers on the cluster of a scheduler, or on one of this machine.

    Parameters
    ----------
    scheduler : str, optional
        Address of a dask scheduler, such as "tcp://node:8786".
    processes : int, optional
        Without a scheduler: processes of this machine, each with one thread.

    Raises
    ------
    InputError
        If dask is not installed, nobody answers, or a worker has another version of the program.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError(
            "needs dask",
            field="--workers" if scheduler is None else "--scheduler",
            expected="pip install 'sassgis[cluster]'",
        ) from None
    if scheduler is None:
        with (
            LocalCluster(
                n_workers=processes, threads_per_worker=1, processes=True,
                dashboard_address=None, silence_logs=50,
            ) as own,
            Client(own) as client,
        ):  # fmt: skip
            yield Cluster(client)
        return
    try:
        client = Client(scheduler, timeout=_CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"no scheduler answers: {' '.join(str(error).split())}",
            field="--scheduler",
            found=scheduler,
            expected='the address of a dask scheduler, such as "tcp://node:8786"',
        ) from None
    with client:
        _check_versions(client, scheduler)
        yield Cluster(client)


def _version() -> str:
    return f"{sassgis.__version__} ({program_digest()[:12]})"


def _check_versions(client: Client, scheduler: str) -> None:
    """Other versions of the program compute other numbers."""
    try:
        found: dict[str, str] = client.run(_version)
    except ImportError:
        found = {"a worker": "none"}
    if not found:
        raise InputError("has no workers", field="--scheduler", found=scheduler)
    for address, version in found.items():
        if version != _version():
            raise InputError(
                f"the worker {address} has another version of sassgis",
                field="--scheduler",
                found=version,
                expected=_version(),
            )
