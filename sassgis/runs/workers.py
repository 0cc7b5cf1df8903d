"""Who works on the parts of a job: threads of this process, or a cluster of processes.

Whoever it is, results come in the order of the parts, so that they are added up in the same order
and the same bytes come out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol


class Workers(Protocol):
    """Works on tasks that have something large in common."""

    def in_order(
        self, work: Callable[[Any, Any], Any], common: Any, tasks: Iterable[Any]
    ) -> Generator[Any, None, None]:
        """Results of ``work(common, task)`` in the order of the tasks, a few at work at a time.

        Closing the generator gives up what was not asked for yet.
        """
        ...


#: Number of threads or processes; None: as configured, 0: all cores; or who works instead.
Jobs = int | Workers | None


@dataclass(frozen=True, slots=True)
class Threads:
    """Threads of this process.

    Never the calling one: Ctrl-C would strike within compiled code, which turns it into a
    SystemError.
    """

    count: int

    def in_order(
        self, work: Callable[[Any, Any], Any], common: Any, tasks: Iterable[Any]
    ) -> Generator[Any, None, None]:
        """As ``Workers`` says."""
        with ThreadPoolExecutor(self.count) as pool:
            waiting: deque[Future[Any]] = deque()
            try:
                for task in tasks:
                    waiting.append(pool.submit(work, common, task))
                    if len(waiting) > 2 * self.count:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()
