"""Processes of a dask cluster, on many machines."""

from __future__ import annotations

import logging
import pickle
import warnings
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import sassgis
from sassgis.errors import InputError, OutputError, SassgisError
from sassgis.files.digests import program_digest
from sassgis.simulation.workers import Work

if TYPE_CHECKING:
    from distributed import Client
    from distributed import Future as ClusterFuture

#: Tasks per process at a time: enough that none waits, few enough to hold their results.
_AHEAD = 3
_CONNECT_S = 30.0


class Cluster:
    """Workers on a dask cluster.

    A lost worker costs time only: its tasks are done again elsewhere, and the scheduler keeps the
    data common to the tasks. One with another version of the program is refused when it is given a
    task.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._version = _version()
        self._sent: tuple[Any, ClusterFuture] | None = None

    def in_order(self, work: Work, common: Any, tasks: Iterable[Any]) -> Generator[Any, None, None]:
        """Return results in the order of the tasks, as Workers.in_order.

        InputError: a worker has another version of the program. OutputError: the cluster is lost,
        or a task ends every process that it is given to.
        """
        with _cluster_errors():
            there = self._there(common)
            ahead = _AHEAD * max(len(self._client.ncores()), 1)
        waiting: deque[ClusterFuture] = deque()
        try:
            for task in tasks:
                with _cluster_errors():
                    given = self._version, work, there, task
                    waiting.append(self._client.submit(_checked, *given, pure=False))
                if len(waiting) > ahead:
                    yield self._result(waiting.popleft())
            while waiting:
                yield self._result(waiting.popleft())
        finally:
            # A lost cluster has no tasks to cancel.
            with suppress(Exception):
                self._client.cancel(list(waiting))

    def _there(self, common: Any) -> ClusterFuture:
        """Return the common data of the tasks on the cluster, sent once."""
        if self._sent is None or self._sent[0] is not common:
            # A task, not scattered data: the scheduler makes it anew where a worker is lost.
            content = pickle.dumps(common, protocol=5)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Sending large graph")
                self._sent = common, self._client.submit(pickle.loads, content, pure=False)
        return self._sent[1]

    def _result(self, future: ClusterFuture) -> Any:
        with _cluster_errors():
            done = future.result()
        # An error of a task is returned, and so distinguished from those of the cluster.
        if isinstance(done, Exception):
            raise done
        return done


def _checked(version: str, work: Work, common: Any, task: Any) -> Any:
    """Do one task on a worker if it has the same program; another computes other numbers."""
    if version != (own := _version()):
        return _other_version("a worker", own, version)
    try:
        return work(common, task)
    except Exception as error:
        return error


def _version() -> str:
    return f"{sassgis.__version__} ({program_digest()[:12]})"


def _other_version(who: str, found: str, expected: str) -> InputError:
    text = f"{who} of the cluster has another version of sassgis, or of a library it computes with"
    return InputError(text, found=found, expected=expected)


@contextmanager
def _cluster_errors() -> Iterator[None]:
    """Turn errors of the cluster, whatever the work, into one line."""
    from distributed import KilledWorker

    try:
        yield
    except KilledWorker:
        raise OutputError(
            "the cluster lost one process after another at the same task; memory may have run "
            "out; run the same command to resume from what is saved"
        ) from None
    # CancelledError of a future is none of Exception.
    except (Exception, CancelledError) as error:
        if isinstance(error, SassgisError):
            raise
        said = " ".join(str(error).split()) or type(error).__name__
        raise OutputError(
            f"the cluster was lost ({said}); run the same command to resume from what is saved"
        ) from None


@contextmanager
def cluster(scheduler: str) -> Iterator[Cluster]:
    """Open workers on the cluster of a dask scheduler at an address such as "tcp://node:8786".

    InputError: dask is not installed, nobody answers, or a worker has another version of the
    program.
    """
    try:
        from distributed import Client
    except ImportError:
        expected = "pip install 'sassgis[cluster]'"
        raise InputError("needs dask", field="--scheduler", expected=expected) from None
    if logging.getLogger().level > logging.DEBUG:
        # Errors of the cluster are reported in one line, without the tracebacks of its log.
        for name in ("distributed", "distributed.client", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(scheduler, timeout=_CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"no scheduler answers: {' '.join(str(error).split())}",
            field="--scheduler", found=scheduler,
            expected='the address of a dask scheduler, such as "tcp://node:8786"',
        ) from None  # fmt: skip
    with client:
        # An error that every task would raise is raised at once.
        try:
            found: dict[str, str] = client.run(_version)
        except (ImportError, AttributeError):
            found = {"a worker": "none, or an old one"}
        if not found:
            raise InputError("has no workers", field="--scheduler", found=scheduler)
        for address, version in found.items():
            if version != _version():
                raise _other_version(address, version, _version())
        yield Cluster(client)
