"""Edits of experts from a vector file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any, get_args

import numpy as np
import shapely

from sassgis.errors import InputError
from sassgis.files.vector_layer import descriptions
from sassgis.grid import Grid
from sassgis.inputs.result_folder import EDITS_FILE, EDITS_LAYER, read_layer
from sassgis.inputs.vector_features import (
    Feature,
    cells_under,
    nearest,
    open_layer,
    outside,
    read_features,
    refuse_unknown,
    share_inside,
)
from sassgis.settings.hazard_rules import NO_LEVEL, Edit, EditLimit, EditSettings, HazardPreset
from sassgis.settings.styles import FieldInfo

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
    return Edit(feature.geometry, level, limit, author, day, reason, computed)


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
