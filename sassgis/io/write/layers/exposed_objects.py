"""Exposed objects as layers of their own: what is there, without what it risks."""

from __future__ import annotations

import geopandas as gpd
import shapely

from sassgis.io.vector_layer import VectorLayer, described_layer
from sassgis.model.exposure import PlacedObjects
from sassgis.model.styles import Symbol, VectorStyle

_COLOUR = "#5a4632"
_LAYERS = {
    "exposed_areas": Symbol("fill", _COLOUR, outline="#ffffff", outline_mm=0.15),
    "exposed_lines": Symbol("line", _COLOUR, size_mm=0.8),
    "exposed_points": Symbol("marker", _COLOUR, size_mm=2.4, outline="#ffffff", shape="diamond"),
}
_DIMENSION = {"fill": 2, "line": 1, "marker": 0}


def exposed_layers(placed: PlacedObjects, crs: str) -> list[VectorLayer]:
    """Layers of areas, lines and points, those that have objects; stretches of a road as one."""
    whole = {"name": [t.whole for t in placed.objects], "kind": [t.kind for t in placed.objects]}
    frame = gpd.GeoDataFrame(whole, geometry=list(placed.geometries), crs=crs or None)
    frame = frame.dissolve(["name", "kind"], sort=False).reset_index()[["name", "kind", "geometry"]]
    # A name is written along a whole road, which its stretches are too short for.
    stretches = frame.geom_type == "MultiLineString"
    frame.geometry = frame.geometry.where(~stretches, frame.geometry.line_merge())
    dimension = shapely.get_dimensions(frame.geometry.to_numpy())
    layers = []
    for name, symbol in _LAYERS.items():
        own = frame[dimension == _DIMENSION[symbol.kind]]
        if len(own):
            style = VectorStyle(symbol, label_column="name")
            columns = own[["name", "kind"]].reset_index(drop=True)
            layers.append(described_layer(name, columns, list(own.geometry), crs, style))
    return layers
