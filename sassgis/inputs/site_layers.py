"""The layers in which a site is drawn, and the keys of the configuration that read them.

``sassgis new`` writes them empty; ``sassgis init`` finds them again and writes the keys.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyproj
from annotated_types import Interval

from sassgis.errors import InputError
from sassgis.files.gdal_safety import layers_of, read_frame, vector_file
from sassgis.files.plain_file import seen_from, toml_table
from sassgis.grid import Grid
from sassgis.inputs.config import LISTS, declared_sections
from sassgis.inputs.dem_system import NO_SYSTEM
from sassgis.inputs.ground_map import built_in_table
from sassgis.inputs.presets import read_preset
from sassgis.inputs.tiles import open_terrain
from sassgis.inputs.vector_features import open_layer, with_shapes, without_shapes
from sassgis.inputs.vectors import edit_fields
from sassgis.settings.blocks import ForestPlace
from sassgis.settings.exposure import NUMBERS_OF_KIND, OBJECT_KINDS, ObjectSettings
from sassgis.settings.schema import Declared, declared, interval
from sassgis.settings.settings import BarrierSettings
from sassgis.settings.styles import (
    ASSESSED_STYLE,
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
    file_keys: tuple[str, str] = ("file", "layer")


_NAME = FieldInfo("name", description="name that no other feature has", needed=True, unique=True)
#: The unit of what is declared, where the name of the key holds one.
_UNITS = {
    "height_m": "m",
    "capacity_kj": "kJ",
    "width_m": "m",
    "roof_slope_deg": "°",
    "cushion_kpa": "kPa",
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
    """Return keys that name columns, by the names of the columns."""
    return {column: f"{column}_field" for column in columns}


def site_layers() -> tuple[SiteLayer, ...]:
    """Return all layers of a site, the topmost first."""
    barrier, forest = declared(BarrierSettings), declared(ForestPlace)
    barriers = {
        "name": _NAME,
        "kind": FieldInfo(
            "kind", "", "wall, net or gallery", ("wall", "net", "gallery"), needed=True
        ),
        "height_m": _stated(barrier["height_m"], needed=True),
        **{
            key: _stated(barrier[key])
            for key in ("capacity_kj", "width_m", "roof_slope_deg", "cushion_kpa")
        },
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
            "assessed_area", "hazard", {}, ASSESSED_STYLE,
            file_keys=("assessed", "assessed_layer"),
        ),
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


#: Keys with their values by section; sections with double brackets are not separate, as there is
#: one entry at most for each layer of a site.
StartKeys = list[tuple[str, dict[str, object]]]

#: Layers of a site that a configuration names though they are empty: release areas must be drawn,
#: edits may be.
_NAMED_EMPTY = ("release", "edits")

#: The layer of release areas of a site, and what it is called elsewhere.
_RELEASE_LAYERS = ("release_areas", "release")


def project_keys(file: Path) -> StartKeys:
    """Return the name of the project: that of the folder of the configuration."""
    name = file.resolve().parent.name
    return [("project", {"name": name})] if name else []


def start_keys(folder: Path, dem: Path | None, release: Path | None) -> StartKeys:
    """Return the keys that the files of a site decide.

    Paths are written as seen from the folder of the configuration. ``release`` holds release areas,
    or it is a GeoPackage of ``sassgis new``, of which every layer with features is used.
    """
    keys: StartKeys = []
    if dem is not None:
        if not dem.exists():
            expected = "a raster or folder of tiles"
            raise InputError("file not found", file=dem, field="--dem", expected=expected)
        keys.append(("terrain", {"dem": seen_from_folder(folder, dem)}))
    if release is None:
        return keys
    place = seen_from_folder(folder, release)
    layers = _layers(release)
    site = {own.name: own for own in site_layers()}
    if "release_areas" in layers and len(layers) > 1:
        for name, own in site.items():
            if name in layers and (own.section in _NAMED_EMPTY or _has_features(release, name)):
                keys.append((own.section, _keys_of(own, release, place)))
        return keys
    chosen = next((n for n in _RELEASE_LAYERS if n in layers), layers[0])
    if len(layers) > 1 and chosen not in _RELEASE_LAYERS:
        raise InputError(
            "has several layers", file=release, field="--release", found=", ".join(layers),
            expected="a file with one layer, or one that is called release_areas",
        )  # fmt: skip
    own_keys: dict[str, object] = {"file": place}
    if len(layers) > 1:
        own_keys["layer"] = chosen
    table = _table(release, chosen)
    column = next((c for c in table.columns if str(c).lower() == "name"), None)
    if column is not None and are_names(table[column]):
        own_keys["name_field"] = str(column)
    return [*keys, ("release", own_keys)]


def with_values(given: StartKeys, assignments: Sequence[str]) -> StartKeys:
    """Return keys that the user sets, in place of or besides those that the files decide.

    An assignment is ``section.key=value``; the value is TOML, or a text without quotes. Of a
    section with double brackets also all of them: ``blocks=[{name="a", volume_m3=1}, {...}]``.
    """
    keys = [(section, dict(values)) for section, values in given]
    for text in assignments:
        dotted, equals, value = text.partition("=")
        section, _, key = dotted.strip().rpartition(".")
        several = _toml(value.strip()) if equals and not section and key in LISTS else None
        if isinstance(several, list) and all(isinstance(own, dict) for own in several):
            keys = [own for own in keys if own[0] != key] + [(key, dict(own)) for own in several]
            continue
        if not equals or key not in declared_sections().get(section, {}):
            raise InputError(
                "is no key with a value", field="--set", found=text,
                expected="section.key=value, as in release.spacing_m=5",
            )  # fmt: skip
        own = next((values for name, values in keys if name == section), None)
        if own is None:
            own = {}
            keys.append((section, own))
        own[key] = _toml(value.strip())
    return keys


def with_system(given: StartKeys, dem: Path | None, release: Path | None) -> StartKeys:
    """Check that the keys lie in one place, and add the coordinate system.

    It is that of the release areas if only they state one. InputError if the terrain model has none
    that can be used, or they are not on it.
    """
    if dem is None:
        return given
    keys = [(section, dict(values)) for section, values in given]
    by_name = dict(reversed(keys))
    terrain = by_name["terrain"]
    drawn = None
    if release is not None:
        own = str(by_name["release"].get("layer") or _layers(release)[0])
        drawn = open_layer(release, own, "release", {})
    try:
        frame = outline_of(dem, terrain)
    except InputError as error:
        system = None if drawn is None or drawn.crs is None else pyproj.CRS(drawn.crs)
        code = None if system is None else system.to_authority(min_confidence=90)
        if error.problem != NO_SYSTEM or system is None or not system.is_projected or code is None:
            raise
        terrain["crs"] = ":".join(code)
        frame = open_terrain(dem, ":".join(code)).outline()
    if drawn is not None and release is not None:
        with_shapes(without_shapes(drawn, release), drawn, release, frame, "release")
    return keys


def outline_of(dem: Path, terrain: Mapping[str, object]) -> Grid:
    """Return a terrain model without its heights; ``terrain`` are keys of its section."""
    crs, override = terrain.get("crs"), bool(terrain.get("override_crs", False))
    return open_terrain(dem, None if crs is None else str(crs), None, override).outline()


def _toml(text: str) -> object:
    try:
        value = toml_table(f"x = {text}", "--set")["x"]
    except InputError:
        return text
    return value if isinstance(value, bool | int | float | str | list | dict) else text


def _keys_of(own: SiteLayer, file: Path, place: str) -> dict[str, object]:
    """Return the section for a layer of a site: attributes count where one feature has a value."""
    keys: dict[str, object] = dict(own.fixed)
    keys |= dict(zip(own.file_keys, (place, own.name), strict=True))
    table = _table(file, own.name)
    for column, key in own.attributes.items():
        if column not in table.columns:
            continue
        filled = are_names(table[column]) if column == "name" else bool(_texts(table[column]))
        if filled or (own.fields[column].needed and column != "name"):
            keys[key] = column
    return keys


def _texts(column: Any) -> list[str]:
    return [text for text in (str(v).strip() for v in column.dropna()) if text]


def are_names(column: Any) -> bool:
    """Return whether every feature has a separate name."""
    texts = _texts(column)
    return bool(texts) and len(set(texts)) == len(texts) == len(column)


def _layers(file: Path) -> list[str]:
    """Return layers with geometry."""
    with vector_file(file, "--release"):
        names = [name for name, kind in layers_of(file).items() if kind is not None]
    if not names:
        raise InputError(
            "holds no layer with geometry", file=file, field="--release",
            expected="polygons, lines or points",
        )  # fmt: skip
    return names


def _has_features(file: Path, layer: str) -> bool:
    """With the geometry: without it a layer that has no attributes reads as empty."""
    with vector_file(file, "--release"):
        return len(read_frame(file, layer)) > 0


def _table(file: Path, layer: str) -> Any:
    with vector_file(file, "--release"):
        return read_frame(file, layer, read_geometry=False)


def seen_from_folder(folder: Path, file: Path) -> str:
    """Return a file as it is named from the folder of a configuration."""
    return seen_from(folder.resolve(), file.resolve())
