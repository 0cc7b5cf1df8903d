"""Inputs of Rockyfor3D as a configuration with its layers."""

from __future__ import annotations

import math
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from helpers.rockyfor3d_folder import made, write_grid
from helpers.small_slope import CELL, COLS, NORTH, ROWS, WEST, heights

from sassgis.errors import InputError, OutputError
from sassgis.inputs.config import load_config
from sassgis.inputs.ground_map import built_in_table
from sassgis.inputs.rockyfor3d import soil_types
from sassgis.outputs.site_template import write_rockyfor3d_site
from sassgis.runs.inputs import read_map_run
from sassgis.settings.map_run import MapRun
from sassgis.terrain.prepare import placed_points

NONE = np.zeros((ROWS, COLS))


def site_of(folder: Path, **options: bool) -> tuple[list[Path], list[str]]:
    file = folder.parent / "site.toml"
    return write_rockyfor3d_site(file, folder, ["terrain.crs=EPSG:2056"], **options)


def run_of(folder: Path) -> MapRun:
    site_of(folder)
    return read_map_run(load_config(folder.parent / "site.toml"))


def nets(col: int = 40, rows: slice = np.s_[5:45]) -> dict[str, np.ndarray]:
    number = NONE.copy()
    number[rows, col] = 2.0
    return {"net_number": number, "net_height": 3.5 * (number > 0),
            "net_energy": 1500.0 * (number > 0)}  # fmt: skip


def test_source_cells_are_release_points_with_blocks_of_their_mass(tmp_path: Path) -> None:
    run = run_of(made(tmp_path / "in"))
    small, large = run.blocks
    assert large.volume_m3 == pytest.approx((0.96, 0.96))  # 1.2 x 1.0 x 0.8 m, rectangular
    assert small.volume_m3 == pytest.approx((math.pi / 6 * 0.08,) * 2, rel=1e-3)
    assert large.density_kgm3 == (2700.0, 2700.0) and small.density_kgm3 == (2600.0, 2600.0)
    axes = [getattr(large, f"axis_{k}_m")[0] for k in (1, 2, 3)]
    assert axes == pytest.approx([1.0, 1.0 / 1.2, 0.8 / 1.2], abs=1e-4)
    points = placed_points(run)
    col, row = (points.x - WEST) / CELL, (NORTH - points.y) / CELL
    # The middle of every source cell, and no other place.
    expected = {(r + 0.5, c + 0.5) for r in range(10, 14) for c in range(3, 7)}
    expected |= {(r + 0.5, c + 0.5) for r in range(30, 33) for c in range(3, 8)}
    assert {(float(r), float(c)) for r, c in zip(row, col, strict=True)} == expected
    assert len(points) == len(expected) == 31
    by_area = {area.name: area.scenarios for area in run.areas}
    assert sorted(by_area.values()) == [(small.name,), (large.name,)]


def test_soil_types_are_ground_classes_with_a_source(tmp_path: Path) -> None:
    run = run_of(made(tmp_path / "in"))
    assert (run.ground[:, :45] == run.table.index("talus")).all()
    assert (run.ground[:, 45:] == run.table.index("soft_meadow")).all()
    for own in soil_types().values():
        assert own.ground_class in built_in_table().names
        # Numbers of the manual were not read: nothing of this is called checked.
        assert not own.verified and "not checked" in own.source
    text = (tmp_path / "site.toml").read_text()
    flat = " ".join(line.strip("# ") for line in text.splitlines())
    assert "Soil type 4 (talus, compact soil, large fragments), 64.3 % of the cells" in flat
    assert "mean of rg70 0.20 m, rg20 0.40 m, rg10 0.80 m." in flat
    assert "rg70, rg20 and rg10 have no counterpart" in flat


def test_nets_are_lines_with_height_and_energy(tmp_path: Path) -> None:
    bent = nets()
    bent["net_number"][44, 41:46] = 2.0
    for name, own in (("net_height", 3.5), ("net_energy", 1500.0)):
        bent[name] = own * (bent["net_number"] > 0)
    bent["net_number"][20:30, 60] = 7.0
    bent["net_height"][20:30, 60], bent["net_energy"][20:30, 60] = 5.0, 3000.0
    run = run_of(made(tmp_path / "in", bent))
    (first, trace), (second, _) = run.control_lines
    assert (first.name, first.kind, first.height_m, first.capacity_kj) == (
        "net 2", "net", 3.5, 1500.0,
    )  # fmt: skip
    assert (second.name, second.height_m, second.capacity_kj) == ("net 7", 5.0, 3000.0)
    # Along the middle of the cells, round the corner.
    length = np.hypot(*np.diff(trace, axis=0).T).sum()
    assert length == pytest.approx(39 * CELL + 5 * CELL, abs=CELL)
    ends = sorted(trace[[0, -1]].tolist(), key=lambda p: p[1])
    assert ends[1] == pytest.approx([WEST + 40.5 * CELL, NORTH - 5.5 * CELL])
    assert ends[0] == pytest.approx([WEST + 45.5 * CELL, NORTH - 44.5 * CELL])


