"""Runs from the release and from station to station, against what was observed.

A run from the release carries every error down the slope. A run that starts again at each station
from what was observed there carries none beyond the next one: it shows on which stretch the motion
differs. What was not observed at a station, such as the direction of the motion, is taken from
rocks that the model itself brings there at a like speed and height.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from sassgis.engine.simulate import moving_axes
from sassgis.gap.constants import (
    FEWEST_LIKE_ROCKS,
    LIKE_ROCKS,
    PARALLEL_S,
    PARALLEL_STEP_S,
    RESTART_DROP_M,
)
from sassgis.gap.forward.released_rocks import Releases, fixed_blocks, move
from sassgis.gap.forward.rock_lines import dips_at
from sassgis.gap.observations.case import Case, errors_of
from sassgis.gap.residuals.rock_residuals import Residual, mean_of_draws, t_statistics
from sassgis.gap.residuals.stop_residuals import (
    AtStations,
    FreeRun,
    ends_of,
    observed_end,
    passages_of,
    residuals_at_station,
)
from sassgis.grid import FloatArray, IntArray
from sassgis.settings.results import ProfileSet


def reach_residuals(
    case: Case,
    seen: AtStations,
    run: FreeRun,
    edges: FloatArray,
    *,
    rng: np.random.Generator,
) -> list[Residual]:
    """Return residuals of every reach, and the part of the first that the others do not have.

    The first reach is the run from the release. Where it is wrong, and more so than those below,
    what is wrong is the release: the finding of the phase "release", which both must support.
    """
    found: list[Residual] = []
    speeds: list[Residual] = []
    for k, (name, (s0, s1)) in enumerate(zip(case.reaches, edges.tolist(), strict=True)):
        again = _restarted(case, seen, run, k - 1, rng) if k else (run.at, run.ends.runout_m)
        if again is None:
            continue
        at, stop = again
        if k < len(case.station_names):
            own = residuals_at_station(
                case=case, seen=seen, run=run, predicted=at, k=k, place=name, test="reach",
                span=(s0, s1),
            )  # fmt: skip
            if k:
                started = np.isfinite(seen.speed_mps[:, k - 1])
                own = [replace(r, observed=np.where(started, r.observed, np.nan)) for r in own]
            found += own
            speeds.append(own[0])
        else:
            runout = observed_end(case).runout_m
            stopped = Residual(
                place=name, phase="stopping", quantity="runout_m", test="reach", observed=runout,
                predicted=mean_of_draws(stop), s0_m=s0, s1_m=s1,
            )  # fmt: skip
            found.append(stopped)
    if len(speeds) > 1:
        first = speeds[0]
        others = mean_of_draws(np.column_stack([r.gap for r in speeds[1:]]), least=1)
        # Were the motion as wrong there as below.
        predicted = first.predicted + others
        score = _weaker(first.gap, first.gap - others)
        found.append(replace(first, phase="release", predicted=predicted, score=score))
    return found


def _weaker(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the less sure of two gaps that must both be there and of one sign."""
    known = np.isfinite(first) & np.isfinite(second)
    a, b = np.where(known, first, np.nan), np.where(known, second, np.nan)
    t_a, t_b = t_statistics(np.column_stack([a, b])).tolist()
    if not t_a * t_b > 0.0:
        return np.where(known, 0.0, np.nan)
    return a if abs(t_a) < abs(t_b) else b


