"""The Swiss minimal geodata model 166.1: its classes, attributes and codes, and where it holds.

Source: Federal Office for the Environment, minimal geodata model *Hazard Mapping* (identifier
166.1), version 1.3. What is known of it from elsewhere than its documentation has ``verified`` set
to false, and the page ``docs/federal_model.md`` calls it unverified.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import pyproj

from sassgis.model.crs import same_crs
from sassgis.model.hazard import HazardPreset

MODEL_TITLE = "Swiss federal minimal geodata model 166.1, Hazard Mapping, version 1.3"
#: EPSG code of the model's coordinates: CH1903+ / LV95.
FEDERAL_EPSG = 2056
#: (west, south, east, north) within which coordinates may lie (m).
FEDERAL_EXTENT = (2_460_000.0, 1_045_000.0, 2_870_000.0, 1_310_000.0)
#: Decimals of a coordinate in metres: 1 mm.
DECIMALS = 3
#: No extreme scenario has a return period up to this (years).
LONGEST_OF_A_SCENARIO = 300

HAZARD_LEVELS = ("not_in_danger", "residual_hazard", "slight", "mean", "substantial")
INTENSITY_CLASSES = ("no_impact", "existing_impact", "low", "mean", "high")
MAIN_PROCESSES = ("water", "landslide", "rockfall", "avalanche")
COMPLETENESS = ("complete", "not_complete", "not_recognizable", "to_be_clarified")
#: The model has more of these than the three that are known here.
STATES = ("not_assessed", "assessment_not_necessary", "assessed_and_complete")
CANTONS = (
    "AG", "AI", "AR", "BE", "BL", "BS", "FR", "GE", "GL", "GR", "JU", "LU", "NE", "NW", "OW", "SG",
    "SH", "SO", "SZ", "TG", "TI", "UR", "VD", "VS", "ZG", "ZH",
)  # fmt: skip

ROCKFALL = "rockfall"
ROCK_FALL_SUBPROCESS = "r_rock_fall"
NOT_ASSESSED = "not_assessed"
#: Code of a hazard that is indicated; not read in the model: unverified.
HAZARD_INDICATED = "indicated"

Kind = Literal["code", "text", "whole", "number", "boolean"]


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute of a class of the model.

    Attributes
    ----------
    name : str
        Column of the layer.
    alias : str
        For people.
    kind : {"code", "text", "whole", "number", "boolean"}
    required : bool
        Whether each feature needs a value.
    codes : tuple of str
        Values of a "code"; empty where the model's are not known here.
    longest : int or None
        Most characters of a "text".
    low, high : float
        Limits of a number, both allowed.
    unit : str
    verified : bool
        Whether name and codes were read in the documentation of the model.
    """

    name: str
    alias: str
    kind: Kind
    required: bool = True
    codes: tuple[str, ...] = ()
    longest: int | None = None
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    verified: bool = True


@dataclass(frozen=True, slots=True)
class FederalClass:
    """One class of the model: the layer of the same name.

    Attributes
    ----------
    name, title, description : str
    geometry : str
        Name of the attribute that holds the surface.
    attributes : tuple of Attribute
        In the order of the columns.
    """

    name: str
    title: str
    description: str
    geometry: str
    attributes: tuple[Attribute, ...]


def _state(name: str, process: str, *, verified: bool = False) -> Attribute:
    return Attribute(
        name, f"state of assessment: {process}", "code", codes=STATES, verified=verified
    )


ROCK_FALL_STATE = "rf_state_rock_fall"
STATE_ATTRIBUTES = (
    _state("fl_state_flooding", "flooding"),
    _state("df_state_debris_flow", "debris flow"),
    _state("be_state_bank_erosion", "bank erosion"),
    _state("pl_state_permanent_landslide", "permanent landslide"),
    _state("sl_state_spontaneous_landslide", "spontaneous landslide"),
    _state("hd_state_hillslope_debris_flow", "hillslope debris flow"),
    _state(ROCK_FALL_STATE, "rockfall", verified=True),
    _state("rs_state_rock_slide_rock_aval", "rock slide and rock avalanche"),
    _state("if_state_ice_fall", "ice fall"),
    _state("sh_state_sinkhole_or_subsidence", "sinkhole or subsidence"),
    _state("fa_state_flowing_avalanche", "flowing avalanche"),
    _state("pa_state_powder_avalanche", "powder avalanche"),
    _state("gs_state_gliding_snow", "gliding snow"),
)
_INTENSITY_ATTRIBUTES = (
    Attribute("intensity_class", "intensity", "code", codes=INTENSITY_CLASSES),
    Attribute("process_cantonal_term", "process, cantonal term", "text", False, longest=50),
    Attribute(
        "return_period_in_years", "return period", "whole", False, low=1, high=10_000, unit="years"
    ),
    Attribute("extreme_scenario", "extreme scenario", "boolean"),
)

