"""Whether the real QGIS is there to be asked."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

SYSTEM_PYTHON = Path("/usr/bin/python3")


@pytest.fixture(scope="session")
def qgis() -> None:
    if SYSTEM_PYTHON.is_file():
        done = subprocess.run(
            [SYSTEM_PYTHON, "-c", "import qgis.core"], capture_output=True, check=False
        )
        if done.returncode == 0:
            return
    pytest.skip("QGIS for the system's Python is not installed (Debian: python3-qgis)")
