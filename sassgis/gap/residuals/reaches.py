"""Runs from the release and from station to station, against what was observed.

A run from the release carries every error down the slope. A run that starts again at each station
from what was observed there carries none beyond the next one: it shows on which stretch the motion
differs. What was not observed at a station, such as the direction of the motion, is taken from
rocks that the model itself brings there at a like speed and height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sassgis.engine.effects.trees import Trees
from sassgis.engine.simulate import Simulated, simulate
from sassgis.gap.case import Case
from sassgis.gap.distances import t_statistics
from sassgis.gap.replicas import Ways, dips_at, ways_of
from sassgis.gap.residuals.residuals import Residual, beyond, mean_of_draws, only_above, spread
from sassgis.gap.sample import errors_of, main_blocks, observed_sample
from sassgis.model.blocks import BlockPopulation
from sassgis.model.effects import EffectSettings
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.ground import GroundTable
from sassgis.model.map_run import Forest
from sassgis.model.profiles import ControlLineCrossings, ProfileSet
from sassgis.model.results import ControlLine, StopReason
from sassgis.model.settings import LateralDeflection

BoolArray = NDArray[np.bool_]

#: Height above the resting position from which most rocks at a station count as flying (m).
FLYING_M = 0.3
#: Rocks of the model among which one is drawn that came to a station like the observed one, and
#: how many there must be.
_LIKE, _LEAST_LIKE = 150, 24
#: Longest time along a flight to where it runs parallel to the ground (s), and its steps.
_LONGEST_S, _STEP_S = 1.5, 0.02
#: Least height of a restart in flight above the resting position, and of a start above zero (m).
_LEAST_DROP_M = 1e-3


@dataclass(frozen=True, slots=True)
class AtStations:
    """Rocks at stations; NaN where one was not measured, or did not come.

    Attributes
    ----------
    speed_mps, rotation_hz, height_m : float64, shape (n_rocks, ..., n_stations)
        ``height_m`` is that of the centre above the ground.
    came : float64, shape (n_rocks, ..., n_stations)
        1 or 0; NaN where it is not known.
    """

    speed_mps: FloatArray
    rotation_hz: FloatArray
    height_m: FloatArray
    came: FloatArray


@dataclass(frozen=True, slots=True)
class FreeRun:
    """Replicates of the rocks of a case, let go where they were.

    Attributes
    ----------
    at : AtStations
        Arrays of shape (n_rocks, replicates, n_stations).
    ground : bool, shape (n_rocks, replicates, n_stations)
        Whether they rolled or slid there.
    way : float64, shape (n_rocks, replicates, n_stations)
        Angle of the velocity above the ground (rad).
    runout_m : float64, shape (n_rocks, replicates)
        Of the largest block.
    stops, largest : float64, shape (n_rocks, replicates)
        Blocks left of each rock, mass of the largest over that of the rock.
    axes_m : float64, shape (n_rocks, replicates, 3)
        Semi-axes, longest first.
    """

    at: AtStations
    ground: BoolArray
    way: FloatArray
    runout_m: FloatArray
    stops: FloatArray
    largest: FloatArray
    axes_m: FloatArray

    @property
    def radius_m(self) -> FloatArray:
        """Of the sphere of equal volume, mean over replicates, shape (n_rocks,)."""
        radius: FloatArray = np.cbrt(self.axes_m.prod(axis=2)).mean(axis=1)
        return radius


@dataclass(frozen=True, slots=True)
class Model:
    """What the rocks of a case are run with; see ``sassgis.engine.simulate.simulate``."""

    table: GroundTable
    effects: EffectSettings
    forest: Forest | None
    ways: Ways
    seed: int

    @classmethod
    def of(
        cls,
        case: Case,
        table: GroundTable,
        effects: EffectSettings | None,
        forest: Forest | None,
        seed: int,
    ) -> Model:
        """The model of a case; what is not given is as its configuration has it."""
        ways = ways_of(case if forest is None else replace(case, forest=forest))
        used = case.effects if effects is None else effects
        return cls(table, used, ways.wood if used.get(Trees) else None, ways, seed)

    @property
    def profiles(self) -> ProfileSet:
        """One for each rock."""
        return self.ways.bare if self.forest is None else self.ways.wooded


# ---------------------------------------------------------------------------------------------
# Observed


def observed_at_stations(case: Case) -> AtStations:
    """Whole rocks at stations as they were observed; shape (n_rocks, n_stations).

    A rock came to a station if it was seen there or further down; if it lies above, or was seen by
    the others' station but not there, it did not.
    """
    shape = (case.n_rocks, len(case.station_names))
    speed, rotation, height = (np.full(shape, np.nan) for _ in range(3))
    came = np.full(shape, np.nan)
    passages = case.observations.passages
    seen_at = np.zeros(shape[1], bool)
    if len(passages) and shape[1]:
        rock = case.observations.rock_of("passages")
        piece = case.observations.is_piece("passages")
        place = {name: k for k, name in enumerate(case.station_names)}
        station = np.array([place.get(name, -1) for name in passages.station.tolist()], np.int64)
        centre = np.where(
            np.isfinite(passages.height_m), passages.height_m, case.projected["passages"].height_m
        )
        own = np.flatnonzero((rock >= 0) & (station >= 0))
        whole = own[~piece[own]][::-1]
        # Written backwards: of two rows for one passage the first stays.
        for column, values in (
            (speed, passages.speed_mps),
            (rotation, passages.rotation_hz),
            (height, centre),
        ):
            column[rock[whole], station[whole]] = values[whole]
        came[rock[own], station[own]] = 1.0
        seen_at = (came == 1.0).any(axis=0)
    s = case.station_s
    below = np.maximum.accumulate((came == 1.0)[:, ::-1], axis=1)[:, ::-1]
    came[below] = 1.0
    end = _observed_end(case)[0]
    known = np.isfinite(end)[:, None]
    with np.errstate(invalid="ignore"):
        came = np.where(np.isnan(came) & known, (end[:, None] >= s).astype(float), came)
    missed = np.isnan(came) & seen_at & ~known
    came = np.where(missed, 0.0, came)
    off = ~np.isfinite(s) | (s <= case.start[:, 1:2])
    came[off] = np.nan
    speed, rotation, height = (np.where(off, np.nan, v) for v in (speed, rotation, height))
    return AtStations(speed, rotation, height, came)


def _observed_end(case: Case) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Run-out, position aside, number of blocks and share of the largest, by rock.

    Blocks that belong to no rock are counted with the rocks of their fall line, in turn.
    """
    n = case.n_rocks
    runout, aside, stops, largest = (np.full(n, np.nan) for _ in range(4))
    rows = observed_sample(case).deposits
    if rows is None:
        return runout, aside, stops, largest
    main = main_blocks(rows, n)
    has = main >= 0
    runout[has], aside[has] = rows.s[main[has]], rows.aside_m[main[has]]
    with np.errstate(invalid="ignore", divide="ignore"):
        largest[has] = rows.mass_kg[main[has]] / case.mass_kg[has]
    stops[has] = np.bincount(rows.rock[rows.rock >= 0], minlength=n)[has]
    put = case.projected["deposits"]
    for line in np.unique(put.line[(rows.rock < 0) & (put.line >= 0)]).tolist():
        loose = int(((rows.rock < 0) & (put.line == line)).sum())
        own = np.flatnonzero(has & (case.line == line))
        if own.size:
            stops[own] += np.bincount(np.arange(loose) % own.size, minlength=own.size)
    return runout, aside, stops, largest


