"""Changes from one result to another: maps, zones, run-out, control lines, objects."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np
import shapely

from sassgis.grid import FloatArray, IntArray
from sassgis.hazard.significance import SampledRates, beyond_sampling
from sassgis.settings.languages import joined, phrase
from sassgis.settings.results import RUNOUT_COUNTS, short, thousands
from sassgis.studies.stored_result import StoredResult


class ComparedMap(NamedTuple):
    """A band of a map."""

    # Of the map of both results.
    stem: str
    band: str
    title: str
    unit: str


LEVEL = ComparedMap("hazard_level", "level", "Hazard level", "class")
REACH = ComparedMap("reach_probability", "reach", "Reach probability", "1")
ENERGY = ComparedMap("energy", "q95", "Kinetic energy, 95 % quantile", "kJ")
HEIGHT = ComparedMap("passing_height", "q95", "Passing height, 95 % quantile", "m")
COMPARED = (REACH, ENERGY, HEIGHT)
REACH_MEAN = "reach probability, mean over the cells reached by either"
ENERGY_MEAN = "energy (95 % quantile), mean over the cells reached by both"
HEIGHT_MEAN = "passing height (95 % quantile), mean over the cells reached by both"
SEED_SHARE = "share that changes level with another random seed"
#: What would be more by both results counts each by itself.
BY_ONE_ONLY = "area reached in one result only"
_RUNOUT = dict(
    zip(
        RUNOUT_COUNTS,
        ("run-out, median", "run-out, 95 % quantile", "run-out, 99 % quantile", "run-out, largest"),
        strict=True,
    )
)
#: Quantity and unit of the columns of control lines.
_AT_LINES = {
    "rocks": ("share of blocks that arrive", "1"),
    "energy_kj_q95": ("energy (95 % quantile)", "kJ"),
    "speed_mps_q95": ("speed (95 % quantile)", "m/s"),
    "height_m_q95": ("passing height (95 % quantile)", "m"),
}
#: Of a map, and what results have of all blocks that reach an object.
_AT_OBJECTS = (
    (REACH, "reach probability, largest of the cells", ""),
    (ENERGY, "energy (95 % quantile), largest of the cells", "energy_q95_kj"),
    (HEIGHT, "passing height (95 % quantile), largest of the cells", "height_q95_m"),
    (LEVEL, "hazard level", ""),
)
_RISK = {"deaths_per_year": ("deaths", "1/year"), "loss_per_year": ("loss", "{}/year")}
_UNKNOWN = (math.nan, math.nan)


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
    limits: tuple[tuple[float, ...], ...] = field(default=(_UNKNOWN, _UNKNOWN), kw_only=True)

    @property
    def change(self) -> float:
        """After less before."""
        return self.after - self.before

    @property
    def same(self) -> bool:
        """Whether nothing changes."""
        if self.quantity == BY_ONE_ONLY:
            return self.before == self.after == 0.0
        return self.before == self.after or (math.isnan(self.before) and math.isnan(self.after))


class SettingChange(NamedTuple):
    """A setting, an input or a version in which two results differ, as text; empty: has none."""

    kind: str
    name: str
    before: str
    after: str


@dataclass(frozen=True, slots=True)
class ResultChange:
    """Changes between two results."""

    rows: tuple[ChangeRow, ...]
    differences: tuple[SettingChange, ...]  # of the two manifests
    # Area of higher and lower hazard level (m²); NaN if levels were not compared.
    higher_m2: float
    lower_m2: float
    # Area on which the reach probability changes beyond the sampling of both, of which a twentieth
    # at most is by chance (m²).
    certain_m2: float
    # Objects with such cells that blocks reach more often, and less often; some may be in both.
    reached: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    notes: tuple[str, ...] = ()  # what a reader must know before comparing numbers

    def row(self, part: str, quantity: str, name: str = "") -> ChangeRow:
        """Return the row of a number."""
        wanted = (part, name, quantity)
        return next(r for r in self.rows if (r.part, r.name, r.quantity) == wanted)

    def of(self, part: str) -> tuple[ChangeRow, ...]:
        """Return the rows of a part."""
        return tuple(r for r in self.rows if r.part == part)

    @property
    def beyond_sampling(self) -> str:
        """Where more changes than chance does, in words."""
        if not self.certain_m2 > 0.0:
            return phrase("No significant change in reach probability.")
        text = "The reach probability changes significantly in cells of {} m²."
        return phrase(text, thousands(self.certain_m2))

    @property
    def verdict(self) -> str:
        """Changes on the whole, in a few sentences."""
        if all(row.same for row in self.rows) and not self.higher_m2 and not self.lower_m2:
            return "Nothing changes. The two results agree in every number compared."
        return joined(" ", self._sentences())

    def lines(self) -> tuple[str, ...]:
        """Return the most important numbers in words, a line each."""
        return (*self._sentences(), *self._object_lines())

    def _sentences(self) -> Iterator[str]:
        area = self.row("map", "area reached")
        before, after = map(thousands, (area.before, area.after))
        if area.before:
            text = "Area of the cells that blocks reach: {} m² before, {} m² after ({} %)."
            share = 100.0 * (area.after / area.before - 1.0)
            yield phrase(text, before, after, _signed(f"{share:+.0f}"))
        else:
            yield phrase(
                "Area of the cells that blocks reach: {} m² before, {} m² after.", before, after
            )
        reach = self.row("map", REACH_MEAN).change
        if math.isfinite(reach):
            text = "Reach probability, mean change over these cells: {} percentage points."
            yield phrase(text, _signed(short(100.0 * reach, "+")))
        energy = self.row("map", ENERGY_MEAN).change
        if math.isfinite(energy):
            text = "Energy (95 % quantile), mean change over the cells reached by both: {} kJ."
            yield phrase(text, _signed(f"{energy:+.3g}"))
        if math.isfinite(self.higher_m2):
            text = "Hazard level of cells, before zones are drawn: higher on {} m², lower on {} m²."
            yield phrase(text, thousands(self.higher_m2), thousands(self.lower_m2))
        texts = (
            "Significantly more blocks reach at least a part of: {}.",
            "Significantly fewer blocks reach at least a part of: {}.",
        )
        for text, names in zip(texts, self.reached, strict=True):
            if names:
                yield phrase(text, ", ".join(names))

    def _object_lines(self) -> Iterator[str]:
        text = "{}: {} {} before, {} after; {} {} % before, {} % after."
        (_, reach_name, _), (_, largest, _), *_ = _AT_OBJECTS
        for name in dict.fromkeys(r.name for r in self.of("object")):
            own = {r.quantity: r for r in self.of("object") if r.name == name}
            energy = own.get(_of_all(largest)) or own[largest]
            reach = own[reach_name]
            before, after = (
                phrase("{} kJ{}", thousands(value), limits_text(limits, thousands))
                for value, limits in zip((energy.before, energy.after), energy.limits, strict=True)
            )
            shares = (short(100.0 * value) for value in (reach.before, reach.after))
            before_after = (phrase(energy.quantity), before, after)
            yield phrase(text, name, *before_after, phrase(reach.quantity), *shares)


def _of_all(quantity: str) -> str:
    """Return the name of a value of an object that is one of all blocks that reach it."""
    return quantity.removesuffix(", largest of the cells")


def _signed(text: str) -> str:
    return text.replace("-", "\u2212")


def limits_text(limits: tuple[float, ...], written: Callable[[float], str]) -> str:
    """Return limits by the sampling in brackets; nothing where none are known."""
    low, high = limits
    if math.isnan(low):
        return ""
    if math.isnan(high):
        return phrase(" ({} or more)", written(low))
    return phrase(" ({} to {})", written(low), written(high))


def difference(before: FloatArray, after: FloatArray) -> FloatArray:
    """Subtract before from after; zero where no block arrives, NaN where none does in either."""
    old, new = np.asarray(before, np.float64), np.asarray(after, np.float64)
    change = np.nan_to_num(new) - np.nan_to_num(old)
    result: FloatArray = np.where(np.isfinite(old) | np.isfinite(new), change, np.nan)
    return result


def compared_maps(before: StoredResult, after: StoredResult) -> tuple[ComparedMap, ...]:
    """Return maps that both results have."""
    return tuple(m for m in COMPARED if m.stem in before.maps and m.stem in after.maps)


def levels_differ(before: StoredResult, after: StoredResult) -> str:
    """State why hazard levels cannot be compared; empty if they can."""
    if LEVEL.stem not in before.maps or LEVEL.stem not in after.maps:
        return "Hazard levels are not compared, because one of the results has none."
    levels = [_levels(r) for r in (before, after)]
    same_preset = before.manifest["preset"] == after.manifest["preset"]
    if len(levels[0]) != len(levels[1]) or not all(
        # In whatever language they are named. A level without a zone has its label for a code.
        one == other or code == other_code or (same_preset and (code == one or other_code == other))
        for (one, code), (other, other_code) in zip(*levels, strict=True)
    ):
        return "Hazard levels are not compared, because the two presets have different levels."
    widths = [r.manifest["ref_widths_m"]["hazard"] for r in (before, after)]
    if widths[0] != widths[1]:
        text = (
            "Hazard levels are not compared, because their reference widths differ ({} m and {} m)."
        )
        return phrase(text, *(f"{width:g}" for width in widths))
    return ""


def _levels(result: StoredResult) -> list[tuple[str, str]]:
    """Return label and code of the levels, low to high; the label again where no code is known."""
    labels = [c.label for c in sorted(result.maps[LEVEL.stem].classes, key=lambda c: c.value)]
    return list(zip(labels, result.level_codes or labels, strict=True))


def result_change(
    before: StoredResult,
    after: StoredResult,
    objects: tuple[Sequence[str], IntArray, IntArray],
    notes: Sequence[str] = (),
) -> ResultChange:
    """Compare two results on the same cells.

    ``objects`` are the names of the whole objects; cells that they touch, and the position of the
    object of each. The notes are said besides.
    """
    both = before, after
    why = levels_differ(before, after)
    cell_m2 = before.grid.cell_size**2
    higher = lower = math.nan
    if not why:
        change = difference(*(r.band(*LEVEL[:2]) for r in both))
        if np.isfinite(change).any():
            higher, lower = (float((s * change > 0.0).sum() * cell_m2) for s in (1.0, -1.0))
    one_has_levels = LEVEL.stem in {*before.maps, *after.maps}
    maps = compared_maps(*both)
    rows = (
        *_map_rows(both, maps),
        *(() if why else _zone_rows(both)),
        *_runout_rows(both),
        *_control_line_rows(both),
        *_object_rows(both, maps if why else (*maps, LEVEL), *objects),
    )
    certain = _certain(both)
    return ResultChange(
        rows, tuple(_differences(before.manifest, after.manifest)), higher, lower,
        certain_m2=float(certain.sum() * cell_m2), reached=_reached(both, certain, *objects),
        notes=(*notes, *([why] if why and one_has_levels else [])),
    )  # fmt: skip


_Both = tuple[StoredResult, StoredResult]


def _certain(both: _Both) -> np.ndarray:
    """Return cells whose reach probability differs by more than both samples explain."""

    def shares(result: StoredResult) -> SampledRates:
        reach = result.band(*REACH[:2]).ravel()
        error = result.band(REACH.stem, "standard_error").ravel()
        variance = np.where(np.isfinite(reach), error**2, 0.0)
        return SampledRates(reach, variance, 1.0 / max(result.blocks, 1), result.freedom)

    return beyond_sampling(*map(shares, both))


def _reached(
    both: _Both, certain: np.ndarray, names: Sequence[str], cells: IntArray, owner: IntArray
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return objects with a cell that is certainly reached more often, and less often."""
    change = np.where(certain, difference(*(r.band(*REACH[:2]).ravel() for r in both)), 0.0)[cells]
    more, fewer = (np.unique(owner[sign * change > 0.0]).tolist() for sign in (1.0, -1.0))
    return tuple(names[i] for i in more), tuple(names[i] for i in fewer)


