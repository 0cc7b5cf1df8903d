"""Runs from the release against what was observed at stations and of the stops."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.cluster.hierarchy import fcluster, linkage

from sassgis.engine.effects.lateral_deflection import LateralDeflection
from sassgis.engine.simulate import moving_axes
from sassgis.gap.constants import FLYING_M, LOGGED_EVENTS, ONE_RELEASE_M, SPEED_PARTS
from sassgis.gap.forward.observation_operator import observe
from sassgis.gap.forward.released_rocks import HypothesisModel, Moved, all_rocks, move
from sassgis.gap.forward.rock_lines import RockLines, dips_at, rock_lines_of
from sassgis.gap.observations.case import (
    Case,
    ImpactRows,
    errors_of,
    main_blocks,
    observed_campaign,
)
from sassgis.gap.residuals.rock_residuals import Residual, beyond, mean_of_draws, only_above, spread
from sassgis.grid import BoolArray, FloatArray, IntArray
from sassgis.settings.results import ProfileSet, StopReason


@dataclass(frozen=True, slots=True)
class AtStations:
    """Rocks at stations, shape (n_rocks, ..., n_stations); NaN: not measured, or did not come."""

    speed_mps: FloatArray
    rotation_hz: FloatArray
    height_m: FloatArray  # of the centre above the ground
    lateral_m: FloatArray  # from the fall line
    arrived: FloatArray  # 1 or 0; NaN where it is not known


@dataclass(frozen=True, slots=True)
class Ends:
    """Ends of released rocks; float64, shape (n, count), of observed ones (n,)."""

    # Chainage and lateral offset of the largest block.
    runout_m: FloatArray
    lateral_m: FloatArray
    stops: FloatArray  # blocks left of each rock
    largest: FloatArray  # mass of the largest over that of the rock


@dataclass(frozen=True, slots=True)
class FreeRun:
    """Replicates of the rocks, arrays (n_rocks, replicates, n_stations), of ``ends`` (.., ..)."""

    model: HypothesisModel
    rock_lines: RockLines
    seed: int
    at: AtStations
    ground: BoolArray  # whether they rolled or slid there
    rise_rad: FloatArray  # angle of the velocity above the ground
    ends: Ends
    #: Of each replicate, as the observer of the case records them; empty where he does not.
    impacts: tuple[ImpactRows, ...]
    axes_m: FloatArray  # shape (n_rocks, replicates, 3); semi-axes, longest first

    @property
    def radius_m(self) -> FloatArray:
        """Of the sphere of equal volume, mean over replicates, shape (n_rocks,)."""
        radius: FloatArray = np.cbrt(self.axes_m.prod(axis=2)).mean(axis=1)
        return radius

    def turn_after(self, out_mps: FloatArray) -> FloatArray:
        """Return the mean turn of paths at impacts that they leave as fast (deg), (n,)."""
        columns = [(np.hypot(rows.vt_out, rows.vn_out), rows.turn_deg) for rows in self.impacts]
        speed, turn = np.concatenate([np.empty((2, 0)), *columns], axis=1)
        known = np.isfinite(speed) & np.isfinite(turn)
        order = np.argsort(speed[known], kind="stable")
        if not order.size:
            return np.zeros(out_mps.size)
        near = max(order.size // SPEED_PARTS, 1)
        size = sliding_window_view(np.abs(turn[known][order]), near).mean(axis=1)
        middle = sliding_window_view(speed[known][order], near).mean(axis=1)
        return np.asarray(np.interp(out_mps, middle, size))


def observed_at_stations(case: Case) -> AtStations:
    """Return whole rocks at stations as they were observed; shape (n_rocks, n_stations).

    A rock reached a station if it was seen there or further down; if it lies above, or was seen by
    the others' station but not there, it did not.
    """
    values = np.full((5, case.n_rocks, len(case.station_names)), np.nan)
    passages, put = case.observations.passages, case.projected["passages"]
    rock, station = case.observations.rock_of("passages"), case.passed_station
    piece = case.observations.is_piece("passages")
    own = np.flatnonzero((rock >= 0) & (station >= 0))
    whole = own[~piece[own]][::-1]
    centre = np.where(np.isfinite(passages.height_m), passages.height_m, put.height_m)
    columns = (passages.speed_mps, passages.rotation_hz, centre, put.lateral_m)
    # Written backwards: of two rows for one passage the first stays.
    for filled, column in zip(values[:4], columns, strict=True):
        filled[rock[whole], station[whole]] = column[whole]
    arrived = values[4]
    arrived[rock[own], station[own]] = 1.0
    seen_at = (arrived == 1.0).any(axis=0)
    s = case.station_s
    below = np.maximum.accumulate((arrived == 1.0)[:, ::-1], axis=1)[:, ::-1]
    arrived[below] = 1.0
    end = observed_end(case).runout_m[:, None]
    unseen = np.isnan(arrived)
    with np.errstate(invalid="ignore"):
        passed = np.where(np.isfinite(end), end >= s, np.where(seen_at, 0.0, np.nan))
    arrived[unseen] = passed[unseen]
    values[:, _not_passed(case)] = np.nan
    return AtStations(*values)


def _not_passed(case: Case) -> BoolArray:
    """Find stations that a rock's line does not cross below its start, (n_rocks, n_stations)."""
    s = case.station_s
    return ~np.isfinite(s) | (s <= case.start[:, 1:2])


