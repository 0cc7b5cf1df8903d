"""The GeoPackage holds layers, styles, aliases and metadata as the standard and QGIS want them."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree as ET

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
from helpers import made_up_result as made_up
from shapely.geometry import LineString, MultiPolygon, Point, box

from sassgis.errors import OutputError
from sassgis.files.vector_layer import VectorLayer
from sassgis.outputs.geopackage import write_geopackage
from sassgis.settings import styles


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_geopackage(
        tmp_path_factory.mktemp("result") / "result.gpkg",
        list(made_up.vector_layers().values()),
        {"seed": 7, "ref_width_m": 3.0, "note": "ß → “x”", "nothing": None},
    )


@pytest.fixture
def database(package: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(f"file:{package}?mode=ro", uri=True)) as connection:
        connection.row_factory = sqlite3.Row
        yield connection


def frame_of(geometry: list, **columns: list) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(columns, geometry=geometry, crs="EPSG:2056")


def written(folder: Path, frame: gpd.GeoDataFrame, style: styles.VectorStyle) -> Path:
    """A GeoPackage with the frame as its only layer."""
    return write_geopackage(folder / "a.gpkg", [VectorLayer("own", "A", "", frame, style=style)])


def test_gdal_reads_every_layer_as_it_was(package: Path) -> None:
    expected = made_up.vector_layers()
    listed = dict(pyogrio.list_layers(package))
    assert set(listed) == {*expected, "layer_styles", "run_metadata"}
    assert listed["run_metadata"] is None
    for name, layer in expected.items():
        info = pyogrio.read_info(package, layer=name)
        assert info["crs"] == "EPSG:2056"
        assert info["features"] == len(layer.frame)
        assert list(info["fields"]) == layer.columns[1:]
        assert info["layer_metadata"]["IDENTIFIER"] == layer.title
        assert info["layer_metadata"].get("DESCRIPTION", "") == layer.description
        read = pyogrio.read_dataframe(package, layer=name)
        for column in layer.columns[1:]:
            assert read[column].tolist() == layer.frame[column].tolist()
        assert read.geometry.geom_equals(layer.frame.geometry).all()
    assert listed["release_areas"] == "MultiPolygon"
    assert listed["empty_lines"] == "LineString"


def test_contents_metadata_and_columns_follow_the_standard(database: sqlite3.Connection) -> None:
    assert database.execute("PRAGMA application_id").fetchone()[0] == 0x47504B47
    assert database.execute("PRAGMA user_version").fetchone()[0] == 10300
    rows = {row["table_name"]: row for row in database.execute("SELECT * FROM gpkg_contents")}
    kinds = {name: rows[name]["data_type"] for name in ("layer_styles", "run_metadata", "stops")}
    assert list(kinds.values()) == ["attributes", "attributes", "features"]
    assert {row["last_change"] for row in rows.values()} == {"2000-01-01T00:00:00.000Z"}
    metadata = dict(map(tuple, database.execute("SELECT key, value FROM run_metadata")))
    assert metadata == {"seed": "7", "ref_width_m": "3.0", "note": "ß → “x”", "nothing": None}
    title, description = database.execute(
        "SELECT title, description FROM gpkg_data_columns WHERE table_name = 'fall_lines' "
        "AND column_name = 'energy_kj'"
    ).fetchone()
    assert (title, description) == ("Greatest energy (kJ)", "Translation and rotation")
    extensions = database.execute(
        "SELECT table_name, extension_name FROM gpkg_extensions WHERE column_name IS NULL"
    )
    assert dict(map(tuple, extensions))["gpkg_data_columns"] == "gpkg_schema"


def test_styles_are_found_by_qgis(database: sqlite3.Connection) -> None:
    # The very question that QGIS asks; a NULL schema would not be found by it.
    columns = {
        row["table_name"]: row["column_name"]
        for row in database.execute("SELECT * FROM gpkg_geometry_columns")
    }
    for name, layer in made_up.vector_layers().items():
        rows = database.execute(
            "SELECT * FROM layer_styles WHERE f_table_schema = '' AND f_table_name = ? "
            "AND f_geometry_column = ? AND useAsDefault = 1",
            (name, columns[name]),
        ).fetchall()
        assert len(rows) == 1
        root = ET.fromstring(rows[0]["styleQML"])
        assert root.tag == "qgis"
        aliases = {entry.get("field"): entry.get("name") for entry in root.iter("alias")}
        assert list(aliases) == layer.columns
        for column, info in layer.fields.items():
            assert aliases[column] == info.label
        symbols = {entry.get("name") for entry in root.find("renderer-v2/symbols") or ()}
        used = {entry.get("symbol") for entry in (*root.iter("category"), *root.iter("range"))}
        assert used <= symbols
        assert len(symbols) == max(1, len(layer.style.classes))


def test_equal_input_gives_equal_bytes(tmp_path: Path) -> None:
    first, second = (
        write_geopackage(tmp_path / name, list(made_up.vector_layers().values()), {"seed": 1})
        for name in ("a.gpkg", "b.gpkg")
    )
    assert first.read_bytes() == second.read_bytes()


def test_the_time_of_gdal_is_left_as_it_was(tmp_path: Path) -> None:
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": "2020-02-02T00:00:00Z"})
    try:
        written(tmp_path, frame_of([Point(0, 0)]), styles.RELEASE_POINT_STYLE)
        assert pyogrio.get_gdal_config_option("OGR_CURRENT_DATE") == "2020-02-02T00:00:00Z"
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})


def test_parts_and_heights_are_kept(tmp_path: Path) -> None:
    (tmp_path / "lines").mkdir()
    areas = frame_of([box(0, 0, 1, 1), MultiPolygon([box(2, 0, 3, 1), box(4, 0, 5, 1)])])
    read = pyogrio.read_dataframe(written(tmp_path, areas, styles.FOOTPRINT_STYLE), layer="own")
    assert set(read.geom_type) == {"MultiPolygon"} and read.area.tolist() == [1.0, 2.0]
    lines = frame_of([LineString([(0, 0, 5), (1, 1, 4)]), LineString([(0, 0), (2, 2)])])
    read = pyogrio.read_dataframe(
        written(tmp_path / "lines", lines, styles.FALL_LINE_STYLE), layer="own"
    )
    assert read.geometry.has_z.all()
    assert [point[2] for point in read.geometry[0].coords] == [5.0, 4.0]


def test_local_coordinates_are_undefined_cartesian(tmp_path: Path) -> None:
    path = written(tmp_path, gpd.GeoDataFrame(geometry=[Point(1, 2)]), styles.RELEASE_POINT_STYLE)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT srs_id FROM gpkg_geometry_columns").fetchone() == (-1,)


def test_an_empty_frame_without_geometry_type(tmp_path: Path) -> None:
    frame = gpd.GeoDataFrame(
        {"name": np.array([], dtype=object), "n": np.array([], dtype=np.int64)},
        geometry=gpd.GeoSeries([], crs="EPSG:2056"),
    )
    info = pyogrio.read_info(written(tmp_path, frame, styles.RELEASE_AREA_STYLE), layer="own")
    assert (info["features"], info["geometry_type"]) == (0, "MultiPolygon")
    assert list(info["fields"]) == ["name", "n"]
    assert list(info["dtypes"]) == ["object", "int64"]


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    points = frame_of([Point(0, 0)], name=["a"])
    with pytest.raises(ValueError, match="no such column: nmae"):
        VectorLayer(
            "p",
            "P",
            "",
            points,
            {"nmae": styles.FieldInfo("Name")},
            style=styles.RELEASE_POINT_STYLE,
        )
    with pytest.raises(ValueError, match="needs the column name"):
        VectorLayer("a", "A", "", frame_of([box(0, 0, 1, 1)]), style=styles.RELEASE_AREA_STYLE)
    layer = VectorLayer("a", "A", "", points, style=styles.RELEASE_AREA_STYLE)
    with pytest.raises(ValueError, match="layer a: cannot draw Point"):
        write_geopackage(tmp_path / "a.gpkg", [layer])
    assert not (tmp_path / "a.gpkg").exists()
    good = VectorLayer("p", "P", "", points, style=styles.RELEASE_POINT_STYLE)
    with pytest.raises(ValueError, match="one name each"):
        write_geopackage(tmp_path / "a.gpkg", [good, good])
    write_geopackage(tmp_path / "a.gpkg", [good])
    with pytest.raises(OutputError, match="exists already"):
        write_geopackage(tmp_path / "a.gpkg", [good])
