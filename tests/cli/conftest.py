"""The small slope, and a way to call the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from sassgis.cli import main

from helpers.small_slope import Slope, heights, release_box


@pytest.fixture
def slope(tmp_path: Path) -> Slope:
    made = Slope(tmp_path)
    made.write_config()
    made.write_dem(heights())
    made.write_release(release_box())
    return made


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Call the command line; gives exit code, stdout and stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        assert isinstance(stopped.value.code, int)
        return stopped.value.code, out, err

    return run
