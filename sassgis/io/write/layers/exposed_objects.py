"""Exposed objects as layers of their own: what is there, without what it risks."""

from __future__ import annotations

import geopandas as gpd
import shapely

from sassgis.io.vector_layer import VectorLayer
from sassgis.model.exposure import PlacedObjects
from sassgis.model.styles import FieldInfo, Symbol, VectorStyle

_COLOUR = "#5a4632"
_LAYERS = (
    ("exposed_areas", "Buildings and people",
     Symbol("fill", _COLOUR, outline="#ffffff", outline_mm=0.15)),
    ("exposed_lines", "Roads and lines", Symbol("line", _COLOUR, size_mm=0.8)),
    ("exposed_points", "People at points",
     Symbol("marker", _COLOUR, size_mm=2.4, outline="#ffffff", shape="diamond")),
)  # fmt: skip
_DIMENSION = {"fill": 2, "line": 1, "marker": 0}


def exposed_layers(placed: PlacedObjects, crs: str) -> list[VectorLayer]:
    """Layers of areas, lines and points, those that have objects; stretches of a road as one.

    Parameters
    ----------
    placed : PlacedObjects
    crs : str
        Well-known text; empty for local coordinates.
    """
    frame = gpd.GeoDataFrame(
        {
            "name": [thing.whole for thing in placed.objects],
            "kind": [thing.kind for thing in placed.objects],
        },
        geometry=list(placed.geometries),
        crs=crs or None,
    )
    frame = frame.dissolve(["name", "kind"], sort=False).reset_index()[["name", "kind", "geometry"]]
    # A name is written along a whole road, which its stretches are too short for.
    stretches = frame.geom_type == "MultiLineString"
    frame.geometry = frame.geometry.where(~stretches, frame.geometry.line_merge())
    dimension = shapely.get_dimensions(frame.geometry.to_numpy())
    return [
        VectorLayer(
            name,
            title,
            "Exposed objects as configured.",
            frame[dimension == _DIMENSION[symbol.kind]].reset_index(drop=True),
            {"name": FieldInfo("name"), "kind": FieldInfo("kind")},
            style=VectorStyle(symbol, label_column="name"),
        )
        for name, title, symbol in _LAYERS
        if (dimension == _DIMENSION[symbol.kind]).any()
    ]
