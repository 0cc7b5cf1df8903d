"""Edits of an expert on computed zones."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from sassgis.grid import FloatArray, Grid, IntArray
from sassgis.hazard.zoning.coverage import (
    PRECISION_M,
    Coverage,
    dissolved,
    faces_of,
    without_threads,
)
from sassgis.settings.hazard_rules import NO_LEVEL, Edit

#: From this share of its area on, another computed level below an edit is reported; and only where
#: it is this many times what another sample of blocks changes.
CHANGED_MIN, BEYOND_CHANCE = 0.05, 2.0


@dataclass(frozen=True, slots=True)
class AppliedEdit:
    """An edit with what was computed below it."""

    edit: Edit
    # Share of the edit's area by code of the computed level: of this run, and when the edit was
    # made; the latter is empty if it is not known.
    now: Mapping[str, float]
    then: Mapping[str, float]
    # Share of its area whose level another sample of as many blocks would change.
    by_chance: float = 0.0

    @property
    def changed(self) -> float:
        """Return the least share of the area whose computed level has changed; NaN if unknown."""
        if not self.then:
            return float("nan")
        codes = {*self.now, *self.then}
        return sum(abs(self.now.get(c, 0.0) - self.then.get(c, 0.0)) for c in codes) / 2.0

    @property
    def has_changed(self) -> bool:
        """Return whether the computed level has changed by so much that a user is warned."""
        return self.changed >= max(CHANGED_MIN, BEYOND_CHANCE * self.by_chance)


def shares_text(shares: Mapping[str, float]) -> str:
    """Write shares of levels as the column ``computed``: "mean 62 %, residual_hazard 38 %"."""
    return ", ".join(f"{code} {100.0 * share:.0f} %" for code, share in shares.items())


def shares_of_text(text: str) -> dict[str, float]:
    """Read shares of levels from their text; empty if it is no such list.

    What the text does not name has no level.
    """
    shares: dict[str, float] = {}
    for code, share in re.findall(r"([A-Za-z]\w*) ([0-9.]+) %", text):
        shares[code] = shares.get(code, 0.0) + float(share) / 100.0
    rest = 1.0 - sum(shares.values())
    if shares and rest >= 0.005:
        shares[NO_LEVEL] = shares.get(NO_LEVEL, 0.0) + rest
    return shares


def share_of(area: Any, grid: Grid, cells: IntArray, values: FloatArray) -> float:
    """Average values of cells (flat indices, 0 elsewhere) over an area, however narrow."""
    x, y = grid.cell_centres(cells)
    west, south, east, north = area.bounds
    half = 0.5 * grid.cell_size
    near = (x > west - half) & (x < east + half) & (y > south - half) & (y < north + half)
    near &= values != 0.0
    boxes = shapely.box(x[near] - half, y[near] - half, x[near] + half, y[near] + half)
    shapely.prepare(area)
    common = np.where(shapely.covers(area, boxes), grid.cell_size**2, np.nan)
    cut = np.isnan(common)
    common[cut] = shapely.area(shapely.intersection(area, boxes[cut]))
    return float((common * values[near]).sum() / area.area)


def with_edits(
    zones: Coverage, edits: Sequence[Edit], codes: Sequence[str]
) -> tuple[Coverage, IntArray, tuple[AppliedEdit, ...]]:
    """Return zones with the edits of experts, later ones over earlier ones.

    A place whose level an edit changed is a separate zone. ``codes`` of the levels are from low to
    high. The second value is the edit that made each zone; -1 for none.
    """
    if not edits:
        return zones, np.full(zones.classes.size, -1), ()
    shapes = [shapely.set_precision(e.geometry, PRECISION_M) for e in edits]
    faces = faces_of([*zones.polygons, *shapes])
    inside = shapely.point_on_surface(faces)
    computed = np.zeros(faces.size, np.int64)
    face, zone = shapely.STRtree(zones.polygons).query(inside, predicate="within")
    computed[face] = zones.classes[zone]
    area: FloatArray = shapely.area(faces)
    level, made_by = computed.copy(), np.full(faces.size, -1)
    applied = []
    for number, (edit, shape) in enumerate(zip(edits, shapes, strict=True)):
        shapely.prepare(shape)
        own = shapely.contains(shape, inside)
        applied.append(
            AppliedEdit(
                edit, _shares(computed[own], area[own], codes), shares_of_text(edit.computed)
            )
        )
        acts = own & _acts(edit, level)
        level[acts], made_by[acts] = edit.level, number
    # What is a separate zone: the level first, so that threads join a level that is not lower.
    base = len(edits) + 1
    kinds = without_threads(faces, np.where(level > 0, level * base + made_by + 1, 0))
    drawn = dissolved(faces, kinds)
    return Coverage(drawn.polygons, drawn.classes // base), drawn.classes % base - 1, tuple(applied)


def _acts(edit: Edit, level: IntArray) -> Any:
    """Find where an edit changes or confirms a level."""
    if edit.limit == "at_least":
        return level < edit.level
    if edit.limit == "at_most":
        return level > edit.level
    return np.ones(level.shape, np.bool_)


def _shares(level: IntArray, area: FloatArray, codes: Sequence[str]) -> dict[str, float]:
    """Return the share of an area by level, from high to low; omit what rounds to 0."""
    of_level = np.bincount(level, area, len(codes) + 1) / area.sum()
    names = [NO_LEVEL, *codes]
    order = range(len(codes), -1, -1)
    return {names[k]: float(of_level[k]) for k in order if of_level[k] >= 0.005}
