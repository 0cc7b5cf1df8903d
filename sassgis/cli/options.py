"""What commands share: options, how a command is declared, who works, the progress bar."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click

#: Share of all steps, and least number of them, whose pace tells the time left.
_PACED, _FEWEST = 0.05, 2


class ProgressBar:
    """A bar with the time left on a terminal; a line now and then in a log.

    A context manager: the line of the bar ends with it, however it is left. A program that shows
    the lines of the log as progress asks for more of them by ``SASSGIS_PROGRESS_S``, the seconds
    between two of them.
    """

    def __init__(self) -> None:
        # None where it was closed before the start.
        self._terminal = sys.stderr is not None and sys.stderr.isatty()
        asked = os.environ.get("SASSGIS_PROGRESS_S", "")
        self._every_s = float(asked) if asked.replace(".", "", 1).isdecimal() else 30.0
        self._began: tuple[float, int] | None = None
        self._done = 0
        self._shown = time.monotonic()
        self._open = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def say(self, text: str) -> None:
        """Announce the next step."""
        self.close()
        _tell(f"{text} ...")

    def step(self, done: int, total: int, rocks: int) -> None:
        """Show the progress of a run."""
        now = time.monotonic()
        # The first chunk gives no pace: it waits for the program to be compiled, and in a run that
        # resumes from a saved state all before it was done another time. Each stage has a pace.
        if self._began is None or done < self._done:
            self._began = (now, done)
        self._done = done
        since, first = self._began
        # Nor do a few others: further kernels are compiled when they are first called.
        steps, left = done - first, ""
        if steps >= max(_FEWEST, total * _PACED):
            left = f", about {clock((now - since) / steps * (total - done))} left"
        if self._terminal:
            if now - self._shown < 0.1 and done < total:
                return
            width = 28
            filled = width * done // total
            bar = "#" * filled + "-" * (width - filled)
            _tell(f"\r  [{bar}] {100 * done // total:3d} %, {rocks} blocks{left}  ", nl=False)
            self._open = True
        elif now - self._shown >= self._every_s:
            _tell(f"  {100 * done // total} %, {rocks} blocks{left}")
        else:
            return
        self._shown = now

    def close(self) -> None:
        """End the line of the bar."""
        if self._open:
            _tell("")
            self._open = False


def _tell(text: str, nl: bool = True) -> None:
    """Show progress, if the terminal is still there: a run does not end with it."""
    with suppress(OSError):
        click.echo(text, nl=nl, err=True)


def print_json(found: Mapping[str, object]) -> None:
    """Print one JSON object: numbers that are not finite as null, paths as text."""

    def plain(value: object) -> object:
        if isinstance(value, Mapping):
            return {str(key): plain(own) for key, own in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(own) for own in value]
        if isinstance(value, float) and not math.isfinite(value):
            return None
        return str(value) if isinstance(value, Path) else value

    click.echo(json.dumps(plain(found), indent=1, ensure_ascii=False, allow_nan=False))


def printed(found: Any, as_json: bool = False, *how: object) -> None:
    """Print a report, line by line (``how`` goes to ``lines``) or as one JSON object."""
    if as_json:
        print_json(found.as_dict())
    else:
        for line in found.lines(*how):
            click.echo(line)


def notes(texts: Iterable[str]) -> None:
    """Print first the few warnings of what may make a result wrong, then all other ones."""
    from sassgis.settings.results import first_warnings

    stated = tuple(texts)
    first = first_warnings(stated)
    for kind, said in (("Warning", first), ("Note", [t for t in stated if t not in first])):
        for text in said:
            click.echo(f"{kind}: {text.removeprefix('warning: ')}", err=True)


def conclude(
    warnings: Sequence[str], summary: str, folder: Path, facts: Mapping[str, object] | None = None
) -> None:
    """Report the result of a simulation and where it is; with facts as JSON, without as lines."""
    if facts is not None:
        print_json({"output": folder, **facts, "warnings": warnings})
        return
    notes(warnings)
    click.echo(summary)
    if (folder / "report.html").is_file():
        click.echo(f"Open {folder / 'project.qgz'} in QGIS, {folder / 'report.html'} in a browser.")
    else:
        click.echo(f"The maps are in {folder / 'maps'}.")


def clock(seconds: float) -> str:
    """Time as hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


