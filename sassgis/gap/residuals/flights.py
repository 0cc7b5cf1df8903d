"""Paths in time: what happens between impacts, in the air and along the ground.

Between two impacts the model knows only gravity in the air, and only friction on the ground. A
path that is bent otherwise, or loses speed on it, shows what acts there: air, stems, or a
wrong scale or time base of the measurement.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sassgis.engine.effects.registry import EFFECTS
from sassgis.engine.effects.trees import Trees
from sassgis.engine.simulate import simulate
from sassgis.gap.constants import (
    AIR_FLIGHT_S,
    ALOFT_M,
    CERTAIN_ERROR,
    CLEAR_M,
    FALLING_SHARE,
    GROUND_BRAKE_MPS2,
    GROUND_CONE,
    KINK_MPS,
    KINK_SIGMAS,
    LEVEL_SPEED_MPS,
    LOSS_SIDE_POINTS,
    LOSS_SIDE_S,
    MEDIAN_OF_NORMAL,
    MISSTATED_SHARE,
    PATH_POINTS,
    PATH_SPEED_MPS,
    ROLLED_RUNS,
    ROLLING_M,
    ROLLING_S,
    SLIDING_SHARE,
    TRIMMED_POINTS,
)
from sassgis.gap.forward.released_rocks import fixed_blocks
from sassgis.gap.forward.rock_lines import repeated
from sassgis.gap.observations.case import Case, errors_of
from sassgis.gap.residuals.rock_residuals import Residual, beyond, mean_of_draws
from sassgis.gap.residuals.stop_residuals import FreeRun
from sassgis.grid import BoolArray, FloatArray, IntArray
from sassgis.settings.results import ControlLine, ControlLineCrossings

#: Effects that act between impacts; the flights that are compared here have none of them.
FLIGHT_EFFECTS = tuple(row.name for row in EFFECTS.values() if row.phase == "flight")
_Bounds = tuple[IntArray, IntArray]


@dataclass(frozen=True, slots=True)
class _Piece:
    """One flight or stretch along the ground: value, prediction, weight by quantity."""

    rock: int
    s: float
    values: dict[str, tuple[float, float, float]]


def path_residuals(case: Case, run: FreeRun, edges: FloatArray) -> list[Residual]:
    """Return residuals of flights and of stretches along the ground, by reach and over all.

    Weighted by how closely each is measured. ``edges``: limits of the reaches (m), (n_reaches, 2).
    """
    flights: list[_Piece] = []
    round_m = rolling_radius(run.axes_m)
    rolling: list[_Stretch] = []
    for path, bounds, impacted in bounded_paths(case, round_m):
        flights += [_fitted(case, path, own) for own in flights_of(case, path, bounds, impacted)]
        rolling += _along_ground(path, bounds, float(round_m[path.rock]))
    found = []
    if not any(e in run.model.effects.names for e in FLIGHT_EFFECTS):
        found += _by_reach(case, edges, flights, "flight")
    if not run.model.effects.get(Trees):
        found += _by_reach(case, edges, _rolled(case, run, rolling, round_m), "rolling")
    return found


def struck_above_ground(
    case: Case, axes_m: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the surest loss of speed on each path in time that the ground cannot have made.

    Whatever the ground does, its impulse lies in a cone about its normal: friction and tilts of
    single spots make it as wide as they can. Several contacts together stay in it, as it is convex.
    A stem takes speed along the ground and gives none away from it.

    Rock, chainage (m), speed before, and that less what is lost beyond the cone (m/s), and the
    standard deviation of the difference, of each path of which a part lies high enough; shape (n,).
    """
    found = [
        (path.rock, *loss)
        for path, _, _ in bounded_paths(case, rolling_radius(axes_m))
        if (loss := surest_loss(case, path)) is not None
    ]
    rock, (s, before, after, sd) = _columns(found)
    return rock, s, before, after, sd


