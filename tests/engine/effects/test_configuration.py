"""``[effects.*]`` in the configuration, and where the forest stands."""

from __future__ import annotations

from typing import get_args

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from affine import Affine
from annotated_types import Interval
from shapely import box

from sassgis.engine.effects.registry import EFFECTS
from sassgis.errors import SassgisError
from sassgis.inputs.config import load_config
from sassgis.runs.check_inputs import check_inputs
from sassgis.runs.inputs import read_map_run

FAMILIES = [f for f in EFFECTS if f != "trees"]
TREES = "stems_per_ha = 300\ndbh_cm = 30\n"


@pytest.fixture
def valley(make_valley):
    """Write sections at the end of the sample's configuration and read everything."""
    path = make_valley()

    def read(text, whole=True, along="followed"):
        path.write_text(base.replace("[terrain]", f'[terrain]\npath = "{along}"') + text)
        config = load_config(path)
        return read_map_run(config) if whole else config

    base = path.read_text() + "\n"
    read.folder = path.parent
    return read


def wrong_lines():
    """Every key of every family with a value of the wrong kind, and numbers beyond the limits."""
    for family, row in EFFECTS.items():
        for key, field in row.keys.items():
            if key == "form":
                yield family, key, '"magic"'
            elif key == "classes":
                yield family, key, "3"
            elif isinstance(field.default, (int, float)):
                yield family, key, '"much"'
                low = next(a.ge for a in get_args(field.kind) if isinstance(a, Interval))
                yield family, key, str(min(low, 0) - 1)
                yield family, key, "1e9" if isinstance(field.default, float) else "1000000"
        yield family, "strenth", "1"


def test_a_wrong_key_or_value_is_one_line(valley):
    for family, key, value in wrong_lines():
        needed = TREES if family == "trees" else ""
        with pytest.raises(SassgisError) as caught:
            valley(f"[effects.{family}]\n{needed}{key} = {value}\n", whole=False)
        line = str(caught.value)
        assert "\n" not in line
        assert "config.toml" in line and f"effects.{family}.{key}" in line
        assert "found" in line or "unknown" in line
        assert "expected" in line


def test_an_empty_section_turns_the_family_on_with_its_defaults(valley):
    for family in FAMILIES:
        effects = valley(f"[effects.{family}]\n", whole=False).effects
        assert effects.names == (family,)


def test_headings_do_not_turn_on_fall_lines(valley):
    text = "[effects.lateral_deflection]\n"
    with pytest.raises(SassgisError) as caught:
        valley(text, whole=False, along="fall_line")
    line = str(caught.value)
    assert "\n" not in line and "config.toml: effects.lateral_deflection: " in line
    assert 'expected terrain.path = "followed"' in line


def test_an_unknown_family_is_told(valley):
    with pytest.raises(SassgisError, match="effects"):
        valley("[effects.snow]\n", whole=False)


def test_a_constant_forest_stands_everywhere(valley):
    run = valley(f"[effects.trees]\n{TREES}")
    assert (run.forest.stems_per_m2 == 0.03).all()
    assert run.forest.diameter_m == pytest.approx(0.3)
    assert valley("").forest is None


def test_trees_without_stems_are_refused(valley):
    for text, key in (("dbh_cm = 30\n", "stems_per_ha"), ("stems_per_ha = 300\n", "dbh_cm")):
        with pytest.raises(SassgisError, match=f"effects.trees.{key}"):
            valley(f"[effects.trees]\n{text}")


def test_polygons_give_each_cell_its_stand(valley):
    grid = valley("").grid
    west, south, east, north = grid.bounds
    middle = 0.5 * (west + east)
    frame = gpd.GeoDataFrame(
        {"stems": [400.0, 100.0], "dbh": [20.0, 50.0]},
        geometry=[box(west, south, west + 50.0, north), box(middle, south, middle + 50.0, north)],
        crs="EPSG:2056",
    )
    frame.to_file(valley.folder / "forest.gpkg", driver="GPKG")
    run = valley(
        '[effects.trees]\nfile = "forest.gpkg"\nstems_field = "stems"\ndbh_field = "dbh"\n'
    )
    x = west + (np.arange(grid.shape[1]) + 0.5) * grid.cell_size
    for stems, dbh, low in ((0.04, 0.2, west), (0.01, 0.5, middle)):
        inside = (x > low) & (x < low + 50.0)
        assert (run.forest.stems_per_m2.reshape(grid.shape)[:, inside] == stems).all()
        assert run.forest.diameter_m.reshape(grid.shape)[:, inside] == pytest.approx(dbh)
    outside = (x > west + 50.0) & (x < middle)
    assert (run.forest.stems_per_m2.reshape(grid.shape)[:, outside] == 0.0).all()
    frame["stems"] = [400.0, -1.0]
    frame.to_file(valley.folder / "forest.gpkg", driver="GPKG")
    with pytest.raises(SassgisError) as caught:
        valley('[effects.trees]\nfile = "forest.gpkg"\nstems_field = "stems"\ndbh_cm = 30\n')
    assert "forest.gpkg" in str(caught.value) and "stems" in str(caught.value)


def test_validate_reads_the_forest(valley):
    config = valley(f'[effects.trees]\nfile = "nowhere.gpkg"\n{TREES}', whole=False)
    with pytest.raises(SassgisError, match=r"nowhere\.gpkg"):
        check_inputs(config)


def test_rasters_are_read_at_the_nearest_cell(valley):
    grid = valley("").grid
    west, _, _, north = grid.bounds
    size = 10.0
    shape = (int(300 // size), int(300 // size))
    values = np.arange(shape[0] * shape[1], dtype=np.float32).reshape(shape)
    values[0, 0] = -9999.0
    with rasterio.open(
        valley.folder / "stems.tif", "w", driver="GTiff", count=1, height=shape[0],
        width=shape[1], dtype="float32", crs="EPSG:2056", nodata=-9999.0,
        transform=Affine(size, 0.0, west, 0.0, -size, north),
    ) as out:  # fmt: skip
        out.write(values, 1)
    run = valley('[effects.trees]\nstems_raster = "stems.tif"\ndbh_cm = 30\n')
    found = 1e4 * run.forest.stems_per_m2.reshape(grid.shape)
    row, col = np.indices(grid.shape)
    own = (
        ((row + 0.5) * grid.cell_size // size).astype(int),
        ((col + 0.5) * grid.cell_size // size).astype(int),
    )
    on = (own[0] < shape[0]) & (own[1] < shape[1])
    expected = np.maximum(values[own[0][on], own[1][on]], 0.0)
    # Cell centres on the border of two cells of the raster may fall to either.
    assert np.mean(np.isclose(found[on], expected)) > 0.99
    assert (found[~on] == 0.0).all()
    with pytest.raises(SassgisError, match=r"effects\.trees\.stems_raster"):
        valley('[effects.trees]\nstems_raster = "none.tif"\ndbh_cm = 30\n')