def _map_rows(both: _Both, maps: Sequence[ComparedMap]) -> Iterator[ChangeRow]:
    cell_m2 = both[0].grid.cell_size ** 2
    was, now = (np.isfinite(r.band(*REACH[:2])) for r in both)
    for name, cells in (("area reached", (was, now)), (BY_ONE_ONLY, (was & ~now, now & ~was))):
        yield ChangeRow("map", "", name, "m2", *(float(c.sum() * cell_m2) for c in cells))
    for compared, name in zip(COMPARED, (REACH_MEAN, ENERGY_MEAN, HEIGHT_MEAN), strict=True):
        if compared in maps:
            values = [r.band(*compared[:2]) for r in both]
            known = [np.isfinite(v) for v in values]
            own = known[0] | known[1] if compared is REACH else known[0] & known[1]
            means = (float(np.nan_to_num(v)[own].mean()) if own.any() else math.nan for v in values)
            yield ChangeRow("map", "", name, compared.unit, *means)


def _zone_rows(both: _Both) -> Iterator[ChangeRow]:
    zones = [r.zones for r in both if r.zones is not None]
    if len(zones) < 2:
        return
    codes = dict(enumerate(both[1].level_codes, 1))
    for entry in sorted(both[1].maps[LEVEL.stem].classes, key=lambda c: -c.value):
        own = (shapely.area(z.polygons[z.classes == entry.value]).sum() for z in zones)
        yield ChangeRow("zones", entry.label, "area of zones", "m2", *map(float, own))
        changed = [r.seed_share(codes.get(int(entry.value), "")) for r in both]
        if not all(map(math.isnan, changed)):
            yield ChangeRow("zones", entry.label, SEED_SHARE, "1", *changed)


