"""Release areas, stations, barriers and edits from any vector file, in those of the DEM."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
import shapely

from sassgis.errors import ConfigError, InputError, notice
from sassgis.files.vector_layer import descriptions
from sassgis.grid import FloatArray, Grid
from sassgis.inputs.config import control_line_of
from sassgis.inputs.dem_system import extent_text
from sassgis.inputs.result_folder import EDITS_FILE, EDITS_LAYER, read_layer
from sassgis.inputs.vector_features import (
    Feature,
    cells_under,
    nearest,
    open_layer,
    outside,
    read_features,
    refuse_twice,
    refuse_unknown,
    share_inside,
    share_known,
    steepest_slope_deg,
    with_shapes,
    without_repeats,
    without_shapes,
)
from sassgis.settings.exposure import ObjectSettings
from sassgis.settings.hazard_rules import NO_LEVEL, Edit, EditLimit, EditSettings, HazardPreset
from sassgis.settings.map_run import Config, ReleaseArea
from sassgis.settings.results import ControlLine
from sassgis.settings.schema import Input, composed
from sassgis.settings.settings import BarrierSettings, ReleaseSettings, StationSettings
from sassgis.settings.styles import FieldInfo

#: Below this slope no block at rest rolls: the smallest rolling friction that Bozzolo and Pamini
#: (1986) quote from Statham (1979) is 0.37, the tangent of 20.3 degrees; sliding asks for more.
START_SLOPE_DEG = math.degrees(math.atan(0.37))


_NO_START = (
    "no block starts there: fewer blocks a year if the onset frequency is per hectare or metre, "
    "as many if it is per year"
)
#: Keys that name attributes of the layer.
_ATTRIBUTES = ("name_field", "scenario_field")


def release_features(release: ReleaseSettings) -> list[Feature]:
    """Return release areas of a file by number and attributes; their shapes are not looked at."""
    file, frame = _release_layer(release, "name_field")
    return without_shapes(frame, file, release.name_field)


def release_names(release: ReleaseSettings) -> tuple[str, ...]:
    """Return names of all release areas in the order of the file; shapes are not looked at."""
    return tuple(feature_names(release_features(release), "area", "release"))


def _release_layer(release: ReleaseSettings, *keys: str) -> tuple[Input, Any]:
    """Return the file and the layer, which has the attributes that some keys name."""
    if release.file is None:
        problem, field = "no release areas are given", "release.file"
        raise InputError(problem, file=release.config_file, field=field, expected="a file")
    fields = {key: getattr(release, key) for key in keys}
    return release.file, open_layer(release.file, release.layer, "release", fields)


def read_release(
    release: ReleaseSettings,
    grid: Grid,
    block_names: Sequence[str],
    only: Sequence[str] | None = None,
) -> list[ReleaseArea]:
    """Read the release areas, in the order of the file, and check them against the DEM.

    ``only`` are the names of the areas to read: the shapes of the others are not looked at. Notices
    name areas that can be used but deserve a look (partly outside the DEM, over nodata, too flat
    for a start, or over another area).
    """
    file, frame = _release_layer(release, *_ATTRIBUTES)
    features = without_shapes(frame, file, release.name_field)
    names = feature_names(features, "area", "release")
    only = None if only is None else [composed(name) for name in only]
    for name in only or ():
        refuse_unknown(name, names, "no release area has this name", file=file, field="area")
    places = [k for k, name in enumerate(names) if only is None or name in only]
    shaped = with_shapes([features[k] for k in places], frame, file, grid, "release")
    areas = [
        release_area(feature, names[k], release, grid, block_names)
        for feature, k in zip(shaped, places, strict=True)
    ]
    warn_of_overlaps(areas, file)
    return areas


def read_release_feature(release: ReleaseSettings, number: int, grid: Grid) -> Feature:
    """Return one feature of the release areas, in the coordinates of the DEM.

    ``number`` is its place in the layer, counted from 1. The heights of the terrain model are not
    looked at.
    """
    file, frame = _release_layer(release, *_ATTRIBUTES)
    own = without_shapes(frame.iloc[[number - 1]], file, release.name_field)[0]
    return with_shapes([replace(own, number=number)], frame, file, grid, "release")[0]


def release_area(
    feature: Feature, name: str, release: ReleaseSettings, grid: Grid, block_names: Sequence[str]
) -> ReleaseArea:
    """Return a release area from its feature, checked against the DEM under it."""
    known = _known_under(feature, grid)
    scenarios = _scenarios(feature, release.scenario_field, block_names)
    return ReleaseArea(name, feature.geometry, scenarios, known)


def named_features(
    item: StationSettings | ObjectSettings,
    grid: Grid,
    key: str,
    columns: Mapping[str, str],
    kinds: Sequence[str],
) -> list[tuple[Feature, str]]:
    """Return the features that a section reads, with their names; a single one may have that of it.

    ``columns`` are attributes that the section names besides that of the names, by what they say.
    """
    assert item.file is not None
    features = read_features(
        item.file, grid, key, layer=item.layer,
        fields={f"{k}_field": v for k, v in [("name", item.name_field), *columns.items()]},
        label=item.name_field, kinds=kinds,
    )  # fmt: skip
    if item.name_field is None and len(features) == 1:
        return [(features[0], item.name)]
    return list(zip(features, feature_names(features, item.name, key), strict=True))


def feature_names(features: Sequence[Feature], stem: str, section: str) -> list[str]:
    """Return names of the features: identities, so no two are the same."""
    seen: dict[str, Feature] = {}
    for feature in features:
        field = feature.name_field
        name = f"{stem} {feature.number}" if field is None else feature.text(field)
        if name is None:
            raise feature.wrong("has no name", field, expected="a text")
        if name in seen:
            found = f"{name!r} in features {seen[name].number} and {feature.number}"
            expected = f"names that differ, or another {section}.name_field"
            raise InputError(
                "name is used twice", file=feature.file, field=field, found=found, expected=expected
            )
        seen[name] = feature
    return list(seen)


def _scenarios(feature: Feature, field: str | None, known: Sequence[str]) -> tuple[str, ...]:
    text = None if field is None else feature.text(field)
    if text is None:
        if field is not None:
            notice(f"{feature.file}: {feature.label} names no scenario: all of them", "info")
        return tuple(known)
    chosen = tuple(dict.fromkeys(part.strip() for part in re.split(r"[;,]", text) if part.strip()))
    for name in chosen:
        problem = f"{feature.label} names an unknown block scenario"
        refuse_unknown(name, known, problem, file=feature.file, field=field)
    return chosen or tuple(known)


def _known_under(feature: Feature, grid: Grid) -> float:
    """Return the share of a release area on known terrain; it is compared with the DEM under it."""
    file, label = feature.file, feature.label
    inside, known = share_inside(feature, grid), share_known(feature, grid)
    if inside == 0.0:
        raise outside(file, "release.file", label, feature.geometry.bounds, grid)
    if known == 0.0:
        expected = "an area on known terrain"
        raise feature.wrong(
            "lies on nodata", "release.file", found="no height under it", expected=expected
        )
    for share, what in ((1.0 - inside, "lies outside the DEM"), (inside - known, "is nodata")):
        if share > 1e-8:
            percent = max(100.0 * share, 0.1)
            notice(f"{file}: {label}: {percent:.1f} % of it {what}; {_NO_START}")
    steepest = steepest_slope_deg(feature.geometry, grid)
    if steepest < START_SLOPE_DEG:
        notice(
            f"{file}: {label}: nowhere steeper than {steepest:.1f} degrees; "
            f"below {START_SLOPE_DEG:.1f} degrees no block at rest starts to move"
        )
    return known


def warn_of_overlaps(areas: Sequence[ReleaseArea], file: Input) -> None:
    """Warn of overlapping areas of one scenario, where blocks start twice as densely."""
    shapes = [a.geometry for a in areas]
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        common = shapes[i].intersection(shapes[j]).area if i < j else 0.0
        if common > 0.0 and set(areas[i].scenarios) & set(areas[j].scenarios):
            names = f"areas {areas[i].name} and {areas[j].name}"
            notice(f"{file}: {names} overlap by {common:.1f} m2; blocks start there from both")


def read_control_lines(config: Config, grid: Grid) -> list[tuple[ControlLine, FloatArray]]:
    """Read stations, then barriers, that lie on the map, in the order of the configuration.

    Each comes with x and y of its vertices (m), float64 of shape (n, 2).
    """
    control_lines: list[tuple[ControlLine, FloatArray]] = []
    for section, items in (("stations", config.stations), ("barriers", config.barriers)):
        for item in items:
            control_lines += _control_lines_of(item, f"{section}[{item.name}]", config.file, grid)
    names = [control_line.name for control_line, _ in control_lines]
    expected = "names that differ, features of station and barrier files included"
    field = "stations/barriers.name"
    refuse_twice(names, expected, error=ConfigError, file=config.file, field=field)
    return control_lines


def _control_lines_of(
    item: StationSettings, key: str, config_file: Path | None, grid: Grid
) -> list[tuple[ControlLine, FloatArray]]:
    wrong = partial(ConfigError, file=config_file)
    if item.line is not None:
        line = shapely.LineString(item.line)
        if not line.is_valid:
            found, expected = str([list(p) for p in item.line]), "at least two points that differ"
            raise wrong("has no length", field=f"{key}.line", found=found, expected=expected)
        feature = Feature(1, {}, line, "line")
        check_on_map(feature, grid, config_file, f"{key}.line", item.name)
        points = without_repeats(shapely.get_coordinates(line))
        return [(control_line_of(item, item.name), points)]
    if item.file is None:
        found = "chainage_m, which belongs to profile runs"
        raise wrong("has no place on the map", field=key, found=found, expected="line or file")
    columns = item.fields if isinstance(item, BarrierSettings) else {}
    control_lines = []
    for feature, name in named_features(item, grid, key, columns, ("line",)):
        points = _one_line(feature, key)
        check_on_map(feature, grid, item.file, key, feature.label)
        own = _with_attributes(item, feature)
        control_lines.append((control_line_of(own, name), points))
    return control_lines


def read_line(file: Input, grid: Grid, key: str) -> FloatArray:
    """Return the only line of a file, which must lie within the terrain model.

    As x and y of its vertices in the coordinates of the DEM (m), float64 of shape (n, 2).
    """
    features = read_features(file, grid, key, kinds=("line",))
    if len(features) != 1:
        raise InputError(
            "holds several lines", file=file, field=key, found=str(len(features)),
            expected="one line",
        )  # fmt: skip
    (feature,) = features
    points = _one_line(feature, key)
    # Half a cell: heights are known between the centres of cells.
    inside = shapely.box(*grid.bounds).buffer(-0.5 * grid.cell_size, join_style="mitre")
    if not inside.contains(feature.geometry):
        raise InputError(
            f"{feature.label} or a part of it lies outside the DEM", file=file, field=key,
            found=extent_text(*feature.geometry.bounds),
            expected=f"within {extent_text(*inside.bounds)}, half a cell from its edge",
        )  # fmt: skip
    return points


def _one_line(feature: Feature, key: str) -> FloatArray:
    """Return vertices of a line whose parts, if it has several, meet at their ends."""
    line = feature.geometry
    if line.geom_type == "MultiLineString":
        line = shapely.line_merge(line)
    if line.geom_type != "LineString":
        expected = "one line without gaps; make each part a feature of its own"
        found = f"{len(line.geoms)} parts"
        raise feature.wrong("is made of separate parts", key, found=found, expected=expected)
    return without_repeats(shapely.get_coordinates(line))


def _with_attributes(item: StationSettings, feature: Feature) -> StationSettings:
    """Return barrier with what the attributes of one feature say; empty ones leave it as it is."""
    if not isinstance(item, BarrierSettings):
        return item
    stated: dict[str, Any] = {}
    for key, column in item.fields.items():
        text = feature.text(column)
        if text is not None:
            stated[key] = text if key == "kind" else feature.value(column)
    try:
        own = replace(item, **stated)
        for key in own.needed:
            if getattr(own, key) is None:
                raise feature.wrong("has no value", own.fields[key], expected=f"its {key}")
        return own
    except ConfigError as error:
        problem, field = f"{feature.label}: {error.problem}", item.fields.get(str(error.field))
        raise InputError(**error.parts(problem=problem, file=feature.file, field=field)) from None


def check_on_map(feature: Feature, grid: Grid, file: Input | None, key: str, label: str) -> None:
    """Raise InputError if a feature lies outside the DEM; warn if a part of it does."""
    if not feature.geometry.intersects(shapely.box(*grid.bounds)):
        raise outside(file, key, label, feature.geometry.bounds, grid)
    inside = share_inside(feature, grid)
    if inside < 1.0:
        percent = max(100.0 * (1.0 - inside), 0.1)
        notice(f"{file}: {key}: {label}: {percent:.1f} % of it lies outside the DEM")


_NEEDED = ("level", "author", "date", "reason")
_DRAWN = ("level", "limit", "author", "date", "reason", "computed")
#: How near the whole of an edit must lie within the terrain model.
_WHOLE = 1.0 - 1e-9
#: Expressions of QGIS for a new edit. Levels below it are those of the zones of the same project.
_DEFAULTS = {
    "author": "@user_full_name",
    "date": "format_date(now(), 'yyyy-MM-dd')",
    "computed": (
        # What was computed below an earlier edit is not in the zones: left open there. Of no zone
        # aggregate makes an empty text.
        "if(aggregate('vector_hazard_zones', 'count', \"zone\", "
        "intersects($geometry, geometry(@parent)) and \"edited\" <> '') > 0, NULL, "
        "coalesce(nullif(aggregate('vector_hazard_zones', 'concatenate', "
        "\"hazard_level\" || ' ' || to_string(round(100 * area(intersection($geometry, "
        "geometry(@parent))) / area(geometry(@parent)))) || ' %', "
        "intersects($geometry, geometry(@parent)), ', '), ''), "
        f"'{NO_LEVEL} 100 %'))"
    ),
}


def edit_fields(codes: Sequence[str], in_result: bool) -> dict[str, FieldInfo]:
    """Return columns of a layer of edits; ``codes`` of the levels are from low to high.

    A layer ``in_result`` lies next to the zones of a result, and says what was computed.
    """
    rows = descriptions()["edits"]
    choices = {"level": (NO_LEVEL, *codes), "limit": ("at_least", "at_most")}
    return {
        name: FieldInfo(
            rows[name]["alias"], rows[name]["unit"], rows[name]["description"],
            choices=choices.get(name, ()),
            default=_DEFAULTS.get(name, "") if in_result or name != "computed" else "",
            needed=name in _NEEDED,
        )
        for name in (*_DRAWN, *(("computed_now", "changed_share") if in_result else ()))
    }  # fmt: skip


def read_edits(settings: EditSettings, preset: HazardPreset, grid: Grid) -> tuple[Edit, ...]:
    """Read edits, and check them against the preset and the terrain model.

    InputError if a column or value is missing, a level is not one of the preset, or a polygon is
    not on the terrain.
    """
    if settings.file is None:
        return ()
    features = read_features(
        settings.file, grid, "edits", layer=settings.layer, fields={c: c for c in _NEEDED},
        kinds=("polygon",), may_be_empty=True,
    )  # fmt: skip
    codes = [NO_LEVEL, *(c.code for c in preset.levels)]
    return tuple(_edit(f, codes, grid) for f in features)


def assessed_area(file: Input | None, layer: str | None, grid: Grid) -> tuple[Any, ...]:
    """Read polygons of what was assessed; InputError if none of them is on the terrain model."""
    if file is None:
        return ()
    field = "hazard.assessed"
    try:
        features = read_features(file, grid, field, layer=layer, kinds=("polygon",))
    except InputError as error:
        # The keys of other layers are file and layer of a section.
        own = {f"{field}.file": field, f"{field}.layer": f"{field}_layer"}
        key = own.get(error.field or "", error.field)
        raise InputError(**error.parts(field=key)) from error
    if not any(share_inside(feature, grid) > 0.0 for feature in features):
        whole = shapely.GeometryCollection([feature.geometry for feature in features])
        raise outside(file, field, "the assessed area", whole.bounds, grid)
    return tuple(feature.geometry for feature in features)


def check_no_edits(settings: EditSettings) -> None:
    """Raise InputError if there are edits; a layer without features is none."""
    if settings.file is None:
        return
    n = len(open_layer(settings.file, settings.layer, "edits", {}, may_be_empty=True))
    if n:
        raise InputError(
            "a batch takes no edits by hand", file=settings.file, field="edits.file",
            found=f"{n} edits", expected="none; sassgis zone takes them",
        )  # fmt: skip


def _edit(feature: Feature, codes: Sequence[str], grid: Grid) -> Edit:
    def text(column: str, expected: str) -> str:
        found = feature.text(column)
        if found is None:
            raise feature.wrong("has no value", column, expected=expected)
        return found

    def one_of(column: str, found: str, known: Sequence[str]) -> int:
        problem = f"{feature.label} has an unknown value"
        refuse_unknown(found, known, problem, file=feature.file, field=column)
        return known.index(found)

    level = one_of("level", text("level", nearest("", codes)), codes)
    limits: tuple[EditLimit, ...] = get_args(EditLimit)
    limit = limits[one_of("limit", feature.text("limit") or "", limits)]
    day = text("date", "a date such as 2026-01-31")[:10]
    try:
        date.fromisoformat(day)
    except ValueError:
        expected = "year-month-day: 2026-01-31"
        raise feature.wrong("has no date", "date", found=repr(day), expected=expected) from None
    if share_inside(feature, grid) < _WHOLE:
        raise outside(feature.file, "edits.file", feature.label, feature.geometry.bounds, grid)
    rows, cols, mask = cells_under(feature.geometry, grid)
    if not (mask & np.isfinite(grid.values[rows, cols])).any():
        expected = "a polygon on the terrain model"
        raise feature.wrong("lies where the terrain is unknown", "edits.file", expected=expected)
    author, reason = text("author", "who made the edit"), text("reason", "why it was made")
    computed = feature.text("computed") or ""
    return Edit(
        geometry=feature.geometry,
        level=level,
        limit=limit,
        author=author,
        date=day,
        reason=reason,
        computed=computed,
    )


def with_earlier(edits: Sequence[Edit], folder: Path) -> tuple[Edit, ...]:
    """Complete edits that lack what was computed below them from an earlier result.

    It is the one in ``folder`` that is replaced, if there is any.
    """
    frame = read_layer(folder / EDITS_FILE, EDITS_LAYER)
    if frame is None or "computed" not in frame:
        return tuple(edits)
    rows = zip(frame.geometry, frame["date"], frame["reason"], frame["computed"], strict=True)
    known = {_key(*row): computed for *row, computed in rows if isinstance(computed, str)}
    return tuple(
        e if e.computed else replace(e, computed=known.get(_key(e.geometry, e.date, e.reason), ""))
        for e in edits
    )


def _key(geometry: Any, day: object, reason: str) -> tuple[bytes, str, str]:
    """Return the key by which an edit differs from all others."""
    parts = shapely.multipolygons(shapely.get_parts(geometry))
    return bytes(shapely.to_wkb(shapely.normalize(parts))), str(day)[:10], reason
