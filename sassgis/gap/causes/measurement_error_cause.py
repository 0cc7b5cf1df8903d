"""An error of the measurement as a cause: instruments contradict each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import pairwise

import numpy as np
from scipy.special import ndtri

from sassgis.gap.causes.cause import (
    Cause,
    CausePart,
    ParameterDraws,
    Scores,
    Trace,
    Unseen,
    base_size,
    gaps_by_reach,
    known_mean,
    over_scatter,
    station_offsets,
    usual_offset,
)
from sassgis.gap.constants import (
    COMPENSATED_PRODUCT,
    FAR_ERRORS,
    FAST_MPS,
    FINGERPRINT_ROCKS,
    FREE_FLIGHT_SHARE,
    LIKE_FLIGHTS,
    LOG_SCALE,
    MISSTATED_SHARE,
    PATH_LAG_S,
    PRINTED_Z,
    ROCK_FALL_M,
    SOON_BELOW_M,
    STATION_SIDE_S,
    STRAIGHT_GROWTH,
    UPPER_FLIGHTS,
    USUAL_SCALE,
)
from sassgis.gap.diagnosis import Fingerprint
from sassgis.gap.forward.released_rocks import HypothesisModel, MeasurementError
from sassgis.gap.observations.case import Case, errors_of
from sassgis.gap.residuals.residual_table import ResidualTable, StepTable
from sassgis.gap.residuals.rock_residuals import mean_of_draws, per_rock, sureness
from sassgis.gap.residuals.stop_residuals import side_error
from sassgis.grid import FloatArray

_IN_TIME = "speeds against distances in time, all rocks alike"
_PASSING = "speeds at stations against the paths in time there, all rocks alike"
_AGAINST_FALLS = "speeds against the falls between contacts, all rocks alike"
_ENERGY = "energy_jpkg"


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    kinds = [draws.share(f"seen.{what}") < 0.6 for what in ("scale", "clock", "turns", "place")]
    if not any(kinds):
        kinds[int(draws.share("seen.one") * 4)] = True
    scale = math.exp(draws.uniform("seen.log_scale", -LOG_SCALE, LOG_SCALE)) if kinds[0] else 1.0
    turns = math.exp(draws.uniform("seen.log_turns", -0.3, 0.3)) if kinds[2] else 1.0
    measurement = MeasurementError(
        scale=scale, clock_sd=draws.log("seen.clock_sd", 0.02, 0.35) if kinds[1] else 0.0,
        rotation_scale=turns, spin_scale=turns,
        noise_rel=draws.log("seen.noise", 0.05, 0.4) if kinds[2] else 0.0,
        stretch=1.0 + (scale - 1.0) * draws.share("seen.stretch"),
        position_m=draws.log("seen.position_m", 0.5, 8.0) if kinds[3] else 0.0,
    )  # fmt: skip

    def change(model: HypothesisModel) -> HypothesisModel:
        own = model.measurement
        both = replace(
            measurement,
            rotation_scale=turns * own.rotation_scale,
            rotation_noise=own.rotation_noise,
            spin_scale=turns * own.spin_scale,
            spin_noise=own.spin_noise,
        )
        return replace(model, measurement=both)

    return CausePart("scale, time base, noise", change, asdict(measurement))


def _measured(prints: Mapping[str, Fingerprint]) -> Mapping[str, float]:
    """Return the scale of speeds, if a fingerprint shows it: what fits the motion says less."""
    for one in (prints[n] for n in (_IN_TIME, _PASSING, _AGAINST_FALLS) if n in prints):
        if one.z >= PRINTED_Z and one.value > 0.0 and abs(math.log(one.value)) < LOG_SCALE:
            share = 0.5 + 0.5 * math.log(one.value) / LOG_SCALE
            return {"seen.scale": 0.0, "seen.log_scale": share}
    return {}


def _speed_ratios(case: Case) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return logarithms of stated speeds over those in time by rock, scatter, and correction."""
    track = case.observations.trajectories
    error = errors_of(case)
    ratio, usual, corrected = np.full((3, case.n_rocks), np.nan)
    for rock, rows in case.observations.paths_of_rocks(track.speed_mps).items():
        t = track.t_s[rows]
        ahead = np.searchsorted(t, t + PATH_LAG_S - 1e-6)
        first = np.flatnonzero(ahead < rows.size)
        last = ahead[first]
        lag = t[last] - t[first]
        way = [getattr(track, c)[rows] for c in "xyz"]
        distance = np.sqrt(sum((c[last] - c[first]) ** 2 for c in way))
        sums = np.concatenate([[0.0], np.cumsum(track.speed_mps[rows])])
        stated = (sums[last + 1] - sums[first]) / (last + 1 - first)
        clean = _without_errors(distance, error.position_m)
        fast = (stated > FAST_MPS) & (lag < 2.0 * PATH_LAG_S) & (clean > 1.0)
        if fast.sum() >= 5:
            ratio[rock] = np.median(np.log(stated[fast] * lag[fast] / clean[fast]))
            spread = math.hypot(error.speed_rel, 1.5 * error.position_m / np.median(clean[fast]))
            usual[rock] = 2.0 * spread / math.sqrt(float(fast.sum()) / 5.0)
            corrected[rock] = np.median(np.log(distance[fast] / clean[fast]))
    if np.isfinite(ratio).sum() < FINGERPRINT_ROCKS:
        raise Unseen
    return ratio, usual, corrected


