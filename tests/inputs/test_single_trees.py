"""Single trees and rasters of a forest on the cells of the terrain."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
from affine import Affine
from helpers.input_files import NORTH, WEST

from sassgis.engine.effects.trees import Trees, energy_ratios, prepare, stem_loss
from sassgis.errors import ConfigError, InputError
from sassgis.grid import Grid
from sassgis.inputs.ground_map import TREES_WITHIN_M, read_forest
from sassgis.inputs.in_memory import as_input
from sassgis.settings.blocks import ForestPlace

GRID = Grid(np.zeros((40, 50)), WEST, NORTH, 2.0)


def trees(n: int = 300) -> gpd.GeoDataFrame:
    """Trees all over the grid and beside it."""
    rng = np.random.default_rng(3)
    x, y = WEST + rng.uniform(-8.0, 108.0, n), NORTH - rng.uniform(-8.0, 88.0, n)
    columns = {"dbh_cm": rng.uniform(8.0, 70.0, n), "conifer_share": rng.uniform(0.0, 1.0, n)}
    return gpd.GeoDataFrame(columns, geometry=gpd.points_from_xy(x, y))


def table(frame: gpd.GeoDataFrame, file: Path, *columns: str) -> Path:
    frame.assign(x=frame.geometry.x, y=frame.geometry.y)[["x", "y", *columns]].to_csv(
        file, index=False
    )
    return file


def energy_of(diameter_m: float) -> float:
    """What a stem of fir takes (J), by the engine."""
    stand = prepare(Trees("full_stems"), has_stems=True)
    return float(stem_loss(stand, np.uint64(1), 0, diameter_m))


def test_stems_are_counted_within_their_reach_and_take_what_the_trees_take(tmp_path: Path) -> None:
    frame = trees()
    file = table(frame, tmp_path / "trees.csv", "dbh_cm", "conifer_share")
    stems, diameter = read_forest(ForestPlace(single_trees=file), GRID)
    ratios = energy_ratios()
    col, row = (np.floor(v / 2.0) for v in (frame.geometry.x - WEST, NORTH - frame.geometry.y))
    checked = 0
    for i, j in ((0, 0), (20, 25), (39, 49), (5, 40)):
        # By cells, as trees have the place of theirs.
        near = np.hypot(2.0 * (row - i), 2.0 * (col - j)) <= TREES_WITHIN_M
        cells = sum(
            np.hypot(2.0 * a, 2.0 * b) <= TREES_WITHIN_M for a in range(-3, 4) for b in range(-3, 4)
        )
        own = frame[near.to_numpy()]
        at = 50 * i + j
        assert stems[at] == pytest.approx(len(own) / (4.0 * cells))
        if len(own):
            share = own["conifer_share"]
            factor = share * ratios["conifers"] + (1.0 - share) * ratios["broadleaved"]
            mean = np.mean(
                [f * energy_of(d / 100.0) for f, d in zip(factor, own["dbh_cm"], strict=True)]
            )
            assert energy_of(diameter[at]) == pytest.approx(mean)
            checked += 1
    assert checked >= 3


def test_a_part_of_the_terrain_has_the_forest_of_the_whole(tmp_path: Path) -> None:
    settings = ForestPlace(single_trees=table(trees(), tmp_path / "t.csv", "dbh_cm"))
    whole = [v.reshape(GRID.shape) for v in read_forest(settings, GRID)]
    part = Grid(GRID.values[10:20, 5:30], WEST + 10.0, NORTH - 20.0, 2.0)
    for of_part, of_whole in zip(read_forest(settings, part, GRID), whole, strict=True):
        assert np.allclose(of_part.reshape(part.shape), of_whole[10:20, 5:30])


def test_points_and_tables_say_the_same(tmp_path: Path) -> None:
    frame = trees(50)
    frame.loc[3, "conifer_share"] = np.nan
    frame.to_file(tmp_path / "trees.gpkg", driver="GPKG")
    ways = (
        tmp_path / "trees.gpkg",
        table(frame, tmp_path / "trees.csv", "dbh_cm", "conifer_share"),
        as_input(frame, "trees"),
    )
    found = [read_forest(ForestPlace(single_trees=way), GRID) for way in ways]
    for stems, diameter in found[1:]:
        assert np.allclose(stems, found[0][0]) and np.allclose(diameter, found[0][1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y,dbh_cm\n1,2,thick\n", "row 2: is not a number"),
        ("x,y,dbh_cm\n1,2,30\n", "no tree lies on the DEM"),
        ("x,y,dbh_cm\n", "holds no tree"),
        (f"x,y,dbh_cm,conifer_share\n{WEST + 5},{NORTH - 5},30,80\n", "a share, 0 to 1"),
    ],
)
def test_what_is_no_tree_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "trees.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_forest(ForestPlace(single_trees=tmp_path / "trees.csv"), GRID)


def test_a_forest_is_given_once() -> None:
    with pytest.raises(ConfigError, match="forest is given twice"):
        ForestPlace(single_trees=Path("a.csv"), file=Path("b.gpkg"), stems_per_ha=1, dbh_cm=1)


def stems_of(file: Path, grid: Grid = GRID, whole: Grid | None = None) -> np.ndarray:
    """Stems per hectare of a raster."""
    return 1e4 * read_forest(ForestPlace(stems_raster=file, dbh_cm=30.0), grid, whole)[0]


def test_stems_stored_with_a_factor_and_beside_a_transparency_band(make_dem) -> None:
    stored = np.full((8, 10), 30)
    stored[0, 0] = 255
    file = make_dem(
        stored, crs=None, dtype="uint8", nodata=255, scale=10.0, offset=5.0,
    )  # fmt: skip
    stems = stems_of(file).reshape(GRID.shape)
    assert (stems[:5, :5] == 0.0).all() and (stems[5:, 5:] == 305.0).all()
    clear = np.where(np.arange(10) < 5, 0, 255) * np.ones((8, 1))
    file = make_dem(np.stack([np.full((8, 10), 30), clear]), crs=None, dtype="uint8", alpha="yes")
    stems = stems_of(file).reshape(GRID.shape)
    assert (stems[:, :25] == 0.0).all() and (stems[:, 25:] == 30.0).all()


def test_a_raster_beyond_the_terrain_is_no_forest(make_dem) -> None:
    far = Affine(10.0, 0.0, WEST + 9e3, 0.0, -10.0, NORTH)
    file = make_dem(np.ones((8, 10)), crs=None, transform=far)
    words = r"dem\.tif: effects\.trees\.stems_raster: .*no value on the DEM .*overlaps"
    with pytest.raises(InputError, match=words):
        stems_of(file)
    # An area of a batch may lie beside the forest.
    assert not stems_of(file, whole=GRID).any()
