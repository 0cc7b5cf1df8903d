"""What the files of a site say about the configuration that reads them."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import pytest
import shapely
from helpers.small_slope import CELL, NORTH, WEST, Slope, heights, release_box

from sassgis.errors import InputError
from sassgis.inputs.config import load_config
from sassgis.inputs.site_layers import start_keys, with_values
from sassgis.inputs.tiles import read_terrain
from sassgis.inputs.vectors import read_control_lines


def boxes(folder: Path, layer: str, **columns: list[object]) -> Path:
    count = len(next(iter(columns.values())))
    frame = gpd.GeoDataFrame(columns, geometry=[release_box()] * count, crs="EPSG:2056")
    frame.to_file(folder / "areas.gpkg", layer=layer, driver="GPKG")
    return folder / "areas.gpkg"


@pytest.mark.parametrize(
    ("names", "field"), [(["a", "b"], "Name"), (["a", "a"], None), (["a", None], None)]
)
def test_names_are_taken_where_they_are_names(tmp_path: Path, names, field) -> None:
    file = boxes(tmp_path, "x", Name=names)
    ((section, keys),) = start_keys(tmp_path / "sub", None, file)
    assert section == "release" and keys["file"] == "../areas.gpkg"
    assert keys.get("name_field") == field and "layer" not in keys


def test_of_several_layers_one_must_be_known(tmp_path: Path) -> None:
    boxes(tmp_path, "x", name=["a"])
    file = boxes(tmp_path, "y", name=["a"])
    with pytest.raises(InputError, match=r"several layers.*x, y"):
        start_keys(tmp_path, None, file)
    boxes(tmp_path, "release", name=["a"])
    assert dict(start_keys(tmp_path, None, file))["release"]["layer"] == "release"


def test_a_drawn_layer_without_attributes_is_taken(tmp_path: Path) -> None:
    file = boxes(tmp_path, "release_areas", name=["a"])
    area = gpd.GeoDataFrame(geometry=[release_box()], crs="EPSG:2056")
    area.iloc[:0].to_file(file, layer="assessed_area", driver="GPKG")
    assert "hazard" not in dict(start_keys(tmp_path, None, file))
    area.to_file(file, layer="assessed_area", driver="GPKG")
    assert dict(start_keys(tmp_path, None, file))["hazard"] == {
        "assessed": "areas.gpkg", "assessed_layer": "assessed_area",
    }  # fmt: skip


def test_a_list_of_blocks_replaces_all() -> None:
    both = 'blocks=[{name="a", volume_m3=1.0}, {name="b", volume_m3=[2, 3]}]'
    assert with_values([("blocks", {"name": "x"}), ("run", {"seed": 2})], [both]) == [
        ("run", {"seed": 2}),
        ("blocks", {"name": "a", "volume_m3": 1.0}),
        ("blocks", {"name": "b", "volume_m3": [2, 3]}),
    ]


def test_values_of_the_user_stand_beside_those_of_the_files(tmp_path: Path) -> None:
    given = [("release", {"file": "a.gpkg", "spacing_m": 3.0})]
    asked = ("release.spacing_m=5", "blocks.volume_m3=[0.5, 2]", "ground.default = rock")
    assert with_values(given, asked) == [
        ("release", {"file": "a.gpkg", "spacing_m": 5}),
        ("blocks", {"volume_m3": [0.5, 2]}),
        ("ground", {"default": "rock"}),
    ]
    assert given[0][1]["spacing_m"] == 3.0
    for wrong in ("release.spacing=5", "release.spacing_m", "spacing_m=5", "blocks=[1, 2]"):
        with pytest.raises(InputError, match="--set: is no key with a value"):
            with_values(given, (wrong,))


NETS = """
[[barriers]]
name = "measure"
file = "nets.gpkg"
name_field = "name"
kind = "wall"
kind_field = "kind"
height_m_field = "height"
capacity_kj_field = "capacity"
"""


def barriers(folder: Path, **columns: list[object]):
    slope = Slope(folder)
    slope.write_config()
    slope.write_dem(heights())
    lines = [
        shapely.LineString([(WEST + CELL * c, NORTH - 2), (WEST + CELL * c, NORTH - 90)])
        for c in (20, 30)
    ]
    frame = gpd.GeoDataFrame({"name": ["a", "b"], **columns}, geometry=lines, crs="EPSG:2056")
    frame.to_file(folder / "nets.gpkg", driver="GPKG")
    slope.config.write_text(slope.config.read_text() + NETS)
    config = load_config(slope.config)
    return [own for own, _ in read_control_lines(config, read_terrain(config.dem_source))]


def test_each_barrier_has_its_own_kind_height_and_capacity(tmp_path: Path) -> None:
    own = barriers(tmp_path, kind=["net", None], height=[3.0, 2.0], capacity=[500.0, None])
    assert [(b.name, b.kind, b.height_m, b.capacity_kj) for b in own] == [
        ("a", "net", 3.0, 500.0),
        ("b", "wall", 2.0, float("inf")),
    ]


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"kind": ["fence", None], "height": [3.0, 2.0]}, ["kind", "'fence'", "wall"]),
        ({"kind": ["net", None], "height": [3.0, None]}, ["feature 2 (b)", "height", "no value"]),
        ({"kind": ["net", None], "height": [3.0, 0.0]}, ["height", "0.0", "above 0"]),
    ],
)
def test_attributes_keep_the_limits_of_the_keys(tmp_path: Path, columns, words) -> None:
    with pytest.raises(InputError) as error:
        barriers(tmp_path, **columns, capacity=[500.0, 500.0])
    assert all(word in str(error.value) for word in ("nets.gpkg", *words)), str(error.value)
