"""A program that waits for its worker processes, to be killed; it prints their numbers."""

from __future__ import annotations

import multiprocessing
import sys
import threading
import time

from sassgis.runs.workers import task_map


def sleep(_problem: object, seconds: float) -> None:
    time.sleep(seconds)


def told() -> None:
    while len(multiprocessing.active_children()) < 2:
        time.sleep(0.05)
    print(*(child.pid for child in multiprocessing.active_children()), flush=True)


if __name__ == "__main__":
    from helpers.sleeping_workers import sleep as task

    threading.Thread(target=told).start()
    with task_map(None, 2) as run:
        list(run(task, [float(sys.argv[1])] * 16))
