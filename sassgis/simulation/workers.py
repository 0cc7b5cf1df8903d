"""Workers for the parts of a job: threads or processes of this machine, or a cluster.

With each of them results come in the order of the parts, so that sums are the same to the byte.
"""

from __future__ import annotations

import gc
import logging
import os
import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from subprocess import PIPE, Popen, TimeoutExpired
from typing import IO, Any, Protocol, TypeVar

from sassgis.errors import OutputError
from sassgis.settings.process import give_back_arrays

#: Libraries that would each start separate threads.
_THREADS = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "GDAL_NUM_THREADS",
)
#: Signals of Ctrl-C and of a closed terminal (not on Windows).
OF_TERMINALS = [getattr(signal, n) for n in ("SIGINT", "SIGHUP") if hasattr(signal, n)]
#: Number of new objects at which Python collects unused ones.
COLLECTED_EVERY = 100_000
#: Errors of a pipe that is closed, or ends within a message.
_BROKEN = (OSError, EOFError, pickle.UnpicklingError)
#: Seconds that a process may take to end after it has closed its pipes.
_ENDING_S = 10.0


class WorkerLost(Exception):
    """Raised with its exit code when a worker process ends before it answers."""


class WorkerProcess:
    """A clean interpreter with separate pipes, which works in a single thread.

    Not of ``multiprocessing`` or ``concurrent.futures``: these look for modules in the current
    folder as they start, load the program that is running, and give up all tasks where one process
    is killed.
    """

    def __init__(self) -> None:
        # Nothing is imported before the path is set: the current folder may come from anybody.
        start = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        self._popen = Popen(
            [sys.executable, "-c", start], stdin=PIPE, stdout=PIPE,
            env={**os.environ, **dict.fromkeys(_THREADS, "1")},
        )  # fmt: skip
        self._holds: bytes | None = None

    def do(self, common: bytes, call: bytes) -> Any:
        """Return the result of a pickled (work, task) with pickled common data, or its error."""
        assert self._popen.stdin is not None and self._popen.stdout is not None
        try:
            _send(self._popen.stdin, b"" if common is self._holds else common)
            _send(self._popen.stdin, call)
            self._holds = common
            answer = pickle.load(self._popen.stdout)
        except _BROKEN:
            # A process closes its pipes a little before it has ended, and its exit code is known.
            with suppress(TimeoutExpired):
                self._popen.wait(_ENDING_S)
            self.kill()
            raise WorkerLost(self.ended()) from None
        result, error = pickle.loads(answer)
        if error is not None:
            raise error
        return result

    def runs(self) -> bool:
        """Return whether the process has not ended."""
        return self._popen.poll() is None

    def kill(self) -> None:
        """End the process at once, also one that is stopped."""
        self._popen.kill()

    def ended(self) -> int:
        """Wait for the end of the process; its exit code."""
        for pipe in (self._popen.stdin, self._popen.stdout):
            assert pipe is not None
            # Unsent data have no receiver.
            with suppress(OSError):
                pipe.close()
        return self._popen.wait()


def _send(pipe: IO[bytes], message: bytes) -> None:
    pickle.dump(message, pipe, pickle.HIGHEST_PROTOCOL)
    pipe.flush()


def serve() -> None:
    """Work on what comes by standard input in a worker process, and end where that ends."""
    # Signals reach all processes of a terminal; the first one ends the others.
    for number in OF_TERMINALS:
        signal.signal(number, signal.SIG_IGN)
    gc.set_threshold(COLLECTED_EVERY)
    give_back_arrays()
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # Libraries must not read the calls or print among the answers.
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    came: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(calls, came), daemon=True).start()
    common = None
    while True:
        if packed := came.get():
            common = pickle.loads(packed)
        answer = _answer(common, came.get())
        _send(answers, answer)


def _listen(calls: IO[bytes], came: SimpleQueue[bytes]) -> None:
    """Hand on what comes; when the parent is killed, input ends without a message."""
    with suppress(*_BROKEN):
        while True:
            came.put(pickle.load(calls))
    os._exit(1)


def _answer(common: Any, call: bytes) -> bytes:
    """Return the pickled result of a task and None, or None and its error."""
    try:
        work, task = pickle.loads(call)
        return pickle.dumps((work(common, task), None), pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        error.add_note(traceback.format_exc())
        try:
            pickle.loads(answer := pickle.dumps((None, error)))
        except Exception:
            answer = pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}")))
        return answer


R = TypeVar("R")

#: Processes that may be lost, one after the other, at the same task.
_LOST_MOST = 3


@contextmanager
def held_back() -> Iterator[None]:
    """Delay signals that end the command until the block ends, so that nothing is half saved.

    KeyboardInterrupt comes after the block, if the user asked for it within.
    """
    # Only the main thread may set handlers, and only it is interrupted.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = {number: signal.getsignal(number) for number in (*OF_TERMINALS, signal.SIGTERM)}
    # A signal that is ignored, or ends the process, raises nothing to hold back.
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
#: Number of threads or processes; None: as configured, 0: all cores; or the workers.
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
        """Return results in the order of the tasks, as Workers.in_order."""
        with ThreadPoolExecutor(self.count) as pool:
            # One result more than there are threads: each of them takes memory while it waits.
            yield from _in_order(pool, partial(work, common), tasks, self.count)


class Processes:
    """Processes of this machine, which live as long as the ``with`` block.

    A lost process costs time only: its task is done again in another one, so a task may begin more
    than once. A stopped process is waited for. At the end of the block all are ended, also at work.

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
        """Return results in the order of the tasks, as Workers.in_order.

        OutputError: one process after another is lost at the same task, or none can be started.
        """
        if self._sent is None or self._sent[0] is not common:
            self._sent = common, pickle.dumps(common, pickle.HIGHEST_PROTOCOL)
        do = partial(self._do, work, self._sent[1])
        yield from _in_order(self._threads, do, tasks, self._ahead)

    def submit(self, work: Callable[[], R]) -> Future[R]:
        """Give a process a call that has nothing in common with others."""
        return self._threads.submit(self._do, _called, _NOTHING, work)

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


_NOTHING = pickle.dumps(None)


def _called(_common: None, work: Callable[[], R]) -> R:
    return work()


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

    It runs in the language of the caller. ``given_up`` tells it that the block failed or was
    stopped, so that it need not finish.
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
