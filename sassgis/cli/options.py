"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

if TYPE_CHECKING:
    from sassgis.runs.workers import Jobs

OUT = click.option(
    "-o", "--output", "out", required=True, type=click.Path(path_type=Path), help="Folder to write."
)
CONFIG = click.argument("config", type=click.Path(path_type=Path))
OVERWRITE = click.option(
    "--overwrite", is_flag=True, help="Replace a result that nobody has changed."
)
SEED = click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), help="In place of run.seed of the configuration."
)
AREAS = click.option(
    "--area", "areas", multiple=True, help="Only this release area; may be given several times."
)
JOBS = click.option("--jobs", type=click.IntRange(0), help="Processor cores; 0: all.")
AS_JSON = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object in place of lines."
)
_Command = TypeVar("_Command", bound=Callable[..., object])


def cluster_options(command: _Command) -> _Command:
    """Options of commands that processes in place of threads, or a dask cluster, can work on."""
    own = click.option("--workers", type=click.IntRange(1), help="Processes of this machine.")
    other = click.option("--scheduler", metavar="ADDRESS", help="Dask cluster: tcp://node:8786.")
    return other(own(command))


@contextmanager
def who_works(jobs: int | None, scheduler: str | None, workers: int | None) -> Iterator[Jobs]:
    """Threads or processes, or a cluster that is there as long as the block.

    Raises
    ------
    click.UsageError
        If more than one of them is asked for.
    InputError
        If the cluster cannot be used.
    """
    if sum(asked is not None for asked in (jobs, scheduler, workers)) > 1:
        raise click.UsageError("give one of --jobs, --scheduler and --workers")
    if workers is not None:
        from sassgis.runs.workers import Processes

        with Processes(workers, ahead=3) as own:
            yield own
    elif scheduler is not None:
        from sassgis.runs.cluster import cluster

        with cluster(scheduler) as other:
            yield other
    else:
        yield jobs