# ---------------------------------------------------------------------------------------------
# Runs from the release


def free_run(case: Case, model: Model, replicates: int) -> FreeRun:
    """Let every rock go ``replicates`` times where it was let go."""
    n, m = case.n_rocks, len(case.station_names)
    done = simulate(
        model.profiles,
        model.table,
        case.blocks,
        case.engine,
        seed=model.seed,
        rocks_per_line=replicates,
        line_keys=model.ways.keys,
        starts=case.start,
        control_lines=model.ways.control_lines,
        effects=model.effects,
        forest=model.forest,
    )
    axes = np.stack([done.rocks[f] for f in ("a_m", "b_m", "c_m")], axis=1)
    axes = axes.reshape(n, replicates, 3)
    rows = done.passages
    at, ground, way = _passages(model.ways.bare, rows, rows["line"], rows["rock"], axes, m)
    off = ~np.isfinite(case.station_s) | (case.station_s <= case.start[:, 1:2])
    at.came[np.broadcast_to(off[:, None, :], at.came.shape)] = np.nan
    runout, stops, largest = _ends(done, n, replicates, model.ways.end)
    return FreeRun(at, ground, way, runout, stops, largest, axes)


def _passages(
    profiles: ProfileSet,
    rows: NDArray[np.void],
    rock: IntArray,
    draw: IntArray,
    axes: FloatArray,
    n_stations: int,
) -> tuple[AtStations, BoolArray, FloatArray]:
    """Passages as arrays by rock, replicate and station; of a rock and its pieces the rock's."""
    n, k, _ = axes.shape
    speed, rotation, height = (np.full((n, k, n_stations), np.nan) for _ in range(3))
    came = np.zeros((n, k, n_stations))
    ground = np.zeros((n, k, n_stations), bool)
    way = np.full((n, k, n_stations), np.nan)
    # The rock's own rows come before those of its pieces.
    rows, rock, draw = rows[::-1], rock[::-1], np.asarray(draw, np.int64)[::-1]
    control_line = rows["control_line"].astype(np.int64)
    dip = dips_at(profiles, rock, rows["chainage_m"])
    on_ground = rows["height_m"] <= 0.0
    a, b = axes[rock, draw, 0], axes[rock, draw, 1]
    # A rolling rock turns about its centre at the mean radius; flights are counted from b.
    round_ = 0.5 * (a + b)
    rest = np.where(on_ground, round_, b) / np.cos(dip)
    place = (rock, draw, control_line)
    speed[place] = rows["speed_mps"]
    rotation[place] = rows["rotation_hz"]
    height[place] = rows["height_m"] + rest
    came[place] = 1.0
    ground[place] = on_ground
    way[place] = np.arctan2(rows["vz_mps"], rows["vx_mps"]) - dip
    return AtStations(speed, rotation, height, came), ground, way