def _runout_rows(both: _Both) -> Iterator[ChangeRow]:
    yield ChangeRow("run-out", "", "blocks that started (weighted)", "1", *(r.blocks for r in both))
    counts = [r.manifest["counts"] for r in both]
    for key, name in _RUNOUT.items():
        if any(key in own for own in counts):
            values = (float(own.get(key, math.nan)) for own in counts)
            yield ChangeRow("run-out", "", name, "m", *values)


def _control_line_rows(both: _Both) -> Iterator[ChangeRow]:
    for name in dict.fromkeys(name for r in both for name in r.control_lines):
        for column, (quantity, unit) in _AT_LINES.items():
            values = [float(r.control_lines.get(name, {}).get(column, math.nan)) for r in both]
            if column == "rocks":
                values = [v / max(r.blocks, 1) for v, r in zip(values, both, strict=True)]
            yield ChangeRow("control line", name, quantity, unit, *values)


def _object_rows(
    both: _Both, maps: Sequence[ComparedMap], names: Sequence[str], cells: IntArray, owner: IntArray
) -> Iterator[ChangeRow]:
    """Yield the loads on each object; 0 where no block arrives."""
    # Energy and height are those of all blocks that reach it, where both results have them, else,
    # as all others, the largest values over its cells.
    shown = [
        (quantity, m.unit, key, [r.band(*m[:2]).ravel() for r in both])
        for m, quantity, key in _AT_OBJECTS
        if m in maps
    ]
    currency = str(both[1].manifest["settings"].get("risk", {}).get("currency", "value"))
    for number, name in enumerate(names):
        own = cells[owner == number]
        for quantity, unit, key, values in shown:
            found = [r.values.get(name, {}).get(key) for r in both]
            largest = [float(np.nan_to_num(v[own]).max(initial=0.0)) for v in values]
            limits: tuple[tuple[float, ...], ...] = (_UNKNOWN, _UNKNOWN)
            if all(found):
                (one, *first), (two, *second) = (pooled or () for pooled in found)
                largest = [float(np.nan_to_num(v)) for v in (one, two)]
                limits = tuple(first), tuple(second)
            shown_as = _of_all(quantity) if all(found) else quantity
            yield ChangeRow("object", name, shown_as, unit, *largest, limits=limits)
        risks = [r.risk.get(name) for r in both]
        for column, (quantity, unit) in _RISK.items() if any(risks) else ():
            sums = (math.nan if r is None else r[column] for r in risks)
            yield ChangeRow("object", name, quantity, phrase(unit, currency), *sums)


