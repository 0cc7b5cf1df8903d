"""A program whose worker processes sleep, to be ended; it prints their numbers.

With the word ``starting``, Ctrl-C is pressed as soon as there is a process.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

from helpers.worker_tasks import sleep

from sassgis.runs.worker_process import WorkerProcess
from sassgis.runs.workers import Processes


class Pressed(WorkerProcess):
    """Starts as Ctrl-C reaches all processes of the terminal."""

    def __init__(self) -> None:
        super().__init__()
        os.killpg(0, signal.SIGINT)


def say(own: Processes) -> None:
    while len(own._all) < 2:
        time.sleep(0.01)
    print(*(process._popen.pid for process in own._all), flush=True)


if __name__ == "__main__":
    from sassgis.runs import workers

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if "starting" in sys.argv:
        workers.WorkerProcess = Pressed
    with Processes(2) as pool:
        threading.Thread(target=say, args=(pool,), daemon=True).start()
        list(pool.in_order(sleep, None, [120.0] * 4))
