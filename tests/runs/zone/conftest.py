"""Folders for runs of zones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def make_folder(tmp_path: Path) -> Callable[[str], Path]:
    """A fresh folder with a name."""

    def make(name: str) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        return folder

    return make
