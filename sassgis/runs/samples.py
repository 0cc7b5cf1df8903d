"""The sample terrain that comes with sassgis."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import sassgis
from sassgis.io.atomic_output import staged_output
from sassgis.model.errors import InputError, OutputError


def sample_folder() -> Path:
    """Folder of the samples: in the installed package, or beside it in a source tree.

    Raises
    ------
    InputError
        If the installation has none.
    """
    package = Path(sassgis.__file__).resolve().parent
    for folder in (package / "data" / "sample_dem", package.parent / "sample_dem"):
        if (folder / "valley" / "config.toml").is_file():
            return folder
    raise InputError("the sample terrain is missing from this installation", file=package)


def write_samples(folder: Path) -> None:
    """Write the samples, with their configurations, into a new folder; it appears whole or not."""
    if os.path.lexists(folder):
        raise OutputError(f"{folder}: exists already; choose a new folder")
    with staged_output(folder, overwrite=False) as work:
        shutil.copytree(
            sample_folder(),
            work,
            ignore=shutil.ignore_patterns("__pycache__", "*.py"),
            copy_function=shutil.copyfile,
            dirs_exist_ok=True,
        )
