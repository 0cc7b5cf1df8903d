"""Layers of a small result with hazard zones in Ticino, made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from helpers.made_up_result import preset
from shapely.geometry import MultiPolygon, Polygon, box

from sassgis.files.vector_layer import VectorLayer
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.outputs.swiss.federal_model import federal_layer, intensity_rows

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


def intensity_row(zone: Any, years: Any, extreme: Any = False, code: Any = "low") -> Any:
    """A zone with an intensity, which the model may not have."""
    when = {"return_period_in_years": years, "extreme_scenario": extreme}
    return zone, {"intensity_class": code, **when}


def source_row(
    name: str, zone: Any, probability: Any = 1.0, description: str = ""
) -> tuple[Any, dict[str, Any]]:
    """A zone of low intensity once in 30 years, of one source."""
    own = {
        "process_source": name,
        "subscenario_probability": probability,
        "scenario_description": description,
    }
    return zone, {**intensity_row(zone, 30)[1], **own}


def level_rows(polygons: list[Any], codes: list[Any], **values: Any) -> list[Any]:
    """Rows of the levels of places."""
    return [(p, {"hazard_level": code, **values}) for p, code in zip(polygons, codes, strict=True)]


def layer(name: str, rows: list[Any], **where: Any) -> VectorLayer:
    """A federal layer with the legend of a preset."""
    own = preset().levels if name == "hazard_area" else preset().intensities
    return federal_layer(name, rows, **{"legend": own, **where})


def some_layers(**changes: Any) -> list[VectorLayer]:
    where: dict[str, Any] = {
        "crs": "EPSG:2056", "federal": True, "canton": changes.get("canton", "TI")
    }  # fmt: skip
    codes = [c.code for c in preset().intensities]
    maps = {
        years: Coverage(polygons, np.array([1 + codes.index(c) for c in own]))
        for years, polygons, own in (
            (30, [CORE], ["low"]),
            (300, [CORE, HOLLOW], ["high", "mean"]),
            (None, [shapely.union_all([CORE, HOLLOW]), STEPS], ["high", "low"]),
        )
    }
    zones = intensity_rows(maps, preset())
    name = ("Parete nord <A> & C., " + "lunga " * 8)[:50].strip()
    term = {"process_cantonal_term": "caduta sassi"}
    indicated = {"hazard_area_existing": False, "method": "Cells that rocks reach at all."}
    levels = level_rows([CORE, HOLLOW, PARTS], ["substantial", "mean", "residual_hazard"])
    assessed = box(E - 100, N - 100, E + 200, N + 200)
    return [
        layer("assessment_area", [(assessed, {"comments": 'Only "rockfall" <here>'})], **where),
        layer("synoptic_intensity", [(p, {**v, **term}) for p, v in zones], **where),
        layer("intensity_by_source", [source_row(name, CORE, 0.3333, "blocks of 1–5 m³")], **where),
        layer("hazard_area", levels, **where),
        layer(
            "indicative_hazard_area",
            [(p, indicated) for p in changes.get("indicative", [STEPS])],
            **where,
        ),
    ]
