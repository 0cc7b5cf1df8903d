"""Copies of the sample terrain."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from sassgis.outputs.site_template import sample_folder


def copy_sample(name: str, target: Path) -> Path:
    """Copy "valley", "bedrina" or "piota_negra" and return the path of its configuration.

    It asks for a number of blocks, not for as many as the map needs.
    """
    shutil.copytree(sample_folder() / name, target, dirs_exist_ok=True)
    config = next(iter(sorted(target.glob("config*.toml"))))
    config.write_text(with_given_blocks(config.read_text(encoding="utf-8")), "utf-8")
    return config


def with_given_blocks(text: str) -> str:
    """A configuration that asks for the number of blocks that it states."""
    return re.sub(r"(?m)^(blocks|changed_share_max) = .*\n", "", text)
