"""What works in a thread beside the rest."""

from __future__ import annotations

import threading
from contextvars import ContextVar

import pytest

from sassgis.settings.languages import current_language, in_language
from sassgis.simulation.workers import beside

GIVEN_UP: ContextVar[threading.Event | None] = ContextVar("given_up", default=None)


def test_it_works_in_the_language_of_the_caller_and_is_not_given_up() -> None:
    def work() -> tuple[str, bool]:
        given_up = GIVEN_UP.get()
        assert given_up is not None
        return current_language(), given_up.is_set()

    with in_language("de"), beside(work, GIVEN_UP) as result:
        assert result() == ("de", False)
    assert GIVEN_UP.get() is None


@pytest.mark.parametrize("stopped", [KeyboardInterrupt, OSError])
def test_it_ends_when_the_rest_fails(stopped: type[BaseException]) -> None:
    ended = []

    def work() -> None:
        given_up = GIVEN_UP.get()
        assert given_up is not None
        ended.append(given_up.wait(60.0))

    with pytest.raises(stopped), beside(work, GIVEN_UP):
        raise stopped
    assert ended == [True]
