"""No input file makes the program read another file of the machine, or fetch one from a network."""

from __future__ import annotations

import os
import shutil
import sqlite3
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import geopandas as gpd
import numpy as np
import pyogrio
import pytest
import rasterio
import rasterio.shutil
import shapely
from helpers.one_line import one_line
from rasterio.transform import from_origin

from sassgis.errors import InputError
from sassgis.files.gdal_safety import offline, read_frame, vector_file
from sassgis.grid import Grid
from sassgis.inputs.dem import open_raster, read_dem
from sassgis.inputs.ground_map import read_forest
from sassgis.inputs.vector_features import open_layer
from sassgis.settings.blocks import ForestPlace

_WMS = """<GDAL_WMS><Service name="TMS"><ServerUrl>{}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>100</UpperLeftY><LowerRightX>100</LowerRightX>
<LowerRightY>0</LowerRightY><TileLevel>1</TileLevel></DataWindow><Projection>EPSG:2056</Projection>
<BandsCount>1</BandsCount></GDAL_WMS>"""
_OGR = (
    "<OGRVRTDataSource><OGRVRTLayer name='secret'><SrcDataSource>{}</SrcDataSource></OGRVRTLayer>"
    "</OGRVRTDataSource>"
)
RASTERS = {
    "list of sources": lambda url: mosaic(f"/vsicurl/{url}/a.tif", relative=0),
    "list of addresses": lambda url: mosaic(f"{url}/a.tif", relative=0),
    "tile server": _WMS.format,
}
VECTORS = {
    "list of sources": lambda url: _OGR.format(f"/vsicurl/{url}/a.geojson"),
    "list of addresses": lambda url: _OGR.format(f"{url}/a.geojson"),
    "feature server": lambda url: f"<OGRWFSDataSource><URL>{url}/wfs</URL></OGRWFSDataSource>",
}


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, list[str]]]:
    """Address of a server that has nothing, and what it was asked for."""
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
    paths: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            paths.append(self.path)
            self.send_error(404)

        do_HEAD = do_POST = do_GET

        def log_message(self, *_arguments: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}", paths
        server.shutdown()


@pytest.mark.parametrize("kind", RASTERS)
def test_no_raster_is_fetched(tmp_path: Path, asked: tuple[str, list[str]], kind: str) -> None:
    url, paths = asked
    file = tmp_path / "dem.tif"
    file.write_text(RASTERS[kind](url))
    with pytest.raises(InputError, match=r"dem\.tif"), open_raster(file, "DEM"):
        pass
    assert paths == []


@pytest.mark.parametrize("kind", VECTORS)
def test_no_layer_is_fetched(tmp_path: Path, asked: tuple[str, list[str]], kind: str) -> None:
    url, paths = asked
    file = tmp_path / "release.gpkg"
    file.write_text(VECTORS[kind](url))
    with pytest.raises(InputError, match=r"release\.gpkg") as refused:
        open_layer(file, None, "release", {})
    assert "\n" not in str(refused.value) and paths == []


def test_the_settings_of_gdal_are_left_as_they_were() -> None:
    before = pyogrio.get_gdal_config_option("GDAL_HTTP_PROXY")
    with offline():
        assert pyogrio.get_gdal_config_option("GDAL_HTTP_PROXY") == "none://offline"
    assert pyogrio.get_gdal_config_option("GDAL_HTTP_PROXY") == before


# ---------------------------------------------------------------------------------------------
# Other files of the machine

