"""Scripts for the Python that has QGIS."""

from __future__ import annotations

import subprocess
from pathlib import Path

SYSTEM_PYTHON = "/usr/bin/python3"


def in_qgis(script: Path, *words: object, home: Path, code: int = 0) -> str:
    """What a script writes, or what it complains of if it is to end with another exit code."""
    done = subprocess.run(
        [SYSTEM_PYTHON, str(script), *map(str, words)],
        capture_output=True, text=True, timeout=180, check=False,
        env={"QT_QPA_PLATFORM": "offscreen", "HOME": str(home), "LC_ALL": "C.UTF-8"},
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    return done.stderr if code else done.stdout
