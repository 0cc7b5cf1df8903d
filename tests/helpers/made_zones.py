"""Layers of a small result with hazard zones in Ticino, made by hand."""

from __future__ import annotations

from typing import Any

import shapely
from shapely.geometry import MultiPolygon, Polygon, box

from sassgis.io.vector_layer import VectorLayer
from sassgis.io.write.layers.federal import (
    IntensityZones,
    SourceZones,
    assessment_area,
    hazard_area,
    indicative_hazard_area,
    intensity_by_source,
    synoptic_intensity,
)

E, N = 2_705_000.0, 1_150_000.0


def at(*corners: tuple[float, float], hole: list[tuple[float, float]] | None = None) -> Polygon:
    def moved(points: Any) -> list[tuple[float, float]]:
        return [(E + x, N + y) for x, y in points]

    return Polygon(moved(corners), [] if hole is None else [moved(hole)])


# As raster cells leave them: a hole that touches the outline in a corner, and an area that touches
# its neighbour in one corner only.
HOLLOW = at((0, 0), (40, 0), (40, 40), (0, 40), hole=[(0, 20), (10, 10), (20, 20), (10, 30)])
CORE = at((0, 20), (10, 10), (20, 20), (10, 30))
STEPS = at((40, 40), (60, 40), (60, 50.0004), (50, 50.0004), (50, 60), (40, 60))
PARTS = MultiPolygon([STEPS, at((80, 0), (90, 0), (90, 10))])


def some_layers(**changes: Any) -> list[VectorLayer]:
    where: dict[str, Any] = {
        "crs": "EPSG:2056", "federal": True, "canton": changes.get("canton", "TI")
    }  # fmt: skip
    zones = [
        IntensityZones(30, False, [CORE], ["low"]),
        IntensityZones(300, False, [CORE, HOLLOW], ["high", "mean"]),
        IntensityZones(None, True, [shapely.union_all([CORE, HOLLOW]), STEPS], ["high", "low"]),
    ]
    source = SourceZones(
        "Parete nord <A> & C., " + "lunga " * 8, zones[:1], 0.3333, "blocks of 1–5 m³"
    )
    return [
        assessment_area(
            [box(E - 100, N - 100, E + 200, N + 200)],
            comments='Only "rockfall" <here>',
            **where,
        ),
        synoptic_intensity(zones, process_cantonal_term="caduta sassi", **where),
        intensity_by_source([source], **where),
        hazard_area([CORE, HOLLOW, PARTS], ["substantial", "mean", "residual_hazard"], **where),
        indicative_hazard_area(
            changes.get("indicative", [STEPS]),
            hazard_area_existing=False,
            method="Cells that rocks reach at all.",
            **where,
        ),
    ]