def observed_end(case: Case) -> Ends:
    """Return the end of each rock, or NaN; nameless blocks count with rocks of their line."""
    n = case.n_rocks
    rows = observed_campaign(case).deposits
    if rows is None:
        return Ends(*np.full((4, n), np.nan))
    main = main_blocks(rows, n)
    has = main >= 0
    # -1, of rocks without a block, takes the last.
    runout, lateral, mass = (
        np.append(v, np.nan)[main] for v in (rows.s, rows.lateral_m, rows.mass_kg)
    )
    stops = np.where(has, np.bincount(rows.rock[rows.rock >= 0], minlength=n), np.nan)
    put = case.projected["deposits"]
    for line in np.unique(put.line[(rows.rock < 0) & (put.line >= 0)]).tolist():
        loose = int(((rows.rock < 0) & (put.line == line)).sum())
        own = np.flatnonzero(has & (case.line == line))
        if own.size:
            stops[own] += np.bincount(np.arange(loose) % own.size, minlength=own.size)
    with np.errstate(invalid="ignore", divide="ignore"):
        return Ends(runout, lateral, stops, mass / case.mass_kg)


def free_run(case: Case, model: HypothesisModel, seed: int, replicates: int) -> FreeRun:
    """Release every rock ``replicates`` times where it was released."""
    n, m, lines = case.n_rocks, len(case.station_names), rock_lines_of(case)
    recorded = len(case.observations.impacts) > 0
    done = move(
        case, lines, all_rocks(case, lines), model, seed=seed, count=replicates,
        log_events=LOGGED_EVENTS["impacts"] if recorded else 0,
    )  # fmt: skip
    axes = np.stack([done.rocks[f] for f in ("a_m", "b_m", "c_m")], axis=1)
    axes = axes.reshape(n, replicates, 3)
    rows = done.passages
    at, ground, rise_rad = passages_of(
        lines.unforested, done, rows["line"], rows["rock"],
        moving_axes(axes, case.engine), m,
    )  # fmt: skip
    at.arrived[np.broadcast_to(_not_passed(case)[:, None, :], at.arrived.shape)] = np.nan
    ends = ends_of(done, n, replicates, lines.end)
    impacts: tuple[ImpactRows, ...] = ()
    if recorded:
        # What instruments scale is scaled back in the case already.
        error = replace(model.measurement, scale=1.0, spin_scale=1.0, stretch=1.0)
        made = observe(
            case, lines, replace(model, measurement=error), done, count=replicates,
            rng=np.random.default_rng([seed, 35]), tables=frozenset({"impacts"}),
        )  # fmt: skip
        impacts = tuple(one.impacts for one in made if one.impacts is not None)
    return FreeRun(
        model=model, rock_lines=lines, seed=seed, at=at, ground=ground, rise_rad=rise_rad,
        ends=ends, impacts=impacts, axes_m=axes,
    )  # fmt: skip


