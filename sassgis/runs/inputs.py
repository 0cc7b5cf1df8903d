"""From a configuration to everything that a run on the map needs."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.simulate import Forest
from sassgis.io.read.forest import read_forest
from sassgis.io.read.ground_map import ground_raster, read_ground_table
from sassgis.io.read.tiles import read_terrain
from sassgis.io.read.vectors import ReleaseArea, read_control_lines, read_release
from sassgis.model.errors import ConfigError
from sassgis.model.grid import FloatArray, Grid
from sassgis.model.ground import GroundTable
from sassgis.model.results import ControlLine
from sassgis.model.run_config import Config
from sassgis.runs.map import MapRun
from sassgis.terrain.fall_lines import FallLineSettings
from sassgis.terrain.spread import SpreadSettings


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
    table = read_ground_table(config.ground.classes)
    ground = ground_raster(config.ground, grid, table)
    control_lines = read_control_lines(config, grid)
    return map_run_of(config, grid, ground, table, chosen, control_lines, forest_of(config, grid))


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
        spread=SpreadSettings(config.spread.lines_per_point, config.spread.width_percent),
        segment_tolerance_m=config.terrain.segment_tolerance_m,
        spacing_m=config.release.spacing_m,
        placement=config.release.placement,
        rocks_per_point=config.release.rocks_per_point,
        seed=config.run.seed,
        stop_points_max=config.output.stop_points_max,
        effects=config.effects,
        forest=forest,
    )


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


def unverified_classes(run: MapRun) -> list[str]:
    """Names of the ground classes on the map whose values are not from the paper."""
    used = np.unique(run.ground[np.isfinite(run.grid.values)])
    return [run.table.classes[i].name for i in used if not run.table.classes[i].verified]
