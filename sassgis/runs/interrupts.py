"""Ctrl-C, or what is taken for it, at the right moment."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def held_back() -> Iterator[None]:
    """Let Ctrl-C wait until the block is done, so that nothing is left half added or half saved.

    Raises
    ------
    KeyboardInterrupt
        After the block, if the user asked for it within.
    """
    # Only the main thread may set handlers, and only it is interrupted.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
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