def passages_of(
    profiles: ProfileSet,
    done: Moved,
    rock: IntArray,
    draw: IntArray,
    moving: FloatArray,
    n_stations: int,
) -> tuple[AtStations, BoolArray, FloatArray]:
    """Return passages as arrays by rock, replicate and station; of fragments they are the rock's.

    ``rock`` and ``draw`` are those of each passage, ``moving`` the semi-axes of rocks as they move
    (m), shape (n, k, 3).
    """
    n, k, _ = moving.shape
    *values, rise_rad = np.full((6, n, k, n_stations), np.nan)
    at = AtStations(*values)
    at.arrived[:] = 0.0
    ground = np.zeros((n, k, n_stations), bool)
    # The rock's rows come before those of its fragments.
    rows, rock, draw = done.passages[::-1], rock[::-1], np.asarray(draw, np.int64)[::-1]
    control_line = rows["control_line"].astype(np.int64)
    dip = dips_at(profiles, rock, rows["chainage_m"])
    on_ground = rows["height_m"] <= 0.0
    a, b = moving[rock, draw, 0], moving[rock, draw, 1]
    # A rolling rock turns about its centre at the mean radius; flights are counted from b.
    round_ = 0.5 * (a + b)
    rest = np.where(on_ground, round_, b) / np.cos(dip)
    place = (rock, draw, control_line)
    at.speed_mps[place] = rows["speed_mps"]
    at.rotation_hz[place] = rows["rotation_hz"]
    at.height_m[place] = rows["height_m"] + rest
    at.lateral_m[place] = done.passed_lateral_m[::-1]
    at.arrived[place] = 1.0
    ground[place] = on_ground
    rise_rad[place] = np.arctan2(rows["vz_mps"], rows["vx_mps"]) - dip
    return at, ground, rise_rad


def ends_of(done: Moved, n: int, replicates: int, end: FloatArray) -> Ends:
    """Return the ends of rocks; run-out at most to ``end``, shape (n,) (m)."""
    rocks, pieces = done.rocks, done.pieces
    runout, lateral = rocks["runout_m"].copy(), done.lateral_m[: rocks.size].copy()
    mass = np.where(rocks["reason"] == StopReason.BROKEN, 0.0, rocks["mass_kg"])
    stops = (mass > 0.0).astype(float)
    for piece, beside in zip(pieces, done.lateral_m[rocks.size :].tolist(), strict=True):
        if piece["reason"] == StopReason.BROKEN:
            continue
        i = int(piece["line"]) * replicates + int(piece["rock"])
        stops[i] += 1.0
        if piece["mass_kg"] > mass[i]:
            mass[i], runout[i], lateral[i] = piece["mass_kg"], piece["runout_m"], beside
    shape = (n, replicates)
    capped = np.minimum(runout.reshape(shape), end[:, None])
    return Ends(
        capped,
        lateral.reshape(shape),
        stops.reshape(shape),
        (mass / rocks["mass_kg"]).reshape(shape),
    )


def free_run_residuals(
    case: Case, seen: AtStations, run: FreeRun, *, rng: np.random.Generator
) -> list[Residual]:
    """Return residuals of runs from the release: stations, sides, run-out and blocks."""
    found: list[Residual] = []
    mean_s = _column_means(case.station_s)
    for k, name in enumerate(case.station_names):
        where = (mean_s[k], mean_s[k])
        found += residuals_at_station(
            case=case, seen=seen, run=run, predicted=run.at, k=k, place=name, test="free run",
            span=where,
        )  # fmt: skip
    sides = case.terrain is not None or case.effects.get(LateralDeflection) is None
    if sides:
        for k, name in enumerate(case.station_names):
            phase = _phase(case, run, seen, k)
            found += _sides(
                case=case, lateral=seen.lateral_m[:, k], draws=run.at.lateral_m[:, :, k],
                place=name, phase=phase, span=(mean_s[k], mean_s[k]), rng=rng,
            )  # fmt: skip
    end, made = observed_end(case), run.ends
    runout = end.runout_m
    if np.isfinite(runout).any():
        span = (float(np.nanmin(runout)), float(np.nanmax(runout)))
        draws = made.runout_m + errors_of(case).stop_m * rng.standard_normal(made.runout_m.shape)
        stopped = Residual(
            place="all", phase="stopping", quantity="runout_m", test="free run", observed=runout,
            predicted=mean_of_draws(draws), s0_m=span[0], s1_m=span[1],
        )  # fmt: skip
        away, usual, score = spread(runout, draws)
        other = "runout_m_spread"
        found += [
            stopped,
            replace(stopped, quantity=other, observed=away, predicted=usual, score=score),
        ]
        if sides:
            found += _sides(
                case=case, lateral=end.lateral_m, draws=made.lateral_m, place="all",
                phase="stopping", span=span, rng=rng,
            )  # fmt: skip
        found += [
            replace(
                stopped, phase="impact", quantity=name, observed=values,
                predicted=mean_of_draws(draws),
            )
            for name, values, draws in (
                ("stops_per_rock", end.stops, made.stops),
                ("largest_share", end.largest, made.largest),
            )
        ]  # fmt: skip
    return found


