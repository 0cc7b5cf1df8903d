"""The current folder may come from anybody: no library takes settings or data from it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from helpers.small_slope import SASSGIS, Slope

#: What numba, matplotlib, PROJ and GDAL look for there.
LOOKED_FOR = (".numba_config.yaml", "matplotlibrc", "proj.db", "proj.ini", "gdalrc", ".gdal")


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_nothing_in_the_current_folder_is_opened(slope: Slope, tmp_path: Path) -> None:
    """A pipe that nobody writes to holds up who opens it."""
    here = tmp_path / "here"
    here.mkdir()
    for name in LOOKED_FOR:
        os.mkfifo(here / name)
    for command in ("validate", "run"):
        out = ("-o", slope.folder / "out") if command == "run" else ()
        arguments = map(str, (command, slope.config, *out))
        done = subprocess.run(
            [*SASSGIS, *arguments], cwd=here, capture_output=True, text=True, timeout=300.0,
            check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert (slope.folder / "out" / "report.html").is_file()