# ---------------------------------------------------------------------------------------------
# Manifests


def _differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[SettingChange]:
    """Yield how two manifests differ: version, seed, settings, input contents, libraries."""
    old, new = _facts(before), _facts(after)
    for kind in old:
        yield from _changes(kind, old[kind], new[kind])


def setting_changes(
    before: Mapping[str, Any], after: Mapping[str, Any]
) -> tuple[SettingChange, ...]:
    """Return settings that are not equal, by dotted key; files are equal if they have one name."""
    return tuple(_changes("setting", dict(_flat(before)), dict(_flat(after))))


def _changes(kind: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[SettingChange]:
    """Yield how facts of a kind differ, by name."""
    for name in sorted({*old, *new}):
        one, two = old.get(name), new.get(name)
        if kind == "input":
            # By the contents, wherever they lie.
            mine, theirs = one or {}, two or {}
            one = {digest: path for digest, path in mine.items() if digest not in theirs}
            two = {digest: path for digest, path in theirs.items() if digest not in mine}
        if one != two and not _same_file(one, two):
            shown = name.partition(":")[0] if kind == "input" else name
            yield SettingChange(kind, shown, _text(one), _text(two))


def _facts(manifest: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the compared facts by kind and name; of inputs the path by the digest."""
    inputs: dict[str, dict[str, str]] = {}
    for entry in manifest["inputs"]:
        # The settings of a configuration are compared one by one.
        if not entry["role"].startswith("config"):
            # By the kind of file: there may be many tiles.
            name = f"{entry['role']}: {PurePath(entry['path']).suffix}"
            inputs.setdefault(name, {})[entry["sha256"]] = entry["path"]
    # Results of a zoning stand among its settings.
    settings = {k: v for k, v in manifest["settings"].items() if k != "zoning"}
    return {
        "program": {"sassgis": manifest["sassgis"]},
        "seed": {"seed": manifest["seed"]},
        "preset": {"preset": manifest["preset"]},
        "setting": dict(_flat(settings)),
        "input": inputs,
        "library": dict(manifest["versions"]),
    }


def _flat(value: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Yield settings by dotted name; items of a list by their name, if they have one."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _flat(entry, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
        for number, entry in enumerate(value, start=1):
            yield from _flat(entry, f"{name}.{entry.get('name', number)}")
    else:
        yield name, value


def _same_file(one: object, two: object) -> bool:
    """Return whether settings name files of one name; their contents are compared as inputs."""
    if not isinstance(one, str) or not isinstance(two, str):
        return False
    paths = PurePath(one), PurePath(two)
    return paths[0].name == paths[1].name and any(len(p.parts) > 1 for p in paths)


def _text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, Mapping):
        return ", ".join(f"{path} ({digest[:8]})" for digest, path in value.items())
    if isinstance(value, list):
        return " to ".join(map(str, value)) if len(value) == 2 else ", ".join(map(str, value))
    return str(value)
