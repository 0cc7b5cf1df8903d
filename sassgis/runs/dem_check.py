"""Whether a terrain model will do for rockfall: one page of findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from affine import Affine
from scipy import ndimage

from sassgis.errors import InputError
from sassgis.files.atomic_output import staged_file
from sassgis.grid import BoolArray, FloatArray, Grid
from sassgis.inputs.dem import few_values
from sassgis.inputs.dem_raw import RawDem, read_raw_dem
from sassgis.inputs.dem_system import in_options
from sassgis.outputs.geopackage import write_geopackage
from sassgis.outputs.layers.run_vectors import defective_cells
from sassgis.report.page import ReportContext, ReportTable, write_report
from sassgis.runs.inputs import collected_notices
from sassgis.settings.crs import crs_name
from sassgis.terrain.dem_defects import (
    TRACES_ADVICE,
    NodataTraces,
    bumps_m,
    contour_interval,
    depression_depth,
    equal_neighbours,
    height_step,
    inner_holes,
    nodata_traces,
)
from sassgis.terrain.edge import ANGLE_DEG, BeyondEdge, beyond_edge
from sassgis.terrain.slope_units import WALL_DEG, WALL_SHARE, slopes_deg, wall_share

Verdict = Literal["good", "look", "bad"]

# The limits are expert judgement of ours; docs/starting.md gives the reason of each.
#: Cells up to these sizes are good, and deserve a look (m).
_CELL_M = (2.0, 10.0)
#: Slope errors from the step of the heights, likewise (degrees).
_STEP_ERROR_DEG = (1.0, 3.0)
#: Shares of equal neighbours on ground that is not level, likewise.
_EQUAL = (0.05, 0.3)
#: Ground on which blocks may start is steeper than this (degrees).
_STEEP_DEG = 30.0
#: Ground from which blocks come wherever it is, and how far their energy lines may leave the model
#: without a word, as there is steep ground near most edges (degrees, m).
_CLIFF_DEG, _BEYOND_M = 45.0, 100.0
#: A spike or single pit stands out by this (m), or by the width of a cell if that is more.
_BUMP_M = 0.5
#: More of them than this share of the cells and this number, or one higher than this (m), is bad.
_BUMP_SHARE, _BUMP_COUNT, _BUMP_BAD_M = 1e-4, 3, 10.0
#: Depressions count from this depth on, and deserve a look from that or that share on.
_DEPRESSION_M, _DEEP_M, _DEPRESSION_SHARE = 0.5, 2.0, 0.001


@dataclass(frozen=True, slots=True)
class DemFinding:
    """One item of the page."""

    item: str
    verdict: Verdict
    found: str
    advice: str  # what to do about it; empty if nothing
    numbers: dict[str, Any]  # for programs


@dataclass(frozen=True, slots=True)
class DemReport:
    """All findings on a terrain model."""

    file: Path
    findings: tuple[DemFinding, ...]
    #: By item, of the shape of the model: how much is wrong with a cell; 0: nothing.
    cells: Mapping[str, FloatArray]
    transform: Affine  # from columns and rows to coordinates
    crs: str  # well-known text; empty if not known

    @property
    def verdict(self) -> Verdict:
        """The worst of all."""
        order: tuple[Verdict, ...] = ("bad", "look", "good")
        return next(v for v in order if any(f.verdict == v for f in self.findings))

    @property
    def sentence(self) -> str:
        """The answer in a line."""
        named = {
            v: ", ".join(f.item for f in self.findings if f.verdict == v) for v in ("bad", "look")
        }
        parts = [f"bad: {named['bad']}"] if named["bad"] else []
        parts += [f"check: {named['look']}"] if named["look"] else []
        return "; ".join(parts) or "no fault"

    def lines(self) -> list[str]:
        """Return the page for people, line by line."""
        out = [f"{self.file}: {self.sentence}"]
        for f in self.findings:
            out.append(f"{f.verdict:<6}{f.item:<19}{f.found}")
            out += [f"{'':<25}{f.advice}"] if f.advice else []
        return out

    def suggestion(self, options: str = "") -> str:
        """Return how to see the cells on a map, with these options; empty if there are none."""
        where = ", ".join(self.cells)
        call = f"sassgis dem check {self.file}{options} -o dem_check.gpkg"
        return where and f"In QGIS ({where}): {call}"

    def as_dict(self) -> dict[str, Any]:
        """Return the page for programs."""
        return {
            "file": str(self.file),
            "verdict": self.verdict,
            "findings": [asdict(f) for f in self.findings],
        }


def check_dem(path: Path, crs: str | None = None, override_crs: bool = False) -> DemReport:
    """Judge a terrain model, a raster or a folder of tiles.

    ``crs`` is its coordinate system, where the file states none, or with ``override_crs`` in place
    of it.
    """
    with collected_notices() as notices:
        dem = read_raw_dem(path, crs, override_crs)
    slopes = slopes_deg(dem.values, dem.dx_m, dem.dy_m)
    bumps, depth = bumps_m(dem.values), depression_depth(dem.values)
    traces = nodata_traces(dem.values, max(dem.dx_m, dem.dy_m))
    beyond = _beyond(dem, slopes)
    found = {
        "coordinate system": _system(dem, notices),
        "units": _units(dem),
        "nodata": _nodata(dem, traces),
        "resolution": _resolution(dem),
        "steepness": _steepness(slopes),
        "terraces": _terraces(dem),
        "spikes": _bumps(dem, bumps, "stand out"),
        "pits": _bumps(dem, -bumps, "lie low"),
        "depressions": _depressions(dem, depth),
        "extent": _extent(dem, beyond),
    }
    findings = tuple(DemFinding(item, *own) for item, own in found.items())
    least = _least_bump_m(dem)
    cells = {
        "nodata": (inner_holes(dem.values) | traces.cells).astype(float),
        "steepness": np.where(np.nan_to_num(slopes) > WALL_DEG, slopes, 0.0),
        "spikes": np.where(bumps >= least, bumps, 0.0),
        "pits": np.where(-bumps >= least, -bumps, 0.0),
        "depressions": np.where(depth >= _DEPRESSION_M, depth, 0.0),
        "extent": _edge_cells(dem, beyond),
    }
    shown = {f.item for f in findings if f.verdict != "good"}
    wrong = {item: own for item, own in cells.items() if item in shown and own.any()}
    return DemReport(path, findings, wrong, dem.transform, dem.crs)


def write_dem_cells(file: Path, report: DemReport, overwrite: bool = False) -> None:
    """Write the cells that deserve a look as a layer of a GeoPackage."""
    if file.suffix.lower() != ".gpkg":
        raise InputError("is no GeoPackage", file=file, expected="a name ending in .gpkg")
    with staged_file(file, overwrite) as work:
        layer = defective_cells(report.cells, report.transform, report.crs)
        write_geopackage(work, [layer], {"terrain": report.file.name})


def write_dem_page(file: Path, report: DemReport, overwrite: bool = False) -> None:
    """Write the findings as one HTML page."""
    rows = tuple((f.item, f.verdict, f.found, f.advice) for f in report.findings)
    columns = (("item", ""), ("verdict", ""), ("found", ""), ("what to do", ""))
    context = ReportContext(
        title=f"Terrain model {report.file.name}",
        verdict=report.sentence.capitalize() + ".",
        key_results=ReportTable("Findings", columns, rows, "Limits: docs/starting.md."),
    )
    with staged_file(file, overwrite) as work:
        write_report(work, context)


def _grade(value: float, limits: tuple[float, float]) -> Verdict:
    return "good" if value <= limits[0] else "look" if value <= limits[1] else "bad"


#: Verdict, what was found, advice and numbers of an item.
_Found = tuple[Verdict, str, str, dict[str, Any]]


def _system(dem: RawDem, notices: list[str]) -> _Found:
    fault = dem.system_fault
    if fault is not None:
        found = fault.problem if fault.found is None else f"{fault.problem}: {fault.found}"
        return "bad", found, f"expected {in_options(fault.expected or '')}", {}
    own = [n.partition(": ")[2] for n in notices if not (dem.gaps and n.endswith(dem.gaps))]
    return "look" if own else "good", crs_name(dem.crs), "; ".join(own), {}


def _units(dem: RawDem) -> _Found:
    low, high = float(np.nanmin(dem.values)), float(np.nanmax(dem.values))
    numbers = {"lowest_m": low, "highest_m": high, "unit": dem.unit, "datum": dem.vertical_datum}
    found = f"heights from {low:.1f} to {high:.1f} m, " + (
        f"height system {dem.vertical_datum}" if dem.vertical_datum else "height system not stated"
    )
    kinds = few_values(dem.values)
    if kinds:
        found = f"{len(kinds)} different numbers from {low:g} to {high:g}"
        advice = "a map of classes, such as zones or codes of ground, is no terrain model"
        return "bad", found, advice, numbers
    if dem.unit_fault:
        return "bad", dem.unit_fault, "heights in metres or feet", numbers
    if dem.unit and dem.unit.lower() not in ("m", "metre", "meter", "metres", "meters"):
        return "look", f"{found}, converted from {dem.unit}", "compare with a map", numbers
    advice = "" if dem.vertical_datum else "state the height system as terrain.vertical_datum"
    return "good", found, advice, numbers


def _nodata(dem: RawDem, traces: NodataTraces) -> _Found:
    known = np.isfinite(dem.values)
    wrong = dem.not_heights
    holes = int(inner_holes(dem.values).sum()) - wrong
    missing = 1.0 - float(known.mean())
    numbers = {
        "nodata_share": missing, "declared": dem.nodata,
        "not_declared_cells": wrong, "inner_cells": max(holes, 0),
        "mixed_cells": int(traces.cells.sum()),
    }  # fmt: skip
    share = f"{100.0 * missing:.2f} % nodata"
    if wrong:
        found = (
            f"{share}; {wrong} cells hold numbers that are no heights (infinite, beyond the Earth, "
            "or 0 amid mountains)"
        )
        return "bad", found, "declare them with rio edit-info FILE --nodata NUMBER", numbers
    if traces.cells.any():
        x, y = _place_of_largest(dem, traces.cells)
        found = f"{share}; {traces.words}, the first at {x:.10g}, {y:.10g}"
        return "bad", found, TRACES_ADVICE, {**numbers, "x": x, "y": y}
    if dem.gaps:
        advice = "get the missing tiles; blocks end at these gaps"
        return "look", f"{share}; {dem.gaps}", advice, numbers
    if holes > 0:
        found = f"{share}, {holes} cells of it in holes"
        advice = (
            "blocks end there: fill them (QGIS: Fill NoData cells), or keep them if they are water"
        )
        return "look", found, advice, numbers
    return "good", share, "", numbers


def _resolution(dem: RawDem) -> _Found:
    cell = max(dem.dx_m, dem.dy_m)
    n_rows, n_cols = dem.values.shape
    numbers = {"dx_m": dem.dx_m, "dy_m": dem.dy_m, "rows": n_rows, "columns": n_cols}
    found = f"cells of {dem.dx_m:.3g} x {dem.dy_m:.3g} m, {n_rows} rows x {n_cols} columns"
    verdict = _grade(round(cell, 6), _CELL_M)
    advice = {
        "good": [],
        "look": [f"ledges, gullies and walls narrower than about {2.0 * cell:.3g} m are not in it"],
        "bad": ["too coarse: slopes are flattened and cliffs are missing"],
    }[verdict]
    advice += [] if dem.in_metres else ["cell sizes are taken as metres, see coordinate system"]
    advice += [] if dem.square else ["is resampled to square cells"]
    return "look" if advice and verdict == "good" else verdict, found, "; ".join(advice), numbers


def _steepness(slopes: FloatArray) -> _Found:
    known = slopes[np.isfinite(slopes)]
    if not known.size:
        found = "no cell with known neighbours on all sides"
        return "bad", found, "fill the rows or columns that are missing", {}
    shares = {f"above_{a:.0f}_deg": float((known > a).mean()) for a in (30.0, 45.0, 60.0, 80.0)}
    numbers = {"median_deg": float(np.median(known)), "steepest_deg": float(known.max()), **shares}
    found = (
        f"median {numbers['median_deg']:.1f}°, steepest {numbers['steepest_deg']:.1f}°, "
        f"{100.0 * shares['above_45_deg']:.1f} % above 45°"
    )
    if wall_share(slopes) > WALL_SHARE:
        found = f"{found}, {100.0 * shares['above_80_deg']:.1f} % above 80°"
        return "bad", found, "too steep for terrain: are heights or cells in another unit?", numbers
    if known.max() < _STEEP_DEG:
        what = f"nothing steeper than {_STEEP_DEG:.0f}°: is the model smoothed or too coarse?"
        return "look", found, what, numbers
    return "good", found, "", numbers


def _terraces(dem: RawDem) -> _Found:
    step = height_step(dem.values)
    cell = min(dem.dx_m, dem.dy_m)
    error = float(np.degrees(np.arctan(step / (2.0 * cell))))
    equal = equal_neighbours(dem.values, dem.dx_m, dem.dy_m)
    interval, crowding = (0.0, 0.1) if step else contour_interval(dem.values)
    numbers = {
        "step_m": step, "slope_error_deg": error, "equal_neighbours": equal,
        "contour_interval_m": interval, "crowding": crowding,
    }  # fmt: skip
    grades = [_grade(error, _STEP_ERROR_DEG), _grade(equal, _EQUAL)]
    grades += ["bad" if crowding > 0.4 else "look"] if interval else []
    verdict: Verdict = "bad" if "bad" in grades else "look" if "look" in grades else "good"
    parts = []
    if step:
        parts.append(f"heights are multiples of {step:g} m: slopes are off by up to {error:.1f}°")
    if interval:
        parts.append(f"heights crowd at multiples of {interval:g} m")
    if equal > _EQUAL[0]:
        parts.append(f"{100.0 * equal:.0f} % of the neighbours across slopes are equal")
    advice = (
        "take the data before they were rounded, interpolated from contour lines or repeated; "
        "smoothing does not restore the slopes"
    )
    return verdict, "; ".join(parts) or "none", "" if verdict == "good" else advice, numbers


def _least_bump_m(dem: RawDem) -> float:
    return max(_BUMP_M, min(dem.dx_m, dem.dy_m))


def _bumps(dem: RawDem, out: FloatArray, word: str) -> _Found:
    """Return single cells that differ from all around them by so much, upwards."""
    least = _least_bump_m(dem)
    count, top = int((out >= least).sum()), float(out.max())
    numbers: dict[str, Any] = {"cells": count, "limit_m": least, "largest_m": top}
    if not count:
        return "good", f"no single cells {word} by {least:.2g} m or more", "", numbers
    x, y = _place_of_largest(dem, out)
    bad = count > max(_BUMP_COUNT, _BUMP_SHARE * out.size) or top > _BUMP_BAD_M
    found = (
        f"{count} single cells {word} by {least:.2g} m or more, the largest by {top:.1f} m "
        f"at {x:.8g}, {y:.8g}"
    )
    advice = (
        "remove trees, birds and faults of the survey, or replace these cells by their neighbours"
    )
    return "bad" if bad else "look", found, advice, {**numbers, "x": x, "y": y}


def _place_of_largest(dem: RawDem, values: FloatArray | BoolArray) -> tuple[float, float]:
    row, col = np.unravel_index(int(np.argmax(values)), values.shape)
    return dem.place(int(row), int(col))


def _depressions(dem: RawDem, depth: FloatArray) -> _Found:
    labels, count = ndimage.label(depth > 0.0, np.ones((3, 3)))
    deepest = np.asarray(ndimage.maximum(depth, labels, np.arange(1, count + 1)), float)
    deep = int((deepest >= _DEPRESSION_M).sum())
    share = float((depth >= _DEPRESSION_M).mean())
    top = float(depth.max())
    numbers = {"count": deep, "share": share, "deepest_m": top}
    if not deep:
        return "good", f"none deeper than {_DEPRESSION_M:g} m", "", numbers
    x, y = _place_of_largest(dem, depth)
    found = (
        f"{deep} without outlet, deeper than {_DEPRESSION_M:g} m; "
        f"the deepest {top:.1f} m at {x:.8g}, {y:.8g}"
    )
    numbers |= {"x": x, "y": y}
    if top < _DEEP_M and share <= _DEPRESSION_SHARE:
        return "good", found, "", numbers
    advice = (
        "blocks may stop there: keep real hollows (lakes, quarries), remove dams of bridges and "
        "trees"
    )
    return "look", found, advice, numbers


def _beyond(dem: RawDem, slopes: FloatArray) -> list[BeyondEdge]:
    """Return where energy lines from steep ground go on far beyond the edge."""
    steep = np.flatnonzero(np.nan_to_num(slopes.ravel()) > _CLIFF_DEG)
    if not steep.size or not dem.square or dem.unit_fault:
        return []
    grid = _plain_grid(dem)
    found = beyond_edge(grid, *grid.cell_centres(steep))
    return [own for own in found if own.distance_m > _BEYOND_M]


def _plain_grid(dem: RawDem) -> Grid:
    return Grid(dem.values, 0.0, 0.0, dem.dx_m)


def _edge_cells(dem: RawDem, beyond: list[BeyondEdge]) -> FloatArray:
    """Return how far beyond the model energy lines end, at the cells where they leave (m)."""
    out = np.zeros(dem.values.shape)
    for own in beyond:
        out.flat[_plain_grid(dem).cell_of(np.array([own.x]), np.array([own.y]))] = own.distance_m
    return out


def _extent(dem: RawDem, far: list[BeyondEdge]) -> _Found:
    if not dem.square or dem.unit_fault:
        return "good", "not checked: no square cells in metres", "", {}
    what = f"energy line of {ANGLE_DEG:g}° from ground above {_CLIFF_DEG:g}°"
    numbers = {"angle_deg": ANGLE_DEG, "beyond_m": {own.side: own.distance_m for own in far}}
    if not far:
        text = f"{what}: ends within the model, or {_BEYOND_M:g} m beyond it at most"
        return "good", text, "", numbers
    sides = ", ".join(f"{own.where} {own.distance_m:.0f} m" for own in far)
    advice = (
        "blocks that leave the model are lost: extend it where blocks are released near the "
        "edge; sassgis validate checks your release areas"
    )
    return "look", f"{what} ends beyond the model: {sides}", advice, numbers
