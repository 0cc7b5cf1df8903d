"""What changes from one result to another: maps, zones and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd

from sassgis.hazard.result_change import (
    LEVEL,
    REACH,
    ChangeRow,
    ComparedMap,
    SettingChange,
    compared_maps,
    difference,
)
from sassgis.hazard.stored_result import StoredResult
from sassgis.hazard.zone_styles import LEVEL_CHANGES
from sassgis.hazard.zoning.generalise import Coverage
from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.layers.zones import change_table, changes, level_changes
from sassgis.model.grid import FloatArray
from sassgis.model.labels import rounded
from sassgis.model.results import Band, RasterClass, RasterLayer

_RAMP = "RdBu_r"
#: Limits of the legend: as much below as above zero.
_BREAKS = {
    "reach_probability": (-0.3, -0.1, -0.03, -0.01, 0.01, 0.03, 0.1, 0.3),
    "energy": (-300.0, -100.0, -30.0, -10.0, 10.0, 30.0, 100.0, 300.0),
    "passing_height": (-3.0, -1.0, -0.3, -0.1, 0.1, 0.3, 1.0, 3.0),
}
NOTHING = "Cells that no block reaches count as zero."


def change_layers(before: StoredResult, after: StoredResult) -> tuple[RasterLayer, ...]:
    """Maps of the change, each with bands of the value before and after.

    Parameters
    ----------
    before, after : StoredResult
        On the same cells.
    """
    return tuple(_change_layer(m, before, after) for m in compared_maps(before, after))


def _change_layer(compared: ComparedMap, before: StoredResult, after: StoredResult) -> RasterLayer:
    old, new = (r.band(compared.stem, compared.band) for r in (before, after))
    unit = compared.unit
    words = f"Change of the {compared.title[0].lower()}{compared.title[1:]}, after less before"
    width = f" Width {before.grid.cell_size:.4g} m (one cell)." if compared is REACH else ""
    return RasterLayer(
        f"{compared.stem}_change",
        words + (f" ({unit})" if unit != "1" else ""),
        NOTHING + width,
        (
            Band("change", words, unit, difference(old, new).astype(np.float32)),
            Band("before", f"{compared.title}, before", unit, old.astype(np.float32)),
            Band("after", f"{compared.title}, after", unit, new.astype(np.float32)),
        ),
        _BREAKS[compared.stem],
        _RAMP,
    )


def level_change_layer(before: StoredResult, after: StoredResult) -> RasterLayer:
    """Where the hazard level is higher or lower, with bands of the level before and after."""
    old, new = (r.band(LEVEL, "level") for r in (before, after))
    kinds = [RasterClass(i, *LEVEL_CHANGES[c]) for i, c in enumerate(LEVEL_CHANGES, start=1)]
    change: FloatArray = 2.0 + np.sign(difference(old, new))
    legend = "; ".join(f"{c.value} {c.label}" for c in after.maps[LEVEL].classes)
    return RasterLayer(
        "hazard_level_change",
        "Change of the hazard level",
        f"Cells, after compared with before. Levels: {legend}.",
        (
            Band("change", "Change of the hazard level", "class", change.astype(np.float32)),
            Band("before", "Hazard level, before", "class", old.astype(np.float32)),
            Band("after", "Hazard level, after", "class", new.astype(np.float32)),
        ),
        (),
        "",
        tuple(kinds),
    )


def zone_changes(
    before: StoredResult, after: StoredResult
) -> tuple[VectorLayer, pd.DataFrame] | None:
    """Pieces of the zones by what becomes of their level, and their areas; None without zones."""
    if before.zones is None or after.zones is None:
        return None
    both = changes(*(_one_class_each(r.zones) for r in (before, after) if r.zones is not None))
    labels = [c.label for c in sorted(after.maps[LEVEL].classes, key=lambda c: c.value)]
    layer = level_changes(
        both,
        _codes(before, after),
        after.grid.crs,
        "Change of the hazard zones",
        "Hazard level of the zones before and after.",
        ("level before", "level after"),
    )
    return layer, change_table(both, labels, "level_before")


def _one_class_each(zones: Coverage) -> Coverage:
    """Zones of a class as one: only borders between levels are to cut the other zones."""
    frame = gpd.GeoDataFrame({"k": zones.classes}, geometry=list(zones.polygons)).dissolve("k")
    return Coverage(frame.geometry.to_numpy(), frame.index.to_numpy(np.int64))


def _codes(before: StoredResult, after: StoredResult) -> list[str]:
    """Codes of the levels; the label of one that neither result has a zone of."""
    labels = [c.label for c in sorted(after.maps[LEVEL].classes, key=lambda c: c.value)]
    return [
        two if two != label else one
        for label, one, two in zip(labels, before.level_codes, after.level_codes, strict=True)
    ]


def change_rows_table(rows: Sequence[ChangeRow]) -> pd.DataFrame:
    """Every number before and after, a row each."""
    columns: dict[str, list[Any]] = {
        "part": [r.part for r in rows],
        "name": [r.name for r in rows],
        "quantity": [r.quantity for r in rows],
        "unit": [r.unit for r in rows],
        **{
            name: [rounded(getattr(r, name), 6) for r in rows]
            for name in ("before", "after", "change")
        },
    }
    return pd.DataFrame(columns)


def difference_table(differences: Sequence[SettingChange]) -> pd.DataFrame:
    """In what program, settings, inputs and libraries differ, a row each."""
    return pd.DataFrame(
        [(d.kind, d.name, d.before, d.after) for d in differences],
        columns=["kind", "name", "before", "after"],
    )
