"""From a configuration to everything that a run on the map needs."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.assess import Rules
from sassgis.hazard.sources import OnsetTable, onset_frequencies
from sassgis.hazard.warnings import rule_warnings
from sassgis.hazard.zoning.generalise import ZoneSettings
from sassgis.io.read.forest import read_forest
from sassgis.io.read.frequencies import read_frequencies
from sassgis.io.read.ground_map import ground_raster, read_ground_table
from sassgis.io.read.objects import joined_objects, read_objects, read_vulnerability
from sassgis.io.read.presets import read_preset
from sassgis.io.read.readiness import readiness
from sassgis.io.read.tiles import read_terrain
from sassgis.io.read.vectors import read_control_lines, read_release, release_names
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.exposure import PlacedObjects
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.ground import GroundTable
from sassgis.model.hazard import HazardPreset
from sassgis.model.map_run import Forest, MapRun
from sassgis.model.release_areas import FallLineSettings, ReleaseArea
from sassgis.model.results import ControlLine
from sassgis.model.run_config import Config
from sassgis.terrain.block_scale import block_scale_grid


@contextmanager
def collected_notices() -> Iterator[list[str]]:
    """Collect what the readers have to say (level WARNING and above), each once."""
    notices: list[str] = []

    class _Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            text = record.getMessage()
            if text not in notices:
                notices.append(text)

    logger = logging.getLogger("sassgis")
    handler = _Collector(level=logging.WARNING)
    logger.addHandler(handler)
    try:
        yield notices
    finally:
        logger.removeHandler(handler)


def forest_of(config: Config, grid: Grid, whole: Grid | None = None) -> Forest | None:
    """The forest on the cells, if trees are on; ``whole`` as for ground_raster."""
    trees = config.trees
    return None if trees is None else Forest(*read_forest(trees, grid, whole))


def fall_line_settings(config: Config) -> FallLineSettings:
    """How fall lines are traced."""
    return FallLineSettings(
        smoothing_m=config.terrain.smoothing_m,
        flat_slope_deg=config.terrain.flat_slope_deg,
        energy_line_angle_deg=config.terrain.energy_line_angle_deg,
        max_length_m=config.terrain.max_line_length_m,
    )


def read_map_run(
    config: Config, areas: Sequence[str] | None = None, grid: Grid | None = None
) -> MapRun:
    """Read every file that the configuration names.

    Parameters
    ----------
    config : Config
    areas : sequence of str, optional
        Names of the release areas to run; default: all.
    grid : Grid, optional
        The DEM, if it has been read already.

    Raises
    ------
    ConfigError, InputError
        With the file, the field, what was found and what is expected.
    """
    if not config.blocks:
        raise ConfigError(
            "no block scenario", file=config.file, field="blocks", expected="one [[blocks]] or more"
        )
    terrain = config.terrain
    if grid is None:
        grid = read_terrain(config.dem_path, terrain.crs, terrain.vertical_datum)
    chosen = read_release(config.release, grid, config.block_names, areas)
    table = read_ground_table(config.ground.classes, config.engine.readings)
    ground = ground_raster(config.ground, grid, table)
    control_lines = read_control_lines(config, grid)
    run = map_run_of(config, grid, ground, table, chosen, control_lines, forest_of(config, grid))
    return on_block_scale(run)


def map_run_of(
    config: Config,
    grid: Grid,
    ground: NDArray[np.int32],
    table: GroundTable,
    areas: Sequence[ReleaseArea],
    control_lines: Sequence[tuple[ControlLine, FloatArray]],
    forest: Forest | None,
) -> MapRun:
    """A run with the settings of the configuration and inputs that have been read."""
    return MapRun(
        grid=grid,
        ground=ground,
        table=table,
        areas=tuple(areas),
        blocks=config.blocks,
        control_lines=tuple(control_lines),
        engine=config.engine,
        fall_lines=fall_line_settings(config),
        segment_tolerance_m=config.terrain.segment_tolerance_m,
        spacing_m=config.release.spacing_m,
        placement=config.release.placement,
        rocks_per_point=config.release.rocks_per_point,
        seed=config.run.seed,
        stop_points_max=config.output.stop_points_max,
        effects=config.effects,
        forest=forest,
        block_scale_m=block_scale_m(config),
        path=config.terrain.path,
    )


def block_scale_m(config: Config) -> float:
    """Size below which terrain counts as roughness (m); 0: none."""
    stated = config.terrain.block_scale_m
    if stated is None:
        # The paper has profiles of the terrain as it was surveyed.
        paper = config.engine.readings == "1986"
        return 0.0 if paper else min(b.mean_width_m for b in config.blocks)
    return stated


def on_block_scale(run: MapRun) -> MapRun:
    """The run with heights without what is smaller than its blocks."""
    heights = block_scale_grid(run.grid, run.block_scale_m)
    return replace(run, ground_heights=None if heights is run.grid else heights)


def input_files(config: Config) -> dict[str, Path]:
    """The files that a configuration names, by their role, for the manifest."""
    files: dict[str, Path] = {"config": config.file}
    candidates = {
        "dem": config.terrain.dem,
        "release": config.release.file,
        "ground": config.ground.file,
        "ground classes": config.ground.classes,
        "profile": config.profile.file if config.profile else None,
    }
    if config.trees is not None:
        for key in ("file", "stems_raster", "dbh_raster"):
            candidates[f"trees {key}"] = getattr(config.trees, key)
    for item in (*config.stations, *config.barriers):
        candidates[item.name] = item.file
    files.update({role: path for role, path in candidates.items() if path is not None})
    return files


def yearly_frequencies(
    config: Config, areas: Sequence[ReleaseArea], known: Sequence[str] | None = None
) -> dict[tuple[str, str], float]:
    """Blocks released per year, by release area and block scenario.

    Parameters
    ----------
    config : Config
    areas : sequence of ReleaseArea
    known : sequence of str, optional
        Names that the table of frequencies may hold; default those of the file of release areas.

    Raises
    ------
    ConfigError, InputError
        As read_frequencies and onset_frequencies.
    """
    table = OnsetTable({})
    file = config.hazard.frequencies
    if file is not None:
        names = release_names(config.release) if known is None else known
        table = OnsetTable(read_frequencies(file, names, config.block_names), file)
    return onset_frequencies(areas, config.onsets, table, config.file)


def read_rules(config: Config, run: MapRun) -> Rules:
    """Read preset, frequencies and exposed objects.

    Raises
    ------
    ConfigError, InputError
    """
    preset = named_preset(config)
    frequencies = yearly_frequencies(config, run.areas)
    with collected_notices() as notices:
        placed = placed_objects(config, run.grid)
        vulnerability = None
        if len(placed):
            if config.risk.vulnerability is None:
                raise ConfigError(
                    "missing key: objects need to know what a hit does to them",
                    file=config.file,
                    field="risk.vulnerability",
                    expected="a CSV table: kind, intensity, vulnerability, lethality, source",
                )
            codes = [c.code for c in preset.intensities]
            vulnerability = read_vulnerability(config.risk.vulnerability, codes)
            vulnerability.check_covers(placed.objects)
    width = ref_width(config, run.grid.cell_size)
    z = config.zones
    # Between two fall lines nothing was computed: the gap is not a place that is safe.
    gap = max(z.min_width_m, run.spacing_m)
    settings = ZoneSettings(
        min_area_m2=z.min_area_m2,
        closing_m=gap if z.closing_m is None else z.closing_m,
        min_width_m=z.min_width_m,
        tolerance_m=z.tolerance_m,
    )
    return Rules(preset, frequencies, placed, vulnerability, settings, width, tuple(notices))


def placed_objects(config: Config, grid: Grid) -> PlacedObjects:
    """The exposed objects of all layers.

    Raises
    ------
    ConfigError, InputError
    """
    parts = [
        read_objects(
            o.file, grid, kind=o.kind, name=o.name, layer=o.layer, name_field=o.name_field,
            fields=o.fields, defaults=o.defaults, segment_m=o.segment_m, radius_m=o.radius_m,
        )
        for o in config.objects
    ]  # fmt: skip
    return joined_objects(parts, config.file)


def named_preset(config: Config) -> HazardPreset:
    """The preset that the configuration names.

    Raises
    ------
    InputError
        There is none, or it cannot be used.
    """
    try:
        return read_preset(config.hazard.preset)
    except InputError as error:
        if error.field != "preset":
            raise
        raise InputError(
            error.problem,
            file=error.file or config.file,
            field="hazard.preset",
            found=error.found,
            expected=error.expected,
        ) from None


def check_rules(config: Config, grid: Grid | None = None) -> list[str]:
    """Read what there is for a zoning, and say what it holds.

    Parameters
    ----------
    config : Config
        Where it is not complete for a zoning, preset and objects are read if it names any.
    grid : Grid, optional
        The DEM, if it has been read already.

    Raises
    ------
    ConfigError, InputError
        As for a zoning.
    """
    ready = {own.task: not own.missing for own in readiness(config)}
    if not ready["zone"]:
        preset = named_preset(config)
        lines = [f"zoning: preset {preset.name} ({preset.title})"]
        if config.objects and grid is not None:
            with collected_notices() as notices:
                lines.append(f"  exposed objects: {len(placed_objects(config, grid))}")
            lines += [f"  note: {text}" for text in notices]
        return lines
    run = read_map_run(config, grid=grid)
    rules = read_rules(config, run)
    annual = sum(rules.frequencies.values())
    lines = [
        f"zoning: preset {rules.preset.name} ({rules.preset.title})",
        f"  onset: {annual:.4g} blocks a year in all, from {len(rules.frequencies)} sources",
        f"  reference width: {rules.ref_width_m:.4g} m",
    ]
    if len(rules.placed):
        lines.append(f"  exposed objects: {len(rules.placed)}")
    notes = (*rules.notices, *rule_warnings(rules.preset, rules.frequencies))
    return lines + [f"  note: {text}" for text in notes]


def ref_width(config: Config, cell_size: float) -> float:
    """Reference width of the hazard curves (m).

    Raises
    ------
    ConfigError
        It is missing, or below one cell: blocks could pass between the centres of two cells and
        count for neither.
    """
    width = config.hazard.ref_width_m
    if width is None:
        raise ConfigError(
            "missing key: frequencies need the width that they refer to",
            file=config.file,
            field="hazard.ref_width_m",
            expected="width of the exposed object and a block, as 10 (m)",
        )
    if width < cell_size * (1.0 - 1e-9):
        raise ConfigError(
            "is narrower than a cell of the terrain model",
            file=config.file,
            field="hazard.ref_width_m",
            found=f"{width:g} m with cells of {cell_size:g} m",
            expected=f"{cell_size:g} m or more, or a finer terrain model",
        )
    return width
