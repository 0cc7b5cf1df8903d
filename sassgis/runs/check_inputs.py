"""Read and check every input of a run, and say what it holds and what the run will take."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sassgis.errors import InputError
from sassgis.grid import Grid
from sassgis.hazard.adaptive_sampling import check_budget
from sassgis.hazard.design import size_warnings
from sassgis.hazard.warnings import (
    ground_warnings,
    idle_areas,
    path_warnings,
    release_warnings,
    rule_warnings,
)
from sassgis.inputs.ground_map import default_class, read_ground_table
from sassgis.inputs.vectors import read_edits
from sassgis.runs.inputs import (
    collected_notices,
    compared_run,
    named_preset,
    placed_objects,
    profile_from_csv,
    read_map_run,
    read_rules,
    states_frequencies,
    with_rules,
)
from sassgis.runs.resumable_run import check_means, workers_asked
from sassgis.runs.variant_lab import spread_rules
from sassgis.settings.crs import crs_name
from sassgis.settings.ground import TRUST_TEXT, GroundTable
from sassgis.settings.map_run import Config, MapRun, ReleaseArea
from sassgis.settings.results import ControlLine, first_warnings
from sassgis.settings.schema import Input
from sassgis.simulation.estimate import RunEstimate, estimate_of, for_zones, require_profile
from sassgis.simulation.loop import check_starts, on_known_ground
from sassgis.simulation.path_sample import ProfileInput
from sassgis.terrain.edge import ANGLE_DEG, beyond_edge
from sassgis.terrain.prepare import placed_points, plan

#: Release areas, and stations and barriers, that are listed unless all are asked for.
_SHOWN = 8


@dataclass(frozen=True, slots=True)
class InputReport:
    """Summary of the inputs of a run."""

    config: Path | None
    dem: Mapping[str, Any] | None  # lengths in m; None where there are only profile runs
    profile: Mapping[str, Any] | None  # lengths in m; None without a profile file
    # Each ``size`` is in m2 for polygons, in m for lines, a count for points.
    areas: tuple[Mapping[str, Any], ...]
    # Those that occur; each ``share`` is of the cells with a height, or of the profile's length.
    classes: tuple[Mapping[str, Any], ...]
    control_lines: tuple[ControlLine, ...]
    blocks: tuple[str, ...]
    notices: tuple[str, ...]  # what was done to the inputs, such as reprojection
    warnings: tuple[str, ...]  # to check before results are trusted
    estimate: RunEstimate | None  # None where nothing is complete for a run on the map
    zoning: tuple[str, ...]  # what there is for a zoning
    ready: tuple[Readiness, ...]

    @property
    def points(self) -> int:
        """Release points of all areas."""
        return sum(area["points"] for area in self.areas)

    def as_dict(self) -> dict[str, Any]:
        """Return the report for programs."""
        keys = (
            "name", "kind", "height_m", "capacity_kj", "width_m", "roof_slope_deg", "cushion_kpa",
        )  # fmt: skip
        return {
            "configuration": self.config,
            "dem": self.dem,
            "profile": self.profile,
            "release_areas": self.areas,
            "blocks": self.blocks,
            "ground": self.classes,
            "control_lines": [{key: getattr(o, key) for key in keys} for o in self.control_lines],
            "notices": self.notices,
            "warnings": self.warnings,
            "estimate": None if self.estimate is None else self.estimate.as_dict(),
            "zoning": self.zoning,
            "missing": {o.task: [*o.missing, *filter(None, [o.problem])] for o in self.ready},
        }

    def lines(self, every: bool = False) -> list[str]:
        """Return the report for people, line by line; ``every``: all areas, sources of ground."""
        out = [f"configuration  {self.config or 'made by a program'}"]
        if (d := self.dem) is not None:
            out += [
                f"DEM            {d['file']}",
                f"               {d['n_rows']} rows x {d['n_cols']} columns of "
                f"{d['cell_size']:g} m, {100.0 * d['nodata_share']:.1f} % nodata",
                f"               heights {d['lowest']:.1f} to {d['highest']:.1f} m, "
                f"height system {d['vertical_datum'] or 'not stated'}",
                f"               {d['crs']}",
            ]
        if (p := self.profile) is not None:
            out += [
                f"profile        {p['file']}",
                f"               {p['vertices']} vertices, chainage {p['first']:g} to "
                f"{p['last']:g} m, heights {p['lowest']:.1f} to {p['highest']:.1f} m",
            ]
        extent = "profile" if self.dem is None else "cells"
        units = {"polygon": " m2", "line": " m", "point": " points"}
        areas = [
            f"release area   {a['name']}: {a['size']:.0f}{units[a['kind']]}, {a['points']} release "
            f"points, blocks {', '.join(a['scenarios'])}"
            for a in self.areas
        ]
        out += areas if every else _some(areas)
        if self.areas:
            out.append(
                f"               {self.points} release points in {len(self.areas)} "
                f"{'area' if len(self.areas) == 1 else 'areas'} in all"
            )
        out.append(f"blocks         {', '.join(self.blocks)}")
        for c in self.classes:
            text = f"on {100.0 * c['share']:.1f} % of the {extent}: {TRUST_TEXT[c['trust']]}"
            out.append(f"ground         {c['name']}, {text}")
            out += [f"               {c['source']}"] if every else []
        built = []
        for control_line in self.control_lines:
            text = f"{control_line.kind:<15}{control_line.name}"
            if control_line.kind != "station":
                capacity = control_line.capacity_kj
                limit = "unlimited capacity" if math.isinf(capacity) else f"{capacity:g} kJ"
                text += f": {control_line.height_m:g} m high, {limit}"
            if control_line.kind == "gallery":
                text += (
                    f", roof {control_line.width_m:g} m wide, slope "
                    f"{control_line.roof_slope_deg:g} degrees, {control_line.cushion_kpa:g} kPa"
                )
            built.append(text)
        out += built if every else _some(built)
        out += [f"notice         {text}" for text in self.notices]
        first = first_warnings(self.warnings)
        out += [f"WARNING        {text}" for text in first]
        out += [f"note           {text}" for text in self.warnings if text not in first]
        out += [] if self.estimate is None else self.estimate.lines()
        return [*out, *self.zoning, *(own.line for own in self.ready)]


def _some(lines: list[str]) -> list[str]:
    """Return the first lines, and how many more there are."""
    left = len(lines) - _SHOWN
    if left <= 1:
        return lines
    return [*lines[:_SHOWN], f"               and {left} more: sassgis validate --all"]


def check_inputs(config: Config) -> InputReport:
    """Read all inputs of a configuration, as a run would, and check all that it would check.

    InputError, ConfigError or OutputError: whatever would stop a run, or a zoning if the
    configuration is complete for one; but for what only the simulation shows.
    """
    ready = {own.task: own for own in readiness(config)}
    profile: ProfileInput | None = None
    along: dict[str, Any] | None = None
    run: MapRun | None = None
    areas: tuple[dict[str, Any], ...] = ()
    zoning: tuple[str, ...] = ()
    estimate: RunEstimate | None = None
    said: list[str] = []
    notices: list[str] = []
    with collected_notices(quietly=notices) as warned:
        if config.profile is not None and config.profile.file is not None:
            try:
                profile = profile_from_csv(config)
                s, z = profile.s, profile.z
                require_profile(config, s, z, config.profile.rocks)
                along = {
                    "file": config.profile.file, "vertices": s.size, "first": float(s[0]),
                    "last": float(s[-1]), "lowest": float(z.min()), "highest": float(z.max()),
                }  # fmt: skip
            except InputError as error:
                # Stations have a place on the map or on a profile: some files are for one of both.
                if config.terrain.dem is None:
                    raise
                ready["profile"] = Readiness("profile", (), str(error))
        if config.terrain.dem is not None:
            released = config.release.file is not None or config.profile is None
            run = read_map_run(config, None if released else ())
            zoning, run = _zoning(config, run, not ready["zone"].missing)
        if run is not None and run.areas:
            areas, estimate, said = _checked(config, run, not ready["zone"].missing)
    if run is None:
        table, shares = _along(config, profile)
        control_lines = () if profile is None else tuple(own for own, _ in profile.control_lines)
    else:
        table, shares = run.table, _shares(run.ground, run.grid)
        control_lines = tuple(control_line for control_line, _ in run.control_lines)
    return InputReport(
        config=config.file,
        dem=None if run is None else _dem_summary(config.dem_source, run.grid),
        profile=along,
        areas=areas,
        classes=tuple(
            {"name": c.name, "share": shares[i], "trust": c.trust, "source": c.source}
            for i, c in enumerate(table.classes)
            if i in shares
        ),
        control_lines=control_lines,
        blocks=config.block_names,
        notices=tuple(notices),
        warnings=(
            *config.notes,
            *warned,
            *ground_warnings(
                [(table.classes[i], share) for i, share in sorted(shares.items())],
                "share of the terrain",
            ),
            *(path_warnings(config.terrain.path) if areas else ()),
            *said,
        ),
        estimate=estimate,
        zoning=zoning,
        ready=tuple(ready.values()),
    )


def _checked(
    config: Config, run: MapRun, zones: bool
) -> tuple[tuple[dict[str, Any], ...], RunEstimate, list[str]]:
    """Return the release areas with their points, what a run on them takes, and what they lack."""
    check_means(config, run)
    spread_rules(config, run)
    points = placed_points(run)
    check_starts(run, points, lambda: plan(run), config.release.file)
    counts = np.bincount(points.area, minlength=len(run.areas))
    areas = tuple(_area_summary(a, int(n)) for a, n in zip(run.areas, counts, strict=True))
    repeats = 1 + config.run.ground_uncertainty
    cores = workers_asked(config, None)
    assert isinstance(cores, int)
    estimate = estimate_of(run, cores, len(points), repeats)
    if zones:
        check_budget(config, run, estimate.blocks)
        # Blocks without barriers cost at most a repetition more.
        repeats += compared_run(config, run).compared is not None
        estimate = for_zones(estimate, repeats, config.hazard.budget)
    starts = np.bincount(points.area[on_known_ground(run, points)], minlength=len(run.areas))
    said = [
        *release_warnings(run, points),
        *size_warnings(run.released_blocks),
        *idle_areas(a.name for a, n in zip(run.areas, starts, strict=True) if not n),
    ]
    said += [
        f"Extend the terrain model by at least {own.distance_m:.0f} m at {own.x:.0f}, "
        f"{own.y:.0f} ({own.where}). The energy line of {ANGLE_DEG:g} degrees from release "
        f'"{points.area_names[points.area[own.start]]}" is {own.height_m:.0f} m above the '
        "ground there."
        for own in beyond_edge(run.grid, points.x, points.y)
    ]
    return areas, estimate, said


def _zoning(config: Config, run: MapRun, complete: bool) -> tuple[tuple[str, ...], MapRun]:
    """Return the inputs for a zoning, and the run with what it counts if they are complete."""
    if complete:
        rules = read_rules(config, run)
        annual = sum(rules.frequencies.values())
        lines = [
            f"zoning: preset {rules.preset.name} ({rules.preset.title})",
            f"  onset: {annual:.4g} blocks a year in all, from {len(rules.frequencies)} sources",
            f"  reference width: {rules.ref_width_m:.4g} m",
        ]
        if edits := read_edits(config.edits, rules.preset, run.grid):
            lines.append(f"  edits by hand: {len(edits)}")
        if len(rules.placed):
            lines.append(f"  exposed objects: {len(rules.placed)}")
        notes = rule_warnings(rules.preset, rules.frequencies)
        return (*lines, *(f"  note: {text}" for text in notes)), with_rules(run, rules)
    if not (states_frequencies(config) or config.objects):
        return (), run
    preset = named_preset(config)
    lines = [f"zoning: preset {preset.name} ({preset.title})"]
    if config.objects:
        lines.append(f"  exposed objects: {len(placed_objects(config, run.grid))}")
    return tuple(lines), run


def _dem_summary(file: Input, grid: Grid) -> dict[str, Any]:
    known = np.isfinite(grid.values)
    return {
        "file": file,
        "n_rows": grid.shape[0],
        "n_cols": grid.shape[1],
        "cell_size": grid.cell_size,
        "crs": crs_name(grid.crs),
        "vertical_datum": grid.vertical_datum,
        "nodata_share": 1.0 - float(known.mean()),
        "lowest": float(grid.values[known].min()),
        "highest": float(grid.values[known].max()),
    }


def _along(config: Config, profile: ProfileInput | None) -> tuple[GroundTable, dict[int, float]]:
    """Return the ground classes, and the share of each of the length of the profile."""
    if profile is None:
        table = read_ground_table(config.ground.classes, config.engine.readings)
        return table, {default_class(config.ground, table): 1.0}
    s = profile.s
    lengths = np.bincount(profile.ground[:-1], weights=np.diff(s))
    return profile.table, {i: float(n) / float(s[-1] - s[0]) for i, n in enumerate(lengths) if n}


def _area_summary(area: ReleaseArea, points: int) -> dict[str, Any]:
    shape = area.geometry
    kind, size = ("line", float(shape.length)) if shape.length > 0.0 else ("point", points)
    if shape.area > 0.0:
        kind, size = "polygon", float(shape.area)
    return {
        "name": area.name, "kind": kind, "size": size, "points": points,
        "scenarios": area.scenarios,
    }  # fmt: skip


def _shares(
    ground: np.ndarray[tuple[int, ...], np.dtype[np.int32]], grid: Grid
) -> dict[int, float]:
    known = ground[np.isfinite(grid.values)]
    indices, counts = np.unique(known, return_counts=True)
    return {int(i): float(n) / known.size for i, n in zip(indices, counts, strict=True)}


#: Keys that say what is at stake at an object, alone or as the attribute of each feature.
_STAKES = ("value", "value_per_m", "persons", "traffic_per_day")


@dataclass(frozen=True, slots=True)
class Readiness:
    """Whether a configuration is complete for a command."""

    task: str  # "run", "zone", "risk" (part of a zoning) or "profile"
    missing: tuple[str, ...]  # keys that are needed and not there
    problem: str = ""  # what else is in the way; empty if nothing

    @property
    def line(self) -> str:
        """One line for people."""
        if self.problem:
            return f"not ready for  {self.task}: {self.problem}"
        if not self.missing:
            return f"ready for      {self.task}"
        return f"not ready for  {self.task}: missing {'; '.join(self.missing)}"


def readiness(config: Config) -> tuple[Readiness, ...]:
    """Find whether a configuration is complete for run, zone, risk and profile; opens no file."""
    run = [] if config.terrain.dem is not None else ["terrain.dem"]
    run += [] if config.release.file is not None else ["release.file"]
    zone = list(run)
    if config.hazard.frequencies is None:
        zone += [
            f"blocks[{name}].onset_frequency (or hazard.frequencies)"
            for name, onset in config.onsets.items()
            if onset.frequency is None
        ]
    zone += [] if config.hazard.ref_width_m is not None else ["hazard.ref_width_m"]
    harm = [] if config.risk.vulnerability is not None else ["risk.vulnerability"]
    # A zoning with objects computes their risk, and stops where it cannot.
    risk = [*zone, *harm]
    if config.objects:
        zone += harm
    else:
        risk.append("[[objects]]")
    risk += [
        f"objects[{o.name}].value, persons or traffic_per_day"
        for o in config.objects
        if not any(getattr(o, k) or getattr(o, f"{k}_field") for k in _STAKES)
    ]
    found = {"run": run, "zone": zone, "risk": risk}
    if config.profile is not None:
        given = config.profile.file is not None or config.terrain.dem is not None
        found["profile"] = [] if given else ["profile.file (or --csv)"]
    return tuple(Readiness(task, tuple(missing)) for task, missing in found.items())
