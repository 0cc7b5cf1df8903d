"""The page on one case says what the commands do, and its tables are those of the script."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import rasterio
from helpers.pages import commands, shown
from helpers.scripts import run_script

from sassgis.inputs.ground_map import read_ground_table

SCRIPT = Path(__file__).resolve().parents[2] / "sample_dem" / "observed" / "make.py"


@pytest.fixture(scope="module")
def page(repository: Path) -> str:
    return (repository / "docs" / "gap_practice.md").read_text(encoding="utf-8")


def test_the_script_makes_the_committed_tables(tmp_path: Path) -> None:
    assert run_script(SCRIPT, tmp_path).code == 0
    made = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert made == {p.name: p.read_bytes() for p in SCRIPT.parent.glob("*.csv")}
    assert len(made) == 5


def test_the_template_has_the_columns_of_the_page_and_of_the_sample(
    page: str, tmp_path: Path, printed
) -> None:
    printed("gap", "template", tmp_path / "observed")
    for file in SCRIPT.parent.glob("*.csv"):
        empty, own = (
            f.read_text(encoding="utf-8").splitlines()[0].split(",")
            for f in (tmp_path / "observed" / file.name, file)
        )
        assert set(own) <= set(empty)
        rows = [x for x in page.splitlines() if x.startswith(f"| `{file.stem}` |")]
        assert len(rows) == 1
        if file.stem != "metadata":
            assert set(re.findall(r"`(\w+)`", rows[0])) == {file.stem, *own}


def test_the_check_says_what_the_page_says(
    page: str, repository: Path, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(repository)
    (line,) = [c for c in commands(page) if c[:3] == ["sassgis", "gap", "validate"]]
    said = printed(*line[1:])
    assert said.splitlines()[: len(shown(page, "validate"))] == shown(page, "validate")


@pytest.mark.battery
def test_the_case_from_tables_to_the_changed_map(
    page: str, repository: Path, tmp_path: Path, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample_dem").symlink_to(repository / "sample_dem")
    said = {}
    for line in commands(page):
        name = line[2] if line[1] == "gap" else line[1]
        said[name] = printed(*line[1:])
    told = said["diagnose"].splitlines()
    lines = shown(page, "diagnose")
    kept = [x for x in told if not x.startswith("Open ")]
    cut = lines.index("...")  # the page leaves some objects out
    last = lines[cut + 1 :]
    assert kept[:cut] == lines[:cut] and kept[-len(last) :] == last
    found = json.loads((tmp_path / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8"))
    # The truth, which the diagnosis does not know: debris that holds rocks back more.
    assert found["verdict"]["effect"] == "none"
    assert found["advice"]["configured"]["gap"] < 0.0
    table = read_ground_table(tmp_path / "diagnosis" / "model" / "ground_classes.csv", "hazard")
    (debris,) = [c for c in table.classes if c.name == "debris"]
    assert 0.75 < debris.eta_max < 0.88
    before, after = (
        rasterio.open(tmp_path / "diagnosis" / "map" / "maps" / "reach_probability_change.tif")
        .read(k, masked=True).filled(0.0) for k in (2, 3)
    )  # fmt: skip
    assert (after > 0.0).sum() < (before > 0.0).sum()
    assert (tmp_path / "calibrated" / "report.html").is_file()