def side_error(case: Case, stop: bool = False) -> float:
    """Return the error of an offset (m): of its ends, and of the line, known to half a cell."""
    return math.hypot(_ends_error(case, stop), 0.5 * case.grid.cell_size)


def _ends_error(case: Case, stop: bool) -> float:
    """Return the error at both ends of an offset: the start, and the passage or stop (m)."""
    error = errors_of(case)
    return math.hypot(error.position_m, error.stop_m if stop else error.position_m)


def _sides(
    case: Case,
    lateral: FloatArray,
    draws: FloatArray,
    place: str,
    phase: str,
    span: tuple[float, float],
    rng: np.random.Generator,
) -> list[Residual]:
    """Return the lateral offset from the fall line against that of the model; mean and scatter.

    What rocks of one release have in common is an error of their fall lines, too, and no scatter of
    theirs. A model in the plane of the fall line cannot leave it: there only the error is expected.
    """
    stop = place == "all"
    error = side_error(case, stop)
    if case.terrain is not None:
        mean = mean_of_draws(draws)
        blurred = draws + _ends_error(case, stop) * rng.standard_normal(draws.shape)
        both = _apart(case, np.column_stack([lateral, blurred]))
        size, usual, score = spread(both[:, 0], both[:, 1:])
    else:
        mean = np.where(np.isfinite(lateral), 0.0, np.nan)
        size, usual = np.abs(lateral), mean + error * math.sqrt(2.0 / math.pi)
        score = only_above(size - usual)
    aside = Residual(
        place=place, phase=phase, quantity="lateral_m", test="free run", observed=lateral,
        predicted=mean, s0_m=span[0], s1_m=span[1], score=beyond(lateral - mean, error),
    )  # fmt: skip
    other = "lateral_m_spread"
    return [aside, replace(aside, quantity=other, observed=size, predicted=usual, score=score)]


def _apart(case: Case, lateral: FloatArray) -> FloatArray:
    """Return offsets (n_rocks, n_campaigns) less what rocks of each release have in common."""
    start = case.traces.offset[case.line]
    places = np.column_stack([case.traces.x[start], case.traces.y[start]])
    release = np.ones(1, np.int64)
    if len(places) > 1:
        release = fcluster(linkage(places, "single"), ONE_RELEASE_M, "distance")
    found = lateral.copy()
    for k in np.unique(release).tolist():
        own = release == k
        found[own] -= mean_of_draws(lateral[own].T)
    return found


def residuals_at_station(
    case: Case,
    seen: AtStations,
    run: FreeRun,
    predicted: AtStations,
    k: int,
    place: str,
    test: str,
    span: tuple[float, float],
) -> list[Residual]:
    """Return speed, rotation, height and share that comes, at one station."""
    moving = dict.fromkeys(("speed_mps", "rotation_hz", "height_m"), _phase(case, run, seen, k))
    found = []
    for name, phase in {**moving, "arrived": "stopping"}.items():
        own = Residual(
            place=place, phase=phase, quantity=name, test=test, observed=getattr(seen, name)[:, k],
            predicted=mean_of_draws(getattr(predicted, name)[:, :, k]), s0_m=span[0], s1_m=span[1],
        )  # fmt: skip
        found.append(own)
    return found


def _phase(case: Case, run: FreeRun, seen: AtStations, k: int) -> str:
    """Return whether most rocks fly or roll where they pass a station."""
    dip = dips_at(case.profiles, np.maximum(case.line, 0), np.nan_to_num(case.station_s[:, k]))
    above = seen.height_m[:, k] - run.axes_m[:, :, 1].mean(axis=1) / np.cos(dip)
    if not np.isfinite(above).any():
        above = run.at.height_m[:, :, k] - run.axes_m[:, :, 1] / np.cos(dip)[:, None]
    known = above[np.isfinite(above)]
    return "flight" if known.size and np.median(known) > FLYING_M else "rolling"


def _column_means(values: FloatArray) -> list[float]:
    return [
        float(column[np.isfinite(column)].mean()) if np.isfinite(column).any() else math.nan
        for column in values.T
    ]
