"""Cases that fail in every way, for the processes of benchmarks/watched.py."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping


def prepare(word: str) -> Callable[[int], Mapping[str, int]]:
    """What does the cases: 1 raises, 3 ends its process, 5 never ends."""

    def case(number: int) -> Mapping[str, int]:
        if number == 1:
            raise ValueError(word)
        if number == 3:
            os._exit(7)
        if number == 5:
            time.sleep(600.0)
        return {"done": 1}

    return case
