"""The current folder may come from anybody: libraries take no settings from it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def not_found(name: str) -> Iterator[None]:
    """Have a library, as it is imported, not find a file that it looks for by its name alone."""
    exists = os.path.exists
    os.path.exists = lambda path: path != name and exists(path)
    try:
        yield
    finally:
        os.path.exists = exists
