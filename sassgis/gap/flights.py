"""Paths in time: what happens between impacts, in the air and along the ground.

Between two impacts the model knows gravity alone in the air, and friction alone on the ground. A
path that is bent otherwise, or loses speed on the way, shows what acts there: air, stems, or a
wrong scale or time base of the measurement.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sassgis.core.effects import EffectSettings
from sassgis.core.grid import FloatArray, IntArray
from sassgis.core.ground import GroundTable
from sassgis.gap.case import Case
from sassgis.gap.one_step import ground_at
from sassgis.gap.residuals import Residual
from sassgis.gap.sample import errors_of

#: Effects that act between impacts; the flights that are compared here have none of them.
FLIGHT_EFFECTS = ("air_drag", "trees")
#: Height above the resting position from which a rock counts as flying (m).
CLEAR_M = 0.3
#: Points that a flight, and a stretch along the ground, must have.
_LEAST_POINTS = 8
#: Points at both ends of a stretch that are left out.
_TRIM = 1
#: Shortest stretch along the ground (s).
_LEAST_ROLLING_S = 0.8
_LEAST_SPEED_MPS = 0.5


@dataclass(frozen=True, slots=True)
class _Piece:
    """What one flight or stretch along the ground says: value, prediction, weight by quantity."""

    rock: int
    s: float
    values: dict[str, tuple[float, float, float]]


def path_residuals(
    case: Case, table: GroundTable, edges: FloatArray, radius_m: FloatArray, effects: EffectSettings
) -> list[Residual]:
    """Residuals of flights and of stretches along the ground, by leg and over all.

    Parameters
    ----------
    case : Case
    table : GroundTable
    edges : float64, shape (n_legs, 2)
        Limits of the legs (m).
    radius_m : float64, shape (n_rocks,)
        Of the rocks as the model has them.
    effects : EffectSettings
        Of the model.

    Returns
    -------
    list of Residual
        Weighted by how closely each flight is measured.
    """
    if not len(case.observations.trajectories):
        return []
    flights: list[_Piece] = []
    rolling: list[_Piece] = []
    for rock, rows, impacted in _paths(case):
        own = _Path.of(case, rock, rows, radius_m[rock])
        bounds = _bounds(case, rock, own)
        flights += _flights(case, own, bounds, impacted)
        rolling += _along_ground(case, table, own, bounds, radius_m[rock])
    found = []
    if not any(e in effects.names for e in FLIGHT_EFFECTS):
        found += _by_leg(case, edges, flights, "flight")
    if not effects.trees:
        found += _by_leg(case, edges, rolling, "rolling")
    return found


@dataclass(frozen=True, slots=True)
class _Path:
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

    @classmethod
    def of(cls, case: Case, rock: int, rows: IntArray, radius_m: float) -> _Path:
        track = case.observations.trajectories
        put = case.projected["trajectories"]
        _, dip = ground_at(case, np.full(rows.size, rock), put.s[rows])
        return cls(
            rock,
            track.t_s[rows],
            track.x[rows],
            track.y[rows],
            track.z[rows],
            put.s[rows],
            _smooth(put.height_m[rows] - radius_m / np.cos(dip)),
            track.speed_mps[rows],
            track.rotation_hz[rows],
        )


def _paths(case: Case) -> Iterator[tuple[int, IntArray, bool]]:
    """Rows of the points of each whole rock by time, and whether its impacts are known."""
    track = case.observations.trajectories
    rock = case.observations.rock_of("trajectories")
    known = np.isfinite(track.t_s + track.x + track.y + track.z)
    known &= (rock >= 0) & ~case.observations.is_piece("trajectories")
    known &= np.isfinite(case.projected["trajectories"].height_m)
    hit = (
        set(case.observations.rock_of("impacts").tolist())
        if len(case.observations.impacts)
        else set()
    )
    order = np.lexsort((track.t_s, rock))
    order = order[known[order]]
    for i in np.unique(rock[order]).tolist():
        rows = order[rock[order] == i]
        if rows.size >= _LEAST_POINTS and case.line[i] >= 0:
            yield i, rows, i in hit


def _smooth(values: FloatArray) -> FloatArray:
    """Mean over five points, fewer at the ends."""
    n = values.size
    sums = np.concatenate([[0.0], np.cumsum(values)])
    i = np.arange(n)
    low, high = np.maximum(i - 2, 0), np.minimum(i + 3, n)
    smoothed: FloatArray = (sums[high] - sums[low]) / (high - low)
    return smoothed


def _bounds(case: Case, rock: int, path: _Path) -> tuple[IntArray, IntArray]:
    """Points next to which impacts of the rock happened, rising; empty if none are known.

    An impact is known by its position: among points that lie closer than the error of positions it
    may have happened at any.

    Returns
    -------
    first, last : int64
    """
    impacts = case.observations.impacts
    none = np.empty(0, np.int64)
    if not len(impacts):
        return none, none
    own = (case.observations.rock_of("impacts") == rock) & ~case.observations.is_piece("impacts")
    own &= np.isfinite(impacts.x + impacts.y)
    far = np.hypot(
        path.x[None, :] - impacts.x[own][:, None], path.y[None, :] - impacts.y[own][:, None]
    )
    if not far.size:
        return none, none
    at = np.unique(far.argmin(axis=1))
    error = 2.0 * math.sqrt(2.0) * errors_of(case).position_m
    step = np.hypot(np.gradient(_smooth(path.x)), np.gradient(_smooth(path.y)))
    reach = np.ceil(error / np.maximum(_smooth(step)[at], 1e-3)).astype(np.int64)
    return np.maximum(at - reach, 0), np.minimum(at + reach, path.t.size - 1)


def _flights(
    case: Case, path: _Path, bounds: tuple[IntArray, IntArray], impacted: bool
) -> list[_Piece]:
    """Flights between impacts; where none are known, stretches high enough above the ground."""
    if impacted:
        first, last = bounds
        spans = list(zip((last[:-1] + 1).tolist(), first[1:].tolist(), strict=True))
    else:
        spans = [(a + _TRIM, b - _TRIM) for a, b in _runs(path.above > CLEAR_M)]
    found = []
    for a, b in spans:
        if b - a >= _LEAST_POINTS and np.median(path.above[a:b]) > CLEAR_M:
            found.append(_fitted(case, path, slice(int(a), int(b))))
    return found


def _runs(mask: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[tuple[int, int]]:
    """First and one past the last of each run of true values."""
    edge = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edge[::2].tolist(), edge[1::2].tolist(), strict=True))


def _fitted(case: Case, path: _Path, own: slice) -> _Piece:
    """Accelerations by parabolas, and the change of speed that gravity does not make."""
    t = path.t[own] - path.t[own].mean()
    along = np.column_stack([path.x[own], path.y[own]])
    way = along[-1] - along[0]
    size = float(np.hypot(*way))
    # Fit of (1, t, t²): the variance of the last goes with the inverse of this.
    square = t * t - (t * t).mean()
    linear = t * float(square @ t) / float(t @ t)
    weight = float(((square - linear) ** 2).sum())
    fall = 2.0 * np.polyfit(t, path.z[own], 2)[0]
    g = case.engine.gravity_mps2
    values = {"vertical_acceleration_mps2": (fall, -g, weight)}
    if size > 0.0:
        ahead = 2.0 * np.polyfit(t, along @ (way / size), 2)[0]
        values["horizontal_acceleration_mps2"] = (ahead, 0.0, weight)
    v = path.speed[own]
    if np.isfinite(v).all() and v.mean() > _LEAST_SPEED_MPS:
        energy = 0.5 * v * v + g * path.z[own]
        half = v.size // 2
        lost = energy[-half:].mean() - energy[:half].mean()
        values["speed_change_mps"] = (lost / v.mean(), 0.0, float(half))
    return _Piece(path.rock, float(path.s[own].mean()), values)


def _along_ground(
    case: Case, table: GroundTable, path: _Path, bounds: tuple[IntArray, IntArray], radius_m: float
) -> list[_Piece]:
    """Stretches along the ground: acceleration by speed against that by slope and friction."""
    low = np.abs(path.above) < CLEAR_M
    low &= np.isfinite(path.speed) & (path.speed > _LEAST_SPEED_MPS)
    for first, last in zip(*bounds, strict=True):
        low[first : last + 1] = False
    found = []
    law = table.array()
    for a, b in _runs(low):
        own = slice(a + _TRIM, b - _TRIM)
        t = path.t[own]
        if t.size < 2 * _LEAST_POINTS or t[-1] - t[0] < _LEAST_ROLLING_S:
            continue
        v = path.speed[own]
        seen = float(np.polyfit(t, v, 1)[0])
        kind, dip = ground_at(case, np.full(t.size, path.rock), path.s[own])
        turning = 2.0 * math.pi * path.rotation[own] * radius_m
        sliding = np.isfinite(turning).any() and np.nanmedian(turning / v) < 0.3
        row = law[kind]
        mu = row[:, 3] if sliding else row[:, 4] + row[:, 5] * row[:, 6] / (2.0 * radius_m)
        pull = case.engine.gravity_mps2 * (np.sin(dip) - mu * np.cos(dip))
        weight = float(((t - t.mean()) ** 2).sum())
        values = {"rolling_acceleration_mps2": (seen, float(pull.mean()), weight)}
        found.append(_Piece(path.rock, float(path.s[own].mean()), values))
    return found


def _by_leg(case: Case, edges: FloatArray, pieces: list[_Piece], phase: str) -> list[Residual]:
    """Weighted means over the pieces of each rock, by leg and over all."""
    if not pieces:
        return []
    rock = np.array([p.rock for p in pieces], np.int64)
    s = np.array([p.s for p in pieces])
    leg = case.leg_of(rock, s)
    places = [(name, leg == k, *edges[k].tolist()) for k, name in enumerate(case.legs)]
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
            found.append(
                Residual(place, phase, name, "one step", means[0], means[1], s0, s1, weight=sums[2])
            )
    return found
