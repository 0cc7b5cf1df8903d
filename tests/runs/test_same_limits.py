"""What would stop a run stops ``sassgis validate`` first, in the same line."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from helpers.input_files import ONE_BLOCK
from helpers.small_slope import CELL, COLS, NORTH, ROWS, WEST, Slope, heights, release_box
from rasterio.transform import from_origin

from sassgis.batches import batch_area
from sassgis.batches.batch import find_areas
from sassgis.errors import InputError
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import read_map_run
from sassgis.runs.resumable_run import jobs_within
from sassgis.simulation.estimate import estimate_of

Refusal = Callable[..., str]
FALL_LINES = {"terrain__path": '"fall_line"'}
ZONES = {"blocks__onset_frequency": "0.1", "hazard__ref_width_m": "10"}


def every_second_row_unknown(slope: Slope) -> None:
    """Release points on whole multiples of 4 m: all in rows of 2 m without heights."""
    values = heights()
    values[::2] = np.nan
    slope.write_config(release__spacing_m="4")
    slope.write_dem(values)


def tiny_cells(slope: Slope) -> None:
    """A hundred times as small as they are, heights too."""
    slope.write_dem(1500.0 + (heights() - 1500.0) / 400, transform=from_origin(
        WEST, NORTH, CELL / 400, CELL / 400))  # fmt: skip
    x, y = WEST + 3 * CELL / 400, NORTH - 15 * CELL / 400
    slope.write_release(shapely.box(x, y - 0.02, x + 0.02, y))
    slope.write_config(**ZONES, release__spacing_m="0.01")


#: Command, what is done to the small slope, and words of the line.
REFUSED: dict[str, tuple[str, Callable[[Slope], None], tuple[str, ...]]] = {
    "spacing": (
        "run", lambda s: s.write_config(release__spacing_m="1e-9"),
        ("release.spacing_m", "more memory"),
    ),
    "rows without heights": (
        "run", every_second_row_unknown, ("release.file", "no block", "none on known terrain"),
    ),
    "level ground": (
        "run",
        lambda s: (s.write_dem(np.full((ROWS, COLS), 500.0)), s.write_config(**FALL_LINES))[1],
        ("release.gpkg", "release.file", "no block could be simulated",
         "lines that end where they begin"),
    ),
    "cells for zones": ("zone", tiny_cells, ("terrain.dem", "cells of 0.005 m")),
    "blocks at a point": (
        "run", lambda s: s.write_config(release__rocks_per_point="1000000"),
        ("release.rocks_per_point", "more memory", "2 GB"),
    ),
    "windows": (
        "zone", lambda s: s.write_config(**ZONES | {"hazard__ref_width_m": "1000"}),
        ("hazard.ref_width_m", "more memory"),
    ),
}  # fmt: skip


@pytest.fixture
def little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a machine where 2 GB are free."""
    for module in ("settings.process", "simulation.estimate"):
        monkeypatch.setattr(f"sassgis.{module}.memory_bytes", lambda: 2_000_000_000)


def same_line(refusal: Refusal, command: str, config: Path) -> str:
    """The line with which a command and ``validate`` refuse a configuration."""
    line = refusal("validate", config)
    assert refusal(command, config, "-o", config.parent / "result") == line
    assert not list(config.parent.glob("result*"))
    return line


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("name", REFUSED)
def test_what_a_run_refuses_is_refused_before(slope: Slope, refusal: Refusal, name: str) -> None:
    command, spoil, words = REFUSED[name]
    spoil(slope)
    line = same_line(refusal, command, slope.config)
    assert not [word for word in words if word not in line], line


def test_a_terrain_model_larger_than_the_memory_is_not_read(slope: Slope, refusal: Refusal) -> None:
    file = slope.folder / "dem.tif"
    file.unlink()
    with rasterio.open(
        file, "w", driver="GTiff", count=1, dtype="float32", crs="EPSG:2056", tiled=True,
        height=500_000, width=500_000, transform=from_origin(WEST, NORTH, 0.5, 0.5),
        sparse_ok=True, blockxsize=16_384, blockysize=16_384, bigtiff=True,
    ):  # fmt: skip
        pass
    line = same_line(refusal, "run", slope.config)
    assert "dem.tif: terrain.dem: needs more memory than there is (found about 5e+03 GB" in line


def test_what_the_user_allows_is_not_exceeded(slope: Slope, refusal: Refusal) -> None:
    slope.write_config(**ZONES, release__rocks_per_point="1000000")
    out = slope.folder / "out"
    for command in ("run", "zone"):
        line = refusal(command, slope.config, "-o", out, "--memory", "1.5")
        assert "release.rocks_per_point" in line and "at most 1.5 GB, which --memory" in line
    assert not out.exists()


def test_as_many_threads_work_as_fit(slope: Slope) -> None:
    slope.write_config(release__spacing_m="0.25", release__rocks_per_point="1000")
    config = load_config(slope.config)
    run = read_map_run(config)
    need = [sum(estimate_of(run, n).need.values()) for n in range(1, 6)]
    assert min(np.diff(need)) > 1e6
    for threads, fits in enumerate(need, start=1):
        assert jobs_within(config, run, 5, (fits + 1) / 1e9) == threads
    assert jobs_within(config, run, 2, need[-1] / 1e9) == 2
    with pytest.raises(InputError, match="--memory allows"):
        jobs_within(config, run, 5, (need[0] - 1) / 1e9)