def _without_errors(distance: FloatArray, position_m: float) -> FloatArray:
    """Return distances of points with errors, which are too long by them (m)."""
    cleaned: FloatArray = np.sqrt(np.maximum(distance**2 - 4.0 * position_m**2, 1e-6))
    return cleaned


def _scaled(ratio: FloatArray, corrected: FloatArray) -> Scores:
    """Return scale from the logarithms of speeds over those of paths, and of their corrections."""
    middle = float(np.nanmedian(ratio))
    # The correction goes with the square of an error that may be stated wrongly.
    room = (USUAL_SCALE - 1.0) + ((1.0 + MISSTATED_SHARE) ** 2 - 1.0) * corrected
    return Scores(math.copysign(1.0, middle) * ratio - room, math.exp(middle))


def _all_alike(case: Case, residuals: ResidualTable) -> Scores:
    ratio, _, corrected = _speed_ratios(case)
    return _scaled(ratio, corrected)


def _confirmed(case: Case, residuals: ResidualTable) -> bool:
    """Return whether paths in time show that stated speeds have no scale beyond a usual one."""
    with suppress(Unseen):
        alike = _all_alike(case, residuals).values
        return sureness(per_rock(alike, case.group, case.n_rocks)) < -PRINTED_Z
    return False


def _passing(case: Case, residuals: ResidualTable) -> Scores:
    """Return speeds at stations over distances in time there, the mean of each rock."""
    seen, track = case.observations, case.observations.trajectories
    speed, rock, station = seen.passages.speed_mps, seen.whole_of("passages"), case.passed_station
    along, error = case.projected["trajectories"].s, errors_of(case).position_m
    paths = seen.paths_of_rocks(along)
    sums = np.zeros((3, case.n_rocks))
    for i in np.flatnonzero((rock >= 0) & (station >= 0) & (speed > FAST_MPS)).tolist():
        rows = paths.get(int(rock[i]), np.empty(0, np.int64))
        s, t = along[rows], track.t_s[rows]
        below = np.flatnonzero(s >= case.station_s[rock[i], station[i]])
        # A path that begins below the station does not pass it.
        if not below.size or below[0] == 0:
            continue
        after = int(below[0])
        ends = np.searchsorted(
            t, 0.5 * (t[after - 1] + t[after]) + [-STATION_SIDE_S, STATION_SIDE_S]
        )
        first, last = min(int(ends[0]), after - 1), max(int(ends[1]) - 1, after)
        way = [getattr(track, c)[rows] for c in "xyz"]
        distance = np.sqrt(sum((c[last] - c[first]) ** 2 for c in way))
        time = t[last] - t[first]
        # Chosen by the speed: by the distance, errors would choose those that are too long.
        if speed[i] * time > FAR_ERRORS * error and time < PATH_LAG_S + 1e-6:
            clean = float(_without_errors(distance, error))
            own = math.log(speed[i] * time / clean), math.log(distance / clean)
            sums[:, rock[i]] += 1.0, *own
    count = np.where(sums[0] > 0.0, sums[0], np.nan)
    if np.isfinite(count).sum() < FINGERPRINT_ROCKS:
        raise Unseen
    return _scaled(sums[1] / count, sums[2] / count)


