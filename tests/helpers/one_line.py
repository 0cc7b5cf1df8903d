"""Errors that a user reads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def one_line(kind: type[Exception], *words: object, match: str | None = None) -> Iterator[None]:
    """Expect an error that is one line and holds all the words given; ``match`` is a pattern."""
    with pytest.raises(kind, match=match) as error:
        yield
    text = str(error.value)
    assert "\n" not in text
    missing = [str(w) for w in words if str(w) not in text]
    assert not missing, f"{missing} not in: {text}"
