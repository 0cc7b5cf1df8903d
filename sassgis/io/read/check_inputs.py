"""Read every input of a run and say what it holds, without computing anything."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from sassgis.hazard.warnings import ground_warnings, path_warnings
from sassgis.io.read.config import profile_control_lines
from sassgis.io.read.forest import read_forest
from sassgis.io.read.ground_map import (
    built_in_table,
    default_class,
    ground_raster,
    read_ground_table,
)
from sassgis.io.read.profile_csv import check_on_profile, read_profile
from sassgis.io.read.tiles import read_terrain
from sassgis.io.read.vectors import read_control_lines, read_release
from sassgis.model.crs import crs_name
from sassgis.model.grid import Grid
from sassgis.model.ground import GroundTable
from sassgis.model.release_areas import ReleaseArea
from sassgis.model.results import ControlLine
from sassgis.model.run_config import Config
from sassgis.model.settings import ReleaseSettings


@dataclass(frozen=True, slots=True)
class DemSummary:
    """What the terrain model holds; lengths in m."""

    file: Path
    n_rows: int
    n_cols: int
    cell_size: float
    crs: str
    vertical_datum: str
    nodata_share: float
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True)
class ProfileSummary:
    """What the profile of a run without a map holds; lengths in m."""

    file: Path
    vertices: int
    first: float
    last: float
    lowest: float
    highest: float


@dataclass(frozen=True, slots=True)
class AreaSummary:
    """A release area: ``size`` in m2 for polygons, in m for lines, a count for points."""

    name: str
    kind: str
    size: float
    points: int
    scenarios: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ClassSummary:
    """A ground class in use; ``share`` of the cells with a height, or of the profile's length."""

    name: str
    share: float
    verified: bool
    source: str


@dataclass(frozen=True, slots=True)
class InputReport:
    """What the inputs of a run hold.

    Attributes
    ----------
    config : Path
    dem : DemSummary or None
        None where the configuration is for profile runs only.
    profile : ProfileSummary or None
        None where there is a DEM, or no profile file.
    areas : tuple of AreaSummary
    classes : tuple of ClassSummary
        Those that occur.
    control_lines : tuple of ControlLine
    blocks : tuple of str
    notices : tuple of str
        What was done to the inputs, such as reprojection.
    warnings : tuple of str
        What deserves a look before results are trusted.
    terrain : Grid or None
        The DEM as it was read, for whoever has more to check against it.
    """

    config: Path
    dem: DemSummary | None
    profile: ProfileSummary | None
    areas: tuple[AreaSummary, ...]
    classes: tuple[ClassSummary, ...]
    control_lines: tuple[ControlLine, ...]
    blocks: tuple[str, ...]
    notices: tuple[str, ...]
    warnings: tuple[str, ...]
    terrain: Grid | None = field(default=None, repr=False, compare=False)

    @property
    def points(self) -> int:
        """Release points to be expected over all areas."""
        return sum(area.points for area in self.areas)

    def as_dict(self) -> dict[str, Any]:
        """Return the report for programs."""
        lines = [
            {"name": o.name, "kind": o.kind, "height_m": o.height_m, "capacity_kj": o.capacity_kj}
            for o in self.control_lines
        ]
        return {
            "configuration": self.config,
            "dem": None if self.dem is None else asdict(self.dem),
            "profile": None if self.profile is None else asdict(self.profile),
            "release_areas": [asdict(area) for area in self.areas],
            "blocks": self.blocks,
            "ground": [asdict(own) for own in self.classes],
            "control_lines": lines,
            "notices": self.notices,
            "warnings": self.warnings,
        }

    def lines(self) -> list[str]:
        """Return the report for people, line by line."""
        out = [f"configuration  {self.config}"]
        if self.dem is not None:
            d = self.dem
            out += [
                f"DEM            {d.file}",
                f"               {d.n_rows} rows x {d.n_cols} columns of {d.cell_size:g} m, "
                f"{100.0 * d.nodata_share:.1f} % nodata",
                f"               heights {d.lowest:.1f} to {d.highest:.1f} m, "
                f"height system {d.vertical_datum or 'not stated'}",
                f"               {d.crs}",
            ]
        if self.profile is not None:
            p = self.profile
            out += [
                f"profile        {p.file}",
                f"               {p.vertices} vertices, chainage {p.first:g} to {p.last:g} m, "
                f"heights {p.lowest:.1f} to {p.highest:.1f} m",
            ]
        extent = "profile" if self.dem is None else "cells"
        units = {"polygon": " m2", "line": " m", "point": " point(s)"}
        for area in self.areas:
            size = f"{area.size:.0f}{units[area.kind]}"
            out.append(
                f"release area   {area.name}: {size}, about {area.points} release points, "
                f"blocks {', '.join(area.scenarios)}"
            )
        if self.areas:
            out.append(f"               about {self.points} release points in all")
        out.append(f"blocks         {', '.join(self.blocks)}")
        for c in self.classes:
            state = "verified" if c.verified else "UNVERIFIED"
            out.append(f"ground         {c.name}: {100.0 * c.share:.1f} % of the {extent}, {state}")
            out.append(f"               {c.source}")
        for control_line in self.control_lines:
            text = f"{control_line.kind:<15}{control_line.name}"
            if control_line.kind != "station":
                limit = (
                    "no limit"
                    if math.isinf(control_line.capacity_kj)
                    else f"{control_line.capacity_kj:g} kJ"
                )
                text += f": {control_line.height_m:g} m high, {limit}"
            out.append(text)
        out += [f"notice         {text}" for text in self.notices]
        out += [f"WARNING        {text}" for text in self.warnings]
        return out


