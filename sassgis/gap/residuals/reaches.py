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

from sassgis.gap.inference.rock_tests import t_statistics
from sassgis.gap.observations.campaign import errors_of
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.released_rocks import Releases, move
from sassgis.gap.replicas.rock_lines import RockLines, dips_at
from sassgis.gap.residuals.free_run import (
    AtStations,
    FreeRun,
    RunModel,
    ends_of,
    observed_end,
    passages_of,
    residuals_at_station,
)
from sassgis.gap.residuals.residuals import Residual, mean_of_draws
from sassgis.model.blocks import BlockPopulation
from sassgis.model.grid import FloatArray, IntArray

#: Rocks of the model among which one is drawn that reached a station like the observed one, and
#: how many there must be.
_LIKE, _LEAST_LIKE = 150, 24
#: Longest time along a flight to where it runs parallel to the ground (s), and its steps.
_LONGEST_S, _STEP_S = 1.5, 0.02
#: Least height of a restart in flight above the resting position, and of a start above zero (m).
_LEAST_DROP_M = 1e-3


def reach_residuals(
    case: Case,
    model: RunModel,
    seen: AtStations,
    run: FreeRun,
    edges: FloatArray,
    *,
    rng: np.random.Generator,
) -> list[Residual]:
    """Residuals of every reach, and the part of the first that the others do not have.

    The first reach is the run from the release. Where it is wrong, and more so than those below,
    what is wrong is the release: the finding of the phase "release", which both must support.
    """
    names = case.reaches
    n_stations = len(case.station_names)
    found: list[Residual] = []
    speeds: list[Residual] = []
    runout = observed_end(case)[0]
    for k in range(n_stations + 1):
        span = (float(edges[k, 0]), float(edges[k, 1]))
        if k == 0:
            at, stop = run.at, run.ends.runout_m
        else:
            again = _restarted(case, model, seen, run, k - 1, rng)
            if again is None:
                continue
            at, stop = again
        if k < n_stations:
            own = residuals_at_station(case, seen, run, at, k, names[k], "reach", span)
            started = np.isfinite(seen.speed_mps[:, k - 1]) if k else np.ones(case.n_rocks, bool)
            own = [replace(r, observed=np.where(started, r.observed, np.nan)) for r in own]
            found += own
            speeds.append(own[0])
        else:
            found.append(
                Residual(names[k], "stopping", "runout_m", "reach", runout, mean_of_draws(stop),
                         *span)
            )  # fmt: skip
    if len(speeds) > 1:
        first = speeds[0]
        others = mean_of_draws(np.column_stack([r.gap for r in speeds[1:]]), least=1)
        span = (float(edges[0, 0]), float(edges[0, 1]))
        found.append(
            Residual(
                names[0],
                "release",
                "speed_mps",
                "reach",
                first.observed,
                # Were the motion as wrong there as below.
                first.predicted + others,
                *span,
                score=_weaker(first.gap, first.gap - others),
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
    case: Case, model: RunModel, seen: AtStations, run: FreeRun, k: int, rng: np.random.Generator
) -> tuple[AtStations, FloatArray] | None:
    """Runs from station ``k`` of the rocks that were seen there, as many as of the free run.

    Returns
    -------
    at : AtStations
        Arrays of shape (n_rocks, replicates, n_stations).
    runout_m : float64, shape (n_rocks, replicates)
        None if fewer than two rocks can be restarted.
    """
    n, m = run.ends.runout_m.shape
    rocks = np.flatnonzero(np.isfinite(seen.speed_mps[:, k]) & (seen.speed_mps[:, k] > 0.0))
    if rocks.size < 2:
        return None
    rock = np.repeat(rocks, m)
    draw = np.tile(np.arange(m), rocks.size)
    states = _states(case, model.rock_lines, seen, run, k, rock, draw, rng)
    axes = run.axes_m[rock, draw]
    done = move(
        case,
        model.rock_lines,
        Releases(
            rock,
            _blocks(case, rock, axes, states),
            np.column_stack([states.s, states.s]),
            np.nan_to_num(seen.lateral_m[rock, k]),
            np.arange(rock.size, dtype=np.uint64),
        ),
        model.moving,
        seed=model.seed + 1 + k,
        count=1,
    )
    at, _, _ = passages_of(
        model.rock_lines.unforested, done, rock[done.passages["line"]],
        draw[done.passages["line"]], run.axes_m, len(case.station_names),
    )  # fmt: skip
    started = np.zeros(n, bool)
    started[rocks] = True
    at.arrived[~started] = np.nan
    ends = ends_of(done, rock.size, 1, model.rock_lines.end[rock])
    runout = np.full((n, m), np.nan)
    runout[rock, draw] = ends.runout_m[:, 0]
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
    rock_lines: RockLines,
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
    dip = dips_at(rock_lines.unforested, rock, s)
    a, b, _ = np.moveaxis(run.axes_m[rock, draw], -1, 0)
    radius = np.cbrt(run.axes_m[rock, draw].prod(axis=1))
    speed = seen.speed_mps[rock, k]
    turning = 2.0 * math.pi * seen.rotation_hz[rock, k] * radius / speed
    above = np.maximum(seen.height_m[rock, k] - b / np.cos(dip), 0.0)
    ground = np.nan_to_num(above) < 0.1
    rise_rad = np.zeros(size)
    donors = _came(run, k, dip)
    if donors is not None:
        blur = (error.speed_rel, math.hypot(error.speed_rel, error.rotation_rel), error.height_m)
        near = donors.like(speed, turning, above, blur, rng)
        ground, rise_rad = donors.ground[near], donors.rise_rad[near]
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
    angle = np.clip(dip + rise_rad, -1.5, 1.5)
    flight = _parallel(
        case, rock_lines, rock, s, centre, speed * np.cos(angle), speed * np.sin(angle), k
    )
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
    return np.where(np.isfinite(seen), moved, usual)


@dataclass(frozen=True, slots=True)
class _Came:
    """Rocks that the model brings to a station; arrays of shape (n,).

    Attributes
    ----------
    ground : bool
        Whether they roll or slide.
    rise_rad : float64
        Angle of the velocity above the ground (rad).
    speed, turning, above : float64
        Speed (m/s), ω r/v, height above the resting position (m).
    """

    ground: NDArray[np.bool_]
    rise_rad: FloatArray
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
    i, j = np.nonzero(run.at.arrived[:, :, k] == 1.0)
    if i.size < _LEAST_LIKE:
        return None
    speed = run.at.speed_mps[i, j, k]
    radius = np.cbrt(run.axes_m[i, j].prod(axis=1))
    ground = run.ground[i, j, k]
    rest = run.axes_m[i, j, 1] / math.cos(float(np.median(dip)))
    return _Came(
        ground,
        run.rise_rad[i, j, k],
        speed,
        2.0 * math.pi * run.at.rotation_hz[i, j, k] * radius / np.maximum(speed, 0.1),
        np.where(ground, 0.0, np.maximum(run.at.height_m[i, j, k] - rest, 0.0)),
    )


def _parallel(
    case: Case,
    rock_lines: RockLines,
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
    offset = rock_lines.unforested.offset
    for i in np.unique(rock).tolist():
        rows = np.flatnonzero(rock == i)
        own = slice(int(offset[i]), int(offset[i + 1]))
        sx, sz = rock_lines.unforested.s[own], rock_lines.unforested.z[own]
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
    return start, speed, height, dips_at(rock_lines.unforested, rock, start)


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