def _ends(
    done: Simulated, n: int, replicates: int, end: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Run-out of the largest block, number of blocks and share of the largest."""
    rocks, pieces = done.rocks, done.pieces
    runout = rocks["runout_m"].copy()
    mass = np.where(rocks["reason"] == StopReason.BROKEN, 0.0, rocks["mass_kg"])
    stops = (mass > 0.0).astype(float)
    for piece in pieces[pieces["reason"] != StopReason.BROKEN]:
        i = int(piece["line"]) * replicates + int(piece["rock"])
        stops[i] += 1.0
        if piece["mass_kg"] > mass[i]:
            mass[i], runout[i] = piece["mass_kg"], piece["runout_m"]
    shape = (n, replicates)
    capped = np.minimum(runout.reshape(shape), end[:, None])
    return capped, stops.reshape(shape), (mass / rocks["mass_kg"]).reshape(shape)


def free_run_residuals(
    case: Case, model: Model, seen: AtStations, run: FreeRun, *, rng: np.random.Generator
) -> list[Residual]:
    """Residuals of runs from the release: stations, sides, run-out and blocks."""
    found: list[Residual] = []
    mean_s = _column_means(case.station_s)
    for k, name in enumerate(case.station_names):
        where = (mean_s[k], mean_s[k])
        found += _at_station(case, seen, run, run.at, k, name, "free run", where)
    sides = model.effects.get(LateralDeflection) is None
    error = errors_of(case)
    # The fall line starts where the rock was seen to start, and is known to half a cell.
    side_error = math.hypot(math.sqrt(2.0) * error.position_m, 0.5 * case.grid.cell_size)
    passages = observed_sample(case).passages
    if sides and passages is not None:
        aside = np.full((case.n_rocks, len(case.station_names)), np.nan)
        own = np.flatnonzero((passages.rock >= 0) & (passages.kind == 0))[::-1]
        aside[passages.rock[own], passages.station[own]] = passages.aside_m[own]
        for k, name in enumerate(case.station_names):
            phase = _phase(case, run, seen, k)
            found += _sides(aside[:, k], name, phase, (mean_s[k], mean_s[k]), side_error)
    runout, aside_end, stops, largest = _observed_end(case)
    if np.isfinite(runout).any():
        span = (float(np.nanmin(runout)), float(np.nanmax(runout)))
        predicted = run.runout_m + error.position_m * rng.standard_normal(run.runout_m.shape)
        found.append(
            Residual(
                "all", "stopping", "runout_m", "free run", runout, mean_of_draws(predicted), *span
            )
        )
        away, usual, score = spread(runout, predicted)
        found.append(
            Residual("all", "stopping", "runout_m_spread", "free run", away, usual, *span, score)
        )
        if sides:
            found += _sides(aside_end, "all", "stopping", span, side_error)
        found += [
            Residual("all", "impact", name, "free run", values, mean_of_draws(draws), *span)
            for name, values, draws in (
                ("stops_per_rock", stops, run.stops),
                ("largest_share", largest, run.largest),
            )
        ]
    return found


def _sides(
    aside: FloatArray,
    place: str,
    phase: str,
    span: tuple[float, float],
    error: float,
) -> list[Residual]:
    """Position beside the fall line, which a plane model cannot leave; mean and scatter."""
    none = np.where(np.isfinite(aside), 0.0, np.nan)
    size = np.abs(aside)
    usual = error * math.sqrt(2.0 / math.pi)
    return [
        # Rocks of one release share the error of their fall line, which is no error of theirs.
        Residual(place, phase, "lateral_m", "free run", aside, none, *span, beyond(aside, error)),
        Residual(
            place, phase, "lateral_m_spread", "free run", size, none + usual, *span,
            only_above(size - usual),
        ),
    ]  # fmt: skip


def _at_station(
    case: Case,
    seen: AtStations,
    run: FreeRun,
    predicted: AtStations,
    k: int,
    place: str,
    test: str,
    span: tuple[float, float],
) -> list[Residual]:
    """Speed, rotation, height and share that comes, at one station."""
    phase = _phase(case, run, seen, k)
    found = []
    for name in ("speed_mps", "rotation_hz", "height_m"):
        draws = getattr(predicted, name)[:, :, k]
        found.append(
            Residual(place, phase, name, test, getattr(seen, name)[:, k], mean_of_draws(draws),
                     *span)
        )  # fmt: skip
    came = mean_of_draws(predicted.came[:, :, k])
    found.append(Residual(place, "stopping", "arrived", test, seen.came[:, k], came, *span))
    return found


def _phase(case: Case, run: FreeRun, seen: AtStations, k: int) -> str:
    """Whether most rocks fly or roll where they pass a station."""
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


# ---------------------------------------------------------------------------------------------
# Runs from station to station


def leg_residuals(
    case: Case,
    model: Model,
    seen: AtStations,
    run: FreeRun,
    edges: FloatArray,
    *,
    rng: np.random.Generator,
) -> list[Residual]:
    """Residuals of every leg, and the part of the first that the others do not have.

    The first leg is the run from the release. Where it is wrong, and more so than those below, what
    is wrong is the release: that is the finding of the phase "release", which both must support.
    """
    names = case.legs
    n_stations = len(case.station_names)
    found: list[Residual] = []
    speeds: list[FloatArray] = []
    runout = _observed_end(case)[0]
    for k in range(n_stations + 1):
        span = (float(edges[k, 0]), float(edges[k, 1]))
        if k == 0:
            at, stop = run.at, run.runout_m
        else:
            again = _restarted(case, model, seen, run, k - 1, rng)
            if again is None:
                continue
            at, stop = again
        if k < n_stations:
            own = _at_station(case, seen, run, at, k, names[k], "leg", span)
            started = np.isfinite(seen.speed_mps[:, k - 1]) if k else np.ones(case.n_rocks, bool)
            found += [replace(r, observed=np.where(started, r.observed, np.nan)) for r in own]
            speeds.append(np.where(started, own[0].gap, np.nan))
        else:
            found.append(
                Residual(names[k], "stopping", "runout_m", "leg", runout, mean_of_draws(stop),
                         *span)
            )  # fmt: skip
    if len(speeds) > 1:
        others = mean_of_draws(np.column_stack(speeds[1:]), least=1)
        span = (float(edges[0, 0]), float(edges[0, 1]))
        found.append(
            Residual(
                names[0],
                "release",
                "speed_mps",
                "leg",
                speeds[0],
                others,
                *span,
                score=_weaker(speeds[0], speeds[0] - others),
            )
        )
    return found


def _weaker(first: FloatArray, second: FloatArray) -> FloatArray:
    """Of two gaps that must both be there and of one sign, the one that is less sure."""
    known = np.isfinite(first) & np.isfinite(second)
    a, b = np.where(known, first, np.nan), np.where(known, second, np.nan)
    t_a, t_b = t_statistics(np.column_stack([a, b])).tolist()
    if not t_a * t_b > 0.0:
        return np.where(known, 0.0, np.nan)
    return a if abs(t_a) < abs(t_b) else b


def _restarted(
    case: Case, model: Model, seen: AtStations, run: FreeRun, k: int, rng: np.random.Generator
) -> tuple[AtStations, FloatArray] | None:
    """Runs from station ``k`` of the rocks that were seen there, as many as of the free run.

    Returns
    -------
    at : AtStations
        Arrays of shape (n_rocks, replicates, n_stations).
    runout_m : float64, shape (n_rocks, replicates)
        None if fewer than two rocks can be restarted.
    """
    n, m = run.runout_m.shape
    rocks = np.flatnonzero(np.isfinite(seen.speed_mps[:, k]) & (seen.speed_mps[:, k] > 0.0))
    if rocks.size < 2:
        return None
    rock = np.repeat(rocks, m)
    draw = np.tile(np.arange(m), rocks.size)
    states = _states(case, model.ways, seen, run, k, rock, draw, rng)
    axes = run.axes_m[rock, draw]
    done = simulate(
        repeated(model.profiles, rock),
        model.table,
        _blocks(case, rock, axes, states),
        case.engine,
        seed=model.seed + 1 + k,
        rocks_per_line=1,
        line_keys=np.arange(rock.size, dtype=np.uint64),
        starts=np.column_stack([states.s, states.s]),
        control_lines=_control_lines_below(case, k, rock),
        effects=model.effects,
        forest=model.forest,
    )
    rows = done.passages
    at, _, _ = _passages(
        model.ways.bare, rows, rock[rows["line"]], draw[rows["line"]], run.axes_m,
        len(case.station_names),
    )  # fmt: skip
    started = np.zeros(n, bool)
    started[rocks] = True
    at.came[~started] = np.nan
    runout = np.full((n, m), np.nan)
    ends, _, _ = _ends(done, rock.size, 1, model.ways.end[rock])
    runout[rock, draw] = ends[:, 0]
    return at, runout


@dataclass(frozen=True, slots=True)
class _States:
    """How rocks start again; float64, shape (n,): along the ground, and let fall."""

    s: FloatArray
    speed: FloatArray
    spin: FloatArray
    drop: FloatArray
    orientation: FloatArray


def _states(
    case: Case,
    ways: Ways,
    seen: AtStations,
    run: FreeRun,
    k: int,
    rock: IntArray,
    draw: IntArray,
    rng: np.random.Generator,
) -> _States:
    """States in which rocks start again at station ``k``.

    The engine lets a rock go along the ground, from a height. A flight across the station in any
    other direction is therefore begun where it runs along the ground, before or behind the
    station: that is the same flight.
    """
    error = errors_of(case)
    size = rock.size
    s = case.station_s[rock, k]
    dip = dips_at(ways.bare, rock, s)
    a, b, _ = np.moveaxis(run.axes_m[rock, draw], -1, 0)
    radius = np.cbrt(run.axes_m[rock, draw].prod(axis=1))
    speed = seen.speed_mps[rock, k]
    turning = 2.0 * math.pi * seen.rotation_hz[rock, k] * radius / speed
    above = np.maximum(seen.height_m[rock, k] - b / np.cos(dip), 0.0)
    ground = np.nan_to_num(above) < 0.1
    way = np.zeros(size)
    donors = _came(run, k, dip)
    if donors is not None:
        blur = (error.speed_rel, math.hypot(error.speed_rel, error.rotation_rel), error.height_m)
        near = donors.like(speed, turning, above, blur, rng)
        ground, way = donors.ground[near], donors.way[near]
        speed = _towards(speed, donors.speed[near], error.speed_rel * speed)
        turning = _towards(turning, donors.turning[near], blur[1] * donors.turning[near])
        above = _towards(above, donors.above[near], np.full(size, error.height_m))
    above = np.where(ground, 0.0, np.nan_to_num(above))
    spin = np.where(np.isfinite(turning), turning, 1.0) * speed / radius
    orientation = rng.uniform(0.0, math.pi, size)
    # On the ground it stands so that its spin needs no lever: on its flat or its narrow side.
    orientation = np.where(ground, 0.5 * math.pi * rng.integers(0, 2, size), orientation)
    support = np.hypot(a * np.sin(orientation), b * np.cos(orientation))
    centre = np.maximum(above + b / np.cos(dip), b / np.cos(dip) + _LEAST_DROP_M)
    angle = np.clip(dip + way, -1.5, 1.5)
    flight = _parallel(case, ways, rock, s, centre, speed * np.cos(angle), speed * np.sin(angle), k)
    start, fast, high, dip_there = flight
    drop = np.maximum(high - support / np.cos(dip_there), _LEAST_DROP_M)
    return _States(
        np.where(ground, s, start),
        np.where(ground, speed, fast),
        spin,
        np.where(ground, 0.0, drop),
        orientation,
    )


def _towards(seen: FloatArray, usual: FloatArray, error: FloatArray) -> FloatArray:
    """What was seen, moved by up to its error towards what the model has; that if nothing was."""
    moved = usual + np.sign(seen - usual) * np.maximum(np.abs(seen - usual) - error, 0.0)
    result: FloatArray = np.where(np.isfinite(seen), moved, usual)
    return result


@dataclass(frozen=True, slots=True)
class _Came:
    """Rocks that the model brings to a station; arrays of shape (n,).

    Attributes
    ----------
    ground : bool
        Whether they roll or slide.
    way : float64
        Angle of the velocity above the ground (rad).
    speed, turning, above : float64
        Speed (m/s), ω r/v, height above the resting position (m).
    """

    ground: BoolArray
    way: FloatArray
    speed: FloatArray
    turning: FloatArray
    above: FloatArray

    def like(
        self,
        speed: FloatArray,
        turning: FloatArray,
        above: FloatArray,
        blur: tuple[float, float, float],
        rng: np.random.Generator,
    ) -> IntArray:
        """Number of one of the rocks that are most like each of some that were seen.

        ``blur``: relative errors of speed and turning, and the error of the height (m), within
        which rocks are alike.
        """
        pairs = (
            (np.log(np.maximum(self.speed, 0.1)), np.log(np.maximum(speed, 0.1)), blur[0]),
            (self.turning, turning, blur[1]),
            (self.above, above, blur[2]),
        )
        data, asked = [], []
        for own, other, error in pairs:
            # Where a value was not measured it does not count.
            known = np.where(np.isfinite(other), other, float(np.median(own)))
            scale = math.hypot(error, 0.1 * float(own.std())) + 1e-9
            data.append(own / scale)
            asked.append(known / scale)
        count = min(_LIKE, self.speed.size)
        far, near = cKDTree(np.column_stack(data)).query(np.column_stack(asked), k=count)
        # Each with the likelihood of what was seen, up to a factor.
        total = np.cumsum(np.exp(0.5 * (far[:, :1] ** 2 - far**2)), axis=1)
        pick = (total < rng.random(speed.size)[:, None] * total[:, -1:]).sum(axis=1)
        chosen: IntArray = near[np.arange(speed.size), pick]
        return chosen


def _came(run: FreeRun, k: int, dip: FloatArray) -> _Came | None:
    """What the model brings to a station; None if that is too little."""
    i, j = np.nonzero(run.at.came[:, :, k] == 1.0)
    if i.size < _LEAST_LIKE:
        return None
    speed = run.at.speed_mps[i, j, k]
    radius = np.cbrt(run.axes_m[i, j].prod(axis=1))
    ground = run.ground[i, j, k]
    rest = run.axes_m[i, j, 1] / math.cos(float(np.median(dip)))
    return _Came(
        ground,
        run.way[i, j, k],
        speed,
        2.0 * math.pi * run.at.rotation_hz[i, j, k] * radius / np.maximum(speed, 0.1),
        np.where(ground, 0.0, np.maximum(run.at.height_m[i, j, k] - rest, 0.0)),
    )


def _parallel(
    case: Case,
    ways: Ways,
    rock: IntArray,
    s: FloatArray,
    centre: FloatArray,
    vx: FloatArray,
    vz: FloatArray,
    k: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where flights run along the ground: chainage, speed, height of the centre, dip there."""
    g = case.engine.gravity_mps2
    t = np.arange(-_LONGEST_S, _LONGEST_S + 0.5 * _STEP_S, _STEP_S)
    zero = int(np.argmin(np.abs(t)))
    start, speed, height = s.copy(), np.hypot(vx, vz), centre.copy()
    station = case.station_s
    below = np.where(np.isfinite(station) & (station > station[:, k : k + 1]), station, np.inf)
    next_s = below.min(axis=1)
    offset = ways.bare.offset
    for i in np.unique(rock).tolist():
        rows = np.flatnonzero(rock == i)
        own = slice(int(offset[i]), int(offset[i + 1]))
        sx, sz = ways.bare.s[own], ways.bare.z[own]
        x = s[rows, None] + vx[rows, None] * t
        rise = np.interp(x, sx, sz) - np.interp(s[rows], sx, sz)[:, None]
        clear = centre[rows, None] + vz[rows, None] * t - 0.5 * g * t * t - rise
        bad = (clear <= 0.0) | (x >= next_s[i] - 0.1) | (x <= sx[0] + 0.1) | (x >= sx[-1] - 0.1)
        bad[:, zero] = False
        # Only what is joined to the station by flight.
        ahead = np.logical_or.accumulate(bad[:, zero:], axis=1)
        behind = np.logical_or.accumulate(bad[:, zero::-1], axis=1)[:, ::-1]
        bad = np.concatenate([behind[:, :-1], ahead], axis=1)
        best = np.where(bad, -np.inf, clear).argmax(axis=1)
        pick = np.arange(rows.size)
        start[rows], height[rows] = x[pick, best], clear[pick, best]
        speed[rows] = np.hypot(vx[rows], vz[rows] - g * t[best])
    return start, speed, height, dips_at(ways.bare, rock, start)


def _blocks(case: Case, rock: IntArray, axes: FloatArray, states: _States) -> list[BlockPopulation]:
    """One population of fixed values for each restart."""
    a, b, c = axes.T.tolist()
    columns = (states.speed, states.spin, states.drop, states.orientation)
    return [
        replace(
            case.blocks[i],
            axis_1_m=(a[n], a[n]),
            axis_2_m=(b[n], b[n]),
            axis_3_m=(c[n], c[n]),
            volume_m3=None,
            volume_exponent=None,
            speed_mps=(v, v),
            spin_radps=(w, w),
            drop_m=(h, h),
            orientation_rad=(o, o),
        )
        for n, (i, v, w, h, o) in enumerate(
            zip(rock.tolist(), *(c.tolist() for c in columns), strict=True)
        )
    ]


def _control_lines_below(case: Case, k: int, rock: IntArray) -> ControlLineCrossings:
    """The next station below ``k`` on the line of each rock that has one."""
    has = k + 1 < len(case.station_names)
    s = case.station_s[rock, k + 1] if has else np.full(rock.size, np.nan)
    known = np.isfinite(s)
    return ControlLineCrossings(
        tuple(ControlLine(name, "station") for name in case.station_names),
        np.concatenate([[0], np.cumsum(known)]).astype(np.int64),
        s[known],
        np.full(int(known.sum()), k + 1, np.int64),
    )


def repeated(profiles: ProfileSet, which: IntArray) -> ProfileSet:
    """Profiles by number, each as often as it is named."""
    offset, vertex = _gather(profiles.offset, which)
    cell_offset, cell = _gather(profiles.cell_offset, which)
    # Borders are one more than stretches on each profile.
    _, border = _gather(profiles.cell_offset + np.arange(profiles.offset.size), which)
    return ProfileSet(
        offset,
        profiles.s[vertex],
        profiles.z[vertex],
        profiles.ground[vertex],
        cell_offset,
        profiles.cell_s[border],
        profiles.cell[cell],
    )


def _gather(offset: IntArray, which: IntArray) -> tuple[IntArray, IntArray]:
    """Offsets and entries of some items of a ragged array."""
    sizes = np.diff(offset)[which]
    new = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    return new, np.repeat(offset[which] - new[:-1], sizes) + np.arange(new[-1])