def test_trees_keep_their_place_and_kind(tmp_path: Path) -> None:
    folder = made(tmp_path / "in", {"conif_percent": np.full((ROWS, COLS), 30.0)})
    listed = f"x y dbh conifers\n{WEST + 50} {NORTH - 30} 42.5 80\n{WEST + 60},{NORTH - 40},18\n"
    (folder / "TreeFile.txt").write_text(listed)
    files, _ = site_of(folder)
    trees = pd.read_csv(tmp_path / "trees.csv")
    assert trees["dbh_cm"].tolist() == [42.5, 18.0]
    # The second has that of its cell.
    assert trees["conifer_share"].tolist() == [0.8, 0.3]
    assert tmp_path / "trees.csv" in files
    run = read_map_run(load_config(tmp_path / "site.toml"))
    assert run.forest is not None and run.forest.stems_per_m2.max() > 0.0


def test_stands_are_read_from_their_rasters(tmp_path: Path) -> None:
    stand = {"nrtrees": np.full((ROWS, COLS), 400.0), "dbhmean": np.full((ROWS, COLS), 25.0),
             "dbhstd": NONE + 5.0, "conif_percent": NONE + 50.0}  # fmt: skip
    _, notes = site_of(made(tmp_path / "in", stand))
    run = read_map_run(load_config(tmp_path / "site.toml"))
    assert run.forest is not None
    assert run.forest.stems_per_m2 == pytest.approx(0.04)
    assert run.forest.diameter_m == pytest.approx(0.25)
    trees = load_config(tmp_path / "site.toml").effects.named("trees")
    assert trees is not None and trees.species == "conifers"
    assert trees.efficiency == pytest.approx((0.5 * 0.93 + 0.5 * 1.59) / 0.93, abs=1e-3)
    assert any("dbhstd has no counterpart" in note for note in notes)


def test_many_kinds_of_blocks_are_put_together(tmp_path: Path) -> None:
    folder = made(tmp_path / "in")
    side = np.zeros((ROWS, COLS))
    side[5:9, 3:13] = np.linspace(0.3, 2.0, 40).reshape(4, 10)
    density = 2700.0 * (side > 0)
    for name, values in (("d1", side), ("d2", side), ("d3", side), ("rockdensity", density),
                         ("blshape", 3.0 * (side > 0))):  # fmt: skip
        write_grid(folder / f"{name}.asc", values)
    run = run_of(folder)
    assert len(run.blocks) == 12
    low, high = zip(*(b.volume_m3 for b in run.blocks), strict=True)
    assert min(low) == pytest.approx(math.pi / 6 * 0.3**3, rel=1e-3)
    assert max(high) == pytest.approx(math.pi / 6 * 2.0**3, rel=1e-3)
    assert list(low) == sorted(low) and all(a <= b for a, b in zip(high, low[1:], strict=False))
    assert len(placed_points(run)) == 40


def test_what_was_written_is_whole_and_not_overwritten(tmp_path: Path) -> None:
    folder = made(tmp_path / "in", nets())
    # What lies beside the terrain is not taken for it, nor a second raster of its name.
    for suffix in ("prj", "aux.xml", "png", "txt", "xyz", "tif"):
        (folder / f"dem.{suffix}").write_text("no terrain")
    files, _ = site_of(folder)
    assert 'dem = "in/dem.asc"' in (tmp_path / "site.toml").read_text()
    assert {f.name for f in files} == {"site.toml", "release.gpkg", "nets.gpkg"}
    assert gpd.read_file(tmp_path / "release.gpkg").crs.to_epsg() == 2056
    with pytest.raises(OutputError, match="exists already"):
        site_of(folder)
    assert site_of(folder, overwrite=True)[0] == files


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("soiltype", None, "no soiltype.asc"),
        ("rockdensity", None, "no bldens.asc"),
        ("rockdensity", NONE, "has no source cell"),
        ("d2", NONE, "source cells without a block"),
        ("soiltype", NONE + 9.0, "a soil type that is not known .*found 9"),
        ("soiltype", NONE - 9999.0, "soiltype.asc: .*no soil type .*found 3500 cells, all nodata"),
        ("blshape", NONE + 5.0, "a form that is not known .*found 5; expected 1 .rectangular"),
        ("rg70", np.zeros((9, 9)), "does not lie on the cells of dem .*found 9 x 9"),
        ("net_number", NONE + 1.0, "nets without all of their rasters"),
    ],
)
def test_what_cannot_be_used_is_one_line(tmp_path: Path, name: str, values, words: str) -> None:
    folder = made(tmp_path / "in")
    if values is None:
        (folder / f"{name}.asc").unlink()
    else:
        write_grid(folder / f"{name}.asc", values)
    with pytest.raises(InputError, match=words) as caught:
        site_of(folder)
    assert "\n" not in str(caught.value) and not (tmp_path / "site.toml").exists()


def test_the_command_says_what_has_no_counterpart(tmp_path: Path, call, printed, refusal) -> None:
    folder = made(tmp_path / "in", {"slope_extra": heights()})
    new = tmp_path / "site.toml"
    assert "has no coordinate system" in refusal("init", new, "--rockyfor3d", folder)
    told = ("--set", "terrain.crs=EPSG:2056")
    code, out, err = call("init", new, "--rockyfor3d", folder, *told)
    assert code == 0 and f"Wrote {new}" in out
    assert "have no counterpart" in err and "Not read: slope_extra.asc." in err
    printed("validate", new)
    err = refusal("init", tmp_path / "b.toml", "--rockyfor3d", folder, "--dem", "x.tif")
    assert "takes no --dem" in err
