"""What the user sees while a run goes on, and when it ends."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
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
        self._terminal = sys.stderr.isatty()
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
        """Say what is done next."""
        self.close()
        _tell(f"{text} ...")

    def step(self, done: int, total: int, rocks: int) -> None:
        """Show the progress of a run."""
        now = time.monotonic()
        # The first chunk gives no pace: it waits for the program to be compiled, and in a run that
        # goes on from a saved state all before it was done another time. Each stage has its own.
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
    """Print one JSON object; what is not finite is null, a path its text."""

    def plain(value: object) -> object:
        if isinstance(value, Mapping):
            return {str(key): plain(own) for key, own in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(own) for own in value]
        if isinstance(value, float) and not math.isfinite(value):
            return None
        return str(value) if isinstance(value, Path) else value

    click.echo(json.dumps(plain(found), indent=1, ensure_ascii=False, allow_nan=False))


def printed(found: Any, as_json: bool = False) -> None:
    """Print what was found, line by line or as one JSON object."""
    if as_json:
        print_json(found.as_dict())
    else:
        for line in found.lines():
            click.echo(line)


def notes(texts: Iterable[str]) -> None:
    """Print warnings beside the result."""
    for text in texts:
        click.echo(f"Note: {text.removeprefix('warning: ')}", err=True)


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
