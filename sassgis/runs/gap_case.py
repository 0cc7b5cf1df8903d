"""A configuration and observations put together: the case that a diagnosis looks at."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sassgis.engine.simulate_paths import PathTerrain
from sassgis.gap.calibration.parameters import classes_met
from sassgis.gap.calibration.problem import CalibrationProblem
from sassgis.gap.observations.allowances import GRAVITY
from sassgis.gap.observations.case import Case
from sassgis.gap.observations.observed import DENSITY_KGM3, Observations, rock_masses_kg
from sassgis.gap.observations.projection import (
    PROLONG_M,
    observed_release_points,
    project_observations,
    station_chainages,
)
from sassgis.gap.replicas.released_rocks import station_traces
from sassgis.io.read.config import settings_hash
from sassgis.io.read.input_parts import file_digest
from sassgis.io.read.observation_files import AnyObservations, observation_source, read_observations
from sassgis.model.blocks import BlockPopulation
from sassgis.model.declared import Input
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.map_run import MapRun
from sassgis.model.profiles import ReleasePoints, TraceSet
from sassgis.model.run_config import Config
from sassgis.runs.inputs import read_map_run
from sassgis.runs.job import AnyConfig, configured
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.plan import plan
from sassgis.terrain.prepare import prepare_lines
from sassgis.terrain.release import point_keys, take


def comparable(problem: CalibrationProblem, observations: AnyObservations) -> CalibrationProblem:
    """The problem; InputError if nothing was measured that a simulation can be compared with."""
    if not problem.scored:
        tables = problem.case.observations.tables
        raise InputError(
            "nothing to compare simulations with",
            file=observations_name(observations),
            field="deposits, passages, impacts",
            found=", ".join(f"{len(t)} {name}" for name, t in tables.items() if len(t))
            or "no rows",
            expected="stops, passages at stations, of 5 rocks or more, or impacts",
        )
    return problem


def read_case(config: AnyConfig, observations: AnyObservations) -> Case:
    """Read a configuration and observations: a GeoPackage, a folder of CSV files, or the tables.

    InputError, among others, if there is no rock whose fall line can be traced.
    """
    run = read_map_run(configured(config, None))
    seen = read_observations(observations, run.grid, *drop_and_density(run.blocks))
    file = observations_name(observations)
    if not seen.rock_names:
        raise InputError(
            "no rocks: neither a table of rocks nor any row with a rock_id",
            file=file,
            field="rocks",
            expected="one row or more",
        )
    traces, line, moved = _fall_lines(run, seen, file)
    prepared = prepare_lines(run, traces)
    stations = station_chainages(traces, seen.stations, prolong_m=PROLONG_M)
    masses = rock_masses_kg(seen)
    row = {name: i for i, name in enumerate(seen.rocks.rock_id.tolist())}
    blocks = tuple(
        _observed(replace(run.blocks[0], name=name), seen, row.get(name), float(mass))
        for name, mass in zip(seen.rock_names, masses, strict=True)
    )
    radius = np.array([_radius(b) for b in blocks], np.float64)
    case = Case(
        observations=seen,
        grid=run.grid,
        table=run.table,
        engine=run.engine,
        effects=run.effects,
        forest=run.forest,
        traces=traces,
        profiles=prepared.profiles,
        line=line,
        blocks=blocks,
        start=prepared.starts(moved)[line],
        mass_kg=masses,
        radius_m=radius,
        stations=stations,
        projected=project_observations(seen, traces, line, grid=run.grid, prolonged=run.followed),
    )
    case = replace(case, met=classes_met(case))
    if not run.followed:
        return case
    traced = station_traces(case)
    terrain = PathTerrain(
        run.heights, run.ground, run.terrain.segment_tolerance_m, traced, run.forest
    )
    return replace(case, terrain=terrain)


def observations_name(observations: AnyObservations) -> Path:
    """What messages call them."""
    return Path("observations" if isinstance(observations, Mapping) else observations)


def observed_files(case: Case) -> dict[str, Input]:
    """The files of the observations, each once, by their role."""
    files = sorted({*case.observations.files.values()}, key=str)
    return {f"observations {file.name}": file for file in files}


def drop_and_density(blocks: Sequence[BlockPopulation]) -> tuple[float, float]:
    """Height above the ground from which blocks are let go, at most (m), and density (kg/m³).

    A speed counts as its height; densities as the mean of the middles of their limits.
    """
    heights = (own.drop_m[1] + own.speed_mps[1] ** 2 / (2.0 * GRAVITY) for own in blocks)
    middles = [middle for own in blocks if (middle := 0.5 * sum(own.density_kgm3)) > 0.0]
    return max(heights, default=0.0), sum(middles) / len(middles) if middles else DENSITY_KGM3


def fingerprint_of(config: Config, observations: AnyObservations, options: str) -> str:
    """Of settings, inputs, observations and options."""
    digest = hashlib.sha256(settings_hash(config).encode())
    source = observation_source(observations)
    tables = {"": source} if isinstance(source, Path) else source
    digest.update("".join(f"{name} {file_digest(own)}" for name, own in tables.items()).encode())
    digest.update(options.encode())
    return digest.hexdigest()


def _fall_lines(
    run: MapRun, observations: Observations, file: Path
) -> tuple[TraceSet, IntArray, FloatArray]:
    """Fall lines, the line of each rock: its own, or one of the configured release points.

    The last array is of each line: how far up the slope from the release point it begins (m).
    """
    points, rock = observed_release_points(observations)
    line = np.full(len(observations.rock_names), -1, np.int64)
    if len(points):
        places = np.column_stack([points.x, points.y])
        unique, which = np.unique(places, axis=0, return_inverse=True)
        keys = np.concatenate([point_keys(f"{x:.3f} {y:.3f}", 1) for x, y in unique])
        numbers = np.arange(len(unique), dtype=np.int64)
        x, y = (unique[:, k].copy() for k in (0, 1))
        starts = ReleasePoints(x, y, numbers, keys, tuple(map(str, numbers.tolist())))
        line[rock] = which.ravel()
        moved = np.zeros(len(unique))
    else:
        planned = plan(run)
        starts, moved = planned.starts, planned.moved
    surface = fall_line_surface(run.grid, run.terrain)
    good = prepare_lines(run, trace(run.grid, surface, starts, run.terrain)).good
    if not good.any():
        raise InputError(
            "no fall line can be traced from the release points",
            file=file,
            field="rocks.x, rocks.y",
            found=f"{len(starts)} points",
            expected="points on the terrain model, on a slope",
        )
    line[(line >= 0) & ~good[line]] = -1
    # A rock of unknown release may have come from any of the places: they take turns.
    loose = np.flatnonzero(line < 0)
    line[loose] = np.resize(np.flatnonzero(good), loose.size)
    used, line = np.unique(line, return_inverse=True)
    traces = trace(run.grid, surface, take(starts, used), run.terrain)
    return traces, line.ravel().astype(np.int64), moved[used]


def _observed(
    block: BlockPopulation, observations: Observations, i: int | None, mass: float
) -> BlockPopulation:
    """The population of one rock: what was observed is fixed, the rest is drawn as configured.

    ``i`` is its row in the table of rocks, ``mass`` (kg) is NaN where it is unknown.
    """
    if i is None:
        return block
    rocks = observations.rocks
    axes = [float(getattr(rocks, f"semi_axis_{c}_m")[i]) for c in "abc"]
    density = float(rocks.density_kgm3[i])
    speed = float(rocks.release_speed_mps[i])
    changes: dict[str, object] = {}
    if math.isfinite(density):
        changes["density_kgm3"] = (density, density)
    if math.isfinite(speed):
        changes["speed_mps"] = (speed, speed)
    if all(math.isfinite(a) for a in axes):
        changes.update({f"axis_{j + 1}_m": (a, a) for j, a in enumerate(axes)})
        changes["volume_m3"] = changes["volume_exponent"] = None
    elif math.isfinite(mass):
        volume = float(rocks.volume_m3[i])
        if not math.isfinite(volume):
            middle = 0.5 * sum(block.density_kgm3) or DENSITY_KGM3
            volume = mass / (density if math.isfinite(density) else middle)
        changes["volume_m3"] = (volume, volume)
        changes["volume_exponent"] = None
    return replace(block, **changes)  # type: ignore[arg-type]


def _radius(block: BlockPopulation) -> float:
    """Radius of the sphere of equal volume of a rock in the middle of its limits (m)."""
    if block.volume_m3 is not None:
        volume = 0.5 * sum(block.volume_m3)
    else:
        limits = (block.axis_1_m, block.axis_2_m, block.axis_3_m)
        volume = 4.0 / 3.0 * math.pi * math.prod(0.5 * sum(axis) for axis in limits)
    return float(np.cbrt(3.0 * volume / (4.0 * math.pi)))
