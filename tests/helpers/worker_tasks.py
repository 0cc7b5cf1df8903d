"""Tasks of worker processes that end or stop their process at a certain moment."""

from __future__ import annotations

import os
import pickle
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen
from typing import IO, Any

import pytest

from sassgis.simulation import workers

#: Bytes of a result: more than a pipe holds.
LARGE = 1 << 20


@dataclass(frozen=True)
class Task:
    """A task, and when it sends which signal to its process, how often in all."""

    name: str
    moment: str
    folder: Path
    times: int = 1
    number: int = signal.SIGKILL

    def __reduce__(self) -> tuple[Any, ...]:
        return _read, (self.name, self.moment, self.folder, self.times, self.number)

    @property
    def struck(self) -> list[int]:
        """Processes that were sent the signal."""
        return [int(mark.suffix[1:]) for mark in self.folder.glob(f"{self.name}.*")]

    def strike(self, moment: str) -> None:
        """Send the signal, if it is the moment and was not sent so often before."""
        if moment == self.moment and len(self.struck) < self.times:
            (self.folder / f"{self.name}.{os.getpid()}").touch()
            os.kill(os.getpid(), self.number)


def _read(*fields: Any) -> Task:
    task = Task(*fields)
    task.strike("reading")
    return task


def work(common: str, task: Task) -> str:
    """What is common and the name of the task, many times."""
    task.strike("working")
    if task.moment == "answering":

        def half(pipe: IO[bytes], message: bytes) -> None:
            whole = pickle.dumps(message)
            pipe.write(whole[: len(whole) // 2])
            pipe.flush()
            task.strike("answering")
            pipe.write(whole[len(whole) // 2 :])
            pipe.flush()

        workers._send = half
    return f"{common} {task.name} " * (LARGE // 8)


def kill_as_they_start(monkeypatch: pytest.MonkeyPatch, most: int) -> list[int]:
    """Kill so many processes before they run a line; gives their numbers."""
    killed: list[int] = []

    def start(*arguments: Any, **options: Any) -> Popen[bytes]:
        process = Popen(*arguments, **options)
        if len(killed) < most:
            killed.append(process.pid)
            process.kill()
        return process

    monkeypatch.setattr(workers, "Popen", start)
    return killed


def number(_common: object, _task: object) -> int:
    """Of the process."""
    return os.getpid()


def sleep(_common: object, seconds: float) -> None:
    """Do nothing for so long."""
    time.sleep(seconds)


def state(pid: int) -> str:
    """Letter of the system for what a process does: T, stopped; empty: it is gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


def wait_for(states: str, *pids: int, seconds: float = 60.0) -> None:
    """Wait until processes are in one of the states; Z: ended, and gone or not waited for yet."""
    ends = time.monotonic() + seconds
    while not all((state(pid) or "Z") in states for pid in pids):
        assert time.monotonic() < ends, f"{pids} are in states {[state(pid) for pid in pids]}"
        time.sleep(0.02)
