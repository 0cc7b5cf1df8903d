"""Numbered cases in processes of their own, watched: a case that hangs or ends its process counts.

For the batteries that look for failures (fuzz.py, extremes.py).
"""

from __future__ import annotations

import multiprocessing
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

#: Cases of one process; the next one starts after.
BATCH = 250
#: Seconds that the first case of a process may take longer: imports and compiled code.
FIRST_S = 1200.0

#: Does the case of a number; returns what to count, and raises where it fails.
Case = Callable[[int], Mapping[str, int]]


def _work(prepare: Callable[..., Case], given: tuple[Any, ...], first: int, last: int,
          at: Any, results: Any) -> None:  # fmt: skip
    """In a process of its own: the cases from ``first`` to ``last`` - 1."""
    case = prepare(*given)
    for number in range(first, last):
        at.value = number
        try:
            results.put((number, case(number), ""))
        except BaseException:
            results.put((number, {"failed": 1}, traceback.format_exc(limit=-3)))
    at.value = last


def watched(
    prepare: Callable[..., Case], given: tuple[Any, ...], cases: range, too_long_s: float
) -> tuple[Counter[str], list[dict[str, Any]]]:
    """Counts over all cases (a range of step 1), and the failures: their number and what was said.

    ``prepare`` is called once in each process with ``given`` and returns what does a case; after
    ``too_long_s`` a case is a failure.
    """
    context = multiprocessing.get_context("spawn")
    counts: Counter[str] = Counter()
    failures: list[dict[str, Any]] = []
    number = cases.start
    while number < cases.stop:
        last = min(number + BATCH, cases.stop)
        at, results = context.Value("l", number), context.SimpleQueue()
        process = context.Process(target=_work, args=(prepare, given, number, last, at, results))
        process.start()
        seen, since, slow = -1, time.monotonic(), False
        while process.is_alive() or not results.empty():
            while not results.empty():
                k, counted, said = results.get()
                counts.update(counted)
                if said:
                    failures.append({"number": k, "said": said})
            if at.value != seen:
                seen, since = at.value, time.monotonic()
            if time.monotonic() - since > too_long_s + FIRST_S * (at.value == number):
                slow = True
                process.kill()
                break
            process.join(0.05)
        process.join()
        if at.value == last:
            number = last
            continue
        counts["too long" if slow else "process ended"] += 1
        said = f"longer than {too_long_s:g} s" if slow else f"exit code {process.exitcode}"
        failures.append({"number": at.value, "said": said})
        number = at.value + 1
    return counts, failures