def _restarted(
    case: Case, seen: AtStations, run: FreeRun, k: int, rng: np.random.Generator
) -> tuple[AtStations, FloatArray] | None:
    """Return runs from station ``k`` of rocks seen there, and run-outs (m); or None."""
    n, m = run.ends.runout_m.shape
    started = np.isfinite(seen.speed_mps[:, k]) & (seen.speed_mps[:, k] > 0.0)
    rocks = np.flatnonzero(started)
    if rocks.size < 2:
        return None
    rock = np.repeat(rocks, m)
    draw = np.tile(np.arange(m), rocks.size)
    s, states = _states(case, seen, run, k, rock=rock, draw=draw, rng=rng)
    axes = {f"axis_{j + 1}_m": run.axes_m[rock, draw, j] for j in range(3)}
    blocks = [replace(own, volume_m3=None, volume_exponent=None) for own in case.blocks]
    releases = Releases(
        rock,
        fixed_blocks(blocks, rock, **axes, **states),
        np.column_stack([s, s]),
        np.nan_to_num(seen.lateral_m[rock, k]),
        np.arange(rock.size, dtype=np.uint64),
    )
    lines = run.rock_lines
    done = move(case, lines, releases, run.model, seed=run.seed + 1 + k, count=1)
    at, _, _ = passages_of(
        lines.unforested, done, rock[done.passages["line"]],
        draw[done.passages["line"]], moving_axes(run.axes_m, case.engine), len(case.station_names),
    )  # fmt: skip
    at.arrived[~started] = np.nan
    ends = ends_of(done, rock.size, 1, lines.end[rock])
    runout = np.full((n, m), np.nan)
    runout[rock, draw] = ends.runout_m[:, 0]
    return at, runout


