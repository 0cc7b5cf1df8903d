"""From a configuration to everything that a run on the map needs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sassgis.errors import ConfigError, InputError, notice
from sassgis.errors import collected_notices as collected_notices
from sassgis.files.input_parts import file_digest
from sassgis.grid import FloatArray, Grid
from sassgis.hazard.assess import Rules
from sassgis.hazard.sources import onset_frequencies
from sassgis.hazard.zoning.coverage import check_cells
from sassgis.inputs.config import FILE_KEYS, profile_control_lines
from sassgis.inputs.csv_table import check_on_profile, read_profile
from sassgis.inputs.dem import lone_zeros, read_base_map
from sassgis.inputs.frequencies import read_frequencies
from sassgis.inputs.ground_map import default_class, ground_raster, read_forest, read_ground_table
from sassgis.inputs.objects import joined_objects, object_cells, read_objects, read_vulnerability
from sassgis.inputs.presets import read_preset
from sassgis.inputs.tiles import read_terrain
from sassgis.inputs.vectors import (
    assessed_area,
    read_control_lines,
    read_release,
    release_names,
)
from sassgis.settings.exposure import PlacedObjects
from sassgis.settings.ground import GroundTable
from sassgis.settings.hazard_rules import HazardPreset, Onset
from sassgis.settings.map_run import Config, Forest, MapRun, ObjectCells, ReleaseArea
from sassgis.settings.results import ControlLine
from sassgis.settings.schema import Input, is_preset_file
from sassgis.simulation.estimate import require_profile
from sassgis.simulation.path_sample import ProfileInput, stretches_of
from sassgis.terrain.dem_defects import TRACES_ADVICE, nodata_traces
from sassgis.terrain.fall_lines import moved_lines
from sassgis.terrain.slope_units import WALL_DEG, WALL_SHARE, slopes_deg, wall_share
from sassgis.terrain.surface import block_scale_grid


def forest_of(config: Config, grid: Grid, whole: Grid | None = None) -> Forest | None:
    """Return the forest on the cells, if trees are on; ``whole`` as for ground_raster."""
    trees = config.trees
    return None if trees is None else Forest(*read_forest(trees, grid, whole))


def check_heights(grid: Grid, file: Input) -> None:
    """Warn of heights that cannot be those of terrain; ``file`` is named."""
    walls = wall_share(slopes_deg(grid.values, grid.cell_size, grid.cell_size))
    if walls > WALL_SHARE:
        notice(
            f"{file}: {100.0 * walls:.1f} % of the cells are steeper than {WALL_DEG:g} degrees, "
            "too steep for terrain: are heights or cells in another unit?"
        )
    # Zeros as they were stored are named by their reader.
    values = np.where(lone_zeros(grid.values), np.nan, grid.values)
    traces = nodata_traces(values, grid.cell_size)
    if traces.cells.any():
        x, y = (float(c[0]) for c in grid.cell_centres(np.flatnonzero(traces.cells)[:1]))
        notice(f"{file}: {traces.words}, the first at {x:.10g}, {y:.10g}: {TRACES_ADVICE}")


def read_map_run(config: Config, areas: Sequence[str] | None = None) -> MapRun:
    """Read every file that the configuration names, for the named release areas; None: all."""
    terrain = config.terrain
    grid = read_terrain(
        config.dem_source, terrain.crs, terrain.vertical_datum, terrain.override_crs
    )
    # Looked at before anything is simulated, though only the project shows it.
    read_base_map(config.project.base_map, grid)
    check_heights(grid, config.dem_source)
    none = areas is not None and not areas
    chosen = [] if none else read_release(config.release, grid, config.block_names, areas)
    table = read_ground_table(config.ground.classes, config.engine.readings)
    ground = ground_raster(config.ground, grid, table)
    control_lines = read_control_lines(config, grid)
    forest = forest_of(config, grid)
    return on_block_scale(
        map_run_of(config, grid, ground, table, areas=chosen, control_lines=control_lines,
                   forest=forest)
    )  # fmt: skip


def map_run_of(
    config: Config,
    grid: Grid,
    ground: NDArray[np.int32],
    table: GroundTable,
    *,
    control_lines: Sequence[tuple[ControlLine, FloatArray]],
    areas: Sequence[ReleaseArea] = (),
    forest: Forest | None = None,
) -> MapRun:
    """Return a run with the settings of the configuration and inputs that have been read."""
    return MapRun(
        grid=grid, ground=ground, table=table, areas=tuple(areas), blocks=config.blocks,
        control_lines=tuple(control_lines), engine=config.engine, terrain=config.terrain,
        release=config.release, seed=config.run.seed,
        stop_points_max=config.output.stop_points_max, effects=config.effects, forest=forest,
    )  # fmt: skip


def on_block_scale(run: MapRun) -> MapRun:
    """Return the run with heights without what is smaller than its blocks."""
    heights = block_scale_grid(run.grid, run.block_scale_m)
    return replace(run, ground_heights=None if heights is run.grid else heights)


def input_files(config: Config) -> dict[str, Input]:
    """Return the inputs that a configuration names, by their role, for the manifest."""
    files: dict[str, Input] = {} if config.file is None else {"config": config.file}
    candidates = {
        "dem": config.terrain.dem,
        "release": config.release.file,
        "ground": config.ground.file,
        "ground classes": config.ground.classes,
        "ground ranges": config.ground.ranges,
        "profile": config.profile.file if config.profile else None,
    }
    if config.trees is not None:
        for key in FILE_KEYS["effects.trees"]:
            candidates[f"trees {key}"] = getattr(config.trees, key)
    for item in (*config.stations, *config.barriers):
        candidates[item.name] = item.file
    return files | {role: path for role, path in candidates.items() if path is not None}


def zoning_files(config: Config) -> dict[str, Input]:
    """Return the files that a zoning reads besides the inputs of the run, by role."""
    files: dict[str, Input | None] = {
        "frequencies": config.hazard.frequencies,
        "vulnerability": config.risk.vulnerability,
        "assessed area": config.hazard.assessed,
        "edits": config.edits.file,
    }
    files |= {f"objects {o.name}": o.file for o in config.objects}
    if is_preset_file(config.hazard.preset):
        files["preset"] = Path(config.hazard.preset)
    return {role: path for role, path in files.items() if path is not None}


def input_digests(config: Config) -> dict[str, str]:
    """Return digests of all files that a configuration names, empty where one is unreadable."""
    found = {}
    for file in (input_files(config) | zoning_files(config)).values():
        found[str(file)] = ""
        with suppress(InputError):  # Its reader knows better what is wrong with it.
            found[str(file)] = file_digest(file)
    return found


def profile_from_csv(config: Config, path: Input | None = None) -> ProfileInput:
    """Return the profile of ``[profile] file``, or of another CSV file in its place."""
    settings = config.profile
    file = path or (settings.file if settings else None)
    if file is None:
        raise ConfigError(
            "no profile to run", file=config.file, field="profile.file",
            expected="a CSV file, or a point or a fall line to cut a profile from the terrain",
        )  # fmt: skip
    table = read_ground_table(config.ground.classes, config.engine.readings)
    default = table.names[default_class(config.ground, table)]
    flat = read_profile(file, table, default)
    check_on_profile(config, flat)
    s, z = flat.vertices(0)
    require_profile(config, s, z, 0)
    start = settings.start_m if settings else (float(s[0]), float(s[0]))
    return ProfileInput(
        name=config.project.name, s=s, z=z, ground=flat.ground, table=table,
        control_lines=tuple(profile_control_lines(config)), start=start,
        forest=_even_forest(config, s),
    )  # fmt: skip


def _even_forest(config: Config, s: FloatArray) -> Forest | None:
    """Return the same forest all along a profile that lies on no map."""
    trees = config.trees
    if trees is None:
        return None
    for key in FILE_KEYS["effects.trees"]:
        if getattr(trees, key) is not None:
            raise ConfigError(
                "has no place along a profile from a table", file=config.file,
                field=f"effects.trees.{key}", expected="stems_per_ha and dbh_cm alone",
            )  # fmt: skip
    n = stretches_of(s).size - 1
    stems, dbh = (trees.stems_per_ha or 0.0), (trees.dbh_cm or 0.0)
    return Forest(np.full(n, stems / 1e4), np.full(n, dbh / 100.0))


def yearly_frequencies(
    config: Config, areas: Sequence[ReleaseArea], known: Sequence[str] | None = None
) -> dict[tuple[str, str], float]:
    """Return blocks released per year, by release area and block scenario.

    The table of frequencies may hold the ``known`` names; default: of the file of release areas.
    """
    table: dict[tuple[str, str], Onset] = {}
    file = config.hazard.frequencies
    if file is not None:
        names = release_names(config.release) if known is None else known
        table = read_frequencies(file, names, config.block_names)
    return onset_frequencies(areas, config.onsets, table, file, config.file)


def states_frequencies(config: Config) -> bool:
    """Return whether any onset frequency is stated: then all must be."""
    stated = any(o.frequency is not None for o in config.onsets.values())
    return stated or config.hazard.frequencies is not None


def read_rules(config: Config, run: MapRun) -> Rules:
    """Read preset, frequencies and exposed objects."""
    preset = named_preset(config)
    frequencies = yearly_frequencies(config, run.areas)
    with collected_notices() as notices:
        placed = placed_objects(config, run.grid)
        vulnerability = None
        if len(placed):
            if config.risk.vulnerability is None:
                raise ConfigError(
                    "missing key: objects need to know what a hit does to them",
                    file=config.file, field="risk.vulnerability",
                    expected="a CSV table: kind, intensity, vulnerability, lethality, source",
                )  # fmt: skip
            codes = [c.code for c in preset.intensities]
            vulnerability = read_vulnerability(config.risk.vulnerability, codes)
            vulnerability.check_covers(placed.objects)
    width = ref_width(config, run.grid.cell_size)
    cell_size = run.grid.cell_size
    zones = config.zones.drawing(preset.sheet, width, run.release.spacing_m, cell_size)
    check_cells(cell_size)
    return Rules(
        preset=preset,
        frequencies=frequencies,
        placed=placed,
        vulnerability=vulnerability,
        zones=zones,
        ref_width_m=width,
        notices=tuple(notices),
        assessed=assessed_area(config.hazard.assessed, config.hazard.assessed_layer, run.grid),
    )


def placed_objects(config: Config, grid: Grid) -> PlacedObjects:
    """Return the exposed objects of all layers."""
    return joined_objects([read_objects(own, grid) for own in config.objects], config.file)


def named_preset(config: Config) -> HazardPreset:
    """Return the preset that the configuration names."""
    try:
        return read_preset(config.hazard.preset)
    except InputError as error:
        if error.field != "preset":
            raise
        file = error.file or config.file
        raise InputError(**error.parts(file=file, field="hazard.preset")) from None


def with_rules(run: MapRun, rules: Rules) -> MapRun:
    """Return the run with the energies, objects and windows at which a zoning needs counts."""
    thresholds, width = rules.preset.thresholds_kj, rules.ref_width_m
    return with_objects(replace(run, thresholds_kj=thresholds, ref_width_m=width), rules.placed)


def with_objects(run: MapRun, placed: PlacedObjects) -> MapRun:
    """Return the run with the cells of exposed objects, whose hits are counted."""
    return replace(run, objects=ObjectCells(len(placed), *object_cells(placed, run.grid)))


def cells_of_wholes(placed: PlacedObjects, grid: Grid) -> tuple[list[str], ObjectCells]:
    """Return names of the exposed objects, a road as a whole, and the cells that each touches."""
    names = list(placed.wholes)
    cells, part = object_cells(placed, grid)
    owner = np.array([names.index(o.whole) for o in placed.objects], np.int64)
    return names, ObjectCells(len(names), cells, owner[part])


def compared_run(config: Config, run: MapRun, along_slope: bool = False) -> MapRun:
    """Return a run whose blocks are also simulated without barriers, if that is wanted.

    ``along_slope``: these are recorded at copies of the lines up and down the slope, too.
    """
    lines = run.control_lines
    if not (config.hazard.compare_barriers and any(g.kind != "station" for g, _ in lines)):
        return run
    copies = moved_lines(run.grid, lines) if along_slope else ()
    stations = tuple(copy.as_station(lines[copy.of][0].name) for copy in copies)
    return replace(run, further_stations=stations)


def ref_width(config: Config, cell_size: float) -> float:
    """Return reference width of the hazard curves (m)."""
    width = config.hazard.ref_width_m
    if width is None:
        raise ConfigError(
            "missing key: frequencies need the width that they refer to",
            file=config.file, field="hazard.ref_width_m",
            expected="width of the exposed object and a block, as 10 (m)",
        )  # fmt: skip
    # Blocks could pass between the centres of two cells and count for neither.
    if width < cell_size * (1.0 - 1e-9):
        raise ConfigError(
            "is narrower than a cell of the terrain model",
            file=config.file, field="hazard.ref_width_m",
            found=f"{width:g} m with cells of {cell_size:g} m",
            expected=f"{cell_size:g} m or more, or a finer terrain model",
        )  # fmt: skip
    return width
