"""The command line: thin, a short function for each command.

It is quick to answer, as everything heavy is imported when it is used.
"""

from sassgis.cli.entry import main

__all__ = ["main"]
