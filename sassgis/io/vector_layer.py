"""A layer of points, lines or areas: its table, what the columns mean, how it is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import geopandas as gpd

from sassgis.model.styles import FieldInfo, VectorStyle

KEY_COLUMN = "fid"


@dataclass(frozen=True)
class VectorLayer:
    """A layer of points, lines or areas, with what its columns mean and how it is drawn.

    Attributes
    ----------
    name : str
        Of the table.
    title : str
        Name in the legend.
    description : str
    frame : GeoDataFrame
        May be empty; its columns are written all the same.
    fields : mapping of column to FieldInfo
    style : VectorStyle
        Its kind of symbol says which geometries the layer takes.
    """

    name: str
    title: str
    description: str
    frame: gpd.GeoDataFrame
    fields: Mapping[str, FieldInfo] = field(default_factory=dict)
    style: VectorStyle = field(kw_only=True)

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
