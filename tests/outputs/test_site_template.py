"""The empty GeoPackage of a site."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pyogrio
import pytest

from sassgis.errors import InputError, OutputError
from sassgis.files.atomic_output import WRITTEN_NAME
from sassgis.inputs.site_layers import site_layers
from sassgis.outputs.site_template import site_template


def test_empty_layers_with_their_system_and_domains(tmp_path: Path) -> None:
    file = tmp_path / "new" / "site.gpkg"
    assert site_template(file, crs="EPSG:2056") == file.with_suffix(".qgz")
    assert sorted(p.name for p in file.parent.iterdir()) == [WRITTEN_NAME, "site.gpkg", "site.qgz"]
    for own in site_layers():
        info = pyogrio.read_info(file, layer=own.name)
        assert info["features"] == 0 and info["crs"] == "EPSG:2056"
        assert list(info["fields"]) == list(own.fields)
    with closing(sqlite3.connect(file)) as database:
        rows = database.execute(
            "SELECT c.table_name, c.column_name, k.constraint_type, k.value, k.min, k.max "
            "FROM gpkg_data_columns c JOIN gpkg_data_column_constraints k USING (constraint_name)"
        ).fetchall()
    assert ("barriers", "kind", "enum", "wall", None, None) in rows
    assert ("forest", "dbh_cm", "range", None, 0, 300) in rows
    assert ("buildings", "presence", "range", None, 0, 1) in rows


def test_nothing_is_replaced_and_nothing_half_written(tmp_path: Path) -> None:
    file = tmp_path / "site.gpkg"
    file.with_suffix(".qgz").write_text("mine")
    with pytest.raises(OutputError, match=r"site\.qgz: exists already"):
        site_template(file, crs="EPSG:2056")
    assert [p.name for p in tmp_path.iterdir()] == ["site.qgz"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, ["--crs", "no coordinate system"]),
        ({"crs": "EPSG:4326"}, ["--crs", "WGS 84", "projected"]),
        ({"crs": "nonsense"}, ["--crs", "'nonsense'"]),
        ({"dem": Path("nowhere.tif")}, ["nowhere.tif", "not found"]),
    ],
)
def test_a_system_in_metres_is_needed(tmp_path: Path, options, words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        site_template(tmp_path / "site.gpkg", **options)
    assert all(word in str(error.value) for word in words), str(error.value)
    assert not list(tmp_path.iterdir())
