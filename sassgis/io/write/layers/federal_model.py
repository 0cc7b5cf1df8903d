"""The Swiss minimal geodata model 166.1: its classes, attributes and codes, and where it holds.

The tables are ``data/federal_model.toml``, which names the source.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, get_args

import pyproj

from sassgis.model.crs import crs_parts, same_crs
from sassgis.model.hazard import Canton, HazardPreset

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
#: What every delivery holds; the other classes are of the extended model.
MINIMUM_CLASSES = ("assessment_area", "synoptic_intensity", "hazard_area")
RESPONSIBILITY = "data_responsibility"


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute of a class of the model: a column of the layer.

    ``codes`` are the values of a "code", ``longest`` the most characters of a "text", ``low`` and
    ``high`` the limits of a number, both allowed, ``decimals`` those of a "number" in the transfer
    file. ``default`` is what the program writes where it knows no better.
    """

    name: str
    alias: str
    kind: str
    required: bool = True
    codes: tuple[str, ...] = ()
    longest: int = 0
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    decimals: int = 0
    default: Any = None

    @property
    def expected(self) -> str:
        """What may stand there, in words."""
        words = {
            "boolean": "true or false",
            "code": f"one of {', '.join(self.codes)}",
            "text": f"a text of at most {self.longest} characters",
            "whole": f"a whole number, {self.low:g} to {self.high:g}",
            "number": f"a number, {self.low:g} to {self.high:g}",
        }
        return words[self.kind]


@dataclass(frozen=True, slots=True)
class FederalClass:
    """One class of the model: the layer of the same name.

    ``geometry`` names the attribute that holds the surface; the others are in the order of the
    transfer, those that are inherited first.
    """

    name: str
    title: str
    description: str
    geometry: str
    attributes: tuple[Attribute, ...]


def _model() -> tuple[dict[str, tuple[str, ...]], dict[str, FederalClass]]:
    file = resources.files("sassgis") / "data" / "federal_model.toml"
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    codes = {name: tuple(entries) for name, entries in table["codes"].items()}
    codes["canton"] = get_args(Canton)  # and Liechtenstein
    attributes = {}
    for name, own in table["attributes"].items():
        kind = "code" if "codes" in own else "text" if "longest" in own else own["kind"]
        listed = codes[own["codes"]] if "codes" in own else ()
        attributes[name] = Attribute(name, **{**own, "kind": kind, "codes": listed})
    classes = {
        name: FederalClass(
            name, **{**own, "attributes": tuple(attributes[a] for a in own["attributes"])}
        )
        for name, own in table["classes"].items()
    }
    return codes, classes


CODES, _CLASSES = _model()
FEDERAL_CLASSES: Mapping[str, FederalClass] = _CLASSES


def is_lv95(crs: pyproj.CRS | str | None) -> bool:
    """Whether coordinates are CH1903+ / LV95 (EPSG:2056), with a height system or without."""
    if crs is None or crs == "":
        return False
    plane, _ = crs_parts(pyproj.CRS.from_user_input(crs))
    return same_crs(plane, pyproj.CRS.from_epsg(FEDERAL_EPSG))


def in_federal_extent(
    crs: pyproj.CRS | str | None, bounds: tuple[float, float, float, float]
) -> bool:
    """Whether coordinates are those of the federal model, and within its extent.

    The system is None or empty for local coordinates; bounds are west, south, east, north (m).
    """
    west, south, east, north = bounds
    low_x, low_y, high_x, high_y = FEDERAL_EXTENT
    inside = low_x <= west <= east <= high_x and low_y <= south <= north <= high_y
    return inside and is_lv95(crs)


def has_federal_codes(preset: HazardPreset) -> bool:
    """Whether the classes and return periods of a preset can be written in the federal codes."""
    return (
        all(c.code in CODES["intensity_class"] for c in preset.intensities)
        and all(c.code in CODES["hazard_level"] for c in preset.levels)
        and all(t == int(t) and 1 <= t <= 10_000 for t in preset.return_periods)
    )


def federal_note(federal: bool) -> str:
    """What descriptions and metadata say of the federal model.

    It is claimed for what :func:`in_federal_extent` and :func:`has_federal_codes` accept.
    """
    if federal:
        return f"Attributes and codes of the {MODEL_TITLE}."
    return (
        "Not data of a federal geodata model: the result lies outside Switzerland, in other "
        "coordinates, or has other classes."
    )
