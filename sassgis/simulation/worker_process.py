"""A process that works on tasks for the one that started it, and ends with it."""

from __future__ import annotations

import gc
import logging
import os
import pickle
import signal
import sys
import threading
import traceback
from contextlib import suppress
from queue import SimpleQueue
from subprocess import PIPE, Popen, TimeoutExpired
from typing import IO, Any

#: Libraries that would each start separate threads.
_THREADS = (
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "GDAL_NUM_THREADS",
)
#: What Ctrl-C sends, and a terminal that is closed (not on Windows).
OF_TERMINALS = [getattr(signal, n) for n in ("SIGINT", "SIGHUP") if hasattr(signal, n)]
#: Objects made since the last collection of those that nobody needs, at which there is another.
COLLECTED_EVERY = 100_000
#: What a pipe raises that is closed, or ends within a message.
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
            # What remains to be sent has nobody to go to.
            with suppress(OSError):
                pipe.close()
        return self._popen.wait()


def _send(pipe: IO[bytes], message: bytes) -> None:
    pickle.dump(message, pipe, pickle.HIGHEST_PROTOCOL)
    pipe.flush()


def serve() -> None:
    """Work on what comes by standard input in a worker process, and end where that ends."""
    # They reach all processes of a terminal; the first one sees to the others.
    for number in OF_TERMINALS:
        signal.signal(number, signal.SIG_IGN)
    gc.set_threshold(COLLECTED_EVERY)
    logging.basicConfig(level=logging.ERROR, format="%(message)s")
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # What a library reads is no call, and what it prints is no answer.
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
    """Hand on what comes; a parent that is killed says no more than that nothing comes."""
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
