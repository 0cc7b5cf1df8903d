"""The page on starting says what the commands do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.pages import shown

from sassgis.inputs.site_layers import site_layers
from sassgis.runs import dem_check
from sassgis.terrain import slope_units


@pytest.fixture(scope="module")
def page(repository: Path) -> str:
    return (repository / "docs" / "starting.md").read_text(encoding="utf-8")


def test_the_outputs_are_those_of_the_sample(
    page: str, repository: Path, tmp_path: Path, printed
) -> None:
    dem, out = repository / "sample_dem" / "valley" / "dem.tif", tmp_path / "release.gpkg"
    said = printed("cliffs", dem, "-o", out)
    assert said.splitlines()[:-1] == shown(page, "cliffs")
    config = tmp_path / "sassgis.toml"
    printed("init", config, "--dem", dem, "--release", out)
    said = printed("validate", config)
    assert said.splitlines()[-3:] == shown(page, "validate")


def test_every_layer_and_attribute_is_on_the_page(page: str) -> None:
    for own in site_layers():
        (row,) = [x for x in page.splitlines() if x.startswith(f"| `{own.name}` |")]
        assert set(re.findall(r"`(\w+)`", row)) == {own.name, *own.fields}


def test_the_limits_of_the_check_are_on_the_page(page: str) -> None:
    rows = {
        x.split("|")[1].strip(): x for x in page.splitlines() if x.startswith("| ") and "|" in x
    }
    for row, numbers in {
        "resolution": dem_check._CELL_M,
        "steepness": (dem_check._STEEP_DEG, 100 * slope_units.WALL_SHARE, slope_units.WALL_DEG),
        "terraces": (*dem_check._STEP_ERROR_DEG, *(100 * v for v in dem_check._EQUAL)),
        "spikes, pits": (
            dem_check._BUMP_M, dem_check._BUMP_COUNT, 100 * dem_check._BUMP_SHARE,
            dem_check._BUMP_BAD_M,
        ),
        "depressions": (
            dem_check._DEEP_M, 100 * dem_check._DEPRESSION_SHARE, dem_check._DEPRESSION_M,
        ),
    }.items():  # fmt: skip
        for number in numbers:
            assert re.search(rf"(?<![\d.]){number:g}(?![\d.]*\d)", rows[row]), (row, number)
