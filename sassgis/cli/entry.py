"""The commands together, and errors as one line."""

from __future__ import annotations

import errno
import gc
import logging
import signal
import sys
import threading
import traceback
from contextlib import suppress
from typing import Any

import click

from sassgis import __version__
from sassgis.cli.observation_commands import calibrate, diagnose, template, validate_observations
from sassgis.cli.run_commands import batch, compare, demo, export, profile, run, sensitivity, zone
from sassgis.cli.site_commands import (
    check_rules,
    check_terrain,
    cliffs,
    fetch,
    frequency,
    init,
    new,
    sample,
    schema,
    validate,
    write_preset,
)
from sassgis.errors import Interrupted, OutputError, SassgisError, chain, of_the_system, shown
from sassgis.simulation.workers import COLLECTED_EVERY, OF_TERMINALS


class InOrder(click.Group):
    """Commands in the order of work, as they were added."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, not sorted."""
        return list(self.commands)


#: A path of the user's that leads nowhere; what cannot be written is an OutputError.
_CLOSED = (errno.ENAMETOOLONG, errno.EACCES, errno.ELOOP)
_CODES = """\b
Exit codes:
  0    done
  1    other failure, such as not enough memory
  2    input, configuration or option that cannot be used
  3    result that cannot be written
  70   fault of sassgis
  130  stopped by the user"""


@click.group(cls=InOrder, context_settings={"help_option_names": ["-h", "--help"]}, epilog=_CODES)
@click.version_option(__version__, prog_name="sassgis")
@click.option("--debug", is_flag=True, help="Show the full traceback of an error.")
def cli(debug: bool) -> None:
    """Rockfall hazard zoning with the SASS model of Bozzolo and Pamini (1986).

    Commands in the order of work; `sassgis COMMAND -h` has an example of each.
    """


@click.group(cls=InOrder)
def gap() -> None:
    """Observations: check them, compare them, find causes."""


@click.group(cls=InOrder)
def dem() -> None:
    """Terrain models: get them, check them."""


@click.group(cls=InOrder)
def preset() -> None:
    """Rules of hazard levels: copy, edit and check them."""


for _command in (
    demo, sample, dem, cliffs, new, init, schema, preset, frequency, validate, profile, run, zone,
    compare, export, sensitivity, batch, calibrate, gap,
):  # fmt: skip
    cli.add_command(_command)
for _command in (template, validate_observations, diagnose):
    gap.add_command(_command)
for _command in (write_preset, check_rules):
    preset.add_command(_command)
for _command in (fetch, check_terrain):
    dem.add_command(_command)


def run_commands(arguments: list[str] | None = None) -> None:
    """Run the command line; errors print as one line and set the exit code."""
    # Libraries leave a million objects, all of which a collection looks at: a tenth of the start.
    gc.set_threshold(COLLECTED_EVERY)
    given = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in given
    logging.basicConfig(level=logging.DEBUG if debug else logging.ERROR, format="%(message)s")
    for chatty in ("numba", "matplotlib", "rasterio", "fiona"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    if not debug:
        logging.getLogger("sassgis.compiled.jit").setLevel(logging.WARNING)
    if threading.current_thread() is threading.main_thread():
        # What a queue or a container sends before it kills, and a terminal that is closed: the
        # state is saved, workers are ended. Under nohup a command continues.
        for number in {*OF_TERMINALS, signal.SIGTERM} - {signal.SIGINT}:
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, signal.default_int_handler)
    try:
        code: Any = cli.main(
            args=[a for a in given if a != "--debug"], prog_name="sassgis", standalone_mode=False
        )
    except SassgisError as error:
        _fail(str(error), error.exit_code, debug)
    except (click.exceptions.Abort, KeyboardInterrupt):
        _fail("stopped by the user", Interrupted.exit_code, debug)
    except click.ClickException as error:
        _fail(error.format_message(), error.exit_code, debug)
    except Exception as error:
        _fail(*_stated(error), debug)
    else:
        sys.exit(code if isinstance(code, int) else 0)


def _stated(error: Exception) -> tuple[str, int]:
    """The message and exit code of an unexpected error."""
    # Compiled code that Ctrl-C strikes turns it into a SystemError.
    if any(isinstance(link, KeyboardInterrupt) for link in chain(error)):
        return "stopped by the user", Interrupted.exit_code
    if isinstance(error, OSError) and error.errno in _CLOSED:
        return f"{shown(error.filename)}: cannot be opened ({error.strerror})", 2
    if limit := of_the_system(error):
        if _is_printing(error):
            return f"standard output: cannot be written ({limit})", OutputError.exit_code
        return limit, 1
    kind, text = type(error).__name__, " ".join(str(error).split())
    again = "a fault of sassgis; run again with --debug and report what it says"
    return f"unexpected {kind}: {text} ({again})", 70


def _is_printing(error: Exception) -> bool:
    """Whether an error is of what was printed."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and str(trace.tb_frame.f_globals.get("__name__")).startswith("click.")


def _fail(text: str, code: int, debug: bool) -> None:
    # A closed terminal shows no message.
    with suppress(OSError):
        if debug:
            traceback.print_exc()
        click.echo(f"Error: {text}", err=True)
    sys.exit(code)
