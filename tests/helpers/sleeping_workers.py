"""A program whose worker processes sleep, to be ended; it prints their numbers."""

from __future__ import annotations

import signal
import threading
import time

from helpers.worker_tasks import sleep

from sassgis.simulation.workers import Processes


def say(own: Processes) -> None:
    while len(own._all) < 2:
        time.sleep(0.01)
    print(*(process._popen.pid for process in own._all), flush=True)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with Processes(2) as pool:
        threading.Thread(target=say, args=(pool,), daemon=True).start()
        list(pool.in_order(sleep, None, [120.0] * 4))