def _states(
    case: Case,
    seen: AtStations,
    run: FreeRun,
    k: int,
    *,
    rock: IntArray,
    draw: IntArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return chainages and states of the blocks in which rocks start again at station ``k``.

    The engine lets a rock go along the ground, from a height. A flight across the station in any
    other direction is therefore begun where it runs along the ground: that is the same flight.
    """
    error, profiles = errors_of(case), run.rock_lines.unforested
    size = rock.size
    s = case.station_s[rock, k]
    dip = dips_at(profiles, rock, s)
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
        near = _like(donors[2:], (speed, turning, above), blur, rng)
        ground, rise_rad, usual_speed, usual_turning, usual_above = (v[near] for v in donors)
        speed = _towards(speed, usual_speed, error.speed_rel * speed)
        turning = _towards(turning, usual_turning, blur[1] * usual_turning)
        above = _towards(above, usual_above, np.full(size, error.height_m))
    above = np.where(ground, 0.0, np.nan_to_num(above))
    spin = np.where(np.isfinite(turning), turning, 1.0) * speed / radius
    orientation = rng.uniform(0.0, math.pi, size)
    # On the ground it stands so that its spin needs no lever: on its flat or its narrow side.
    orientation = np.where(ground, 0.5 * math.pi * rng.integers(0, 2, size), orientation)
    support = np.hypot(a * np.sin(orientation), b * np.cos(orientation))
    centre = np.maximum(above + b / np.cos(dip), b / np.cos(dip) + RESTART_DROP_M)
    angle = np.clip(dip + rise_rad, -1.5, 1.5)
    start, fast, high = _parallel(
        case, profiles, k, rock=rock, s=s, centre=centre,
        vx=speed * np.cos(angle), vz=speed * np.sin(angle),
    )  # fmt: skip
    dip_there = dips_at(profiles, rock, start)
    drop = np.maximum(high - support / np.cos(dip_there), RESTART_DROP_M)
    return np.where(ground, s, start), {
        "speed_mps": np.where(ground, speed, fast),
        "spin_radps": spin,
        "drop_m": np.where(ground, 0.0, drop),
        "orientation_rad": orientation,
    }


def _towards(seen: FloatArray, usual: FloatArray, error: FloatArray) -> FloatArray:
    """Move observations by up to their error towards the model's; the model's if unseen."""
    moved = usual + np.sign(seen - usual) * np.maximum(np.abs(seen - usual) - error, 0.0)
    return np.where(np.isfinite(seen), moved, usual)


def _like(
    came: Sequence[FloatArray],
    seen: Sequence[FloatArray],
    blur: tuple[float, float, float],
    rng: np.random.Generator,
) -> IntArray:
    """Return one of the rocks that came which are most like each of some that were seen.

    By speed, turning and height, within ``blur``: relative errors of two, and that of the height
    (m).
    """
    data, asked = [], []
    for k, (own, other, error) in enumerate(zip(came, seen, blur, strict=True)):
        if k == 0:
            own, other = np.log(np.maximum(own, 0.1)), np.log(np.maximum(other, 0.1))
        # Where a value was not measured it does not count.
        known = np.where(np.isfinite(other), other, float(np.median(own)))
        scale = math.hypot(error, 0.1 * float(own.std())) + 1e-9
        data.append(own / scale)
        asked.append(known / scale)
    count = min(LIKE_ROCKS, came[0].size)
    far, near = cKDTree(np.column_stack(data)).query(np.column_stack(asked), k=count)
    # Each with the likelihood of what was seen, up to a factor.
    total = np.cumsum(np.exp(0.5 * (far[:, :1] ** 2 - far**2)), axis=1)
    pick = (total < rng.random(len(asked[0]))[:, None] * total[:, -1:]).sum(axis=1)
    chosen: IntArray = near[np.arange(pick.size), pick]
    return chosen


def _came(run: FreeRun, k: int, dip: FloatArray) -> tuple[FloatArray, ...] | None:
    """Return the rocks that the model brings to a station; None if these are too few.

    Whether they roll, angle above the ground (rad), speed (m/s), ω r/v, height above resting (m).
    """
    i, j = np.nonzero(run.at.arrived[:, :, k] == 1.0)
    if i.size < FEWEST_LIKE_ROCKS:
        return None
    speed = run.at.speed_mps[i, j, k]
    radius = np.cbrt(run.axes_m[i, j].prod(axis=1))
    ground = run.ground[i, j, k]
    rest = run.axes_m[i, j, 1] / math.cos(float(np.median(dip)))
    turning = 2.0 * math.pi * run.at.rotation_hz[i, j, k] * radius / np.maximum(speed, 0.1)
    above = np.where(ground, 0.0, np.maximum(run.at.height_m[i, j, k] - rest, 0.0))
    return ground, run.rise_rad[i, j, k], speed, turning, above


def _parallel(
    case: Case,
    profiles: ProfileSet,
    k: int,
    *,
    rock: IntArray,
    s: FloatArray,
    centre: FloatArray,
    vx: FloatArray,
    vz: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Find where flights run along the ground: chainage, speed, height of the centre."""
    g = case.engine.gravity_mps2
    t = np.arange(-PARALLEL_S, PARALLEL_S + 0.5 * PARALLEL_STEP_S, PARALLEL_STEP_S)
    zero = int(np.argmin(np.abs(t)))
    start, speed, height = s.copy(), np.hypot(vx, vz), centre.copy()
    station = case.station_s
    below = np.where(np.isfinite(station) & (station > station[:, k : k + 1]), station, np.inf)
    next_s = below.min(axis=1)
    for i in np.unique(rock).tolist():
        rows = np.flatnonzero(rock == i)
        sx, sz = profiles.vertices(i)
        x = s[rows, None] + vx[rows, None] * t
        rise = np.interp(x, sx, sz) - np.interp(s[rows], sx, sz)[:, None]
        clear = centre[rows, None] + vz[rows, None] * t - 0.5 * g * t * t - rise
        bad = (clear <= 0.0) | (x >= next_s[i] - 0.1) | (x <= sx[0] + 0.1) | (x >= sx[-1] - 0.1)
        bad[:, zero] = False
        # Only contacts that a flight joins to the station.
        ahead = np.logical_or.accumulate(bad[:, zero:], axis=1)
        behind = np.logical_or.accumulate(bad[:, zero::-1], axis=1)[:, ::-1]
        bad = np.concatenate([behind[:, :-1], ahead], axis=1)
        best = np.where(bad, -np.inf, clear).argmax(axis=1)
        pick = np.arange(rows.size)
        start[rows], height[rows] = x[pick, best], clear[pick, best]
        speed[rows] = np.hypot(vx[rows], vz[rows] - g * t[best])
    return start, speed, height
