"""An error of the stated release as a cause: it is there at first, and does not grow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace

import numpy as np

from sassgis.gap.causes.cause import (
    Cause,
    CausePart,
    ParameterDraws,
    Scores,
    Trace,
    Unseen,
    base_size,
    known_mean,
    station_offsets,
    usual_offset,
    usual_scatter,
    wrong_on_one,
)
from sassgis.gap.constants import (
    AT_ONCE_S,
    CAME_DOWN_SHARE,
    COMPARISON_SHIFT,
    EXCEEDED,
    FINGERPRINT_ROCKS,
    FIRST_S,
    FIRST_SLOPE_M,
    GRAVITY_MPS2,
    LATE_SHARE,
    MEDIAN_OF_NORMAL,
    SIGMAS,
    START_AHEAD_M,
    STATED_START_M,
)
from sassgis.gap.forward.released_rocks import ReleaseError
from sassgis.gap.observations.case import Case, errors_of
from sassgis.gap.observations.observed import above_release_m
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import per_rock
from sassgis.grid import IntArray


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    wrong = [draws.share(f"release.{what}") < 0.7 for what in ("ahead", "faster", "aside")]
    if not any(wrong):
        wrong[int(draws.share("release.one") * 3)] = True
    release = ReleaseError(
        ahead_m=draws.uniform("release.ahead_m", -START_AHEAD_M, START_AHEAD_M)
        if wrong[0]
        else 0.0,
        faster_mps=draws.log("release.faster_mps", 0.5, 12.0) if wrong[1] else 0.0,
        shift_m=draws.normal("release.shift_m", 4.0) if wrong[2] else 0.0,
        scatter_m=draws.log("release.scatter_m", 0.3, 12.0) if wrong[2] else 0.0,
    )
    return CausePart("offset and speed", lambda m: replace(m, release=release), asdict(release))


def _position_error(case: Case, paths: Mapping[int, IntArray]) -> float:
    """Return the standard error of a coordinate (m), as stated or, if more, as paths scatter.

    Third differences of a flight are those of only the errors, with variance 20 σ².
    """
    track = case.observations.trajectories
    jumps = [np.abs(np.diff(getattr(track, c)[rows], n=3)) for rows in paths.values() for c in "xy"]
    seen = np.concatenate([np.empty(0), *jumps])
    found = float(np.median(seen)) / (MEDIAN_OF_NORMAL * math.sqrt(20.0)) if seen.size else 0.0
    return max(found, errors_of(case).position_m)


def _first_point(case: Case, residuals: ResidualTable) -> Scores:
    """Compare the first place of a rock with its stated place of release."""
    rocks, track = case.observations.rocks, case.observations.trajectories
    names = case.observations.rock_names
    place = {name: i for i, name in enumerate(rocks.rock_id.tolist())}
    off = np.full(case.n_rocks, np.nan)
    paths = case.observations.paths_of_rocks()
    at_once = {rock for rock, rows in paths.items() if track.t_s[rows[0]] < AT_ONCE_S}
    has_own_clock = len(at_once) < FINGERPRINT_ROCKS
    for rock, rows in paths.items():
        i = place.get(names[rock])
        if i is not None and (has_own_clock or rock in at_once):
            off[rock] = math.hypot(
                float(track.x[rows[0]] - rocks.x[i]), float(track.y[rows[0]] - rocks.y[i])
            )
    error = _position_error(case, paths)
    usual = EXCEEDED * error * math.sqrt(0.5 * math.pi) + STATED_START_M
    # One whose film begins below the start, with a separate clock, says nothing.
    slope = _first_slope(case)
    far = np.flatnonzero(off > usual).tolist()
    late = [rock for rock in far if _came_down(case, paths[rock], slope * off[rock], error)]
    off[late] = np.nan
    if has_own_clock and len(late) > LATE_SHARE * len(far):
        # Nor do slow ones of a film that begins below the start for many.
        raise Unseen
    if np.isfinite(off).sum() < FINGERPRINT_ROCKS:
        raise Unseen
    return Scores(off - usual, float(np.nanmean(off)))


def _came_down(case: Case, rows: IntArray, fell_m: float, error_m: float) -> bool:
    """Return whether a rock has more than a tenth of the energy of a fall where its path begins."""
    track = case.observations.trajectories
    first = rows[0]
    last = rows[track.t_s[rows] <= track.t_s[first] + FIRST_S][-1]
    time = float(track.t_s[last] - track.t_s[first])
    if time <= 0.0:
        return False
    way = math.hypot(*(float(getattr(track, c)[last] - getattr(track, c)[first]) for c in "xy"))
    drawn = SIGMAS * math.sqrt(2.0) * error_m / time
    return bool((way / time) ** 2 > drawn**2 + 2.0 * GRAVITY_MPS2 * CAME_DOWN_SHARE * fell_m)


def _first_slope(case: Case) -> float:
    """Return fall over plan length below the starts, mean of the fall lines."""
    found = []
    for line in np.unique(case.line[case.line >= 0]).tolist():
        s, z = case.profiles.vertices(line)
        near = s <= s[0] + FIRST_SLOPE_M
        found.append((z[near][0] - z[near][-1]) / max(float(s[near][-1] - s[near][0]), 1e-9))
    return max(float(np.mean(found)), 0.0) if found else 0.0


def _first_contact(case: Case, residuals: ResidualTable) -> Scores:
    """Find where a rock first touches the ground, up or down the slope from the model's.

    Farther down than the model's second contact the first one may be missing in the table; between
    the stated start and the model's first contact another law of the contact may make one.
    """
    rows = residuals.steps.of("start", "chainage_m")
    if len(rows) < FINGERPRINT_ROCKS:
        raise Unseen
    off = rows.observed - rows.predicted
    middle = float(np.median(off))
    if middle > 0.0:
        missed = np.isfinite(rows.way_m) & (rows.observed > rows.way_m)
        if 2.0 * missed.mean() > 1.0:
            raise Unseen
    else:
        off = np.minimum(rows.observed - case.start[rows.rock, 0], 0.0)
        middle = float(np.median(off))
    # Films that begin late miss the first contacts of some: they do not shift the others.
    near = usual_scatter(off)
    kept = math.copysign(1.0, middle) * np.clip(off, middle - near, middle + near)
    scores = kept - EXCEEDED * rows.sd - STATED_START_M
    return Scores(per_rock(scores, rows.rock, case.n_rocks), middle)


def _contact_above_start(case: Case, residuals: ResidualTable) -> Scores:
    """Measure how far above its stated start a rock touched the ground at the highest."""
    over = above_release_m(case.observations, case.grid)
    rock = case.observations.rock_of("impacts")
    highest = np.full(case.n_rocks, -np.inf)
    own = (rock >= 0) & np.isfinite(over)
    np.maximum.at(highest, rock[own], over[own])
    highest[~np.isfinite(highest)] = np.nan
    if np.isfinite(highest).sum() < FINGERPRINT_ROCKS:
        raise Unseen
    errors = errors_of(case)
    usual = EXCEEDED * math.hypot(errors.position_m, errors.height_m) + 2.0 * STATED_START_M
    # Films that begin below the start of some rocks say nothing of the others.
    return Scores(np.maximum(highest, 0.0) - usual, float(np.nanmean(highest)))


def _offset_that_stays(case: Case, residuals: ResidualTable) -> Scores:
    at = station_offsets(case, residuals)
    growth = np.abs(at[:, 1] - at[:, 0])
    made = usual_offset(case) + base_size(residuals.run.at.lateral_m[:, :, 0])
    return Scores(np.abs(at[:, 0]) - np.maximum(growth, made), known_mean(np.abs(at[:, 0])))


def _first_reach(case: Case, residuals: ResidualTable) -> Scores:
    wrong = wrong_on_one(residuals).get(case.reaches[0])
    if wrong is None:
        raise Unseen
    return Scores(wrong - COMPARISON_SHIFT, float(np.nanmean(wrong)))


CAUSE = Cause(
    "release_error",
    number=8,
    group="start",
    phase="release",
    label="error of the release",
    summary="an error in the stated place or speed of the release",
    draw=_draw,
    statistics=(
        Trace(
            "first point of the path against the stated start",
            _first_point,
            ("rocks", "trajectories"),
            clear=True,
        ),
        Trace(
            "contact above the stated start", _contact_above_start, ("rocks", "impacts"), clear=True
        ),
        # Not clear: a camera that sees the slope from below the start on makes the same.
        Trace(
            "first contact up or down the slope from where the model has it",
            _first_contact,
            ("impacts",),
        ),
        Trace(
            "offset at the first station, not growing to the second",
            _offset_that_stays,
            ("passages", "stations"),
            clear=True,
        ),
        Trace(
            "speed on the first reach, right on the others", _first_reach, ("passages", "stations")
        ),
    ),
    place=lambda case, models: case.reaches[:1],
)
