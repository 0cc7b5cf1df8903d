"""Commands of the README, and the package installed from a wheel."""

from __future__ import annotations

import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Installed:
    """A virtual environment with the wheel in it."""

    folder: Path

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    @property
    def sassgis(self) -> Path:
        return self.folder / "bin" / "sassgis"


def command_of(readme: str, name: str) -> str:
    """The fenced block below the line ``<!-- command: NAME -->``, which the page has once."""
    found = re.findall(rf"^<!-- command: {name} -->\n```sh\n(.+?)\n```$", readme, re.M | re.S)
    assert len(found) == 1, name
    return str(found[0])


def done_in(folder: Path, *command: object) -> subprocess.CompletedProcess[str]:
    """A finished command that did not fail; it does not see the Python of the tests."""
    done = subprocess.run(
        [str(c) for c in command], cwd=folder, capture_output=True, text=True, check=False,
        env={k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done
