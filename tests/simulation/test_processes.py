"""Processes that are killed, stopped or interrupted at any moment: same results, or one line."""

from __future__ import annotations

import operator
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from subprocess import Popen

import pytest
from helpers.worker_tasks import LARGE, Task, kill_as_they_start, number, wait_for, work

from sassgis.errors import OutputError
from sassgis.simulation import workers
from sassgis.simulation.workers import Processes, task_map

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="processes are found in /proc"
)
NAMES = "abcde"


def expected(names: str = NAMES) -> list[str]:
    return [f"common {name} " * (LARGE // 8) for name in names]


@pytest.mark.parametrize("moment", ["reading", "working", "answering"])
def test_a_process_that_is_killed_at_its_task_is_replaced(tmp_path: Path, moment: str) -> None:
    tasks = [Task(name, moment if name == "b" else "", tmp_path, times=2) for name in NAMES]
    with Processes(2) as pool:
        assert list(pool.in_order(work, "common", tasks)) == expected()
    assert len(tasks[1].struck) == 2


def test_processes_that_are_killed_as_they_start_are_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    killed = kill_as_they_start(monkeypatch, 2)
    tasks = [Task(name, "", tmp_path) for name in NAMES]
    with Processes(2) as pool:
        assert list(pool.in_order(work, "common", tasks)) == expected()
    assert len(killed) == 2


def test_processes_that_are_killed_without_a_task_are_none_that_tasks_have_lost(
    tmp_path: Path,
) -> None:
    with Processes(6) as pool:
        list(pool.in_order(number, None, range(60)))
        own = [process._popen.pid for process in pool._all]
        for pid in own:
            os.kill(pid, signal.SIGKILL)
        wait_for("Z", *own)
        assert list(pool.in_order(work, "common", [Task("a", "", tmp_path)])) == expected("a")


@pytest.mark.parametrize("moment", ["starting", "working"])
def test_one_process_after_the_other_is_one_line(
    tmp_path: Path, moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if moment == "starting":
        kill_as_they_start(monkeypatch, 100)
    tasks = [Task(name, moment, tmp_path, times=100) for name in "ab"]
    with Processes(1) as pool:
        refused = pytest.raises(OutputError, match=r"3 processes ended.* task, a \(killed; memory")
        with refused as caught:
            list(pool.in_order(work, "common", tasks))
    assert caught.value.exit_code == 3 and "\n" not in str(caught.value)
    assert len(tasks[0].struck) == (3 if moment == "working" else 0)


def test_no_process_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    def start(*_: object, **__: object) -> Popen[bytes]:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(workers, "Popen", start)
    refused = pytest.raises(OutputError, match=r"no process can be started: .* unavailable")
    with refused, Processes(1) as pool:
        list(pool.in_order(number, None, [1]))


def test_a_process_that_is_stopped_is_waited_for(tmp_path: Path) -> None:
    task = Task("a", "working", tmp_path, number=signal.SIGSTOP)
    found: list[str] = []
    with Processes(1) as pool:
        results = pool.in_order(work, "common", [task])
        thread = threading.Thread(target=lambda: found.extend(results))
        thread.start()
        while not task.struck:
            time.sleep(0.02)
        wait_for("T", *task.struck)
        assert thread.is_alive() and not found
        os.kill(*task.struck, signal.SIGCONT)
        thread.join()
    assert found == expected("a")


def power(common: int, task: int) -> float:
    return float(task**common)


def fails(_common: object, task: str) -> None:
    raise {"value": ValueError("no"), "own": Unreadable(1, 2)}[task]


class Unreadable(Exception):
    """Cannot be made again from what is pickled of it."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__("of its own")


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_and_errors_are_those_of_the_work(jobs: int) -> None:
    with task_map(2, jobs) as each:
        assert list(each(power, range(40))) == [float(k * k) for k in range(40)]
        with pytest.raises(ZeroDivisionError):
            list(each(operator.mod, [1, 0, 2]))
        # The processes are there for what comes next.
        assert list(each(power, [3])) == [9.0]


def test_errors_say_where_they_arose() -> None:
    with Processes(1) as pool:
        with pytest.raises(ValueError, match="no") as caught:
            list(pool.in_order(fails, None, ["value"]))
        assert "in fails" in caught.value.__notes__[0]
        with pytest.raises(RuntimeError, match="Unreadable: of its own"):
            list(pool.in_order(fails, None, ["own"]))


def program(repository: Path) -> Popen[str]:
    path = os.pathsep.join([str(repository / "tests"), *filter(None, sys.path)])
    return Popen(
        [sys.executable, "-m", "helpers.sleeping_workers"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": path},
        # A shell without a terminal starts what it puts in the background deaf to the interrupt.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("number", "stop"),
    [
        (signal.SIGKILL, False), (signal.SIGTERM, False), (signal.SIGINT, False),
        # One that is stopped sees that a killed program is gone only when it goes on.
        (signal.SIGTERM, True), (signal.SIGINT, True),
    ],
)  # fmt: skip
def test_workers_end_with_the_program(repository: Path, number: signal.Signals, stop: bool) -> None:
    """At any moment, also before their first line."""
    with program(repository) as parent:
        try:
            assert parent.stdout is not None
            own = [int(word) for word in parent.stdout.readline().split()]
            assert len(own) == 2
            for pid in own if stop else ():
                os.kill(pid, signal.SIGSTOP)
            wait_for("T" if stop else "RSDT", *own)
            parent.send_signal(number)
            parent.wait(60.0)
            wait_for("Z", *own)
        finally:
            parent.kill()


def test_ctrl_c_is_kept_from_processes_from_their_first_moment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It reaches all processes of a terminal, and would show a traceback of each."""
    blocked: list[int] = []

    def start(*arguments: object, **options: object) -> Popen[bytes]:
        process = Popen(*arguments, **options)  # type: ignore[call-overload]
        status = Path(f"/proc/{process.pid}/status").read_text()
        (mask,) = re.findall(r"(?m)^SigBlk:\s*(\w+)$", status)
        blocked.append(int(mask, 16) >> (signal.SIGINT - 1) & 1)
        return process

    monkeypatch.setattr(workers, "Popen", start)
    with Processes(2) as pool:
        list(pool.in_order(number, None, range(20)))
    assert set(blocked) == {1}


#: Modules that Python looks for as a process of it starts, or that workers load.
PLANTED = ("multiprocessing", "pickle", "signal", "selectors", "numba", "sassgis", "usercustomize")


def test_the_current_folder_runs_nothing_in_the_processes(tmp_path: Path) -> None:
    (tmp_path / "project").mkdir()
    for name in PLANTED:
        planted = f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})\n"
        (tmp_path / "project" / f"{name}.py").write_text(planted)
    (tmp_path / "program.py").write_text(
        "import math\n"
        "from sassgis.simulation.workers import Processes\n"
        "if __name__ == '__main__':\n"
        "    with Processes(1) as pool:\n"
        "        print(*pool.in_order(math.hypot, 3.0, [4.0]))\n"
    )
    done = subprocess.run(
        [sys.executable, tmp_path / "program.py"], cwd=tmp_path / "project", check=False,
        capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )  # fmt: skip
    assert not (tmp_path / "ran").exists(), (tmp_path / "ran").read_text()
    assert (done.returncode, done.stdout) == (0, "5.0\n"), done.stderr
