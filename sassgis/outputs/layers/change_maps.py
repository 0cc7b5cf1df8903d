"""Changes from one result to another: maps, zones and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd

from sassgis.files.vector_layer import VectorLayer
from sassgis.hazard.zone_styles import LEVEL_CHANGES
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.outputs.frames import same, table_of
from sassgis.outputs.layers.maps import described_band, described_raster
from sassgis.outputs.layers.zones import change_table, changes, level_changes
from sassgis.settings.results import RasterClass, RasterLayer
from sassgis.studies import result_change
from sassgis.studies.stored_result import StoredResult

#: Limits of the legend: as much below as above zero.
_BREAKS = {
    "reach_probability": (-0.3, -0.1, -0.03, -0.01, 0.01, 0.03, 0.1, 0.3),
    "energy": (-300.0, -100.0, -30.0, -10.0, 10.0, 30.0, 100.0, 300.0),
    "passing_height": (-3.0, -1.0, -0.3, -0.1, 0.1, 0.3, 1.0, 3.0),
}


def change_layers(before: StoredResult, after: StoredResult) -> tuple[RasterLayer, ...]:
    """Map the change on the same cells, each map with bands of the value before and after."""
    layers = []
    for stem, band, title, unit in result_change.compared_maps(before, after):
        old, new = (r.band(stem, band) for r in (before, after))
        values = {"change": result_change.difference(old, new), "before": old, "after": new}
        width = (
            f" Width {before.grid.cell_size:.4g} m (one cell)."
            if stem == result_change.REACH.stem
            else ""
        )
        words: dict[str, Any] = {
            "title": title,
            "what": f"{title[0].lower()}{title[1:]}",
            "unit": unit,
            "in_unit": f" ({unit})" if unit != "1" else "",
            "width": width,
        }
        bands = [described_band("change", name, own, **words) for name, own in values.items()]
        look = (_BREAKS[stem], "RdBu_r")
        layers.append(described_raster("change", bands, *look, stem=f"{stem}_change", **words))
    return tuple(layers)


def level_change_layer(before: StoredResult, after: StoredResult) -> RasterLayer:
    """Map where the hazard level is higher or lower, with bands of the level before and after."""
    key = "hazard_level_change"
    old, new = (r.band(*result_change.LEVEL[:2]) for r in (before, after))
    values = {
        "change": 2.0 + np.sign(result_change.difference(old, new)),
        "before": old,
        "after": new,
    }
    bands = [described_band(key, name, own) for name, own in values.items()]
    kinds = [RasterClass(i, *LEVEL_CHANGES[c]) for i, c in enumerate(LEVEL_CHANGES, start=1)]
    levels = "; ".join(f"{c.value} {c.label}" for c in after.maps[result_change.LEVEL.stem].classes)
    return described_raster(key, bands, classes=kinds, levels=levels)


def zone_changes(
    before: StoredResult, after: StoredResult
) -> tuple[VectorLayer, pd.DataFrame] | None:
    """Return parts of the zones by change of level, and their areas; None without zones."""
    if before.zones is None or after.zones is None:
        return None
    both = changes(_one_class_each(before.zones), _one_class_each(after.zones))
    labels = [
        c.label for c in sorted(after.maps[result_change.LEVEL.stem].classes, key=lambda c: c.value)
    ]
    # Of the level that neither result has a zone of, the label.
    codes = [
        two if two != label else one
        for label, one, two in zip(labels, before.level_codes, after.level_codes, strict=True)
    ]
    layer = level_changes(both, codes, after.grid.crs, "level_changes.compared")
    return layer, change_table(both, labels, "level_before")


def _one_class_each(zones: Coverage) -> Coverage:
    """Return zones of a class as one: only borders between levels are to cut the other zones."""
    frame = gpd.GeoDataFrame({"k": zones.classes}, geometry=list(zones.polygons)).dissolve("k")
    return Coverage(frame.geometry.to_numpy(), frame.index.to_numpy(np.int64))


def change_rows_table(rows: Sequence[result_change.ChangeRow]) -> pd.DataFrame:
    """Return every number before and after, a row each."""
    columns = same("part", "name", "quantity", "unit", "before", "after", "change")
    return table_of(rows, columns, dict.fromkeys(("before", "after", "change"), 6))


def difference_table(differences: Sequence[result_change.SettingChange]) -> pd.DataFrame:
    """List in what program, settings, inputs and libraries differ, a row each."""
    return table_of(differences, same("kind", "name", "before", "after"), {})