FEDERAL_CLASSES: Mapping[str, FederalClass] = {
    entry.name: entry
    for entry in (
        FederalClass(
            "assessment_area",
            "Assessment area",
            "What was assessed, and for which processes.",
            "area",
            (
                Attribute("data_responsibility", "responsible canton", "code", codes=CANTONS),
                *STATE_ATTRIBUTES,
                Attribute("comments", "comments", "text", False),
            ),
        ),
        FederalClass(
            "synoptic_intensity",
            "Intensity, all sources",
            "Intensity of all sources together, by return period.",
            "impact_zone",
            (
                *_INTENSITY_ATTRIBUTES,
                Attribute(
                    "subproc_synoptic_intensity",
                    "subprocess",
                    "code",
                    codes=(ROCK_FALL_SUBPROCESS,),
                ),
                Attribute(
                    "sources_in_subprocesses_compl",
                    "sources complete",
                    "code",
                    codes=COMPLETENESS,
                ),
            ),
        ),
        FederalClass(
            "intensity_by_source",
            "Intensity by source",
            "Intensity of each source alone, by return period.",
            "impact_zone",
            (
                *_INTENSITY_ATTRIBUTES,
                Attribute("process_source", "source", "text", longest=50),
                Attribute(
                    "subproc_intensity_by_source",
                    "subprocess",
                    "code",
                    codes=(ROCK_FALL_SUBPROCESS,),
                ),
                Attribute(
                    "subscenario_probability",
                    "probability of the sub-scenario",
                    "number",
                    False,
                    low=0.0,
                    high=1.0,
                ),
                Attribute("scenario_description", "scenario", "text", False, longest=400),
            ),
        ),
        FederalClass(
            "hazard_area",
            "Hazard level",
            "Highest hazard level of each place.",
            "impact_zone",
            (
                Attribute("main_process", "main process", "code", codes=MAIN_PROCESSES),
                Attribute("hazard_level", "hazard level", "code", codes=HAZARD_LEVELS),
                Attribute(
                    "subprocesses_complete", "subprocesses complete", "code", codes=COMPLETENESS
                ),
                Attribute("sources_complete", "sources complete", "code", codes=COMPLETENESS),
            ),
        ),
        FederalClass(
            "indicative_hazard_area",
            "Indicative hazard",
            "Where a hazard is indicated, without a level.",
            "impact_zone",
            (
                Attribute("indicative_process", "process", "code", codes=MAIN_PROCESSES),
                Attribute("hazard_indication", "hazard indication", "code", verified=False),
                Attribute("method", "method", "text", False, longest=400),
            ),
        ),
    )
}


def is_lv95(crs: pyproj.CRS | str | None) -> bool:
    """Whether coordinates are CH1903+ / LV95 (EPSG:2056), with a height system or without."""
    if crs is None or crs == "":
        return False
    system = pyproj.CRS.from_user_input(crs)
    if system.is_compound:
        system = system.sub_crs_list[0]
    return same_crs(system, pyproj.CRS.from_epsg(FEDERAL_EPSG))


def in_federal_extent(
    crs: pyproj.CRS | str | None, bounds: tuple[float, float, float, float]
) -> bool:
    """Whether the coordinates are those of the federal model, and within its extent.

    Parameters
    ----------
    crs : CRS, str or None
        Coordinate system; None or empty for local coordinates.
    bounds : tuple of float
        West, south, east, north (m).
    """
    west, south, east, north = bounds
    low_x, low_y, high_x, high_y = FEDERAL_EXTENT
    inside = low_x <= west <= east <= high_x and low_y <= south <= north <= high_y
    return inside and is_lv95(crs)


def has_federal_codes(preset: HazardPreset) -> bool:
    """Whether the classes and return periods of a preset can be written in the federal codes."""
    return (
        all(c.code in INTENSITY_CLASSES for c in preset.intensities)
        and all(c.code in HAZARD_LEVELS for c in preset.levels)
        and all(t == int(t) and 1 <= t <= 10_000 for t in preset.return_periods)
    )


def federal_note(federal: bool) -> str:
    """What descriptions and metadata say of the federal model.

    Parameters
    ----------
    federal : bool
        Whether the result is one that the model is made for: see :func:`in_federal_extent` and
        :func:`has_federal_codes`.
    """
    if federal:
        return f"Attributes and codes of the {MODEL_TITLE}."
    return (
        "Not data of a federal geodata model: the result lies outside Switzerland, in other "
        "coordinates, or has other classes."
    )
