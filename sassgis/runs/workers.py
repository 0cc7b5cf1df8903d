"""Who works on the parts of a job: threads or processes of this machine, or a cluster.

Whoever it is, results come in the order of the parts, so that they are added up in the same order
and the same bytes come out.
"""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from typing import Any, Protocol

from sassgis.model.errors import OutputError
from sassgis.model.worker_process import end_with_parent


class Workers(Protocol):
    """Works on tasks that have something large in common."""

    def in_order(
        self, work: Callable[[Any, Any], Any], common: Any, tasks: Iterable[Any]
    ) -> Generator[Any, None, None]:
        """Results of ``work(common, task)`` in the order of the tasks, a few at work at a time.

        Closing the generator gives up what was not asked for yet.
        """
        ...


#: Number of threads or processes; None: as configured, 0: all cores; or who works instead.
Jobs = int | Workers | None


@dataclass(frozen=True, slots=True)
class Threads:
    """Threads of this process.

    Never the calling one: Ctrl-C would strike within compiled code, which turns it into a
    SystemError.
    """

    count: int

    def in_order(
        self, work: Callable[[Any, Any], Any], common: Any, tasks: Iterable[Any]
    ) -> Generator[Any, None, None]:
        """As ``Workers`` says."""
        with ThreadPoolExecutor(self.count) as pool:
            yield from _in_order(pool, partial(work, common), tasks, 2 * self.count)


@dataclass(frozen=True, slots=True)
class Processes:
    """Processes of this machine, for work that Python itself has a large share in.

    They leave Ctrl-C to the process that started them, and end with it.

    Attributes
    ----------
    count : int
    ahead : int
        Results of each that may wait. Tasks differ: while the first is at work others are done.
    """

    count: int
    ahead: int = 16

    def in_order(
        self, work: Callable[[Any, Any], Any], common: Any, tasks: Iterable[Any]
    ) -> Generator[Any, None, None]:
        """As ``Workers`` says; closing the generator waits for the tasks at work.

        Raises
        ------
        OutputError
            If a process is lost.
        """
        try:
            with (
                _single_threaded(),
                ProcessPoolExecutor(self.count, get_context("spawn"), _begin, (common,)) as pool,
            ):
                work_on = partial(_with_common, work)
                yield from _in_order(pool, work_on, tasks, self.ahead * self.count)
        except BrokenProcessPool:
            raise OutputError(
                "a worker process was lost; memory may have run out; the same command goes on from "
                "what is saved"
            ) from None


def _in_order(
    pool: Executor, work: Callable[[Any], Any], tasks: Iterable[Any], ahead: int
) -> Generator[Any, None, None]:
    """Results in the order of the tasks, of which so many wait."""
    waiting: deque[Future[Any]] = deque()
    try:
        for task in tasks:
            waiting.append(pool.submit(work, task))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()


#: Of a worker process: what its tasks have in common.
_COMMON: Any = None


def _begin(common: Any) -> None:
    global _COMMON
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _COMMON = common


def _with_common(work: Callable[[Any, Any], Any], task: Any) -> Any:
    return work(_COMMON, task)


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Processes that are started here use one core each: their linear algebra is small."""
    name = "OPENBLAS_NUM_THREADS"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