def surest_loss(case: Case, path: TimedPath) -> tuple[float, float, float, float] | None:
    """Return chainage of the surest loss beyond the cone, speed before and after, and the error."""
    g, n = case.engine.gravity_mps2, path.t.size
    t = path.t - path.t[0]
    # A path without contacts is a straight line in these.
    places = np.column_stack([path.x, path.y, path.z + 0.5 * g * t * t])
    k = np.arange(2, n - 1)
    # Between points k - 1 and k, with two points on both sides.
    middle = 0.5 * (t[k - 1] + t[k])
    first, last = (np.searchsorted(t, middle + by) for by in (-LOSS_SIDE_S, LOSS_SIDE_S))
    above = sliding_window_view(path.above, 4).min(axis=1)
    own = (k - first >= LOSS_SIDE_POINTS) & (last - k >= LOSS_SIDE_POINTS) & (above > ALOFT_M)
    if not own.any():
        return None
    k, first, last, middle = k[own], first[own], last[own], middle[own]
    (before, left_0, square_0), (after, left_1, square_1) = (
        _lines(t, places, a, b) for a, b in ((first, k), (k, last))
    )
    level = np.hypot(before[:, 0], before[:, 1])
    fall = before[:, 2] - g * middle
    ahead = ((after - before)[:, :2] * before[:, :2]).sum(axis=1) / np.maximum(level, 1e-9)
    up = after[:, 2] - before[:, 2]
    _, dip = case.ground_at(np.full(k.size, path.rock), path.s[k])
    along = ahead * np.cos(dip) - up * np.sin(dip)
    away = ahead * np.sin(dip) + up * np.cos(dip)
    lost = -along - GROUND_CONE * np.maximum(away, 0.0)
    stated = CERTAIN_ERROR * errors_of(case).position_m
    sd = np.maximum(stated, np.sqrt(0.5 * (left_0 + left_1))) * np.sqrt(1 / square_0 + 1 / square_1)
    sure = np.where(level > LEVEL_SPEED_MPS, lost / sd, -np.inf)
    best = int(np.argmax(sure))
    if not math.isfinite(sure[best]):
        return None
    speed = math.hypot(float(level[best]), float(fall[best]))
    return float(path.s[k[best]]), speed, speed - float(lost[best]), float(sd[best])