HEIGHTS = 1000.0 + np.arange(12.0).reshape(3, 4)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder that somebody sent, beside a file that is none of their business."""
    (tmp_path / "secret").write_bytes(bytes(range(9)) * 9)
    folder = tmp_path / "site"
    folder.mkdir()
    write(folder / "tile.tif", "GTiff")
    return folder


def write(file: Path, driver: str) -> None:
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", count=1, dtype="float32", width=4, height=3, crs="EPSG:2056",
            transform=from_origin(2_700_000.0, 1_150_000.0, 10.0, 10.0),
        ) as raster:  # fmt: skip
            raster.write(HEIGHTS, 1)
        with memory.open() as raster:
            rasterio.shutil.copy(raster, file, driver=driver)


def mosaic(source: str, *, relative: int = 1, size: int = 9, attributes: str = "") -> str:
    """A virtual raster over the first cells of another raster."""
    return (
        f'<VRTDataset rasterXSize="{size}" rasterYSize="{size}" {attributes}>'
        "<GeoTransform>2700000, 10, 0, 1150000, 0, -10</GeoTransform>"
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        f'<SourceFilename relativeToVRT="{relative}">{source}</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )


def raw(kind: str = 'subClass="VRTRawRasterBand"', more: str = "") -> str:
    """A virtual raster whose band is the bytes of a file."""
    return (
        '<VRTDataset rasterXSize="9" rasterYSize="9">'
        "<GeoTransform>2700000, 10, 0, 1150000, 0, -10</GeoTransform>"
        f'<VRTRasterBand dataType="Byte" band="1" {kind}>'
        f'<SourceFilename relativeToVRT="1">../secret</SourceFilename>{more}'
        "</VRTRasterBand></VRTDataset>"
    )


_PIXELS = (
    "<PixelFunctionType>f</PixelFunctionType><PixelFunctionLanguage>Python</PixelFunctionLanguage>"
    "<PixelFunctionCode>def f(*a, **k): open('run', 'w')</PixelFunctionCode>"
)
_WARP = "<GDALWarpOptions><SourceDataset>../secret</SourceDataset></GDALWarpOptions></VRTDataset>"
#: What a raster may say that leads elsewhere, and what of it the message names.
ASTRAY = {
    "raw band": (raw(), "VRTRawRasterBand"),
    "raw band in small letters": (raw('subclass="vrtrawrasterband"'), "vrtrawrasterband"),
    "band below the declaration": (
        '<?xml version="1.0" encoding="UTF-8"?>\n' + raw(), "VRTRawRasterBand"
    ),
    "raw mask": (
        mosaic("tile.tif").replace(
            "</VRTDataset>",
            "<MaskBand><VRTRasterBand dataType='Byte' subClass='VRTRawRasterBand'>"
            "<SourceFilename>../secret</SourceFilename></VRTRasterBand></MaskBand></VRTDataset>",
        ),
        "VRTRawRasterBand",
    ),
    "computed band": (raw('subClass="VRTDerivedRasterBand"', _PIXELS), "Pixel|Derived"),
    "warped": (
        mosaic("tile.tif", attributes='subClass="VRTWarpedDataset"').replace(
            "</VRTDataset>", _WARP
        ),
        "VRTWarpedDataset",
    ),
    "processed": (
        mosaic("tile.tif", attributes='subClass="VRTProcessedDataset"'), "VRTProcessedDataset"
    ),
    "element unknown here": (
        mosaic("tile.tif").replace("SimpleSource", "ArraySource"), "ArraySource"
    ),
    "virtual raster in another": (mosaic("inner.tif"), "inner.tif"),
    "virtual raster as a name": (
        mosaic(raw().replace("<", "&lt;").replace('"', "&quot;")), "cannot be opened|not found"
    ),
    "virtual raster as an address": (mosaic("vrt://inner.tif", relative=0), "not found"),
    "raster in an archive": (mosaic("/vsizip/a.zip/inner.tif", relative=0), "not found"),
    "text as a tile": (mosaic("../secret"), "secret"),
    "pipe as a tile": (mosaic("pipe.tif"), "pipe"),
    "entities": (
        '<!DOCTYPE a [<!ENTITY b SYSTEM "../secret">]>' + mosaic("tile.tif"), "DOCTYPE|format"
    ),
    "broken": (mosaic("tile.tif")[:-4], "XML"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ASTRAY)
@pytest.mark.parametrize("name", ["dem.tif", "dem.vrt"])
def test_a_virtual_raster_leads_nowhere(site: Path, kind: str, name: str) -> None:
    text, word = ASTRAY[kind]
    (site / "inner.tif").write_text(raw())
    with zipfile.ZipFile(site / "a.zip", "w") as packed:
        packed.writestr("inner.tif", raw())
    os.mkfifo(site / "pipe.tif")
    (site / name).write_text(text)
    with one_line(InputError, name, match=word):
        read_dem(site / name, crs="EPSG:2056")
    assert not list(site.parent.rglob("run"))


@pytest.mark.parametrize("key", ["OVERVIEW_FILE", "OVERVIEW&#95;FILE"])
@pytest.mark.parametrize(
    "beside",
    [
        "dem.tif.msk",
        "dem.tif.MSK",
        "dem.tif.ovr",
        "dem.tif.OVR",
        "dem.tif.msk.ovr",
        "dem.tif.aux.xml",
    ],
)
@pytest.mark.parametrize("below", ["", "a mosaic of it"])
def test_what_lies_beside_a_raster_leads_nowhere(
    site: Path, beside: str, below: str, key: str
) -> None:
    write(site / "dem.tif", "GTiff")
    (site / "raw.vrt").write_text(raw())
    (site / "all.vrt").write_text(mosaic("dem.tif", size=4))
    text = raw()
    if beside.endswith(".xml"):
        text = (
            f'<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="{key}">raw.vrt</MDI>'
            "</Metadata></PAMDataset>"
        )
    file = site / ("all.vrt" if below else "dem.tif")
    assert np.array_equal(read_dem(file, crs="EPSG:2056").values[:3, :4], HEIGHTS)
    if ".msk." in beside:
        write(site / "dem.tif.msk", "GTiff")
    (site / beside).write_text(text)
    file.touch()
    with one_line(InputError, beside):
        read_dem(file, crs="EPSG:2056")


def test_a_link_is_no_raw_raster(site: Path) -> None:
    """The header that says how to read the bytes came with the link."""
    write(site / "dem.bil", "EHdr")
    assert np.array_equal(read_dem(site / "dem.bil", crs="EPSG:2056").values, HEIGHTS)
    (site / "dem.bil").unlink()
    (site / "dem.bil").symlink_to(site.parent / "secret")
    with pytest.raises(InputError, match="cannot be read as a raster"):
        read_dem(site / "dem.bil", crs="EPSG:2056")


@pytest.mark.parametrize("place", ["tile.tif", "../beside/tile.tif", "absolute"])
def test_mosaics_of_tiles_are_read(site: Path, place: str) -> None:
    """From folders beside it too: whoever names a GeoTIFF could have named it as the raster."""
    (site.parent / "beside").mkdir()
    shutil.copy(site / "tile.tif", site.parent / "beside" / "tile.tif")
    text = mosaic(place)
    if place == "absolute":
        text = mosaic(str(site / "tile.tif"), relative=0)
    (site / "dem.vrt").write_text(text)
    values = read_dem(site / "dem.vrt", crs="EPSG:2056").values
    assert np.array_equal(values[:3, :4], HEIGHTS)


@pytest.mark.parametrize(
    ("name", "driver"),
    [("a.tif", "GTiff"), ("a.tif", "COG"), ("a.asc", "AAIGrid"), ("a.xyz", "XYZ"),
     ("a.img", "HFA"), ("a.bil", "EHdr"), ("a.flt", "EHdr"), ("a.vrt", "VRT")],
)  # fmt: skip
def test_formats_of_rasters(site: Path, name: str, driver: str) -> None:
    if driver == "VRT":
        rasterio.shutil.copy(site / "tile.tif", site / name, driver=driver)
    else:
        write(site / name, driver)
    assert np.array_equal(read_dem(site / name, crs="EPSG:2056").values, HEIGHTS)


def test_other_formats_of_rasters_are_refused(site: Path) -> None:
    write(site / "a.bt", "BT")
    with one_line(InputError, "a.bt", "expected GeoTIFF", "cannot be read as a raster"):
        read_dem(site / "a.bt", crs="EPSG:2056")


def test_a_forest_is_read_in_the_same_way(site: Path) -> None:
    grid = Grid(np.zeros((3, 4)), 2_700_000.0, 1_150_000.0, 10.0, "", "")
    for name, text in (("good.vrt", mosaic("tile.tif")), ("bad.vrt", raw())):
        (site / name).write_text(text)
    stems, _ = read_forest(ForestPlace(stems_raster=site / "good.vrt", dbh_cm=30.0), grid)
    assert stems == pytest.approx(HEIGHTS.ravel() / 1e4)
    with pytest.raises(InputError, match=r"bad\.vrt"):
        read_forest(ForestPlace(stems_raster=site / "bad.vrt", dbh_cm=30.0), grid)


# ---------------------------------------------------------------------------------------------
# Vector files

_POINT = (
    '{"type": "Feature", "properties": {"a": "%s"},'
    '"geometry": {"type": "Point", "coordinates": [1, 2]}}'
)
_KML = "<kml xmlns='http://www.opengis.net/kml/2.2'>{}</kml>"
VECTORS_ASTRAY: dict[str, Callable[[Path], str]] = {
    "list of sources": _OGR.format,
    "list of sources in GeoJSON": lambda f: _POINT % _OGR.format(f),
    "list of sources in KML": lambda f: _KML.format("") + _OGR.format(f),
    "commands": lambda f: (
        f'{{"type": "gdal_streamed_alg", "command_line": "gdal vector pipeline ! read {f}"}}'
    ),
    "commands in GeoJSON": lambda f: (
        '{"type": "FeatureCollection", "features": [], "type": "gdal_streamed_alg",'
        f'"command_line": "gdal vector pipeline ! read {f}"}}'
    ),
    "entities": lambda f: (
        f"<!DOCTYPE kml [<!ENTITY a SYSTEM '{f}'>]>" + _KML.format("<name>&a;</name>")
    ),
    "nested": lambda f: '{"type": "FeatureCollection", "features": ' + "[" * 100_000,
    "no format": str,
}


@pytest.mark.parametrize("kind", VECTORS_ASTRAY)
@pytest.mark.parametrize("name", ["release.geojson", "release.gpkg", "release.kml", "release.json"])
def test_no_vector_file_leads_elsewhere(site: Path, kind: str, name: str) -> None:
    secret = site.parent / "secret.geojson"
    secret.write_text(_POINT % "secret")
    (site / name).write_text(VECTORS_ASTRAY[kind](secret))
    with one_line(
        InputError, name, "release.file", "cannot be read as a vector file", "GeoPackage"
    ):
        open_layer(site / name, None, "release", {})


@pytest.mark.parametrize(
    ("name", "driver"),
    [("a.gpkg", "GPKG"), ("a.shp", "ESRI Shapefile"), ("a.geojson", "GeoJSON"),
     ("a.fgb", "FlatGeobuf"), ("a.kml", "LIBKML"), ("a.kml", "KML"), ("a.gdb", "OpenFileGDB")],
)  # fmt: skip
def test_formats_of_vector_files(tmp_path: Path, name: str, driver: str) -> None:
    frame = gpd.GeoDataFrame(
        {"name": ["<b>area</b>"]}, geometry=[shapely.box(8, 46, 9, 47)], crs=4326
    )
    frame.to_file(tmp_path / name, driver=driver)
    found = open_layer(tmp_path / name, None, "release", {})
    assert found.geometry.iloc[0].equals(shapely.box(8, 46, 9, 47))
    assert "<b>area</b>" in found.iloc[0].tolist()


@pytest.mark.parametrize(
    ("name", "driver"),
    [("a.gml", "GML"), ("a.sqlite", "SQLite"), ("a.gpx", "GPX"), ("a.jml", "JML")],
)
def test_other_formats_of_vector_files_are_refused(tmp_path: Path, name: str, driver: str) -> None:
    frame = gpd.GeoDataFrame({"name": ["a"]}, geometry=[shapely.Point(8, 46)], crs=4326)
    pyogrio.write_dataframe(frame, tmp_path / name, driver=driver)
    with one_line(InputError, name, "release.file", "cannot be read as a vector file"):
        open_layer(tmp_path / name, None, "release", {})


_ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT "
_VIEW = f"CREATE VIEW a AS {_ENDLESS} fid, geom FROM base WHERE (SELECT count(*) FROM n)"
_RENAMED = ("PRAGMA legacy_alter_table = on", "ALTER TABLE a RENAME TO base")
COMPUTED = {
    "the layer": (*_RENAMED, _VIEW),
    "a view beside it": (f"CREATE VIEW other AS {_ENDLESS} x FROM n",),
    "a table of GDAL": (
        "DROP TABLE gpkg_extensions", f"CREATE VIEW gpkg_extensions AS {_ENDLESS} x FROM n",
    ),
    "an index of words": (
        *_RENAMED, "CREATE VIRTUAL TABLE a USING fts5(name, content='base', content_rowid='fid')",
    ),
    "a view that is written in another way": (
        *_RENAMED, _VIEW, "PRAGMA writable_schema = on",
        "UPDATE sqlite_master SET sql = 'CREATE/**/' || substr(sql, 7) "
        "WHERE name = 'a'",
    ),
}  # fmt: skip


@contextmanager
def open_in_a_gis(file: Path, *changes: str) -> Iterator[Path]:
    """A GeoPackage with the layer ``a``; changes of it lie in a log beside it within the block."""
    frame = gpd.GeoDataFrame({"name": ["a"]}, geometry=[shapely.box(0, 0, 1, 1)], crs=2056)
    frame.to_file(file, driver="GPKG", layer="a")
    with closing(sqlite3.connect(file, isolation_level=None)) as database:
        find = "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        for (name,) in database.execute(find).fetchall():
            database.execute(f'DROP TRIGGER "{name}"')
        database.execute("PRAGMA journal_mode = wal")
        for statement in changes:
            database.execute(statement)
        yield file


@pytest.mark.parametrize("kind", COMPUTED)
def test_nothing_is_computed_by_a_file(tmp_path: Path, kind: str) -> None:
    """A view may never end, and GDAL asks all of them, also those that lie in a log."""
    with (
        open_in_a_gis(tmp_path / "a.gpkg", *COMPUTED[kind]) as file,
        one_line(InputError, "a.gpkg", "release.file", "holds a view or a virtual table"),
    ):
        open_layer(file, None, "release", {})


def test_plain_tables_are_read_whatever_their_names(tmp_path: Path) -> None:
    frame = gpd.GeoDataFrame({"name": ["a"]}, geometry=[shapely.box(0, 0, 1, 1)], crs=2056)
    for name in ('view "of" all', "CREATE VIEW", "Rüfe"):
        frame.to_file(tmp_path / "a.gpkg", driver="GPKG", layer=name)
        assert len(open_layer(tmp_path / "a.gpkg", name, "release", {})) == 1


def test_pipes_and_devices_are_not_opened(tmp_path: Path) -> None:
    """Reading them might never end."""
    os.mkfifo(tmp_path / "pipe")
    for file in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match="is no file"):
            read_dem(file)
        with pytest.raises(InputError, match="is no file"):
            open_layer(file, None, "release", {})


@pytest.mark.parametrize(
    ("encoding", "stated", "expected"),
    [
        ("UTF-8", "UTF-8", ""),
        ("UTF-8", None, ""),
        ("ISO-8859-1", None, ""),
        ("ISO-8859-1", "ISO-8859-1", ""),
        ("CP850", "CP850", ""),
        ("UTF-8", "ISO-8859-1", "UTF-8"),
        ("UTF-8", "CP1252", "UTF-8"),
        ("ISO-8859-1", "UTF-8", "ISO-8859-1"),
        ("ISO-8859-1", "KLINGON", "ISO-8859-1"),
    ],
)
def test_texts_of_a_shapefile(
    tmp_path: Path, encoding: str, stated: str | None, expected: str
) -> None:
    """What is not stated is seen; what is stated wrongly is refused, with the file that does so."""
    file, beside = tmp_path / "areas.shp", tmp_path / "areas.cpg"
    frame = gpd.GeoDataFrame(
        {"H\u00f6he": ["R\u00f6tiflue"]}, geometry=[shapely.box(0, 0, 1, 1)], crs=2056
    )
    frame.to_file(file, encoding=encoding)
    beside.unlink() if stated is None else beside.write_text(stated)

    def read() -> gpd.GeoDataFrame:
        with vector_file(file, "release.file"):
            return read_frame(file, "areas")

    if expected:
        with pytest.raises(InputError) as caught:
            read()
        assert str(caught.value).startswith(f"{beside}: states another encoding")
        assert caught.value.found == repr(stated) and expected in caught.value.expected
    else:
        assert read()["H\u00f6he"].tolist() == ["R\u00f6tiflue"]
