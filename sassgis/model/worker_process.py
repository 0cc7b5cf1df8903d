"""Worker processes that end with the process that started them, however that ends."""

from __future__ import annotations

import os
import threading
from multiprocessing import connection, parent_process


def end_with_parent() -> None:
    """End this worker process as soon as its parent is gone; called once, at its start.

    A parent that is killed tells its workers nothing: they would wait for tasks for ever.
    """
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()
