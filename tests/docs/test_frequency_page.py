"""The page on volumes and frequencies shows what the command prints."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.pages import commands, shown
from helpers.scripts import run_script


def test_the_output_is_that_of_the_command(
    repository: Path, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (repository / "docs" / "frequency.md").read_text(encoding="utf-8")
    monkeypatch.chdir(repository)
    (line,) = commands(page)
    out = printed(*line[1:])
    assert out.splitlines() == shown(page, "frequency")


def test_the_script_makes_the_committed_volumes(repository: Path, tmp_path: Path) -> None:
    folder = repository / "sample_dem" / "volumes"
    assert run_script(folder / "make.py", tmp_path).code == 0
    assert (tmp_path / "blocks.csv").read_bytes() == (folder / "blocks.csv").read_bytes()
