"""What observers of a site write down: tables with errors of measurement."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.check.worlds import motion_state
from sassgis.gap.check.worlds.simulation import draw_rocks, heights_of, simulate
from sassgis.gap.check.worlds.slopes import CLASSES
from sassgis.gap.check.worlds.world import Run, World, require_known
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, Grid

#: Tables that are observed, by the kind of observations.
KINDS = {
    "stations": ("rocks", "stations", "passages"),
    "stops": ("rocks", "deposits"),
    "both": ("rocks", "stations", "passages", "deposits"),
    "everything": ("rocks", "stations", "passages", "deposits", "impacts", "trajectories"),
}
Table = dict[str, NDArray[Any]]

# Errors that every observer makes, as the metadata state them (standard deviations).
SPEED_ERROR_REL = 0.05
ROTATION_ERROR_REL = 0.06
HEIGHT_ERROR_M = 0.10
POSITION_ERROR_M = 0.25
MASS_ERROR_REL = 0.05
FPS = 25.0
#: Column of the time of a contact.
CONTACT_TIME = 16


@dataclass(frozen=True, slots=True)
class ObservedTables:
    """Observations in the form that the diagnosis reads."""

    #: rocks, stations, passages, deposits, impacts, trajectories: those that were observed, each a
    #: dictionary of columns. rock_id and station are text.
    tables: dict[str, Table]
    metadata: dict[str, float]  # errors of measurement and frame rate


def observe(world: World, kind: str, n_rocks: int, seed: int) -> ObservedTables:
    """Release rocks in a synthetic site and write down what is seen.

    ``kind``: one of KINDS; ``seed`` distinguishes campaigns.

    Raises
    ------
    InputError
        If there is no such kind of observations, or no rock.
    """
    require_known("unknown kind", "kind", kind, KINDS)
    if n_rocks < 1:
        raise InputError("no rocks", field="n_rocks", found=n_rocks, expected="at least 1")
    run = distort(world, simulate(world, draw_rocks(world, n_rocks, 1000 + seed)))
    return write_down(world, run, kind, np.random.default_rng([world.seed, 808, seed]))


def fresh_rocks(world: World, n: int) -> ObservedTables:
    """Rocks that no ``observe`` has seen, by the same instruments, everything observed."""
    run = distort(world, simulate(world, draw_rocks(world, n, 500_000_000)))
    return write_down(world, run, "everything", np.random.default_rng([world.seed, 909, 0]))


def distort(world: World, run: Run) -> Run:
    """Errors of scale, time base and frame rate, where they are the truth of the site.

    A wrong scale stretches lengths (speeds, heights, distances from the first station), a wrong
    time base speeds and rotations, each rock's by its own share; a low frame rate loses turns of
    fast rocks. At half of the sites one camera of two is wrong: only some of the rocks are.
    """
    q = max((e.magnitude for e in world.effects if e.name == "measurement_error"), default=0.0)
    if q <= 0.0:
        return run
    effect = next(e for e in world.effects if e.name == "measurement_error")
    sign = 1.0 if effect.seed % 2 else -1.0
    n = len(run.rocks.state)
    rng = np.random.default_rng([effect.seed, 111, n])
    clock = 1.0 + 0.6 * q * rng.standard_t(4, n).clip(-3.0, 3.0) * 0.4
    clock = np.clip(clock, 0.4, 2.5)
    one_camera = np.random.default_rng([effect.seed, 112]).random() < 0.5
    wrong = one_camera | (rng.random(n) < 0.6)
    scale, clock = np.where(wrong, 1.0 + sign * 0.5 * q, 1.0), np.where(wrong, clock, 1.0)
    frame = world.relief.frame
    anchor_s = float(world.stations_s[0]) if len(world.stations_s) else 0.0

    def move(x: FloatArray, y: FloatArray, sd: float) -> tuple[FloatArray, FloatArray]:
        s, c = frame.s(x, y), frame.c(x, y)
        s = anchor_s + (s - anchor_s) * (1.0 + sign * 0.25 * q) + rng.normal(0.0, sd, len(s))
        return frame.xy(s, c + rng.normal(0.0, sd, len(c)))

    d, p, i, t = (v.copy() for v in (run.deposits, run.passages, run.impacts, run.tracks))
    d[:, 3], d[:, 4] = move(d[:, 3], d[:, 4], 8.0 * q)
    rock = p[:, 0].astype(int)
    p[:, 7] *= scale[rock] / clock[rock]
    p[:, 8] = _by_frames(p[:, 8] / clock[rock], FPS * (1.0 - min(0.9, q)))
    p[:, 9] *= scale[rock]
    rock = i[:, 0].astype(int)
    for column in (8, 9, 11, 12):
        i[:, column] *= scale[rock] / clock[rock]
    for column in (10, 13):
        i[:, column] /= clock[rock]
    rock = t[:, 0].astype(int)
    t[:, 3] *= clock[rock]
    t[:, 7] *= scale[rock] / clock[rock]
    t[:, 8] = _by_frames(t[:, 8] / clock[rock], FPS * (1.0 - min(0.9, q)))
    return replace(run, deposits=d, passages=p, impacts=i, tracks=t)


def _by_frames(rotation: FloatArray, fps: float) -> FloatArray:
    """Rotation as counted on film: turns faster than half the frame rate appear slower."""
    folded = np.abs(rotation)
    return np.where(folded > 0.5 * fps, np.abs(fps - folded), folded)


def _names(world: World, table: FloatArray, own: str = "") -> NDArray[Any]:
    """R7 for rocks, R7.2 for their pieces, U for blocks that nobody can attribute.

    Where observers know no names, only the rock itself keeps its own. A row of another block has a
    name to itself that begins with ``own``; on film ("") a block is the same from row to row.
    """
    rock, piece, kind = (table[:, k].astype(int) for k in range(3))
    other = kind != motion_state.ROCK
    attributed = (kind == motion_state.FRAGMENT) & world.spec.named
    number = rock * motion_state.MAX_PIECES + piece
    if not world.spec.named:
        # An odd factor permutes the numbers: they say nothing of the rock.
        number = number * 40503 % 2**32
        if own:
            number[other] = np.arange(other.sum())
    prefix = f"U{own}" if not world.spec.named else "U"
    return np.array(
        [
            (f"R{r + 1}.{p}" if known else f"{prefix}{n}") if away else f"R{r + 1}"
            for r, p, n, known, away in zip(rock, piece, number, attributed, other, strict=True)
        ],
        dtype=np.str_,
    )


def write_down(world: World, run: Run, kind: str, rng: np.random.Generator) -> ObservedTables:
    """What observers note of a run, with their errors and faults."""
    run = _recorded(world, run)
    tables = {name: _TABLES[name](world, run, rng) for name in KINDS[kind]}
    # What the observers believe of their own errors.
    believed = {
        "speed_error_rel": SPEED_ERROR_REL,
        "rotation_error_rel": ROTATION_ERROR_REL,
        "height_error_m": HEIGHT_ERROR_M,
        "position_error_m": POSITION_ERROR_M,
    }
    metadata = {
        "fps": FPS,
        **{key: world.spec.error_factor * value for key, value in believed.items()},
        **{key: float(getattr(world.faults, key)) for key in world.faults.stated},
    }
    return ObservedTables(tables, metadata)


def _recorded(world: World, run: Run) -> Run:
    """A run as it is recorded: films clipped, contacts too light or soon, passages missed."""
    f = world.faults
    n = len(run.rocks.keys)
    rng = np.random.default_rng([world.seed, 818, int(run.rocks.keys[0] >> np.uint64(32))])
    p, i, t = run.passages, run.impacts, run.tracks
    if f.clipped_share > 0.0:
        ends = np.zeros(n)
        np.maximum.at(ends, t[:, 0].astype(int), t[:, 3])
        late = rng.random(n) < 0.5
        cut = ends * rng.uniform(0.1, 0.5, n) * (rng.random(n) < f.clipped_share)
        begin, end = np.where(late, cut, 0.0), np.where(late, ends, ends - cut)
        i, t = (
            v[(v[:, k] >= begin[v[:, 0].astype(int)]) & (v[:, k] <= end[v[:, 0].astype(int)])]
            for v, k in ((i, CONTACT_TIME), (t, 3))
        )
    i = i[-i[:, 9] >= f.contact_min_normal_speed_mps]
    return replace(
        run,
        passages=p[rng.random(len(p)) >= f.passages_missed_share],
        impacts=merged_contacts(i, f.contact_min_interval_s),
        tracks=t,
    )


def merged_contacts(impacts: FloatArray, least_s: float) -> FloatArray:
    """Contacts sooner than ``least_s`` after another as one: before the first, after the last.

    The turn is that of all of them together.
    """
    kept: list[FloatArray] = []
    began = -math.inf
    for row in impacts[np.lexsort((impacts[:, CONTACT_TIME], impacts[:, 1], impacts[:, 0]))]:
        same = bool(kept) and (kept[-1][:2] == row[:2]).all()
        if same and row[CONTACT_TIME] - began < least_s:
            kept[-1][11:14] = row[11:14]
            kept[-1][14] += row[14]
            continue
        began = float(row[CONTACT_TIME])
        kept.append(row.copy())
    return np.array(kept).reshape(-1, impacts.shape[1])


def _factor(rng: np.random.Generator, n: int, sd: float) -> FloatArray:
    return np.exp(rng.normal(0.0, sd, n))


def _place(rng: np.random.Generator, table: FloatArray, first: int) -> Table:
    """Measured x, y, z from three columns, the first of them by number."""
    return {
        name: table[:, first + k] + rng.normal(0.0, POSITION_ERROR_M, len(table))
        for k, name in enumerate("xyz")
    }


def _rocks(world: World, run: Run, rng: np.random.Generator) -> Table:
    rocks, n = run.rocks, len(run.rocks.state)
    x, y, z = _stated_release(world, rocks.stated[:, :3], n).T
    by_eye = np.random.default_rng([world.seed, 819, n]).normal(0.0, world.faults.axes_sd, (n, 3))
    a, b, c = (rocks.state[:, k] for k in (motion_state.A, motion_state.B, motion_state.C))
    density = rocks.state[:, motion_state.DENSITY]
    volume = 4.0 / 3.0 * math.pi * a * b * c
    axes = -np.sort(-np.column_stack([a, b, c]) * np.exp(by_eye), axis=1)
    return {
        "rock_id": np.array([f"R{k + 1}" for k in range(n)]),
        "mass_kg": volume * density * _factor(rng, n, 0.01),
        "volume_m3": volume * _factor(rng, n, 0.01),
        "semi_axis_a_m": axes[:, 0],
        "semi_axis_b_m": axes[:, 1],
        "semi_axis_c_m": axes[:, 2],
        "density_kgm3": density,
        "x": x,
        "y": y,
        "z": z,
        "release_speed_mps": rocks.stated[:, 3],
    }


def _stated_release(world: World, places: FloatArray, n: int = 0) -> FloatArray:
    """Release points as they are written down, with as much height above the terrain model.

    All are wrong together, and each of ``n`` rocks on its own.
    """
    together, each = world.faults.release_m
    if together == each == 0.0:
        return places
    frame, (x, y, z) = world.relief.frame, places.T
    apart = np.random.default_rng([world.seed, 820, n]).standard_normal(n)
    down = together + (each * apart if n else 0.0)
    to_x, to_y = frame.xy(frame.s(x, y) + down, frame.c(x, y))
    above = z - heights_of(world.survey, x, y)
    return np.column_stack([to_x, to_y, heights_of(world.survey, to_x, to_y) + above])


def _stations(world: World, _run: Run, _rng: np.random.Generator) -> Table:
    lines = world.station_lines()
    ends = zip(("x0", "y0", "x1", "y1"), lines.T, strict=True)
    return {"station": np.array(world.station_names), **dict(ends)}


def _passages(world: World, run: Run, rng: np.random.Generator) -> Table:
    p = run.passages
    names = np.array(world.station_names)
    return {
        "rock_id": _names(world, p, "P"),
        "station": names[p[:, 3].astype(int)],
        **_place(rng, p, 4),
        "speed_mps": p[:, 7] * _factor(rng, len(p), SPEED_ERROR_REL),
        "rotation_hz": p[:, 8] * _factor(rng, len(p), ROTATION_ERROR_REL),
        "height_m": np.maximum(p[:, 9] + rng.normal(0.0, HEIGHT_ERROR_M, len(p)), 0.0),
        "mass_kg": p[:, 10] * _factor(rng, len(p), MASS_ERROR_REL),
    }


def _deposits(world: World, run: Run, rng: np.random.Generator) -> Table:
    d = run.deposits
    place = _place(rng, d, 3)
    if world.faults.stops_m > 0.0:
        for name in "xy":
            place[name] = world.faults.stops_m * np.round(place[name] / world.faults.stops_m)
    error = _factor(rng, len(d), MASS_ERROR_REL)
    return {
        "rock_id": _names(world, d, "D"),
        **place,
        "mass_kg": d[:, 6] * error,
        "volume_m3": d[:, 7] * error,
    }


def _impacts(world: World, run: Run, rng: np.random.Generator) -> Table:
    i = run.impacts
    n = len(i)
    table: Table = {
        "rock_id": _names(world, i),
        "impact": i[:, 3].astype(np.int64),
        **_place(rng, i, 4),
        "slope_deg": i[:, 7] + rng.normal(0.0, 1.0, n),
    }
    # Both components come from the same film: the direction is known, the length has the error.
    for side, vt, vn, spin in (("in", 8, 9, 10), ("out", 11, 12, 13)):
        error = _factor(rng, n, SPEED_ERROR_REL)
        table[f"vt_{side}_mps"] = i[:, vt] * error
        table[f"vn_{side}_mps"] = i[:, vn] * error
        table[f"omega_{side}_radps"] = i[:, spin] * _factor(rng, n, ROTATION_ERROR_REL)
    turn = i[:, 14] + rng.normal(0.0, 1.5, n)
    table["turn_deg"] = (turn + 180.0) % 360.0 - 180.0
    table["mass_kg"] = i[:, 15] * _factor(rng, n, MASS_ERROR_REL)
    return table


def _tracks(world: World, run: Run, rng: np.random.Generator) -> Table:
    t = run.tracks
    return {
        "rock_id": _names(world, t),
        "t_s": t[:, 3],
        **_place(rng, t, 4),
        "speed_mps": t[:, 7] * _factor(rng, len(t), SPEED_ERROR_REL),
        "rotation_hz": t[:, 8] * _factor(rng, len(t), ROTATION_ERROR_REL),
    }


_TABLES: dict[str, Callable[[World, Run, np.random.Generator], Table]] = {
    "rocks": _rocks,
    "stations": _stations,
    "passages": _passages,
    "deposits": _deposits,
    "impacts": _impacts,
    "trajectories": _tracks,
}


@dataclass(frozen=True, slots=True)
class SiteSetup:
    """What the diagnosing side knows besides the observations: enough for a configuration."""

    dem: Grid  # the survey
    class_names: tuple[str, ...]
    class_codes: NDArray[np.int64]  # position in class_names of each cell; shape of the grid
    releases: FloatArray  # release points x, y, z (m), shape (n, 3)
    blocks: dict[str, tuple[float, float]]  # as ``World.blocks``


def setup(world: World) -> SiteSetup:
    """The nominal set-up of a site: no true parameter, no truth."""
    return SiteSetup(
        dem=world.survey,
        class_names=CLASSES,
        class_codes=world.relief.ground,
        releases=_stated_release(world, world.releases),
        blocks=world.blocks,
    )
