from __future__ import annotations

import shapely

from sassgis.outputs.layers.risk_objects import exposed_layers
from sassgis.settings.exposure import ExposedObject, PlacedObjects


def test_stretches_of_a_road_are_one_line_and_kinds_of_geometry_apart() -> None:
    objects = (
        ExposedObject("lane 0-20", "road", parent="lane"),
        ExposedObject("lane 20-40", "road", parent="lane"),
        ExposedObject("house", "building"),
        ExposedObject("bench", "people"),
    )
    places = (
        shapely.LineString([(0, 0), (20, 0)]),
        shapely.LineString([(20, 0), (40, 0)]),
        shapely.box(0, 0, 5, 5),
        shapely.Point(1, 1),
    )
    found = exposed_layers(PlacedObjects(objects, places), "")
    layers = {layer.name: layer.frame for layer in found}
    assert list(layers) == ["exposed_areas", "exposed_lines", "exposed_points"]
    (road,) = layers["exposed_lines"].geometry
    assert road.geom_type == "LineString" and road.length == 40.0
    assert list(layers["exposed_areas"]["name"]) == ["house"]
    assert list(layers["exposed_points"]["kind"]) == ["people"]
    assert exposed_layers(PlacedObjects((), ()), "") == []
