"""One small batch, shared by all tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from helpers.cut_valley import CUTS, Stopped, Valley, areas_of, cut_tile
from rasterio.windows import Window

from sassgis.batches.batch import batch


@pytest.fixture(scope="session")
def valley(make_valley: Callable[..., Path]) -> Valley:
    config = make_valley(spacing_m=15.0)
    folder = config.parent
    tiles = folder / "tiles"
    tiles.mkdir()
    rows, cols = CUTS
    for i in range(2):
        for j in range(2):
            window = Window(cols[j], rows[i], cols[j + 1] - cols[j], rows[i + 1] - rows[i])
            cut_tile(folder / "dem.tif", tiles / f"tile_{i}{j}.tif", window)
    areas_of(folder / "release.gpkg").to_file(folder / "release.gpkg", driver="GPKG")
    return Valley(config, folder / "release.gpkg", tiles, folder / "dem.tif")


@pytest.fixture(scope="session")
def done(valley: Valley, tmp_path_factory: pytest.TempPathFactory) -> Stopped:
    out = tmp_path_factory.mktemp("batch") / "out"

    def stop(text: str) -> None:
        if text.startswith("Area 2"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch(valley.releases, out, dem=valley.tiles, jobs=2, say=stop)
    first = pd.read_csv(out / "summary.csv")
    # The others keep their sums only, which is quicker.
    rest = batch(valley.releases, out, dem=valley.tiles, jobs=2, mosaic_only=True)
    return Stopped(out, first, rest)
