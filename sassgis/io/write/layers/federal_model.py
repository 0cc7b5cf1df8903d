"""The Swiss minimal geodata model 166.1: its classes, attributes and codes, and where it holds.

Source: Federal Office for the Environment, minimal geodata model *Hazard Mapping* (identifier
166.1), version 1.3, model ``Hazard_Mapping_LV95_V1_3`` of 2021-03-01, read in its INTERLIS text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import pyproj

from sassgis.model.crs import same_crs
from sassgis.model.hazard import HazardPreset
from sassgis.model.settings import Canton

MODEL_TITLE = "Swiss federal minimal geodata model 166.1, Hazard Mapping, version 1.3"
MODEL_NAME, MODEL_VERSION = "Hazard_Mapping_LV95_V1_3", "2021-03-01"
MODEL_URI = "https://models.geo.admin.ch/BAFU/"
TOPIC = f"{MODEL_NAME}.hazard_mapping"
#: EPSG code of the model's coordinates: CH1903+ / LV95.
FEDERAL_EPSG = 2056
#: (west, south, east, north) within which coordinates may lie (m).
FEDERAL_EXTENT = (2_460_000.0, 1_045_000.0, 2_870_000.0, 1_310_000.0)
#: Decimals of a coordinate in metres: 1 mm.
DECIMALS = 3
#: Up to this (years) no scenario is extreme, and an intensity is stated in detail.
LONGEST_OF_A_SCENARIO = 300

HAZARD_LEVELS = ("not_in_danger", "residual_hazard", "slight", "mean", "substantial")
INTENSITY_CLASSES = ("no_impact", "existing_impact", "low", "mean", "high")
MAIN_PROCESSES = ("water", "landslide", "rockfall", "avalanche")
INDICATIVE_PROCESSES = (
    "water", "w_flooding", "w_debris_flow", "landslide", "l_permanent_landslide",
    "l_sudden_landslide_proc", "rockfall", "avalanche",
)  # fmt: skip
SOURCE_SUBPROCESSES = (
    "w_flooding", "w_debris_flow", "w_bank_erosion", "l_permanent_landslide",
    "l_sud_spontaneous_landslide", "l_sud_hillslope_debris_flow", "r_rock_fall",
    "r_rock_slide_rock_avalanche", "r_ice_fall", "ss_sinkhole", "ss_subsidence",
    "a_flowing_avalanche", "a_powder_avalanche", "a_gliding_snow",
)  # fmt: skip
SYNOPTIC_SUBPROCESSES = (
    *SOURCE_SUBPROCESSES, "water", "landslide", "l_sudden_landslide_proc", "rockfall",
    "sinkhole_or_subsidence", "avalanche",
)  # fmt: skip
COMPLETENESS = ("complete", "not_complete", "not_recognizable", "to_be_clarified")
STATES = (
    "not_assessed", "assessment_not_necessary", "assessed_and_complete",
    "assessed_and_not_complete", "assessed_and_not_recognizable", "assessed_and_to_be_clarified",
)  # fmt: skip
SIMPLE_STATES = ("not_assessed", "assessment_not_necessary", "assessed")
#: The cantons, and Liechtenstein.
CANTONS: tuple[str, ...] = get_args(Canton)

ROCKFALL = "rockfall"
ROCK_FALL_SUBPROCESS = "r_rock_fall"
NOT_ASSESSED = "not_assessed"

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
        Values of a "code".
    longest : int or None
        Most characters of a "text".
    low, high : float
        Limits of a number, both allowed.
    unit : str
    decimals : int
        Of a "number" in the transfer file.
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
    decimals: int = 0


@dataclass(frozen=True, slots=True)
class FederalClass:
    """One class of the model: the layer of the same name.

    Attributes
    ----------
    name, title, description : str
    geometry : str
        Name of the attribute that holds the surface.
    attributes : tuple of Attribute
        In the order of the transfer, those that are inherited first, and of the columns.
    """

    name: str
    title: str
    description: str
    geometry: str
    attributes: tuple[Attribute, ...]


def _code(name: str, alias: str, codes: tuple[str, ...]) -> Attribute:
    return Attribute(name, alias, "code", codes=codes)


def _text(name: str, alias: str, longest: int, *, required: bool = False) -> Attribute:
    return Attribute(name, alias, "text", required, longest=longest)


def _state(name: str, process: str, codes: tuple[str, ...] = STATES) -> Attribute:
    return _code(name, f"state of assessment: {process}", codes)


ROCK_FALL_STATE = "rf_state_rock_fall"
STATE_ATTRIBUTES = (
    _state("fl_state_flooding", "flooding"),
    _state("df_state_debris_flow", "debris flow"),
    _state("be_state_bank_erosion", "bank erosion"),
    _state("pl_state_permanent_landslide", "permanent landslide"),
    _state("sl_state_spontaneous_landslide", "spontaneous landslide"),
    _state("hd_state_hillslope_debris_flow", "hillslope debris flow"),
    _state(ROCK_FALL_STATE, "rockfall"),
    _state("rs_state_rock_slide_rock_aval", "rock slide and rock avalanche"),
    _state("if_state_ice_fall", "ice fall", SIMPLE_STATES),
    _state("sh_state_sinkhole", "sinkhole", SIMPLE_STATES),
    _state("su_state_subsidence", "subsidence", SIMPLE_STATES),
    _state("fa_state_flowing_avalanche", "flowing avalanche"),
    _state("pa_state_powder_avalanche", "powder avalanche"),
    _state("gs_state_gliding_snow", "gliding snow"),
)
RESPONSIBILITY = "data_responsibility"
_RESPONSIBLE = _code(RESPONSIBILITY, "responsible canton", CANTONS)
_COMMENTS = _text("comments", "comments", 250)
_BASIC = (_RESPONSIBLE, _COMMENTS)
_INTENSITY = (
    *_BASIC,
    _code("intensity_class", "intensity", INTENSITY_CLASSES),
    _text("process_cantonal_term", "process, cantonal term", 50, required=True),
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
            (_RESPONSIBLE, *STATE_ATTRIBUTES, _COMMENTS),
        ),
        FederalClass(
            "synoptic_intensity",
            "Intensity, all sources",
            "Intensity of all sources together, by return period.",
            "impact_zone",
            (
                *_INTENSITY,
                _code("subproc_synoptic_intensity", "subprocess", SYNOPTIC_SUBPROCESSES),
                _code("sources_in_subprocesses_compl", "sources complete", COMPLETENESS),
            ),
        ),
        FederalClass(
            "intensity_by_source",
            "Intensity by source",
            "Intensity of each source alone, by return period.",
            "impact_zone",
            (
                *_INTENSITY,
                _text("process_source", "source", 50, required=True),
                _code("subproc_intensity_by_source", "subprocess", SOURCE_SUBPROCESSES),
                Attribute(
                    "subscenario_probability",
                    "probability of the sub-scenario",
                    "number",
                    low=0.0,
                    high=1.0,
                    decimals=2,
                ),
                _text("scenario_description", "scenario", 400),
            ),
        ),
        FederalClass(
            "hazard_area",
            "Hazard level",
            "Highest hazard level of each place.",
            "impact_zone",
            (
                *_BASIC,
                _code("main_process", "main process", MAIN_PROCESSES),
                _code("hazard_level", "hazard level", HAZARD_LEVELS),
                _code("subprocesses_complete", "subprocesses complete", COMPLETENESS),
                _code("sources_complete", "sources complete", COMPLETENESS),
            ),
        ),
        FederalClass(
            "indicative_hazard_area",
            "Indicative hazard",
            "Where a hazard is indicated, without a level.",
            "impact_zone",
            (
                *_BASIC,
                _code("indicative_process", "process", INDICATIVE_PROCESSES),
                Attribute("hazard_indication", "hazard indication", "boolean"),
                _text("method", "method", 400),
                Attribute("hazard_area_existing", "hazard area exists", "boolean"),
            ),
        ),
    )
}

#: What every delivery holds; the other classes are of the extended model.
MINIMUM_CLASSES = ("assessment_area", "synoptic_intensity", "hazard_area")


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
