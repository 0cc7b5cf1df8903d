"""Who works on the parts of a job: threads or processes of this machine, or a cluster.

Whoever it is, results come in the order of the parts, so that they are added up in the same order
and the same bytes come out.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeVar

from sassgis.errors import OutputError
from sassgis.simulation.worker_process import OF_TERMINALS, WorkerLost, WorkerProcess

R = TypeVar("R")

#: Processes that may be lost, one after the other, at the same task.
_LOST_MOST = 3


@contextmanager
def held_back() -> Iterator[None]:
    """Let signals that end the command wait for the block, so that nothing is half added or saved.

    KeyboardInterrupt comes after the block, if the user asked for it within.
    """
    # Only the main thread may set handlers, and only it is interrupted.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = {number: signal.getsignal(number) for number in (*OF_TERMINALS, signal.SIGTERM)}
    # One that is ignored, or ends the process, raises nothing that could be held back.
    before = {number: handler for number, handler in found.items() if callable(handler)}
    asked = False

    def remember(_number: int, _frame: object) -> None:
        nonlocal asked
        asked = True

    for number in before:
        signal.signal(number, remember)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if asked:
        raise KeyboardInterrupt


@contextmanager
def one_algebra_thread() -> Iterator[None]:
    """Keep linear algebra to one thread: more change the last digits, small products only wait."""
    # The library sets an environment variable for the whole process when it is imported.
    name = "KMP_DUPLICATE_LIB_OK"
    before = os.environ.get(name)
    from threadpoolctl import threadpool_limits

    if before is None:
        os.environ.pop(name, None)
    with threadpool_limits(1, "blas"):
        yield


def available_cores() -> int:
    """Return processor cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


#: Work on a task, given what is common to all tasks.
Work = Callable[[Any, Any], Any]


class Workers(Protocol):
    """Works on tasks that have something large in common."""

    def in_order(self, work: Work, common: Any, tasks: Iterable[Any]) -> Generator[Any, None, None]:
        """Yield results of ``work(common, task)`` in the order of the tasks, a few at a time.

        Closing the generator gives up what was not asked for yet.
        """
        ...


#: Called with (parts done, parts in all, blocks or rocks done).
OnProgress = Callable[[int, int, int], None]
#: Number of threads or processes; None: as configured, 0: all cores; or who works instead.
Jobs = int | Workers | None
#: Results of some work, in the order of the tasks.
TaskMap = Callable[[Work, Sequence[Any]], Iterator[Any]]


@dataclass(frozen=True, slots=True)
class Threads:
    """Threads of this process.

    Never the calling one: Ctrl-C would strike within compiled code, which turns it into a
    SystemError.
    """

    count: int

    def in_order(self, work: Work, common: Any, tasks: Iterable[Any]) -> Generator[Any, None, None]:
        """Return results in the order of the tasks, as ``Workers`` says."""
        with ThreadPoolExecutor(self.count) as pool:
            yield from _in_order(pool, partial(work, common), tasks, 2 * self.count)


class Processes:
    """Processes of this machine, which live as long as the ``with`` block.

    One that is lost, at any moment, costs time only: what it had at work is done again in another
    one. A task may therefore be begun more than once. One that is stopped is waited for. At the
    end of the block all are ended, whatever they have at work.

    ``ahead`` results of each may wait. Tasks differ: while the first is at work others are done.
    """

    def __init__(self, count: int, ahead: int = 16) -> None:
        self._ahead = ahead * count
        # Each process has a thread here that waits for its answers.
        self._threads = ThreadPoolExecutor(count, initializer=_without_ctrl_c)
        self._lock = threading.Lock()
        self._all: set[WorkerProcess] = set()
        self._idle: list[WorkerProcess] = []
        self._ended = False
        self._sent: tuple[Any, bytes] | None = None

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        with held_back():
            with self._lock:
                self._ended = True
                for process in self._all:
                    process.kill()
            self._threads.shutdown(cancel_futures=True)
            for process in self._all:
                process.ended()

    def in_order(self, work: Work, common: Any, tasks: Iterable[Any]) -> Generator[Any, None, None]:
        """Return results in the order of the tasks, as ``Workers`` says.

        OutputError: one process after another is lost at the same task, or none can be started.
        """
        if self._sent is None or self._sent[0] is not common:
            self._sent = common, pickle.dumps(common, pickle.HIGHEST_PROTOCOL)
        do = partial(self._do, work, self._sent[1])
        yield from _in_order(self._threads, do, tasks, self._ahead)

    def _do(self, work: Work, common: bytes, task: Any) -> Any:
        """Return the result of one task, in a thread of its process."""
        call = pickle.dumps((work, task), pickle.HIGHEST_PROTOCOL)
        for _ in range(_LOST_MOST):
            process = self._process()
            try:
                return process.do(common, call)
            except WorkerLost as lost:
                (code,) = lost.args
            finally:
                self._idle.append(process)
        why = "killed; memory may have run out: try fewer" if code < 0 else f"exit code {code}"
        name = getattr(task, "name", "")
        raise OutputError(
            f"{_LOST_MOST} processes ended, one after the other, at the same task"
            f"{name and f', {name}'} ({why}); run the same command to resume from what is saved"
        )

    def _process(self) -> WorkerProcess:
        """Return a process that has nothing at work, or a new one."""
        with self._lock:
            if self._ended:
                raise CancelledError
            while self._idle:
                process = self._idle.pop()
                if process.runs():
                    return process
                process.ended()
                self._all.remove(process)
            try:
                self._all.add(process := WorkerProcess())
            except OSError as error:
                raise OutputError(f"no process can be started: {error}") from None
            return process


@contextmanager
def task_map(common: Any, jobs: int | Workers, ahead: int = 16) -> Iterator[TaskMap]:
    """Yield what maps work over tasks: this process, several, or others."""
    if isinstance(jobs, int) and jobs <= 1:
        yield lambda work, tasks: (work(common, task) for task in tasks)
        return
    with Processes(jobs, ahead) if isinstance(jobs, int) else nullcontext(jobs) as workers:
        yield lambda work, tasks: workers.in_order(work, common, tasks)


@contextmanager
def beside(
    work: Callable[[], R], given_up: ContextVar[threading.Event | None]
) -> Iterator[Callable[[], R]]:
    """Run a function in a thread next to the ``with`` block; yield what waits for its result.

    It works in the language of the caller. ``given_up`` shows it when the block has failed or was
    stopped, so that nobody waits for all of it.
    """
    stop, context = threading.Event(), copy_context()
    context.run(given_up.set, stop)
    with ThreadPoolExecutor(1) as pool:
        try:
            yield pool.submit(context.run, work).result
        except BaseException:
            stop.set()
            raise


def _in_order(
    pool: ThreadPoolExecutor, work: Callable[[Any], Any], tasks: Iterable[Any], ahead: int
) -> Generator[Any, None, None]:
    """Yield results in the order of the tasks, of which so many wait."""
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


def _without_ctrl_c() -> None:
    """Keep Ctrl-C from the processes that this thread starts, from their first moment."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, OF_TERMINALS)
