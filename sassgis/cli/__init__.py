"""The command line: thin, a short function for each command.

It is quick to answer, as everything heavy is imported when it is used.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; errors print as one line and set the exit code.

    Without ``arguments`` those of the process are taken, which ends then: nothing that waits for
    its end is called (atexit).
    """
    try:
        from sassgis.cli.entry import run_commands
    except KeyboardInterrupt:
        sys.stderr.write("Error: stopped by the user\n")
        sys.exit(130)
    try:
        run_commands(arguments)
    except SystemExit as ended:
        if arguments is not None:
            raise
        # Python would look through millions of objects of the libraries first, for a second.
        for stream in (sys.stdout, sys.stderr):
            # None where it was closed before the start.
            if stream is not None:
                with suppress(OSError, ValueError):
                    stream.flush()
        os._exit(ended.code if isinstance(ended.code, int) else int(ended.code is not None))
