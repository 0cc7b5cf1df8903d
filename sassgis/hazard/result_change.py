"""What changes from one result to another: maps, zones, run-out, control lines, objects."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

import numpy as np
import shapely

from sassgis.hazard.beyond_sampling import beyond_sampling
from sassgis.hazard.stored_result import StoredResult
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.labels import short
from sassgis.model.languages import phrase

LEVEL = "hazard_level"
REACH_MEAN = "reach probability, mean over the cells reached by either"
ENERGY_MEAN = "energy (95 % quantile), mean over the cells reached by both"
HEIGHT_MEAN = "passing height (95 % quantile), mean over the cells reached by both"
_RUNOUT = (
    ("run-out, median", 0.5),
    ("run-out, 95 % quantile", 0.95),
    ("run-out, 99 % quantile", 0.99),
    ("run-out, largest", 1.0),
)


@dataclass(frozen=True, slots=True)
class ComparedMap:
    """A map of which two results have the same band."""

    # Of the map of both.
    stem: str
    band: str
    title: str
    unit: str


REACH = ComparedMap("reach_probability", "reach", "Reach probability", "1")
ENERGY = ComparedMap("energy", "q95", "Kinetic energy, 95 % quantile", "kJ")
HEIGHT = ComparedMap("passing_height", "q95", "Passing height, 95 % quantile", "m")
COMPARED = (REACH, ENERGY, HEIGHT)


@dataclass(frozen=True, slots=True)
class ChangeRow:
    """One number before and after."""

    part: str
    name: str  # of the level, control line or object; empty where there is one only
    quantity: str
    unit: str
    # NaN where a result does not have it.
    before: float
    after: float
    # Low and high by the sampling of blocks, before and after; NaN where none are known.
    limits: tuple[tuple[float, ...], ...] = field(default=((math.nan, math.nan),) * 2, kw_only=True)

    @property
    def change(self) -> float:
        """After less before."""
        return self.after - self.before


@dataclass(frozen=True, slots=True)
class SettingChange:
    """A setting, an input or a version in which two results differ, as text; empty: has none."""

    kind: str
    name: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class ResultChange:
    """What changes from one result to another."""

    rows: tuple[ChangeRow, ...]
    differences: tuple[SettingChange, ...]  # of the two manifests
    # Area of higher and lower hazard level (m²); NaN if levels were not compared.
    higher_m2: float
    lower_m2: float
    # Area on which the reach probability changes beyond the sampling of both, of which a twentieth
    # at most is by chance (m²).
    certain_m2: float
    notes: tuple[str, ...] = ()  # what a reader must know before comparing numbers

    def row(self, part: str, quantity: str, name: str = "") -> ChangeRow:
        """The row of a number."""
        wanted = (part, name, quantity)
        return next(r for r in self.rows if (r.part, r.name, r.quantity) == wanted)

    def of(self, part: str) -> tuple[ChangeRow, ...]:
        """The rows of a part."""
        return tuple(r for r in self.rows if r.part == part)

    @property
    def beyond_sampling(self) -> str:
        """Where more changes than chance does, in words."""
        if not self.certain_m2 > 0.0:
            return phrase(
                "Nowhere does the reach probability change by more than the sampling explains."
            )
        text = "More than the sampling of the blocks explains: on {} m²."
        return phrase(text, f"{self.certain_m2:,.0f}")

    def lines(self) -> tuple[str, ...]:
        """The most important numbers in words."""
        area = self.row("map", "area reached")
        share = 100.0 * (area.after / area.before - 1.0) if area.before else math.nan
        before, after = (f"{value:,.0f}" for value in (area.before, area.after))
        text = "Area that blocks reach: {} m² before, {} m² after ({} %)."
        out = [
            phrase(text, before, after, _signed(share, ".0f"))
            if math.isfinite(share)
            else phrase("Area that blocks reach: {} m² before, {} m² after.", before, after)
        ]
        reach = self.row("map", REACH_MEAN).change
        if math.isfinite(reach):
            text = "Reach probability, mean change over these cells: {} percentage points."
            out.append(phrase(text, short(100.0 * reach, "+").replace("-", "\u2212")))
        energy = self.row("map", ENERGY_MEAN).change
        if math.isfinite(energy):
            text = "Energy (95 % quantile), mean change over the cells reached by both: {} kJ."
            out.append(phrase(text, _signed(energy, ".3g")))
        if math.isfinite(self.higher_m2):
            text = "Hazard level: higher on {} m², lower on {} m²."
            out.append(phrase(text, f"{self.higher_m2:,.0f}", f"{self.lower_m2:,.0f}"))
        return (*out, *self._object_lines())

    def _object_lines(self) -> Iterator[str]:
        text = (
            "{}: energy (95 % quantile) {} before, {} after; reach probability {} % before, "
            "{} % after."
        )
        for name in dict.fromkeys(r.name for r in self.of("object")):
            energy = self.row("object", "energy (95 % quantile)", name)
            reach = self.row("object", "reach probability", name)
            before, after = (
                phrase("{} kJ{}", f"{value:,.0f}", limits_text(limits, "{:,.0f}".format))
                for value, limits in zip((energy.before, energy.after), energy.limits, strict=True)
            )
            shares = (short(100.0 * value) for value in (reach.before, reach.after))
            yield phrase(text, name, before, after, *shares)


def _signed(value: float, spec: str) -> str:
    return f"{value:+{spec}}".replace("-", "\u2212")


def limits_text(limits: tuple[float, ...], written: Callable[[float], str]) -> str:
    """Limits by the sampling in brackets; nothing where none are known."""
    low, high = limits
    if math.isnan(low):
        return ""
    if math.isnan(high):
        return phrase(" ({} or more)", written(low))
    return phrase(" ({} to {})", written(low), written(high))


def difference(before: FloatArray, after: FloatArray) -> FloatArray:
    """After less before; where no block arrives counts as zero, NaN where none does in either."""
    old, new = np.asarray(before, np.float64), np.asarray(after, np.float64)
    change = np.nan_to_num(new) - np.nan_to_num(old)
    result: FloatArray = np.where(np.isfinite(old) | np.isfinite(new), change, np.nan)
    return result


def compared_maps(before: StoredResult, after: StoredResult) -> tuple[ComparedMap, ...]:
    """Maps that both results have."""
    return tuple(m for m in COMPARED if m.stem in before.maps and m.stem in after.maps)


def _same_levels(before: StoredResult, after: StoredResult) -> bool:
    """Whether the classes of two maps are the same levels, in whatever language they are named."""
    levels = [_levels(r) for r in (before, after)]
    if len(levels[0]) != len(levels[1]):
        return False
    same_preset = before.manifest["preset"] == after.manifest["preset"]
    for (one, code), (other, other_code) in zip(*levels, strict=True):
        # A level without a zone has its label for a code.
        unknown = code == one or other_code == other
        if one != other and code != other_code and not (unknown and same_preset):
            return False
    return True


def _levels(result: StoredResult) -> list[tuple[str, str]]:
    """Label and code of the levels from low to high; the label again where no code is known."""
    labels = [c.label for c in sorted(result.maps[LEVEL].classes, key=lambda c: c.value)]
    return list(zip(labels, result.level_codes or labels, strict=True))


def levels_differ(before: StoredResult, after: StoredResult) -> str:
    """Why hazard levels cannot be compared; empty if they can."""
    if LEVEL not in before.maps or LEVEL not in after.maps:
        return "Hazard levels are not compared: not both results have them."
    if not _same_levels(before, after):
        return "Hazard levels are not compared: the two presets have different levels."
    widths = [r.manifest["ref_widths_m"]["hazard"] for r in (before, after)]
    if widths[0] != widths[1]:
        text = "Hazard levels are not compared: their reference widths are {} m and {} m."
        return phrase(text, *(f"{width:g}" for width in widths))
    return ""


def result_change(
    before: StoredResult,
    after: StoredResult,
    objects: tuple[Sequence[str], IntArray, IntArray],
    notes: Sequence[str] = (),
) -> ResultChange:
    """Compare two results on the same cells.

    Parameters
    ----------
    before, after : StoredResult
        From :func:`sassgis.hazard.stored_result.on_common_cells`.
    objects : (names, cells, owner)
        Names of the whole objects; cells that they touch, and the position of the object of each.
    notes : sequence of str
        What is to be said besides.
    """
    why = levels_differ(before, after)
    level_change = np.full(1, np.nan)
    if not why:
        level_change = difference(*(r.band(LEVEL, "level") for r in (before, after)))
    cell_m2 = before.grid.cell_size**2
    found = np.isfinite(level_change).any()
    return ResultChange(
        (
            *_map_rows(before, after),
            *(() if why else _zone_rows(before, after)),
            *_runout_rows(before, after),
            *_control_line_rows(before, after),
            *_object_rows(before, after, *objects, levels=not why),
        ),
        tuple(_differences(before.manifest, after.manifest)),
        float((level_change > 0.0).sum() * cell_m2) if found else math.nan,
        float((level_change < 0.0).sum() * cell_m2) if found else math.nan,
        float(_beyond_sampling(before, after).sum() * cell_m2),
        (*notes, *([why] if why and LEVEL in {*before.maps, *after.maps} else [])),
    )


def _beyond_sampling(before: StoredResult, after: StoredResult) -> np.ndarray:
    """Cells whose reach probability differs by more than both samples explain."""
    reach, errors = (
        [r.band(REACH.stem, band).ravel() for r in (before, after)]
        for band in (REACH.band, "standard_error")
    )
    one, two = (np.where(np.isfinite(p), e**2, 0.0) for p, e in zip(reach, errors, strict=True))
    of_a_block = (1.0 / max(before.blocks, 1), 1.0 / max(after.blocks, 1))
    freedom = (before.freedom, after.freedom)
    return beyond_sampling((reach[0], reach[1]), (one, two), of_a_block, freedom)


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else math.nan


def _map_rows(before: StoredResult, after: StoredResult) -> Iterator[ChangeRow]:
    cell_m2 = before.grid.cell_size**2
    old, new = (r.band(REACH.stem, REACH.band) for r in (before, after))
    was, now = np.isfinite(old), np.isfinite(new)
    yield ChangeRow("map", "", "area reached", "m2", was.sum() * cell_m2, now.sum() * cell_m2)
    yield ChangeRow(
        "map", "", "area reached by one of them only", "m2",
        float((was & ~now).sum() * cell_m2), float((now & ~was).sum() * cell_m2),
    )  # fmt: skip
    either = was | now
    yield ChangeRow(
        "map", "", REACH_MEAN, "1", *(_mean(np.nan_to_num(v)[either]) for v in (old, new))
    )
    for compared, quantity in ((ENERGY, ENERGY_MEAN), (HEIGHT, HEIGHT_MEAN)):
        if compared in compared_maps(before, after):
            values = [r.band(compared.stem, compared.band) for r in (before, after)]
            both = np.isfinite(values[0]) & np.isfinite(values[1])
            yield ChangeRow("map", "", quantity, compared.unit, *(_mean(v[both]) for v in values))


def _zone_rows(before: StoredResult, after: StoredResult) -> Iterator[ChangeRow]:
    if before.zones is None or after.zones is None:
        return
    for entry in sorted(after.maps[LEVEL].classes, key=lambda c: -c.value):
        areas = [
            float(shapely.area(z.polygons[z.classes == entry.value]).sum())
            for z in (before.zones, after.zones)
        ]
        yield ChangeRow("zones", entry.label, "area of zones", "m2", *areas)


def _runout_rows(before: StoredResult, after: StoredResult) -> Iterator[ChangeRow]:
    yield ChangeRow("run-out", "", "blocks that started", "1", before.blocks, after.blocks)
    if not before.runout_m.size and not after.runout_m.size:
        return
    for name, share in _RUNOUT:
        values = [
            float(np.quantile(r.runout_m, share)) if r.runout_m.size else math.nan
            for r in (before, after)
        ]
        yield ChangeRow("run-out", "", name, "m", *values)


_AT_LINES = (
    ("energy_kj_q95", "energy (95 % quantile)", "kJ"),
    ("speed_mps_q95", "speed (95 % quantile)", "m/s"),
    ("height_m_q95", "passing height (95 % quantile)", "m"),
)


def _control_line_rows(before: StoredResult, after: StoredResult) -> Iterator[ChangeRow]:
    for name in dict.fromkeys([*before.control_lines, *after.control_lines]):
        rows = [r.control_lines.get(name) for r in (before, after)]
        shares = [
            math.nan if row is None else float(row["rocks"]) / max(result.blocks, 1)
            for row, result in zip(rows, (before, after), strict=True)
        ]
        yield ChangeRow("control line", name, "share of blocks that arrive", "1", *shares)
        for column, quantity, unit in _AT_LINES:
            values = [math.nan if row is None else float(row[column]) for row in rows]
            yield ChangeRow("control line", name, quantity, unit, *values)


#: Of a map, and what results have of all blocks that reach an object.
_AT_OBJECTS = (
    (REACH, "reach probability", ""),
    (ENERGY, "energy (95 % quantile)", "energy_q95_kj"),
    (HEIGHT, "passing height (95 % quantile)", "height_q95_m"),
)
_RISK = (("deaths_per_year", "deaths", "1/year"), ("loss_per_year", "loss", "{}/year"))


def _object_rows(
    before: StoredResult,
    after: StoredResult,
    names: Sequence[str],
    cells: IntArray,
    owner: IntArray,
    *,
    levels: bool,
) -> Iterator[ChangeRow]:
    """What comes to each object; 0 where no block arrives.

    Energy and height are those of all blocks that reach it, where both results have them, else, as
    all others, the largest values over its cells.
    """
    results = before, after
    maps = [own for own in _AT_OBJECTS if own[0] in compared_maps(before, after)]
    if levels:
        maps.append((ComparedMap(LEVEL, "level", "", "class"), "hazard level", ""))
    shown = [
        (quantity, m.unit, key, [r.band(m.stem, m.band).ravel() for r in results])
        for m, quantity, key in maps
    ]
    for number, name in enumerate(names):
        own = cells[owner == number]
        for quantity, unit, key, values in shown:
            pooled = [r.values.get(name, {}).get(key) for r in results]
            if all(pooled):
                (one, *first), (two, *second) = (p or () for p in pooled)
                both = float(np.nan_to_num(one)), float(np.nan_to_num(two))
                limits = tuple(first), tuple(second)
                yield ChangeRow("object", name, quantity, unit, *both, limits=limits)
                continue
            largest = [float(np.nan_to_num(v[own]).max(initial=0.0)) for v in values]
            yield ChangeRow("object", name, quantity, unit, *largest)
        risks = [r.risk.get(name) for r in results]
        if any(risks):
            currency = str(after.manifest["settings"].get("risk", {}).get("currency", "value"))
            for column, quantity, unit in _RISK:
                yield ChangeRow(
                    "object", name, quantity, phrase(unit, currency),
                    *(math.nan if r is None else r[column] for r in risks),
                )  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Manifests


def _inputs(manifest: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Path by digest of the inputs of each role, by the kind of file: there may be many tiles."""
    found: dict[str, dict[str, str]] = {}
    for entry in manifest["inputs"]:
        name = f"{entry['role']}: {PurePath(entry['path']).suffix}"
        found.setdefault(name, {})[entry["sha256"]] = entry["path"]
    return found


