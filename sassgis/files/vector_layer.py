"""A layer of points, lines or areas: its table, what the columns mean, how it is drawn.

Layers and maps in the language in which the program writes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import geopandas as gpd
import pandas as pd

from sassgis.settings.languages import current_language, phrase, with_translated
from sassgis.settings.results import RasterLayer
from sassgis.settings.statistics_table import built_in_rows
from sassgis.settings.styles import FieldInfo, VectorStyle

KEY_COLUMN = "fid"


@dataclass(frozen=True)
class VectorLayer:
    """A layer of points, lines or areas, with what its columns mean and how it is drawn."""

    name: str  # of the table
    title: str  # in the legend
    description: str
    frame: gpd.GeoDataFrame  # may be empty; its columns are written all the same
    fields: Mapping[str, FieldInfo] = field(default_factory=dict)
    style: VectorStyle = field(kw_only=True)  # its symbol says which geometries the layer takes

    def __post_init__(self) -> None:
        columns = set(self.columns)
        if unknown := sorted(set(self.fields) - columns):
            raise ValueError(f"layer {self.name}: no such column: {', '.join(unknown)}")
        for used in (self.style.column, self.style.label_column):
            if used and used not in columns:
                raise ValueError(f"layer {self.name}: the style needs the column {used}")

    @property
    def columns(self) -> list[str]:
        """Columns of the table but the geometry; the key ``fid`` first."""
        own = [str(name) for name in self.frame.columns if name != self.frame.geometry.name]
        return [KEY_COLUMN, *own]


@cache
def descriptions() -> dict[str, dict[str, dict[str, str]]]:
    """Return rows of ``data/map_layers.csv`` by layer and column; "" is the layer's own row."""
    layers: dict[str, dict[str, dict[str, str]]] = {}
    for row in built_in_rows("map_layers"):
        for key in row["layer"].split():
            if layers.setdefault(key, {}).setdefault(row["column"], row) is not row:
                raise ValueError(f"map_layers.csv: {key}.{row['column']} is described twice")
    return layers


def described_layer(
    key: str,
    columns: Mapping[str, Any] | pd.DataFrame,
    geometry: Any,
    crs: str,
    style: VectorStyle,
    *,
    fields: Mapping[str, FieldInfo] | None = None,
    **words: object,
) -> VectorLayer:
    """Return a layer whose title, description and columns are those of ``data/map_layers.csv``.

    Its key there is its name, with a suffix after a point where several kinds of layers have it.
    ``crs`` is well-known text, empty for local coordinates; ``fields`` describes columns that only
    the result knows; ``words`` take the places of ``{...}`` in the table.
    """
    frame = gpd.GeoDataFrame(columns, geometry=geometry, crs=crs or None)
    own = descriptions()[key]

    def text(column: str, part: str) -> str:
        return phrase(own[column][part], **words)

    known = {
        name: FieldInfo(text(name, "alias"), text(name, "unit"), text(name, "description"))
        for name in own
        if name in frame
    } | dict(fields or {})
    if missing := set(frame.columns) - {*known, "geometry"}:
        raise ValueError(f"map_layers.csv: {key}: no description of {', '.join(sorted(missing))}")
    name = key.partition(".")[0]
    return VectorLayer(name, text("", "alias"), text("", "description"), frame, known, style=style)


def translated_raster(layer: RasterLayer) -> RasterLayer:
    """Return a map with its title, note, classes and bands."""
    if current_language() == "en":
        return layer
    return replace(
        with_translated(layer, "title", "note"),
        bands=tuple(with_translated(band, "description", "unit") for band in layer.bands),
        classes=tuple(with_translated(entry, "label") for entry in layer.classes),
    )


def translated_vector(layer: VectorLayer) -> VectorLayer:
    """Return a layer with its title, description, legend and columns; their values are codes."""
    if current_language() == "en":
        return layer
    classes = tuple(with_translated(entry, "label") for entry in layer.style.classes)
    fields = {
        name: with_translated(info, "alias", "unit", "description")
        for name, info in layer.fields.items()
    }
    style = replace(layer.style, classes=classes)
    return replace(with_translated(layer, "title", "description"), style=style, fields=fields)