def test_tables_that_cannot_be_written_are_told_before(
    slope: Slope, refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    slope.write_config(output__rock_table='"parquet"')
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    for given in (("validate", slope.config), ("run", slope.config, "-o", slope.folder / "out")):
        assert "pyarrow" in refusal(*given, code=3)


FEET = "too steep for terrain: are heights or cells in another unit?"


def test_walls_of_heights_in_feet_are_told_by_both(slope: Slope, call, printed) -> None:
    # 65 degrees in metres; three times as steep in feet, 82 degrees.
    fall = np.tan(np.radians(65.0)) * CELL * np.minimum(np.arange(COLS), COLS // 2)
    metres = 1500.0 - np.broadcast_to(fall, (ROWS, COLS))
    slope.write_dem(metres)
    assert FEET not in printed("validate", slope.config)
    slope.write_dem(3.28084 * metres)
    assert FEET in printed("validate", slope.config)
    code, _, err = call("run", slope.config, "-o", slope.folder / "out")
    assert code == 0 and FEET in err


def test_nodata_among_heights_is_told_by_all(slope: Slope, call, printed) -> None:
    """Zeros in a corner that resampling has mixed with heights."""
    told = "a number for nodata that was taken for heights"
    slope.write_config(**ZONES)
    assert told not in printed("validate", slope.config)
    values = heights()
    values[35:, 50:] = 0.0
    values = 0.7 * values + 0.3 * np.roll(values, 1, axis=0)
    values[0] = values[1]
    slope.write_dem(values)
    assert told in printed("validate", slope.config)
    code, _, err = call("run", slope.config, "-o", slope.folder / "out")
    assert code == 0 and told in err
    proposed = ("cliffs", slope.folder / "dem.tif", "--threshold", "35")
    assert told in printed(*proposed, "-o", slope.folder / "cliffs.gpkg")
    # And of the part of the terrain that a batch cuts out for an area.
    config = load_config(slope.config)
    areas = find_areas(config)
    setting, _ = batch_area.read_setting(config, areas, sums_only=True)
    window = batch_area.area_window(setting, areas[0], (1, 1, 1, 1))
    assert told in " ".join(window.notices)


def profile(folder: Path, more: str = "", end_m: float = 100.0, rocks: int = 5) -> Path:
    text = f'[profile]\nfile = "p.csv"\nrocks = {rocks}\n{ONE_BLOCK}{more}'
    (folder / "config.toml").write_text(text)
    (folder / "p.csv").write_text(f"s_m,z_m\n0,100\n50,50\n{end_m},45\n")
    return folder / "config.toml"


TREES = '[effects.trees]\nstems_per_ha = 100\ndbh_cm = 10\nfile = "forest.gpkg"\n'


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"more": TREES}, ("effects.trees.file", "no place along a profile")),
        ({"rocks": 100_000_000}, ("profile.rocks", "more memory")),
        ({"end_m": 1e9}, ("profile.file", "more memory")),
        ({"end_m": 1e300}, ("profile.file", "more memory")),
    ],
)
def test_what_a_profile_run_refuses_is_refused_before(
    tmp_path: Path, refusal: Refusal, change: dict[str, object], words: tuple[str, ...]
) -> None:
    line = same_line(refusal, "profile", profile(tmp_path, **change))  # type: ignore[arg-type]
    assert not [word for word in words if word not in line], line


def test_a_profile_beside_a_map_is_checked_too(slope: Slope, printed, refusal) -> None:
    text = slope.config.read_text()
    slope.config.write_text(f'{text}[profile]\nfile = "p.csv"\n')
    (slope.folder / "p.csv").write_text("s_m,z_m\n0,100\n50,50\nnan,nan\n")
    out = printed("validate", slope.config)
    fault = "p.csv: s_m: row 4: is not a number (found 'nan'"
    assert "ready for      run" in out
    assert f"not ready for  profile: {slope.folder}/{fault}" in out
    assert fault in refusal("profile", slope.config, "-o", slope.folder / "out")


def test_a_profile_cut_from_the_map_needs_no_release_areas(slope: Slope, printed) -> None:
    slope.write_config(release__file="", profile__rocks="5")
    out = printed("validate", slope.config)
    assert "not ready for  run: missing release.file" in out and "ready for      profile" in out
    place = (WEST + 5 * CELL, NORTH - 20 * CELL)
    printed("profile", slope.config, "--point", *place, "-o", slope.folder / "out", "--rocks", "5")


def test_the_estimate_counts_what_is_simulated(slope: Slope, printed) -> None:
    slope.write_release(release_box(), release_box(row=30.0))
    found = json.loads(printed("validate", slope.config, "--json"))["estimate"]
    printed("run", slope.config, "-o", slope.folder / "out")
    counts = json.loads((slope.folder / "out" / "manifest.json").read_text())["counts"]
    # Two points of the lattice of 5 m lie in each area, and two rows of it on its border.
    assert found["release_points"] == counts["release_points"] == 4
    assert found["blocks"] == counts["rocks"] == 16
    assert found["cells"] == ROWS * COLS
    size = sum(f.stat().st_size for f in (slope.folder / "out" / "maps").glob("*.tif"))
    assert 0 < size < found["map_bytes"] + 200_000
