"""The sample terrain that comes with sassgis."""

from __future__ import annotations

import shutil
from pathlib import Path

import sassgis
from sassgis.model.errors import InputError

NAMES = ("valley", "bedrina", "piota_negra")


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


def copy_sample(name: str, target: Path) -> Path:
    """Copy one of NAMES to ``target`` and return the path of its configuration."""
    shutil.copytree(sample_folder() / name, target, dirs_exist_ok=True)
    return next(iter(sorted(target.glob("config*.toml"))))
