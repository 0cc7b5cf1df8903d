from __future__ import annotations

import numpy as np
import shapely

from sassgis.hazard.object_values import ObjectEstimate, ObjectValues
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


def test_a_road_has_the_values_of_its_stretch_with_the_most_energy() -> None:
    objects = tuple(ExposedObject(f"lane {i}", "road", parent="lane") for i in range(3))
    places = tuple(shapely.LineString([(i, 0), (i + 1, 0)]) for i in range(3))
    energy = ObjectEstimate(*np.array([[3.0, 7.0, np.nan], [2.0, 6.0, np.nan], [4.0, 9.0, 1.0]]))
    values = ObjectValues(energy, energy, energy)
    (layer,) = exposed_layers(PlacedObjects(objects, places), "", values)
    (row,) = layer.frame.to_dict("records")
    ends = [row[f"energy_q95_kj{end}"] for end in ("", "_low", "_high")]
    assert ends == [7.0, 6.0, 9.0]