def _lines(
    t: FloatArray, places: FloatArray, first: IntArray, last: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit lines in time to points first to last - 1: slopes (n, 3), variances, squares (n,)."""
    off = places - places.mean(axis=0)
    columns = np.column_stack([np.ones(t.size), t, t * t, off, off * t[:, None], off * off])
    sums = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(columns, axis=0)])
    sums = sums[last] - sums[first]
    n, mean = sums[:, 0], sums[:, 1] / sums[:, 0]
    square = np.maximum(sums[:, 2] - n * mean**2, 1e-9)
    across = sums[:, 6:9] - mean[:, None] * sums[:, 3:6]
    slope = across / square[:, None]
    rest = sums[:, 9:12] - sums[:, 3:6] ** 2 / n[:, None] - slope * across
    left = np.maximum(rest.sum(axis=1), 0.0) / (3.0 * (n - 2.0))
    return slope, left, square


def _columns(rows: Sequence[tuple[int, float, float, float, float]]) -> tuple[IntArray, FloatArray]:
    """Return rocks, and the four numbers of each row, shape (4, n)."""
    values = np.array(rows, np.float64).reshape(-1, 5)
    return values[:, 0].astype(np.int64), values[:, 1:].T


class AirOfFlights(NamedTuple):
    """What air does on flights of paths in time, arrays of shape (n,)."""

    rock: IntArray
    #: Change of the level speed (m/s²); the same if gravity were less by its standard error.
    ahead: FloatArray
    lighter: FloatArray
    ahead_sd: FloatArray  # by the stated errors
    #: Acceleration to the right of the level velocity (m/s²), and its standard deviation.
    across: FloatArray
    across_sd: FloatArray
    speed2: FloatArray  # speed times level speed (m²/s²), to which air brakes in proportion


def air_of_flights(case: Case, axes_m: FloatArray) -> AirOfFlights:
    """Compute what changes the level velocity on flights of paths in time, where gravity does not.

    A stated speed has the direction that its path has there. Gravity is that of the film: a wrong
    time base changes it, and would seem to brake. It is the median of the flights, of which some
    touched the ground unseen; short ones do so most. Without stated speeds the path tells it.
    """
    errors = errors_of(case)
    flown = [
        (path, own, bend)
        for path, bounds, impacted in bounded_paths(case, rolling_radius(axes_m))
        for own in flights_of(case, path, bounds, impacted)
        for bend in (_bend(path, own),)
        if bend.level > LEVEL_SPEED_MPS and np.ptp(path.t[own]) > AIR_FLIGHT_S
    ]
    bends = np.array([bend for _, _, bend in flown]).reshape(-1, len(_Bend._fields)).T
    by_place, across, up, level, rise, weight = bends
    across_sd = 2.0 * errors.position_m / np.sqrt(weight)
    gravity, slack = _fall_of_films(up, across_sd)
    found = np.full((3, len(flown)), np.nan)
    for k, (path, own, bend) in enumerate(flown):
        found[:2, k] = [_level_change(path, own, bend, g) for g in (gravity, gravity - slack)]
        t = path.t[own]
        found[2, k] = errors.speed_rel * bend.level / math.sqrt(t.size * float(t.var()))
    ahead, lighter, ahead_sd = np.where(np.isfinite(found[0]), found, [by_place] * 2 + [across_sd])
    rock = np.array([path.rock for path, _, _ in flown], np.int64)
    speed2 = level * np.hypot(level, rise)
    return AirOfFlights(rock, ahead, lighter, ahead_sd, across, across_sd, speed2)


def _fall_of_films(up: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Return the median acceleration downwards of flights (m/s²), and its standard error."""
    if not up.size:
        return math.nan, math.nan
    order = np.argsort(up)
    below = np.cumsum(1.0 / sd[order])
    middle = float(up[order][np.searchsorted(below, 0.5 * below[-1])])
    scatter = float(np.median(np.abs(up - middle) / sd)) / MEDIAN_OF_NORMAL
    # Of a median: π/2 times the variance of the mean. Stated errors may be too large.
    error = math.sqrt(0.5 * math.pi / float((sd**-2).sum()))
    return -middle, max(scatter, 1.0 - MISSTATED_SHARE) * error


def _level_change(path: TimedPath, own: slice, bend: _Bend, gravity: float) -> float:
    """Return the change of the level part of stated speeds on a flight (m/s²)."""
    t = path.t[own] - path.t[own].mean()
    level = path.speed[own] * bend.level / np.hypot(bend.level, bend.rise - gravity * t)
    return float(t @ level) / float(t @ t)


class _Bend(NamedTuple):
    """Accelerations of a flight (m/s²), by parabolas: ahead, to the right of it, and upwards."""

    ahead: float
    across: float
    up: float
    # Level and upward velocity in the middle (m/s).
    level: float
    rise: float
    weight: float  # inverse of the variance of half an acceleration, for places of variance one


def _bend(path: TimedPath, own: slice) -> _Bend:
    t = path.t[own] - path.t[own].mean()
    places = np.column_stack([path.x[own], path.y[own], path.z[own]])
    bend, velocity, _ = np.polyfit(t, places, 2)
    way = places[-1, :2] - places[0, :2]
    size = float(np.hypot(*way))
    ux, uy = way / size if size > 0.0 else (0.0, 0.0)
    # Fit of (1, t, t²): the variance of the last goes with the inverse of this.
    square = t * t - (t * t).mean()
    linear = t * float(square @ t) / float(t @ t)
    return _Bend(
        2.0 * float(bend[0] * ux + bend[1] * uy), 2.0 * float(bend[0] * uy - bend[1] * ux),
        2.0 * float(bend[2]), math.hypot(velocity[0], velocity[1]), float(velocity[2]),
        float(((square - linear) ** 2).sum()),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class TimedPath:
    """Points of one rock by time; ``above`` is the height over the resting position (m)."""

    rock: int
    t: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    s: FloatArray
    above: FloatArray
    speed: FloatArray
    rotation: FloatArray


def rolling_radius(axes_m: FloatArray) -> FloatArray:
    """Return radii on which rocks roll (m): they stand on a circle between their longer axes."""
    radius: FloatArray = 0.5 * (axes_m[:, :, 0] + axes_m[:, :, 1]).mean(axis=1)
    return radius


def bounded_paths(case: Case, round_m: FloatArray) -> Iterator[tuple[TimedPath, _Bounds, bool]]:
    """Yield each path, the points between which its impacts happened, and if these are known."""
    seen, put = case.observations, case.projected["trajectories"]
    track = seen.trajectories
    columns = (track.t_s, track.x, track.y, track.z, put.s, track.speed_mps, track.rotation_hz)
    hit, none, impacted = _impact_points(case), np.empty(0), set(seen.rock_of("impacts").tolist())
    for rock, rows in seen.paths_of_rocks(put.height_m).items():
        if rows.size >= PATH_POINTS and case.line[rock] >= 0:
            t, x, y, z, s, speed, rotation = (v[rows] for v in columns)
            _, dip = case.ground_at(np.full(rows.size, rock), s)
            above = _smooth(put.height_m[rows] - round_m[rock] / np.cos(dip))
            path = TimedPath(
                rock=rock, t=t, x=x, y=y, z=z, s=s, above=above, speed=speed, rotation=rotation,
            )  # fmt: skip
            bounds = _bounds(path, *hit.get(rock, (none, none)), errors_of(case).position_m)
            yield path, bounds, rock in impacted


def _smooth(values: FloatArray) -> FloatArray:
    """Return the mean over five points, fewer at the ends."""
    n = values.size
    sums = np.concatenate([[0.0], np.cumsum(values)])
    i = np.arange(n)
    low, high = np.maximum(i - 2, 0), np.minimum(i + 3, n)
    smoothed: FloatArray = (sums[high] - sums[low]) / (high - low)
    return smoothed


def _impact_points(case: Case) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Return x and y of the impacts of each whole rock (m)."""
    impacts = case.observations.impacts
    rock = case.observations.whole_of("impacts")
    own = (rock >= 0) & np.isfinite(impacts.x + impacts.y)
    return {
        i: (impacts.x[own & (rock == i)], impacts.y[own & (rock == i)])
        for i in np.unique(rock[own]).tolist()
    }


def _bounds(path: TimedPath, x: FloatArray, y: FloatArray, error_m: float) -> _Bounds:
    """Return points of a path between which its impacts happened, rising; empty if none are known.

    Of points that lie closer than the error of positions it may have happened at any.
    """
    if not x.size:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    far = np.hypot(path.x[None, :] - x[:, None], path.y[None, :] - y[:, None])
    at = np.unique(far.argmin(axis=1))
    step = np.hypot(np.gradient(_smooth(path.x)), np.gradient(_smooth(path.y)))
    error = 2.0 * math.sqrt(2.0) * error_m
    reach = np.ceil(error / np.maximum(_smooth(step)[at], 1e-3)).astype(np.int64)
    return np.maximum(at - reach, 0), np.minimum(at + reach, path.t.size - 1)


def flights_of(case: Case, path: TimedPath, bounds: _Bounds, impacted: bool) -> list[slice]:
    """Return flights between impacts, or stretches high above the ground where none are known.

    Light contacts are not always noted: what touched the ground on the way is no flight.
    """
    if impacted:
        first, last = bounds
        spans = list(zip((last[:-1] + 1).tolist(), first[1:].tolist(), strict=True))
    else:
        spans = [(a + TRIMMED_POINTS, b - TRIMMED_POINTS) for a, b in _runs(path.above > CLEAR_M)]
    error, g = errors_of(case).position_m, case.engine.gravity_mps2
    return [
        own
        for own in (slice(a, b) for a, b in spans if b - a >= PATH_POINTS)
        if np.median(path.above[own]) > CLEAR_M
        and not touched_ground(path.t[own], path.z[own], error, g)
    ]


def touched_ground(t: FloatArray, z: FloatArray, error_m: float, gravity: float) -> bool:
    """Return whether a path's heights show that it met the ground between two contacts."""
    t = t - t.mean()
    smooth, sizes = np.linalg.qr(np.column_stack([np.ones(t.size), t, t * t]))
    # What a change of the last coefficient by one makes of the heights.
    square = float(sizes[2, 2])
    fall = 2.0 * float(smooth[:, 2] @ z) / square
    if fall + FALLING_SHARE * gravity > 2.0 * error_m / abs(square):
        return True
    # A parabola with a kink between point i and i + 1, three points on both sides.
    kinks = np.maximum(t[:, None] - 0.5 * (t[3:-2] + t[2:-3]), 0.0)
    kinks -= smooth @ (smooth.T @ kinks)
    rest = z - smooth @ (smooth.T @ z)
    size = (kinks**2).sum(axis=0)
    upward = kinks.T @ rest / size
    # What fits best: next to a kink downwards, as a stem makes one, others seem to go up.
    best = int(np.argmax(upward**2 * size))
    kink, own = float(upward[best]), float(size[best])
    left = max(float(rest @ rest) - kink**2 * own, 0.0) / (t.size - 4)
    return kink > max(
        KINK_MPS, KINK_SIGMAS * math.sqrt(max(left, (CERTAIN_ERROR * error_m) ** 2) / own)
    )


def _runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Return the first and one past the last of each run of true values."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))


def _fitted(case: Case, path: TimedPath, own: slice) -> _Piece:
    """Return accelerations by parabolas, and the change of speed that gravity does not make."""
    bend, g = _bend(path, own), case.engine.gravity_mps2
    values = {"vertical_acceleration_mps2": (bend.up, -g, bend.weight)}
    if bend.level > 0.0:
        values["horizontal_acceleration_mps2"] = (bend.ahead, 0.0, bend.weight)
    v = path.speed[own]
    if np.isfinite(v).all() and v.mean() > PATH_SPEED_MPS:
        energy = 0.5 * v * v + g * path.z[own]
        half = v.size // 2
        lost = energy[-half:].mean() - energy[:half].mean()
        values["speed_change_mps"] = (lost / v.mean(), 0.0, float(half))
    return _Piece(path.rock, float(path.s[own].mean()), values)


@dataclass(frozen=True, slots=True)
class _Stretch:
    """A stretch along the ground: chainages (m) and speeds (m/s) at its ends, points on it."""

    rock: int
    s0: float
    s1: float
    v0: float
    v1: float
    points: int
    sliding: bool


def _along_ground(path: TimedPath, bounds: _Bounds, radius_m: float) -> list[_Stretch]:
    """Return stretches on which a rock stays low and does not strike."""
    low = np.abs(path.above) < CLEAR_M
    low &= np.isfinite(path.speed) & (path.speed > PATH_SPEED_MPS)
    for first, last in zip(*bounds, strict=True):
        low[first : last + 1] = False
    found = []
    for a, b in _runs(low):
        own = slice(a + TRIMMED_POINTS, b - TRIMMED_POINTS)
        t = path.t[own]
        if t.size < 2 * PATH_POINTS or t[-1] - t[0] < ROLLING_S:
            continue
        v0, v1 = np.polyval(np.polyfit(t, path.speed[own], 2), t[[0, -1]]).tolist()
        s0, s1 = np.polyval(np.polyfit(t, path.s[own], 2), t[[0, -1]]).tolist()
        turning = 2.0 * math.pi * path.rotation[own] * radius_m / path.speed[own]
        known = turning[np.isfinite(turning)]
        sliding = bool(known.size and np.median(known) < SLIDING_SHARE)
        if s1 - s0 > ROLLING_M and s0 > 0.0 and v0 > PATH_SPEED_MPS:
            found.append(_Stretch(
                rock=path.rock, s0=s0, s1=s1, v0=v0, v1=max(v1, 0.0), points=t.size,
                sliding=sliding,
            ))  # fmt: skip
    return found


def _rolled(
    case: Case, run: FreeRun, stretches: list[_Stretch], round_m: FloatArray
) -> list[_Piece]:
    """Return accelerations along the chainage on the ground, against those of the model's rocks."""
    # Rocks may continue beyond the end of their fall line, where they have no profile.
    last = case.profiles.s[case.profiles.offset[1:] - 1][case.line]
    stretches = [p for p in stretches if p.s0 < last[p.rock] - ROLLING_M]
    if not stretches:
        return []
    n = len(stretches)
    # Each in both orientations.
    twice, start, end, fast, sliding = (
        np.tile([getattr(p, name) for p in stretches], 2)
        for name in ("rock", "s0", "s1", "v0", "sliding")
    )
    end = np.minimum(end, last[twice] - 0.1)
    blocks = fixed_blocks(
        case.blocks, twice, speed_mps=fast,
        spin_radps=np.where(sliding, 0.0, fast / round_m[twice]),
        drop_m=np.zeros(2 * n), orientation_rad=np.repeat([0.0, 0.5 * math.pi], n),
    )  # fmt: skip
    done = simulate(
        repeated(run.rock_lines.unforested, twice),
        run.model.table,
        blocks,
        case.engine,
        seed=run.seed + 501,
        rocks_per_line=ROLLED_RUNS,
        line_keys=np.arange(2 * n, dtype=np.uint64),
        starts=np.column_stack([start, start]),
        control_lines=ControlLineCrossings(
            (ControlLine("end", "station"),),
            np.arange(2 * n + 1, dtype=np.int64),
            end,
            np.zeros(2 * n, np.int64),
        ),
        effects=run.model.effects,
    )
    # What it loses up to the end, or to where it comes to rest before.
    square = np.zeros((2 * n, ROLLED_RUNS))
    square[done.passages["line"], done.passages["rock"]] = done.passages["speed_mps"] ** 2
    stop = np.minimum(done.rocks["runout_m"].reshape(2 * n, ROLLED_RUNS), end[:, None])
    distance = np.maximum(stop - start[:, None], 0.05)
    pull = (square - fast[:, None] ** 2) / (2.0 * distance)
    # As the observed rocks, those of the model are to have gone without striking, if any can.
    struck = done.rocks["impacts"].reshape(2 * n, ROLLED_RUNS) > 0
    pull = np.concatenate([np.where(struck, np.nan, pull), pull], axis=1)
    pull = np.stack([pull[:n], pull[n:]], axis=1).reshape(n, 2, 2, ROLLED_RUNS)
    free, every = (mean_of_draws(pull[:, :, k].reshape(n, -1)) for k in (0, 1))
    mean = np.where(np.isfinite(free), free, every)
    return [
        _Piece(
            p.rock,
            0.5 * (p.s0 + p.s1),
            {
                "acceleration_mps2": (
                    (p.v1**2 - p.v0**2) / (2.0 * (p.s1 - p.s0)),
                    a,
                    p.points * (p.s1 - p.s0) ** 2 / max(p.v0, p.v1) ** 2,
                )
            },
        )
        for p, a in zip(stretches, mean.tolist(), strict=True)
    ]


def _by_reach(case: Case, edges: FloatArray, pieces: list[_Piece], phase: str) -> list[Residual]:
    """Return weighted means over the segments of each rock, by reach and over all."""
    if not pieces:
        return []
    rock = np.array([p.rock for p in pieces], np.int64)
    s = np.array([p.s for p in pieces])
    reach = case.reach_of(rock, s)
    places = [(name, reach == k, *edges[k].tolist()) for k, name in enumerate(case.reaches)]
    places.append(("all", np.ones(rock.size, bool), float(edges[0, 0]), float(edges[-1, 1])))
    names = dict.fromkeys(name for p in pieces for name in p.values)
    found = []
    for name in names:
        nothing = (math.nan, math.nan, 0.0)
        seen, predicted, weight = np.array([p.values.get(name, nothing) for p in pieces]).T
        for place, inside, s0, s1 in places:
            own = inside & (weight > 0.0)
            sums = np.zeros((3, case.n_rocks))
            for row, value in zip(sums, (seen * weight, predicted * weight, weight), strict=True):
                np.add.at(row, rock[own], value[own])
            with np.errstate(invalid="ignore", divide="ignore"):
                means = sums[:2] / sums[2]
            score = beyond(means[0] - means[1], GROUND_BRAKE_MPS2) if phase == "rolling" else None
            found.append(
                Residual(
                    place=place, phase=phase, quantity=name, test="one step", observed=means[0],
                    predicted=means[1], s0_m=s0, s1_m=s1, score=score, weight=sums[2],
                    steps=int(own.sum()),
                )
            )  # fmt: skip
    return found
