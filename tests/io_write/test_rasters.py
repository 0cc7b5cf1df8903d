"""Maps are Cloud-Optimised GeoTIFFs that say what they hold."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import made_up
import numpy as np
import pytest
import rasterio

from sassgis.core.errors import OutputError
from sassgis.core.grid import Grid
from sassgis.core.results import Band, RasterLayer
from sassgis.io.rasters import NODATA, write_raster


def layer_of(values: np.ndarray, unit: str = "kJ", **changes: object) -> RasterLayer:
    band = Band("a", "Some energy", unit, values.astype(np.float32))
    facts = {"breaks": (), "ramp": "viridis", "title": "A (kJ)", "note": "", **changes}
    return RasterLayer("a", bands=(band,), **facts)  # type: ignore[arg-type]


def flat(shape: tuple[int, int], crs: str = "") -> Grid:
    return Grid(np.zeros(shape), 100.0, 900.0, 5.0, crs, "LN02")


@pytest.fixture(scope="module")
def energy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RasterLayer]:
    dem = made_up.grid()
    layer = made_up.raster_layers(dem)["energy"]
    return write_raster(layer, dem, tmp_path_factory.mktemp("maps")), layer


def test_values_place_and_words_come_back(energy: tuple[Path, RasterLayer]) -> None:
    path, layer = energy
    with rasterio.open(path) as data:
        assert data.crs.to_epsg() == 2056
        assert data.bounds == (2_600_000.0, 1_199_200.0, 2_601_000.0, 1_200_000.0)
        assert data.dtypes == ("float32", "float32")
        assert data.nodata == NODATA
        assert data.units == ("kJ", "kJ")
        assert data.descriptions[1] == "Greatest energy (kJ)"
        assert data.tags(2)["NAME"] == "emax"
        tags = data.tags()
        assert tags["TITLE"] == layer.title
        assert "reference width 3 m" in tags["NOTE"]
        assert tags["VERTICAL_DATUM"] == "LN02"
        for number, band in enumerate(layer.bands, start=1):
            read = data.read(number, masked=True).filled(np.nan)
            np.testing.assert_array_equal(read, band.values)


def test_the_file_is_cloud_optimised(energy: tuple[Path, RasterLayer]) -> None:
    path, layer = energy
    with rasterio.open(path) as data:
        assert data.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert data.tags(ns="IMAGE_STRUCTURE")["COMPRESSION"] == "DEFLATE"
        assert data.overviews(1) == [2]
        assert data.block_shapes[0] == (256, 256)
        statistics = data.tags(1)
    known = layer.bands[0].values[np.isfinite(layer.bands[0].values)]
    assert float(statistics["STATISTICS_MAXIMUM"]) == pytest.approx(known.max())
    assert float(statistics["STATISTICS_MINIMUM"]) == pytest.approx(known.min())


@pytest.mark.parametrize("ramp", ["viridis", "hillshade"])
def test_overviews_invent_nothing(tmp_path: Path, ramp: str) -> None:
    values = np.full((700, 700), np.nan)
    values[:, 100:104] = 3.0
    values[:, 200] = 8.0
    path = write_raster(layer_of(values, ramp=ramp), flat((700, 700)), tmp_path)
    with rasterio.open(path, overview_level=1) as data:
        read = data.read(1, masked=True)
    assert set(np.unique(read.compressed())) == {3.0, 8.0}
    assert read.mask.mean() > 0.95
    # A line of one cell is not lost from afar.
    assert (~read.mask[:, 50]).all()


def test_a_map_of_nothing(tmp_path: Path) -> None:
    for breaks in ((), (30.0, 300.0)):
        layer = layer_of(np.full((20, 30), np.nan), breaks=breaks)
        with rasterio.open(write_raster(layer, flat((20, 30)), tmp_path)) as data:
            assert data.read(1, masked=True).mask.all()
            assert data.crs is None


def test_infinity_is_nodata(tmp_path: Path) -> None:
    values = np.array([[1.0, np.inf], [-np.inf, np.nan]])
    with rasterio.open(write_raster(layer_of(values), flat((2, 2)), tmp_path)) as data:
        assert data.read(1, masked=True).mask.tolist() == [[False, True], [True, True]]


def test_equal_input_gives_equal_bytes(tmp_path: Path) -> None:
    dem = made_up.grid()
    for layer in made_up.raster_layers(dem).values():
        first, second = (write_raster(layer, dem, tmp_path / name) for name in "ab")
        assert first.read_bytes() == second.read_bytes()
        assert first.with_suffix(".qml").read_bytes() == second.with_suffix(".qml").read_bytes()


def test_the_style_lies_beside(energy: tuple[Path, RasterLayer]) -> None:
    root = ET.fromstring(energy[0].with_suffix(".qml").read_text(encoding="utf-8"))
    labels = [item.get("label") for item in root.iter("item")]
    assert labels == ["< 30 kJ", "30 – 300 kJ", "≥ 300 kJ"]


def test_the_shape_must_fit(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\(3, 4\)"):
        write_raster(layer_of(np.zeros((3, 4))), flat((4, 3)), tmp_path)


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "maps").write_text("in the way")
    with pytest.raises(OutputError, match=r"a\.tif: cannot be written"):
        write_raster(layer_of(np.zeros((2, 2))), flat((2, 2)), tmp_path / "maps")
