"""Processes that make simulated campaigns of one prepared problem, in the order of the tasks."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from sassgis.io.read.config import settings_hash
from sassgis.model.run_config import Config
from sassgis.model.worker_process import end_with_parent
from sassgis.runs.workers import Workers

#: Results of a function of (problem, task), in the order of the tasks.
CampaignMap = Callable[[Callable[[Any, Any], Any], Sequence[Any]], Iterator[Any]]

_PROBLEM: Any = None


def _receive(problem: Any) -> None:
    global _PROBLEM
    end_with_parent()
    _PROBLEM = problem


def _call(function: Callable[[Any, Any], Any], task: Any) -> Any:
    return function(_PROBLEM, task)


@contextmanager
def campaign_workers(problem: Any, jobs: int | Workers) -> Iterator[CampaignMap]:
    """A map of functions of (problem, task) over tasks, in this process, in several or by workers.

    The problem is sent once. Results come in the order of the tasks.
    """
    if not isinstance(jobs, int):
        workers = jobs
        yield lambda function, tasks: workers.in_order(function, problem, tasks)
        return
    if jobs <= 1:
        yield lambda function, tasks: (function(problem, task) for task in tasks)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), _receive, (problem,)) as pool:
        yield lambda function, tasks: pool.map(partial(_call, function), tasks, chunksize=4)


def fingerprint_of(config: Config, observations: Path, options: str) -> str:
    """Of settings, inputs, observations and options."""
    digest = hashlib.sha256(settings_hash(config).encode())
    files = sorted(observations.iterdir()) if observations.is_dir() else [observations]
    for file in files:
        if file.is_file():
            digest.update(file.name.encode() + file.read_bytes())
    digest.update(options.encode())
    return digest.hexdigest()
