"""Workers end with the process that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


def runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    # One that ended and was not waited for yet does not run.
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_of_a_killed_program_end(repository: Path, number: signal.Signals) -> None:
    path = os.pathsep.join([str(repository / "tests"), *filter(None, sys.path)])
    parent = subprocess.Popen(
        [sys.executable, "-m", "helpers.sleeping_workers", "120"],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    try:
        assert parent.stdout is not None
        workers = [int(word) for word in parent.stdout.readline().split()]
        assert len(workers) == 2 and all(map(runs, workers))
        # They watch their parent once they have imported what they need.
        time.sleep(5.0)
        parent.send_signal(number)
        parent.wait(10.0)
        ends = time.monotonic() + 20.0
        while any(map(runs, workers)) and time.monotonic() < ends:
            time.sleep(0.1)
        assert not any(map(runs, workers))
    finally:
        parent.kill()
        if parent.stdout is not None:
            parent.stdout.close()
