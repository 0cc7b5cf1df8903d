"""The command line: thin, a short function for each command.

It is quick to answer, as everything heavy is imported when it is used.
"""

from __future__ import annotations

import sys


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; errors print as one line and set the exit code."""
    try:
        from sassgis.cli.entry import run_commands
    except KeyboardInterrupt:
        sys.stderr.write("Error: stopped by the user\n")
        sys.exit(130)
    run_commands(arguments)
