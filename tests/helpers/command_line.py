"""The command line, called within the process of a test."""

from __future__ import annotations

import pytest

from sassgis.cli import main


def exit_code(*arguments: object) -> int:
    """Call the command line; what it prints is printed."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    assert isinstance(stopped.value.code, int)
    return stopped.value.code
