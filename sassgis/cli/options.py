"""What commands share: options, how a command is declared, and who works."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from sassgis.cli.progress_bar import ProgressBar

Decorator = Callable[[Any], Any]

PATH = click.Path(path_type=Path)


def several(name: str, dest: str, meaning: str) -> Decorator:
    """An option that may be given several times; None where it is not given."""
    meaning += "; may be given several times."
    return click.option(
        name, dest, multiple=True, callback=lambda _, __, given: given or None, help=meaning
    )


OUT = click.option("-o", "--output", "out", required=True, type=PATH, help="Folder to write.")
CONFIG = click.argument("config", type=PATH)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Overwrite, unless files were edited.")
# Its limits are those of the setting, in whose place it is checked.
SEED = click.option("--seed", type=int, help="In place of run.seed of the configuration.")
FIT_SEED = click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=1, show_default=True)
AREAS = several("--area", "areas", "Only this release area")
JOBS = click.option("--jobs", type=click.IntRange(0), help="Processor cores; 0: all.")
#: Who works where processes in place of threads, or a dask cluster, can.
WORKERS = (
    JOBS,
    click.option("--scheduler", metavar="ADDRESS", help="Dask cluster: tcp://node:8786."),
    click.option("--workers", type=click.IntRange(1), help="Processes of this machine."),
)
MEMORY = click.option(
    "--memory", "memory_gb", type=click.FloatRange(min=1.0), metavar="GB",
    help="Memory for all of it: fewer threads, areas or blocks of a mosaic at a time.",
)  # fmt: skip
# Its limits are those of the setting, too.
GROUND_DRAWS = click.option(
    "--ground-uncertainty", type=int, metavar="N",
    help="Simulate N draws of the ground classes, too: bands by their spread between sites.",
)  # fmt: skip
AS_JSON = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object in place of lines."
)
DEM_CRS = click.option("--crs", help="Coordinate system, where DEM states none.")
OVERRIDE_CRS = click.option(
    "--override-crs", is_flag=True, help="Use --crs even though DEM states another, wrong system."
)
OBSERVATIONS = click.option(
    "--observations", required=True, type=PATH, help="A GeoPackage, or a folder of CSV files."
)


def command(*parameters: Decorator, example: str, **more: Any) -> Callable[[Any], click.Command]:
    """A command from its arguments and options in order; what is heavy it imports when it runs.

    Options whose names are those of the function that does the work go through as ``given``.
    """

    def made(function: Any) -> click.Command:
        for parameter in reversed(parameters):
            function = parameter(function)
        declared: Any = click.command(epilog=f"Example: sassgis {example}", **more)
        return declared(function)  # type: ignore[no-any-return]

    return made


@contextmanager
def settings_as_options() -> Iterator[None]:
    """Have errors speak of the options of a command without a configuration, not of settings."""
    from sassgis.errors import InputError
    from sassgis.inputs.dem_system import in_options

    try:
        yield
    except InputError as error:
        texts = {"field": error.field, "expected": error.expected}
        told = {key: text and in_options(text) for key, text in texts.items()}
        raise InputError(**error.parts(**told)) from None


@contextmanager
def at_work(given: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """What is given, with who works (threads, processes or a cluster) and how progress is shown."""
    plain = dict(given)
    jobs, scheduler, workers = (plain.pop(key, None) for key in ("jobs", "scheduler", "workers"))
    if sum(asked is not None for asked in (jobs, scheduler, workers)) > 1:
        raise click.UsageError("give one of --jobs, --scheduler and --workers")
    with ProgressBar() as progress:
        plain |= {"on_progress": progress.step, "say": progress.say}
        if workers is not None:
            from sassgis.simulation.workers import Processes

            with Processes(workers, ahead=3) as own:
                yield plain | {"jobs": own}
        elif scheduler is not None:
            from sassgis.simulation.cluster import cluster

            with cluster(scheduler) as other:
                yield plain | {"jobs": other}
        else:
            yield plain | {"jobs": jobs}
