"""The sample valley in tiles, as files of its own, and as a VRT."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import pandas as pd
import rasterio
import shapely
from rasterio.windows import Window

from sassgis.batches.batch import BatchResult

GOOD = ("Mitte", "Mitte bis", "Nord")
CUTS = ((0, 220, 450), (0, 310, 600))


@dataclass(frozen=True)
class Valley:
    """Inputs of a batch."""

    config: Path
    releases: Path
    tiles: Path
    dem: Path


def cut_tile(dem: Path, tile: Path, window: Window) -> None:
    with rasterio.open(dem) as whole:
        profile = {
            "driver": "GTiff", "dtype": whole.dtypes[0], "count": 1, "crs": whole.crs,
            "nodata": whole.nodata, "width": window.width, "height": window.height,
            "transform": whole.window_transform(window),
        }  # fmt: skip
        with rasterio.open(tile, "w", **profile) as out:
            out.write(whole.read(1, window=window), 1)


def areas_of(file: Path) -> gpd.GeoDataFrame:
    """Mitte, the same a little aside, Nord, and one that crosses itself."""
    frame = gpd.read_file(file)
    own = {name: frame[frame["name"] == name].copy() for name in frame["name"]}
    bis = own["Mitte"].copy()
    bis["name"] = "Mitte bis"
    bis.geometry = bis.geometry.translate(0.0, 12.0)
    crossed = own["Nord"].copy()
    x, y = crossed.geometry.iloc[0].centroid.coords[0]
    bow = [(x, y), (x + 20, y + 20), (x + 20, y), (x, y + 20)]
    crossed["name"] = "crossed"
    crossed.geometry = [shapely.Polygon(bow)]
    return pd.concat([own["Nord"], crossed, bis, own["Mitte"]])


@dataclass(frozen=True)
class Stopped:
    """A batch that was stopped when its second area began, and then finished."""

    folder: Path
    first: pd.DataFrame
    result: BatchResult


def write_vrt(tiles: Path, dem: Path, vrt: Path) -> None:
    """A virtual raster over the four tiles."""
    with rasterio.open(dem) as whole:
        g = whole.transform
        text = f'<VRTDataset rasterXSize="{whole.width}" rasterYSize="{whole.height}">'
        text += f"<SRS>{whole.crs.to_string()}</SRS>"
        text += f"<GeoTransform>{g.c}, {g.a}, 0, {g.f}, 0, {g.e}</GeoTransform>"
        text += f'<VRTRasterBand dataType="Float32" band="1"><NoDataValue>{whole.nodata}'
        text += "</NoDataValue>"
    rows, cols = CUTS
    for i in range(2):
        for j in range(2):
            w, h = cols[j + 1] - cols[j], rows[i + 1] - rows[i]
            text += f"<SimpleSource><SourceFilename>{tiles / f'tile_{i}{j}.tif'}</SourceFilename>"
            text += f'<SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="{w}" '
            text += f'ySize="{h}"/><DstRect xOff="{cols[j]}" yOff="{rows[i]}" xSize="{w}" '
            text += f'ySize="{h}"/></SimpleSource>'
    vrt.write_text(text + "</VRTRasterBand></VRTDataset>")
