"""The layers in which a site is drawn, and the keys of the configuration that read them.

``sassgis new`` writes them empty; ``sassgis init`` finds them again and writes the keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from annotated_types import Interval

from sassgis.inputs.edit_polygons import edit_fields
from sassgis.inputs.ground_map import built_in_table
from sassgis.inputs.presets import read_preset
from sassgis.settings.exposure import NUMBERS_OF_KIND, OBJECT_KINDS, ObjectSettings
from sassgis.settings.schema import Declared, declared, interval
from sassgis.settings.settings import BarrierSettings, ForestPlace
from sassgis.settings.styles import (
    BARRIER_STYLE,
    EDIT_STYLE,
    RELEASE_AREA_STYLE,
    STATION_STYLE,
    FieldInfo,
    Symbol,
    VectorStyle,
    categorised_style,
)


@dataclass(frozen=True, slots=True)
class SiteLayer:
    """A layer to draw in; ``data/map_layers.csv`` has its title and description."""

    name: str
    section: str  # of the configuration that reads it
    fields: Mapping[str, FieldInfo]  # columns with choices or limits, in order
    style: VectorStyle  # its kind of symbol is the kind of geometry
    #: Keys of the section besides the file and the layer; those that name a column, by the column.
    fixed: Mapping[str, object] = field(default_factory=dict)
    attributes: Mapping[str, str] = field(default_factory=dict)


_NAME = FieldInfo("name", description="name that no other feature has", needed=True, unique=True)
#: The unit of what is declared, where the name of the key holds one.
_UNITS = {
    "height_m": "m",
    "capacity_kj": "kJ",
    "dbh_cm": "cm",
    "damage_length_m": "m",
    "speed_kmh": "km/h",
    "vehicle_length_m": "m",
}
_COLOURS = {
    "rock": "#8c8c8c", "debris": "#b5a48b", "talus": "#d9c89e", "soft_meadow": "#b8e186",
    "overgrown_slope": "#7fbc41", "forest_soil": "#4d9221", "asphalt": "#404040",
}  # fmt: skip
#: Layers of exposed objects by their kind.
_OBJECTS = {
    "building": ("buildings", Symbol("fill", "#c51b7d", opacity=0.6, outline="#8e0152")),
    "people": ("people", Symbol("marker", "#c51b7d", shape="diamond")),
    "road": ("roads", Symbol("line", "#c51b7d", size_mm=0.8)),
    "line": ("lines", Symbol("line", "#c51b7d", size_mm=0.5, dash="dash")),
}


def _stated(own: Declared, *, needed: bool = False, high: float | None = None) -> FieldInfo:
    """Return a number's column as its key of the configuration declares it."""
    limits = interval(own.kind) or Interval()
    low = limits.gt if limits.ge is None else limits.ge
    top = limits.le if high is None else high
    name = own.name.rsplit("_", 1)[0] if own.name in _UNITS else own.name
    return FieldInfo(
        name.replace("_", " "), _UNITS.get(own.name, ""), own.description,
        low=None if low is None else float(str(low)), high=None if top is None else float(str(top)),
        needed=needed,
    )  # fmt: skip


def _objects(kind: str) -> SiteLayer:
    name, symbol = _OBJECTS[kind]
    keys = declared(ObjectSettings)
    numbers = {
        n: _stated(keys[n], high=1.0 if n == "presence" else None) for n in NUMBERS_OF_KIND[kind]
    }
    return SiteLayer(
        name, "objects", {"name": _NAME, **numbers}, VectorStyle(symbol, label_column="name"),
        {"name": name, "kind": kind}, _named_by("name", *numbers),
    )  # fmt: skip


def _named_by(*columns: str) -> dict[str, str]:
    """Return keys that name columns as they are called themselves."""
    return {column: f"{column}_field" for column in columns}


def site_layers() -> tuple[SiteLayer, ...]:
    """Return all layers of a site, the topmost first."""
    barrier, forest = declared(BarrierSettings), declared(ForestPlace)
    barriers = {
        "name": _NAME,
        "kind": FieldInfo("kind", "", "wall or net", ("wall", "net"), needed=True),
        "height_m": _stated(barrier["height_m"], needed=True),
        "capacity_kj": _stated(barrier["capacity_kj"]),
    }
    scenarios = FieldInfo("scenario", "", "block scenarios: a;b for several; empty: all")
    stands = {key: _stated(forest[key], needed=True) for key in ("stems_per_ha", "dbh_cm")}
    trees = VectorStyle(Symbol("fill", "#1b7837", hatch="falling", outline="#1b7837"))
    classes = built_in_table().names
    grounds = {"class": FieldInfo("class", "", "ground class", classes, needed=True)}
    plain = Symbol("fill", "#999999", opacity=0.5, outline="#666666", outline_mm=0.1)
    colours: dict[str | int, tuple[str, str]] = {
        c: (c, _COLOURS.get(c, "#999999")) for c in classes
    }
    levels = [c.code for c in read_preset("ch-so").levels]
    return (
        SiteLayer(
            "stations", "stations", {"name": _NAME}, STATION_STYLE, {"name": "station"},
            _named_by("name"),
        ),
        SiteLayer(
            "barriers", "barriers", barriers, BARRIER_STYLE, {"name": "barrier"},
            _named_by(*barriers),
        ),
        *(_objects(kind) for kind in OBJECT_KINDS),
        SiteLayer("edits", "edits", edit_fields(levels, False), EDIT_STYLE),
        SiteLayer(
            "release_areas", "release", {"name": _NAME, "scenario": scenarios},
            RELEASE_AREA_STYLE, {}, _named_by("name", "scenario"),
        ),
        SiteLayer(
            "forest", "effects.trees", stands, trees, {},
            {"stems_per_ha": "stems_field", "dbh_cm": "dbh_field"},
        ),
        SiteLayer(
            "ground", "ground", grounds, categorised_style(plain, "class", colours), {},
            _named_by("class"),
        ),
    )  # fmt: skip