def _against_falls(case: Case, residuals: ResidualTable) -> Scores:
    """Score energy gained between contacts over that of the fall: the square of the scale.

    Air, stems and contacts that were missed take energy, of single flights: too low a scale shows
    in the flight of each rock that gains most, less what the errors of so many flights make of it,
    if most flights are longer than such speeds allow by the same scale. Where the paths in time
    confirm the speeds of the same films, it is air or ground that takes the energy.
    """
    if _confirmed(case, residuals):
        raise Unseen
    rows = residuals.steps.of("flight", _ENERGY)
    fell = np.bincount(rows.rock, rows.fell_jpkg, case.n_rocks)
    flew = np.bincount(rows.rock, minlength=case.n_rocks) > 0
    if flew.sum() < FINGERPRINT_ROCKS or fell[flew].mean() < ROCK_FALL_M * case.engine.gravity_mps2:
        raise Unseen
    gained = rows.observed - rows.predicted
    # Not of each rock by itself: one that hardly fell would have any scale.
    share = np.bincount(rows.rock, gained, case.n_rocks) / fell[flew].mean()
    usual = (USUAL_SCALE**2 - 1.0) * np.abs(fell) / fell[flew].mean()
    if float(share[flew].mean()) >= 0.0:
        scale = math.sqrt(1.0 + float(share[flew].mean()))
        return Scores(np.where(flew, share - usual, np.nan), scale)
    # Where speeds are too low, flights are as much longer than these allow.
    scale = math.sqrt(max(1.0 + float(np.median(gained / np.maximum(rows.fell_jpkg, 1.0))), 0.01))
    alike = np.abs(rows.reach * scale - 1.0) < FREE_FLIGHT_SHARE
    if alike.mean() < LIKE_FLIGHTS:
        return Scores(np.where(flew, share, np.nan), 1.0)
    # Errors by the flights that gain most: losses scatter the others.
    low, high = np.quantile(rows.z, UPPER_FLIGHTS)
    scatter = min((high - low) / float(np.diff(ndtri(UPPER_FLIGHTS))[0]), 1.0)
    rows, flights = _best_flights(rows, case.n_rocks)
    # G. Blom (1958): the largest of n standard normal numbers.
    largest = ndtri((flights - 0.375) / (flights + 0.25))
    less = rows.predicted - rows.observed + scatter * largest * rows.sd
    middle = float(rows.fell_jpkg.mean())
    room = (USUAL_SCALE**2 - 1.0) * np.abs(rows.fell_jpkg)
    return Scores(per_rock((less - room) / middle, rows.rock, case.n_rocks), scale)


def _best_flights(rows: StepTable, n_rocks: int) -> tuple[StepTable, FloatArray]:
    """Return the flight of each rock that gains most in standard deviations, and their numbers."""
    order = np.lexsort((-rows.z, rows.rock))
    rock = rows.rock[order]
    best = np.zeros(len(rows), np.bool_)
    best[order[np.flatnonzero(np.diff(rock, prepend=-1))]] = True
    flights = np.bincount(rock, minlength=n_rocks).astype(np.float64)
    return rows.where(best), flights[rows.rock[best]]


def _each_its_own(case: Case, residuals: ResidualTable) -> Scores:
    ratio, usual, _ = _speed_ratios(case)
    away = np.abs(ratio - float(np.nanmedian(ratio)))
    return Scores(away - (1.0 + MISSTATED_SHARE) * usual, float(np.nanstd(ratio)))


def _made_up(case: Case, residuals: ResidualTable) -> Scores:
    """Test for errors at a station, which are errors of the start of the next reach as well."""
    gaps = gaps_by_reach(residuals, "speed_mps")
    pairs = [pair for pair in pairwise(case.reaches) if gaps.keys() >= {*pair}]
    if not pairs:
        raise Unseen
    own = {place: over_scatter(gap - np.nanmean(gap), 0.02) for place, gap in gaps.items()}
    product = mean_of_draws(np.column_stack([-own[a] * own[b] for a, b in pairs]), least=1)
    return Scores(product - COMPENSATED_PRODUCT, float(np.nanmean(product)))


def _aside(case: Case, residuals: ResidualTable) -> Scores:
    """Return the offset of stops where the rock was on its fall line shortly before."""
    rows = residuals.steps.of("stop", "lateral_m")
    at = station_offsets(case, residuals, 1)
    passed = np.isfinite(at[rows.rock])
    last = at.shape[1] - 1 - np.argmax(passed[:, ::-1], axis=1)
    beyond = rows.way_m - case.station_s[rows.rock, last]
    near = passed.any(axis=1) & (beyond < SOON_BELOW_M)
    near &= np.abs(at[rows.rock, last]) < 0.5 * side_error(case)
    run = residuals.run
    made = run.ends.lateral_m[rows.rock] - run.at.lateral_m[rows.rock, :, last]
    usual = usual_offset(case) + base_size(made)
    if case.terrain is None:
        usual = usual + STRAIGHT_GROWTH * np.maximum(beyond, 0.0)
    size = np.where(near, np.abs(rows.observed) - usual, np.nan)
    return Scores(per_rock(size, rows.rock, case.n_rocks), known_mean(size + usual))


CAUSE = Cause(
    "measurement_error",
    number=9,
    group="instruments",
    phase="observation",
    label="error of measurement",
    summary="an error of the measurement",
    closes=False,
    draw=_draw,
    measured=_measured,
    statistics=(
        Trace(_IN_TIME, _all_alike, ("trajectories",), clear=True),
        Trace(_PASSING, _passing, ("passages", "stations", "trajectories"), clear=True),
        Trace(_AGAINST_FALLS, _against_falls, ("impacts",), clear=True),
        Trace(
            "speeds against distances in time, each rock by its own share",
            _each_its_own,
            ("trajectories",),
            clear=True,
        ),
        Trace(
            "what is off at one station is made up for at the next",
            _made_up,
            ("passages", "stations"),
        ),
        Trace(
            "offset of stops, soon below a station that was passed without",
            _aside,
            ("passages", "stations", "deposits"),
            clear=True,
        ),
    ),
)
