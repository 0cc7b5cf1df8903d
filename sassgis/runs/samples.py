"""The sample terrain that comes with sassgis."""

from __future__ import annotations

from pathlib import Path

import sassgis
from sassgis.model.errors import InputError


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
