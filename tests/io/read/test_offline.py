"""No input file makes the program fetch something from a network."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pyogrio
import pytest
from rasterio.errors import RasterioIOError

from sassgis.io.read.dem import open_raster
from sassgis.io.read.offline import offline
from sassgis.io.read.vector_features import open_layer
from sassgis.model.errors import InputError

_VRT = """<VRTDataset rasterXSize="9" rasterYSize="9"><GeoTransform>0,1,0,0,0,-1</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename>{}</SourceFilename>
<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"""
_WMS = """<GDAL_WMS><Service name="TMS"><ServerUrl>{}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>100</UpperLeftY><LowerRightX>100</LowerRightX>
<LowerRightY>0</LowerRightY><TileLevel>1</TileLevel></DataWindow><Projection>EPSG:2056</Projection>
<BandsCount>1</BandsCount></GDAL_WMS>"""
_OGR = """<OGRVRTDataSource><OGRVRTLayer name="a"><SrcDataSource>{}</SrcDataSource></OGRVRTLayer>
</OGRVRTDataSource>"""
RASTERS = {
    "list of sources": lambda url: _VRT.format(f"/vsicurl/{url}/a.tif"),
    "list of addresses": lambda url: _VRT.format(f"{url}/a.tif"),
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
    with pytest.raises((InputError, RasterioIOError)), open_raster(file, "DEM") as dataset:
        dataset.read(1)
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
