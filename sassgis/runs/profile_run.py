"""A run along one profile: trajectories, stations, run-out, energy along the slope."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sassgis.compiled import rng
from sassgis.engine.simulate import Simulated, simulate
from sassgis.engine.state import trajectory
from sassgis.errors import InputError, notice
from sassgis.files.atomic_output import staged_output
from sassgis.grid import FloatArray, IntArray
from sassgis.hazard.warnings import profile_warnings
from sassgis.inputs.vectors import read_line
from sassgis.outputs.frames import profile_tables, write_table
from sassgis.report.map_report import profile_report
from sassgis.report.page import ReportContext, in_short, translated_report, write_report
from sassgis.runs.inputs import collected_notices, profile_from_csv, read_map_run
from sassgis.runs.provenance import byline, provenance, write_origin
from sassgis.runs.resumable_run import AnyConfig, configured
from sassgis.settings.languages import in_language
from sassgis.settings.map_run import Config, Forest, MapRun
from sassgis.settings.results import (
    ControlLineCrossings,
    LineEnd,
    ProfileSet,
    ReleasePoints,
    StopReason,
    TraceSet,
)
from sassgis.settings.schema import Input, named
from sassgis.settings.statistics_table import PROBABILITIES
from sassgis.simulation.control_lines import ControlLineSums
from sassgis.simulation.estimate import require_profile
from sassgis.simulation.map_sums import quantiles
from sassgis.simulation.path_sample import ProfileInput, ProfileResult, contacts_of, stretches_of
from sassgis.terrain.fall_lines import fall_line_surface, trace
from sassgis.terrain.flatten import chainage_to_xy
from sassgis.terrain.prepare import (
    LEAD_IN_M,
    SHORTEST_LINE_M,
    PreparedLines,
    prepare_lines,
    with_lead_in,
)

_LOG_EVENTS = 2000
_DRAWN = 100


@dataclass(frozen=True, slots=True)
class ProfileRunResult:
    """Result of a run along one profile."""

    folder: Path
    found: ProfileResult = field(repr=False)  # blocks, passages, paths, quantiles along the slope
    warnings: tuple[str, ...] = field(repr=False)  # what deserves a look before it is used
    report: ReportContext = field(repr=False)  # a notebook shows it in short

    def _repr_html_(self) -> str:
        return in_short(self.report, self.folder)


def _forest_along(run: MapRun, traces: TraceSet, s: FloatArray) -> Forest | None:
    """Return the forest of the map under the middle of each stretch of a profile."""
    if run.forest is None:
        return None
    border = stretches_of(s)
    middle = np.clip(0.5 * (border[1:] + border[:-1]), 0.0, s[-1])
    x, y = chainage_to_xy(traces, np.zeros(middle.size, np.int64), middle)
    cell = np.maximum(run.grid.cell_of(x, y), 0)
    return Forest(run.forest.stems_per_m2[cell], run.forest.diameter_m[cell])


def profile_input(
    config: Config,
    *,
    csv: Input | None = None,
    point: tuple[float, float] | None = None,
    line: Input | None = None,
) -> ProfileInput:
    """Return the profile configured, of a table, or of the terrain from a point or under a line."""
    if point is not None:
        try:
            x, y = point
        except (TypeError, ValueError):
            raise InputError(
                "is no point", field="point", found=repr(point),
                expected="(x, y) in the coordinates of the terrain model",
            ) from None  # fmt: skip
        return _fall_line(config, x, y)
    if line is not None:
        return _along_line(config, line)
    return profile_from_csv(config, csv)


def _along_line(config: Config, file: Input) -> ProfileInput:
    """Return profile of the terrain under a line of the map, from its first vertex to its last."""
    run = read_map_run(config, areas=())
    x, y = read_line(file, run.grid, "--line").T
    s = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    only = np.zeros(1, np.int64)
    traces = TraceSet(
        np.array([0, s.size]), x.copy(), y.copy(), s, only,
        np.array([LineEnd.MAX_LENGTH], np.uint8),
    )  # fmt: skip
    prepared = prepare_lines(run, traces)
    if not len(prepared) or not np.isfinite(prepared.flat.z).all():
        raise InputError(
            "no profile can be cut along this line", file=file, field="--line",
            found=f"a length of {s[-1]:.3g} m",
            expected=f"{SHORTEST_LINE_M:g} m or more, over known terrain",
        )  # fmt: skip
    return _profile_of(f"{config.project.name}: {file.stem}", run, prepared)


def _fall_line(config: Config, x: float, y: float) -> ProfileInput:
    """Return the profile of the fall line that starts at a point of the map."""
    run = read_map_run(config, areas=())
    surface = fall_line_surface(run.grid, run.terrain)
    point = ReleasePoints(
        np.array([x]), np.array([y]), np.zeros(1, np.int64), np.zeros(1, np.uint64), ("point",)
    )
    prepared = prepare_lines(run, trace(run.grid, surface, point, run.terrain))
    if not len(prepared):
        west, south, east, north = run.grid.bounds
        raise InputError(
            "no fall line starts here", file=config.dem_source, field="point",
            found=f"{x:.10g}, {y:.10g}",
            expected=f"a point on known terrain within x {west:.10g} to {east:.10g}, "
            f"y {south:.10g} to {north:.10g}",
        )  # fmt: skip
    return _profile_of(f"{config.project.name}: fall line from {x:.0f}, {y:.0f}", run, prepared)


def _profile_of(title: str, run: MapRun, prepared: PreparedLines) -> ProfileInput:
    """Return the profile of one line with the stations and barriers that it crosses."""
    s, z = prepared.flat.vertices(0)
    crossed = prepared.crossings
    control_lines = []
    for k, line in enumerate(crossed.control_lines):
        for i, chainage in enumerate(crossed.chainage[crossed.control_line == k]):
            name = line.name if i == 0 else f"{line.name} ({i + 1})"
            control_lines.append((replace(line, name=name), float(chainage)))
    return ProfileInput(
        name=title, s=s, z=z, ground=prepared.flat.ground, table=run.table,
        control_lines=tuple(control_lines), start=(0.0, 0.0),
        forest=_forest_along(run, prepared.lines, s),
    )  # fmt: skip


def _with_stretches(profile: ProfileInput) -> ProfileSet:
    """Return the profile with stretches of STRETCH_M in place of the cells of a map."""
    border = stretches_of(profile.s)
    n = border.size - 1
    flat = ProfileSet(
        offset=np.array([0, profile.s.size], np.int64),
        s=profile.s,
        z=profile.z,
        ground=profile.ground.astype(np.int32),
        cell_offset=np.array([0, n], np.int64),
        cell_s=border,
        cell=np.arange(n, dtype=np.int64),
    )
    return with_lead_in(flat, LEAD_IN_M)


def simulate_profile(
    config: Config, profile: ProfileInput, *, rocks: int | None = None
) -> ProfileResult:
    """Simulate blocks down one profile: of every scenario so many, or as many as configured."""
    count = rocks or (config.profile.rocks if config.profile else 100)
    bins = require_profile(config, profile.s, profile.z, count)
    flat = _with_stretches(profile)
    lines, chainages = [g for g, _ in profile.control_lines], [c for _, c in profile.control_lines]
    control_lines = ControlLineCrossings.same_for_all(lines, chainages, 1)
    sums = ControlLineSums(control_lines.control_lines)
    parts: list[Simulated] = []
    paths: list[tuple[FloatArray, FloatArray]] = []
    contacts: list[NDArray[np.void]] = []
    drawn = min(count, -(-_DRAWN // len(config.blocks)))
    for blocks in config.blocks:
        keys = rng.combined(np.zeros(1, np.uint64), rng.word_of(blocks.name))
        simulated = partial(
            simulate, flat, profile.table, blocks, config.engine,
            seed=config.run.seed, line_keys=keys,
            starts=np.array([profile.start]), control_lines=control_lines, bins=bins,
            effects=config.effects, forest=profile.forest,
        )  # fmt: skip
        shown = simulated(rocks_per_line=drawn, log_events=_LOG_EVENTS)
        paths += [trajectory(c, config.engine.gravity_mps2)[1:] for c in shown.event_logs]
        met = contacts_of(shown.event_logs, shown.rocks, config.engine)
        contacts.append(np.concatenate(met))
        parts.append(simulated(rocks_per_line=count))
    for part in parts:
        sums.add(part.passages)
    along = {}
    for name in ("energy", "speed", "height"):
        counts: IntArray = np.sum([part.sums[name] for part in parts], axis=0, dtype=np.int64)
        largest = np.max([part.sums[f"{name}_max"] for part in parts], axis=0)
        values = quantiles(counts, bins.edges[name], PROBABILITIES, largest)
        along[name] = dict(zip(PROBABILITIES, values, strict=True))
    numbers = np.arange(len(parts), dtype=np.int64)
    return ProfileResult(
        profile=profile,
        rocks=np.concatenate([p.rocks for p in parts]),
        scenario=np.repeat(numbers, [p.rocks.size for p in parts]),
        pieces=np.concatenate([p.pieces for p in parts]),
        piece_scenario=np.repeat(numbers, [p.pieces.size for p in parts]),
        passages=np.concatenate([p.passages for p in parts]),
        passage_scenario=np.repeat(numbers, [p.passages.size for p in parts]),
        control_lines=sums, paths=tuple(paths), drawn=drawn,
        contacts=np.concatenate(contacts),
        contact_scenario=np.repeat(numbers, [own.size for own in contacts]),
        stretches=flat.cell_s[1:],
        along=along,
    )  # fmt: skip


def run_profile(
    config: AnyConfig,
    out: str | Path,
    *,
    csv_file: str | Path | None = None,
    point: tuple[float, float] | None = None,
    line_file: str | Path | None = None,
    rocks: int | None = None,
    seed: int | None = None,
    overwrite: bool = False,
) -> ProfileRunResult:
    """Run one profile and write figures, tables and report.

    Parameters
    ----------
    csv_file : path, optional
        Profile in place of ``[profile] file``.
    point : (x, y), optional
        Start of a fall line on the terrain, in place of a CSV file.
    line_file : path, optional
        Vector file with one line over the terrain, drawn downwards, in place of a CSV file.
    rocks, seed : int, optional
        In place of those of the configuration.
    """
    config = configured(config, seed)
    csv, line = (None if f is None else named(f) for f in (csv_file, line_file))
    with staged_output(Path(out), overwrite) as work:
        with collected_notices() as notices:
            profile = profile_input(config, csv=csv, point=point, line=line)
            if (rise := _rise(profile)) > 0.0:
                notice(f"{profile.name}: ends {rise:.1f} m above the start: drawn uphill?")
        result = simulate_profile(config, profile, rocks=rocks)
        own = config.profile.file if config.profile else None
        _check_started(result, csv or line or (config.dem_source if point else own))
        warnings = [*config.notes, *notices, *profile_warnings(result, config.effects)]
        scenarios = [b.name for b in config.blocks]
        tables = profile_tables(result, scenarios)
        write_table(work / "tables" / "rocks.csv", [tables.blocks])
        write_table(work / "tables" / "passages.csv", [tables.passages])
        write_table(work / "tables" / "contacts.csv", [tables.contacts])
        settings = tuple(provenance(config).items())
        with in_language(config.project.language):
            context = profile_report(
                result, warnings, config.effects.names, byline(config), settings, work / "figures"
            )
            report = translated_report(context)
            write_report(work / "report.html", report)
        reasons = result.rocks["reason"]
        counts = {
            "rocks": int(result.rocks.size),
            "fragments": int(result.pieces.size),
            **{f"rocks_{r.name.lower()}": int((reasons == r).sum()) for r in StopReason},
        }
        # The profile, or the line under which it lies, if it is not that of the configuration.
        inputs = {"profile": file} if (file := csv or line) else {}
        write_origin(work, config, counts, warnings, seed=config.run.seed, inputs=inputs)
    return ProfileRunResult(Path(out), result, tuple(warnings), report)


def _rise(profile: ProfileInput) -> float:
    """Return by how much the last vertex lies above the start (m)."""
    return float(profile.z[-1] - np.interp(profile.start[0], profile.s, profile.z))


def _check_started(result: ProfileResult, file: Input | None) -> None:
    """Raise InputError where no block starts: empty figures would read as "no hazard"."""
    if (result.rocks["reason"] != StopReason.NEVER_STARTED).any():
        return
    profile = result.profile
    k = int(np.clip(np.searchsorted(profile.s, profile.start[0], "right"), 1, profile.s.size - 1))
    fall, along = profile.z[k - 1] - profile.z[k], profile.s[k] - profile.s[k - 1]
    expected = "a start on a steeper slope, or blocks with speed_mps"
    if (rise := _rise(profile)) > 0.0:
        expected = f"a profile that is drawn downwards: its end lies {rise:.0f} m above the start"
    raise InputError(
        "no block starts", file=file, field=profile.name,
        found=f"a slope of {math.degrees(math.atan2(fall, along)):.0f} degrees at the start",
        expected=expected,
    )  # fmt: skip