Decorator = Callable[[Any], Any]

PATH = click.Path(path_type=Path)


def several(name: str, dest: str, meaning: str) -> Decorator:
    """Declare an option that may be given several times; None without it."""
    meaning += "; may be given several times."
    return click.option(
        name, dest, multiple=True, callback=lambda _, __, given: given or None, help=meaning
    )


OUT = click.option("-o", "--output", "out", required=True, type=PATH, help="Folder to write.")
CONFIG = click.argument("config", type=PATH)
OVERWRITE = click.option("--overwrite", is_flag=True, help="Overwrite, unless files were edited.")
# Its limits are those of the setting, in whose place it is checked.
SEED = click.option("--seed", type=int, help="Random seed; replaces run.seed of the configuration.")
FIT_SEED = click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=1, show_default=True)
AREAS = several("--area", "areas", "Only this release area")
JOBS = click.option("--jobs", type=click.IntRange(0), help="Processor cores; 0: all.")
#: Who works where processes in place of threads, or a dask cluster, can.
WORKERS = (
    JOBS,
    click.option("--scheduler", metavar="ADDRESS", help="Dask cluster: tcp://node:8786."),
    click.option("--workers", type=click.IntRange(1), help="Number of processes on this machine."),
)
MEMORY = click.option(
    "--memory", "memory_gb", type=click.FloatRange(min=1.0), metavar="GB",
    help="Memory for the whole run: limits threads, areas and mosaic blocks at a time.",
)  # fmt: skip
# Its limits are those of the setting, too.
GROUND_DRAWS = click.option(
    "--ground-uncertainty", type=int, metavar="N",
    help="Also simulate N draws of the ground classes, for bands of their spread between sites.",
)  # fmt: skip
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
DEM_CRS = click.option("--crs", help="Coordinate system, if DEM states none.")
OVERRIDE_CRS = click.option(
    "--override-crs", is_flag=True, help="Use --crs although DEM states another (wrong) system."
)
OBSERVATIONS = click.option(
    "--observations", required=True, type=PATH, help="A GeoPackage, or a folder of CSV files."
)


def command(*parameters: Decorator, example: str, **more: Any) -> Callable[[Any], click.Command]:
    """Declare a command with arguments and options in order; heavy imports wait until it runs.

    Options named like parameters of the working function pass through as ``given``.
    """

    def made(function: Any) -> click.Command:
        for parameter in reversed(parameters):
            function = parameter(function)
        declared: Any = click.command(epilog=f"Example: sassgis {example}", **more)
        return declared(function)  # type: ignore[no-any-return]

    return made


@contextmanager
def settings_as_options(
    options: Mapping[str, str] = MappingProxyType({}), with_config: bool = False
) -> Iterator[None]:
    """Have errors speak of the options of a command, not of settings.

    ``options``: those of the command, by the field that an error names. A command ``with_config``
    has no options for the coordinate system of the terrain model.
    """
    from sassgis.errors import InputError
    from sassgis.inputs.dem_system import in_options

    try:
        yield
    except InputError as error:
        field = options.get(error.field or "", error.field)
        stated = {"field": field, "expected": error.expected}
        if not with_config:
            stated = {key: text and in_options(text) for key, text in stated.items()}
        if stated == {"field": error.field, "expected": error.expected}:
            raise
        raise InputError(**error.parts(**stated)) from None


@contextmanager
def at_work(given: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Give the options with the workers (threads, processes or a cluster) and the progress bar."""
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
