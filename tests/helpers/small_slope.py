"""A slope of 40 degrees with everything a run needs, small enough to be spoilt in many ways."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import rasterio
import shapely
from rasterio.transform import from_origin

WEST, NORTH, CELL = 2_700_000.0, 1_150_000.0, 2.0
ROWS, COLS = 50, 70


def heights() -> np.ndarray:
    """A plane that falls to the east by 40 degrees, and runs out level in its last third."""
    fall = np.tan(np.radians(40.0)) * CELL * np.minimum(np.arange(COLS), 2 * COLS // 3)
    return np.broadcast_to(1500.0 - fall, (ROWS, COLS)).copy()


@dataclass
class Slope:
    """A configuration and its files."""

    folder: Path

    @classmethod
    def made(cls, folder: Path) -> Slope:
        """The files as they are before anything is spoilt."""
        own = cls(folder)
        own.write_config()
        own.write_dem(heights())
        own.write_release(release_box())
        return own

    @property
    def config(self) -> Path:
        return self.folder / "config.toml"

    def write_config(self, **changes: str) -> None:
        """``section__key = text of the value``, "" to leave a key out."""
        sections: dict[str, dict[str, str]] = {
            "terrain": {"dem": '"dem.tif"'},
            "release": {
                "file": '"release.gpkg"', "name_field": '"name"', "spacing_m": "5.0",
                "rocks_per_point": "4",
            },
            "ground": {"default": '"debris"'},
            "run": {"seed": "1", "jobs": "1"},
            "output": {},
        }  # fmt: skip
        block = {"name": '"b"', "axis_1_m": "0.5", "axis_2_m": "0.4", "axis_3_m": "0.3"}
        for dotted, value in changes.items():
            section, key = dotted.split("__")
            (block if section == "blocks" else sections.setdefault(section, {}))[key] = value
        lines = []
        for name, keys in [*((f"[{n}]", k) for n, k in sections.items()), ("[[blocks]]", block)]:
            lines += [name, *(f"{k} = {v}" for k, v in keys.items() if v != ""), ""]
        self.config.write_text("\n".join(lines))

    def write_dem(
        self,
        values: np.ndarray,
        *,
        crs: str | None = "EPSG:2056",
        transform: Any = None,
        unit: str | None = None,
    ) -> None:
        file = self.folder / "dem.tif"
        file.unlink(missing_ok=True)
        with rasterio.open(
            file, "w", driver="GTiff", count=1, dtype="float64", crs=crs,
            height=values.shape[0], width=values.shape[1],
            transform=transform or from_origin(WEST, NORTH, CELL, CELL),
        ) as raster:  # fmt: skip
            raster.write(values, 1)
            if unit is not None:
                raster.units = [unit]

    def write_release(self, *shapes: Any) -> None:
        names = [f"area {'abcdef'[i]}" for i in range(len(shapes))]
        frame = gpd.GeoDataFrame({"name": names}, geometry=list(shapes), crs="EPSG:2056")
        (self.folder / "release.gpkg").unlink(missing_ok=True)
        frame.to_file(self.folder / "release.gpkg", driver="GPKG")


def release_box(col: float = 3.0, row: float = 15.0, width: float = 5.0) -> shapely.Polygon:
    x, y = WEST + CELL * col, NORTH - CELL * row
    return shapely.box(x, y - CELL * width, x + CELL * width, y)


SASSGIS = [sys.executable, "-c", "from sassgis.cli import main; main()"]