def check_inputs(config: Config) -> InputReport:
    """Read all inputs of a configuration, as a run would.

    Parameters
    ----------
    config
        The configuration.

    Returns
    -------
    InputReport

    Raises
    ------
    InputError, ConfigError
        Whatever would stop a run.
    """
    grid: Grid | None = None
    dem: DemSummary | None = None
    profile: ProfileSummary | None = None
    areas: tuple[AreaSummary, ...] = ()
    with _heard() as records:
        table = read_ground_table(config.ground.classes, config.engine.readings)
        if config.terrain.dem is None:
            control_lines = tuple(control_line for control_line, _ in profile_control_lines(config))
            profile, shares = _profile(config, table)
        else:
            grid = read_terrain(
                config.dem_path,
                crs=config.terrain.crs,
                vertical_datum=config.terrain.vertical_datum,
            )
            dem = _dem_summary(config.dem_path, grid)
            areas = _areas(config, grid)
            control_lines = tuple(
                control_line for control_line, _ in read_control_lines(config, grid)
            )
            shares = _shares(ground_raster(config.ground, grid, table), grid)
            if config.trees is not None:
                read_forest(config.trees, grid)
    classes = tuple(
        ClassSummary(c.name, shares[i], c.verified, c.source)
        for i, c in enumerate(table.classes)
        if i in shares
    )
    notices = [r.getMessage() for r in records if r.levelno < logging.WARNING]
    warnings = [r.getMessage() for r in records if r.levelno >= logging.WARNING]
    return InputReport(
        config=config.file,
        dem=dem,
        profile=profile,
        areas=areas,
        classes=classes,
        control_lines=control_lines,
        blocks=config.block_names,
        notices=tuple(notices),
        warnings=(
            *config.notes,
            *warnings,
            *ground_warnings(
                [table.classes[i] for i in sorted(shares)],
                built_in_table(config.engine.readings).classes,
            ),
            *(path_warnings(config.terrain.path) if areas else ()),
        ),
        terrain=grid,
    )


def _dem_summary(file: Path, grid: Grid) -> DemSummary:
    known = np.isfinite(grid.values)
    return DemSummary(
        file=file,
        n_rows=grid.shape[0],
        n_cols=grid.shape[1],
        cell_size=grid.cell_size,
        crs=crs_name(grid.crs),
        vertical_datum=grid.vertical_datum,
        nodata_share=1.0 - float(known.mean()),
        lowest=float(grid.values[known].min()),
        highest=float(grid.values[known].max()),
    )


def _profile(config: Config, table: GroundTable) -> tuple[ProfileSummary | None, dict[int, float]]:
    """The profile and the share of each ground class of its length."""
    default = default_class(config.ground, table)
    if config.profile is None or config.profile.file is None:
        return None, {default: 1.0}
    flat = read_profile(config.profile.file, table, config.ground.default)
    check_on_profile(config, flat)
    s, z = flat.vertices(0)
    lengths = np.bincount(flat.ground[:-1], weights=np.diff(s))
    shares = {i: float(n) / float(s[-1] - s[0]) for i, n in enumerate(lengths) if n > 0.0}
    summary = ProfileSummary(
        config.profile.file, s.size, float(s[0]), float(s[-1]), float(z.min()), float(z.max())
    )
    return summary, shares


def _areas(config: Config, grid: Grid) -> tuple[AreaSummary, ...]:
    if config.release.file is None and config.profile is not None:
        return ()
    areas = read_release(config.release, grid, config.block_names)
    return tuple(_area_summary(area, config.release) for area in areas)


def _area_summary(area: ReleaseArea, release: ReleaseSettings) -> AreaSummary:
    shape, spacing = area.geometry, release.spacing_m
    if shapely.get_dimensions(shape) == 2:
        kind, size, points = "polygon", float(shape.area), shape.area / spacing**2
    elif shapely.get_dimensions(shape) == 1:
        kind, size, points = "line", float(shape.length), shape.length / spacing
    else:
        count = float(shapely.get_num_coordinates(shape))
        kind, size, points = "point", count, count
    return AreaSummary(area.name, kind, size, max(1, round(points)), area.scenarios)


def _shares(
    ground: np.ndarray[tuple[int, ...], np.dtype[np.int32]], grid: Grid
) -> dict[int, float]:
    known = ground[np.isfinite(grid.values)]
    indices, counts = np.unique(known, return_counts=True)
    return {int(i): float(n) / known.size for i, n in zip(indices, counts, strict=True)}


@contextmanager
def _heard() -> Iterator[list[logging.LogRecord]]:
    """Collect what the readers log, whatever the program has set up for its own log."""
    records: list[logging.LogRecord] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            records.append(record)

    logger = logging.getLogger("sassgis.io")
    listener, level, passes_on = Listener(logging.INFO), logger.level, logger.propagate
    logger.addHandler(listener)
    logger.setLevel(logging.INFO)
    # The report repeats every message, so the log need not.
    logger.propagate = False
    try:
        yield records
    finally:
        logger.removeHandler(listener)
        logger.setLevel(level)
        logger.propagate = passes_on