def _differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[SettingChange]:
    """In what two manifests differ: version, seed, settings, contents of the inputs, libraries."""
    for kind, key in (("program", "sassgis"), ("seed", "seed"), ("preset", "preset")):
        if before[key] != after[key]:
            yield SettingChange(kind, key, str(before[key]), str(after[key]))
    # What a zoning found stands among its settings.
    old, new = (
        dict(_flat({k: v for k, v in m["settings"].items() if k != "zoning"}))
        for m in (before, after)
    )
    for name in sorted({*old, *new}):
        one, two = old.get(name), new.get(name)
        if one != two and not _same_file(one, two):
            yield SettingChange("setting", name, _text(one), _text(two))
    inputs = [_inputs(m) for m in (before, after)]
    for name in sorted({*inputs[0], *inputs[1]}):
        one, two = (found.get(name, {}) for found in inputs)
        # The settings of a configuration are compared one by one.
        if one.keys() != two.keys() and not name.startswith("config"):
            texts = (
                ", ".join(
                    f"{path} ({digest[:8]})" for digest, path in own.items() if digest not in other
                )
                for own, other in ((one, two), (two, one))
            )
            yield SettingChange("input", name.partition(":")[0], *texts)
    for name in sorted({*before["versions"], *after["versions"]}):
        versions = [m["versions"].get(name, "") for m in (before, after)]
        if versions[0] != versions[1]:
            yield SettingChange("library", name, *versions)


def _flat(value: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Settings by dotted name; items of a list by their own name, if they have one."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _flat(entry, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
        for number, entry in enumerate(value, start=1):
            yield from _flat(entry, f"{name}.{entry.get('name', number)}")
    else:
        yield name, value


def _same_file(one: object, two: object) -> bool:
    """Whether two settings name files of the same name: their contents are compared as inputs."""
    if not isinstance(one, str) or not isinstance(two, str):
        return False
    paths = PurePath(one), PurePath(two)
    return paths[0].name == paths[1].name and any(len(p.parts) > 1 for p in paths)


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return " to ".join(map(str, value)) if len(value) == 2 else ", ".join(map(str, value))
    return str(value)
