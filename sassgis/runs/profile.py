"""A run along one profile: trajectories, stations, run-out, energy along the slope."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import sassgis
from sassgis.engine.event_log import trajectory
from sassgis.engine.simulate import ControlLineCrossings, Forest, Simulated, default_bins, simulate
from sassgis.hazard.control_lines import ControlLineSums
from sassgis.hazard.statistics import quantiles
from sassgis.io.read.config import (
    Config,
    load_config,
    profile_control_lines,
    resolved,
    settings_hash,
)
from sassgis.io.read.ground_map import default_class, read_ground_table
from sassgis.io.read.profile_csv import check_on_profile, read_profile
from sassgis.io.write.frames import write_table
from sassgis.io.write.layers.maps import PROBABILITIES
from sassgis.io.write.layers.run_vectors import STOP_TEXT
from sassgis.io.write.manifest import write_manifest
from sassgis.io.write.staging import staged_output
from sassgis.model import rng
from sassgis.model.errors import ConfigError, InputError
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable
from sassgis.model.profiles import ProfileSet, ReleasePoints, TraceSet
from sassgis.model.results import ControlLine, Histogram, Outcome, StopReason
from sassgis.report import figures
from sassgis.report.map_report import control_line_tables, file_stems, station_figures
from sassgis.report.page import ReportContext, ReportFigure, ReportTable, write_report
from sassgis.runs.inputs import (
    collected_notices,
    fall_line_settings,
    input_files,
    read_map_run,
)
from sassgis.runs.map import LEAD_IN_M, MapRun, scenario_word
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.flatten import chainage_to_xy, crossings, profiles
from sassgis.terrain.stretch import with_lead_in

#: Width of the stretches for which energy, speed and height along the profile are given (m).
STRETCH_M = 1.0
_LOG_EVENTS = 2000
_DRAWN = 100


@dataclass(frozen=True, slots=True)
class ProfileInput:
    """A profile to be run.

    Attributes
    ----------
    name : str
    s, z : float64, shape (n,)
        Chainage and height of the vertices (m).
    ground : int32, shape (n,)
        Ground class of the segment that starts at each vertex.
    table : GroundTable
    gates : tuple of (Gate, chainage)
    start : (low, high)
        Chainages between which rocks start (m).
    forest : Forest or None
        Stems on the stretches of the profile.
    """

    name: str
    s: FloatArray
    z: FloatArray
    ground: NDArray[np.int32]
    table: GroundTable
    control_lines: tuple[tuple[ControlLine, float], ...]
    start: tuple[float, float]
    forest: Forest | None = None


@dataclass(frozen=True, slots=True)
class ProfileResult:
    """What the rocks of a profile left.

    Attributes
    ----------
    profile : ProfileInput
    rocks : ROCK_DTYPE, shape (n_scenarios * n_rocks,)
    scenario : int64, same shape
        Position in the configuration's blocks.
    pieces : ROCK_DTYPE
        Pieces of broken rocks and blocks set in motion.
    piece_scenario : int64, same shape
    passages : PASSAGE_DTYPE
    gates : GateSums
    paths : tuple of (s, z)
        Trajectories of the first rocks of each block scenario (m).
    drawn : int
        How many of each scenario.
    stretches : float64, shape (n + 1,)
        Borders of the stretches of the profile (m).
    along : dict of str to dict of float to float64, shape (n,)
        Quantiles of "energy" (kJ), "speed" (m/s) and "height" (m) in each stretch.
    """

    profile: ProfileInput
    rocks: NDArray[np.void]
    scenario: NDArray[np.int64]
    pieces: NDArray[np.void]
    piece_scenario: NDArray[np.int64]
    passages: NDArray[np.void]
    control_lines: ControlLineSums
    paths: tuple[tuple[FloatArray, FloatArray], ...]
    drawn: int
    stretches: FloatArray
    along: dict[str, dict[float, FloatArray]]


def profile_from_csv(config: Config, path: Path | None = None) -> ProfileInput:
    """The profile of ``[profile] file``, or of another CSV file in its place."""
    settings = config.profile
    file = path or (settings.file if settings else None)
    if file is None:
        raise ConfigError(
            "no profile to run",
            file=config.file,
            field="profile.file",
            expected="a CSV file; or give --csv, or --point to cut a profile from the terrain",
        )
    table = read_ground_table(config.ground.classes)
    default = table.names[default_class(config.ground, table)]
    flat = read_profile(file, table, default)
    check_on_profile(config, flat)
    s, z = flat.vertices(0)
    start = settings.start_m if settings else (float(s[0]), float(s[0]))
    return ProfileInput(
        config.project.name, s, z, flat.ground, table, tuple(profile_control_lines(config)), start,
        _even_forest(config, s),
    )  # fmt: skip


def _even_forest(config: Config, s: FloatArray) -> Forest | None:
    """The same forest all along a profile that lies on no map."""
    trees = config.trees
    if trees is None:
        return None
    for key in ("file", "stems_raster", "dbh_raster"):
        if getattr(trees, key) is not None:
            raise ConfigError(
                "has no place along a profile from a table",
                file=config.file,
                field=f"effects.trees.{key}",
                expected="stems_per_ha and dbh_cm alone",
            )
    n = stretches_of(s).size - 1
    stems, dbh = (trees.stems_per_ha or 0.0), (trees.dbh_cm or 0.0)
    return Forest(np.full(n, stems / 1e4), np.full(n, dbh / 100.0))


def _forest_along(run: MapRun, traces: TraceSet, s: FloatArray) -> Forest | None:
    """The forest of the map under the middle of each stretch of a profile."""
    if run.forest is None:
        return None
    border = stretches_of(s)
    middle = np.clip(0.5 * (border[1:] + border[:-1]), 0.0, s[-1])
    x, y = chainage_to_xy(traces, np.zeros(middle.size, np.int64), middle)
    cell = np.maximum(run.grid.cell_of(x, y), 0)
    return Forest(run.forest.stems_per_m2[cell], run.forest.diameter_m[cell])


def stretches_of(s: FloatArray) -> FloatArray:
    """Borders of the stretches of STRETCH_M that stand in for cells along a profile."""
    n = max(math.ceil((s[-1] - s[0]) / STRETCH_M), 1)
    border: FloatArray = s[0] + STRETCH_M * np.arange(n + 1)
    border[-1] = s[-1]
    return border


def profile_from_terrain(config: Config, x: float, y: float) -> ProfileInput:
    """The profile of the fall line that starts at a point of the map.

    Raises
    ------
    InputError
        If the point lies outside the terrain model or on nodata.
    """
    run = read_map_run(config)
    surface = fall_line_surface(run.grid, fall_line_settings(config))
    point = ReleasePoints(
        np.array([x]), np.array([y]), np.zeros(1, np.int64), np.zeros(1, np.uint64), ("point",)
    )
    traces = trace(run.grid, surface, point, run.fall_lines)
    flat = profiles(run.grid, traces, run.ground, run.segment_tolerance_m)
    s, z = flat.vertices(0)
    if s.size < 2:
        west, south, east, north = run.grid.bounds
        raise InputError(
            "no fall line starts here",
            file=config.dem_path,
            field="--point",
            found=f"{x:.10g}, {y:.10g}",
            expected=f"a point on known terrain within x {west:.10g} to {east:.10g}, "
            f"y {south:.10g} to {north:.10g}",
        )
    control_lines = []
    for control_line, course in run.control_lines:
        _, chainage = crossings(traces, course)
        control_lines += [
            (
                control_line
                if i == 0
                else replace(control_line, name=f"{control_line.name} ({i + 1})"),
                float(c),
            )
            for i, c in enumerate(chainage)
        ]
    return ProfileInput(
        f"{config.project.name}: fall line from {x:.0f}, {y:.0f}",
        s, z, flat.ground[: s.size], run.table, tuple(control_lines), (0.0, 0.0),
        _forest_along(run, traces, s),
    )  # fmt: skip


def _with_stretches(profile: ProfileInput) -> ProfileSet:
    """The profile with stretches of STRETCH_M in place of the cells of a map."""
    border = stretches_of(profile.s)
    n = border.size - 1
    flat = ProfileSet(
        np.array([0, profile.s.size], np.int64), profile.s, profile.z,
        profile.ground.astype(np.int32), np.array([0, n], np.int64), border,
        np.arange(n, dtype=np.int64),
    )  # fmt: skip
    return with_lead_in(flat, LEAD_IN_M)


def simulate_profile(
    config: Config, profile: ProfileInput, *, seed: int | None = None, rocks: int | None = None
) -> ProfileResult:
    """Follow rocks of every block scenario down one profile.

    Parameters
    ----------
    config : Config
    profile : ProfileInput
    seed, rocks : int, optional
        In place of those of the configuration; rocks count per block scenario.
    """
    if not config.blocks:
        raise ConfigError(
            "no block scenario", file=config.file, field="blocks", expected="one [[blocks]] or more"
        )
    count = rocks or (config.profile.rocks if config.profile else 100)
    flat = _with_stretches(profile)
    chainages = [c for _, c in profile.control_lines]
    control_lines = ControlLineCrossings.same_for_all(
        [g for g, _ in profile.control_lines], chainages, 1
    )
    sums = ControlLineSums(control_lines.control_lines)
    relief = float(profile.z.max() - profile.z.min())
    mass = max(b.largest_mass_kg for b in config.blocks)
    bins = default_bins(2e-3 * mass * 9.81 * max(relief, 10.0), max(relief, 4.0), 100.0)
    parts: list[Simulated] = []
    paths: list[tuple[FloatArray, FloatArray]] = []
    drawn = min(count, -(-_DRAWN // len(config.blocks)))
    for blocks in config.blocks:
        keys = rng.combined(np.zeros(1, np.uint64), scenario_word(blocks.name))

        def follow(n: int, first: int, events: int, blocks=blocks, keys=keys) -> Simulated:  # type: ignore[no-untyped-def]
            return simulate(
                flat,
                profile.table,
                blocks,
                config.engine,
                seed=config.run.seed if seed is None else seed,
                rocks_per_line=n,
                line_keys=keys,
                starts=np.array([profile.start]),
                control_lines=control_lines,
                first_rock=first,
                bins=bins,
                log_events=events,
                effects=config.effect_settings,
                forest=profile.forest,
            )

        shown = follow(drawn, 0, _LOG_EVENTS)
        paths += [trajectory(c, config.engine.gravity_mps2) for c in shown.event_logs]
        parts.append(follow(count, 0, 0))
    for part in parts:
        sums.add(part.passages)
    borders = flat.cell_s[1:]
    along = {
        name: dict(
            zip(
                PROBABILITIES,
                quantiles(
                    np.sum([part.sums[name] for part in parts], axis=0, dtype=np.int64),
                    getattr(bins, name),
                    PROBABILITIES,
                    np.max([part.sums[f"{name}_max"] for part in parts], axis=0),
                ),
                strict=True,
            )
        )
        for name in ("energy", "speed", "height")
    }
    return ProfileResult(
        profile,
        np.concatenate([p.rocks for p in parts]),
        np.repeat(np.arange(len(parts), dtype=np.int64), [p.rocks.size for p in parts]),
        np.concatenate([p.pieces for p in parts]),
        np.repeat(np.arange(len(parts), dtype=np.int64), [p.pieces.size for p in parts]),
        np.concatenate([p.passages for p in parts]),
        sums,
        tuple(paths),
        drawn,
        borders,
        along,
    )


def profile_panel(result: ProfileResult, title: str = "") -> figures.ProfilePanel:
    """The slope with trajectories, gates and stops, for one or several panels."""
    p = result.profile
    ended = np.concatenate([result.rocks, result.pieces])
    return figures.ProfilePanel(
        s=p.s,
        z=p.z,
        trajectories=list(result.paths),
        ground=p.ground.astype(np.int64),
        ground_names=p.table.names,
        control_lines=[(g, c, float(np.interp(c, p.s, p.z))) for g, c in p.control_lines],
        stops=ended["runout_m"][
            (ended["rock"] < result.drawn) & (ended["reason"] != StopReason.BROKEN)
        ],
        title=title or p.name,
    )


def passage_histogram(
    result: ProfileResult, control_line: str, quantity: str, edges: Sequence[float], unit: str
) -> Histogram:
    """Histogram of one quantity of the passages at a station or barrier, by its name."""
    names = [g.name for g, _ in result.profile.control_lines]
    rows = result.passages[result.passages["control_line"] == names.index(control_line)]
    counts, _ = np.histogram(np.clip(rows[quantity], edges[0], edges[-1]), edges)
    return Histogram(np.asarray(edges, float), counts.astype(np.int64), unit)


def share_within(
    result: ProfileResult, control_line: str, quantity: str, low: float, high: float
) -> tuple[int, float]:
    """Passages at a station or barrier, and the share of them between two limits (inclusive)."""
    names = [g.name for g, _ in result.profile.control_lines]
    values = result.passages[result.passages["control_line"] == names.index(control_line)][quantity]
    share = float(((values >= low) & (values <= high)).mean()) if values.size else float("nan")
    return int(values.size), share


def arrivals(result: ProfileResult, control_line: str) -> int:
    """Rocks that came to a station or barrier, by its name."""
    names = [g.name for g, _ in result.profile.control_lines]
    return result.control_lines.arrivals(names.index(control_line))


def run_profile(
    config: Config | str | Path,
    out: str | Path,
    *,
    csv_file: str | Path | None = None,
    point: tuple[float, float] | None = None,
    rocks: int | None = None,
    seed: int | None = None,
    overwrite: bool = False,
) -> ProfileResult:
    """Run one profile and write figures, tables and report.

    Parameters
    ----------
    config : Config or path
    out : path
        Folder of the result; appears whole or not at all.
    csv_file : path, optional
        Profile in place of ``[profile] file``.
    point : (x, y), optional
        Start of a fall line on the terrain, in place of a CSV file.
    rocks, seed : int, optional
        In place of those of the configuration.
    overwrite : bool

    Returns
    -------
    ProfileResult

    Raises
    ------
    ConfigError, InputError, OutputError
    """
    if not isinstance(config, Config):
        config = load_config(config, {} if seed is None else {"run.seed": seed})
    with staged_output(Path(out), overwrite) as work:
        with collected_notices() as notices:
            if point is not None:
                profile = profile_from_terrain(config, *point)
            else:
                profile = profile_from_csv(config, None if csv_file is None else Path(csv_file))
        result = simulate_profile(config, profile, seed=seed, rocks=rocks)
        _write(work, config, result, list(notices), csv_file, seed)
    return result


def _write(
    work: Path,
    config: Config,
    result: ProfileResult,
    warnings: list[str],
    csv_file: str | Path | None,
    seed: int | None,
) -> None:
    p = result.profile
    total = result.rocks.size
    born = int(result.pieces.size)
    effects = config.effect_settings
    if effects.lateral_deflection is not None:
        warnings.append("A profile has no width: [effects.lateral_deflection] does nothing here.")
    ended = np.concatenate([result.rocks, result.pieces])
    reasons = np.bincount(result.rocks["reason"], minlength=len(StopReason))
    for reason in (StopReason.LEFT_PROFILE, StopReason.STEP_LIMIT, StopReason.NEVER_STARTED):
        if reasons[reason]:
            warnings.append(f"{reasons[reason]} of {total} rocks: {STOP_TEXT[reason]}.")
    folder = work / "figures"
    pictures = []

    def add(name: str, title: str, caption: str, figure: object) -> None:
        png = figures.to_png(figure)  # type: ignore[arg-type]
        folder.mkdir(exist_ok=True)
        (folder / f"{name}.png").write_bytes(png)
        pictures.append(ReportFigure(title, caption, png))

    control_lines = [(g, c) for g, c in p.control_lines]
    add(
        "profile", "Trajectories", "Paths of the centres of the rocks; chainage in plan.",
        figures.profile_comparison_figure([profile_panel(result)]),
    )  # fmt: skip
    quantities: tuple[tuple[Literal["energy", "speed", "height"], str], ...] = (
        ("energy", "Energy"),
        ("speed", "Speed"),
        ("height", "Passing height"),
    )
    for quantity, words in quantities:
        add(
            f"{quantity}_along",
            f"{words} along the profile",
            f"Quantiles of the rocks that come into each stretch of {STRETCH_M:g} m.",
            figures.energy_profile_figure(
                result.stretches,
                result.along[quantity],
                p.s,
                p.z,
                quantity=quantity,
                control_lines=control_lines,
            ),
        )
    add(
        "runout", "Run-out",
        "Chainage at which rocks end, by the reason"
        + (", their pieces and the blocks that they set in motion too." if born else "."),
        figures.runout_figure(ended["runout_m"], ended["reason"].astype(np.int64)),
    )  # fmt: skip
    drawn = station_figures(result.control_lines, total)
    for (name, figure), stem in zip(drawn, file_stems([n for n, _ in drawn]), strict=True):
        add(f"station_{stem}", f"At {name}", "First downhill passage.", figure)
    scenario = np.array([b.name for b in config.blocks])[
        np.concatenate([result.scenario, result.piece_scenario])
    ]
    rocks = pd.DataFrame({n: ended[n] for n in ended.dtype.names or ()})
    rocks["reason"] = [StopReason(int(r)).name.lower() for r in rocks["reason"]]
    rocks.insert(0, "scenario", scenario)
    write_table(work / "tables" / "rocks.csv", [rocks.drop(columns="line")])
    passages = pd.DataFrame({n: result.passages[n] for n in result.passages.dtype.names or ()})
    names = np.array([g.name for g, _ in p.control_lines], dtype=object)
    passages["control_line"] = names[result.passages["control_line"]] if names.size else []
    passages["outcome"] = [Outcome(int(o)).name.lower() for o in passages["outcome"]]
    write_table(work / "tables" / "passages.csv", [passages.drop(columns="line")])
    table = ReportTable(
        "How rocks end",
        (("reason", ""), ("rocks", ""), ("share", "%")),
        tuple(
            (STOP_TEXT[r], int(reasons[r]), 100.0 * int(reasons[r]) / max(total, 1))
            for r in StopReason
        ),
    )
    used_seed = config.run.seed if seed is None else seed
    write_report(
        work / "report.html",
        ReportContext(
            title=p.name,
            subtitle="Rockfall along one profile with the SASS model (Bozzolo and Pamini, 1986)",
            what_was_run=(
                ("Profile", f"{p.s.size} vertices, {p.s[-1] - p.s[0]:.0f} m long, "
                 f"{p.z.max() - p.z.min():.0f} m of relief"),
                ("Start", f"chainage {p.start[0]:g} to {p.start[1]:g} m"),
                ("Rocks", int(total)),
                ("Pieces and blocks set in motion", born),
                ("Effects beyond the model of 1986", ", ".join(effects.names) or "none"),
            ),
            warnings=tuple(warnings),
            key_results=table,
            figures=tuple(pictures),
            tables=tuple(control_line_tables(result.control_lines)),
            provenance=(
                ("Program", f"sassgis {sassgis.__version__}"),
                ("Seed", used_seed),
                ("Settings and inputs (SHA-256)", settings_hash(config)),
            ),
        ),
    )  # fmt: skip
    inputs = input_files(config)
    if csv_file is not None:
        inputs["profile"] = Path(csv_file)
    write_manifest(
        work / "manifest.json",
        inputs=inputs,
        base=config.file.parent,
        crs="",
        vertical_datum="",
        seed=used_seed,
        ref_width_m=None,
        preset="",
        settings=resolved(config),
        counts={
            "rocks": int(total),
            "pieces": born,
            **{f"rocks_{r.name.lower()}": int(reasons[r]) for r in StopReason},
        },
        warnings=warnings,
    )
