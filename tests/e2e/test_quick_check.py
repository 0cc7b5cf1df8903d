"""The blind check of the diagnosis, from the command line."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from helpers.installed import done_in

pytestmark = [pytest.mark.e2e, pytest.mark.battery]


def test_the_quick_check_of_a_few_worlds_ends_with_its_report(
    repository: Path, tmp_path: Path
) -> None:
    done_in(
        repository, sys.executable, "-m", "sassgis", "gap", "check", "--quick", "-o",
        tmp_path / "check", "--jobs", "2",
    )  # fmt: skip
    made = {p.name for p in (tmp_path / "check").iterdir()}
    assert made >= {"check.json", "labels.sha256", "report.html", "scores.json", "worlds.csv"}
