"""Copies of the sample terrain."""

from __future__ import annotations

import shutil
from pathlib import Path

from sassgis.runs.samples import sample_folder


def copy_sample(name: str, target: Path) -> Path:
    """Copy "valley", "bedrina" or "piota_negra" and return the path of its configuration."""
    shutil.copytree(sample_folder() / name, target, dirs_exist_ok=True)
    return next(iter(sorted(target.glob("config*.toml"))))
