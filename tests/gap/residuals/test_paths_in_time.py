"""Paths in time: what a stem and what air does to them, and what contacts do not look like."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import observed, with_metadata, with_observed

from sassgis.gap.observations.case import Case, errors_of
from sassgis.gap.residuals import flights
from sassgis.gap.residuals.flights import air_of_flights, struck_above_ground

G = 9.81


@pytest.fixture(scope="module")
def case() -> Case:
    seen = with_metadata(observed(12, 3), position_error_m=0.25)
    return replace(seen, engine=replace(seen.engine, gravity_mps2=G))


def axes_of(case: Case) -> np.ndarray:
    """As two draws of the model have them."""
    return np.repeat(case.semi_axes_m[:, None, :], 2, axis=1)


def path(case: Case, kept: float, push: float = 0.0, height: float = 3.0) -> flights.TimedPath:
    """A rock that keeps a share of its level speed after 0.8 s, where the ground pushes it (m/s).

    The ground takes along it as much as it pushes away from it.
    """
    t = np.arange(0.0, 1.65, 0.05)
    s = 30.0 + np.linspace(0.0, 20.0, t.size)
    _, dip = case.ground_at(np.zeros(t.size, np.int64), s)
    c, sine = math.cos(dip[16]), math.sin(dip[16])
    late = np.maximum(t - 0.8, 0.0)
    ahead = 14.0 * t - (14.0 * (1.0 - kept) + push * (c - sine)) * late
    z = 500.0 - 2.0 * t - 0.5 * G * t**2 + push * (c + sine) * late
    noise = 0.05 * np.random.default_rng(3).standard_normal((3, t.size))
    x, y, z = ahead + noise[0], noise[1], z + noise[2]
    return flights.TimedPath(
        0, t, x, y, z, s, np.full(t.size, height), np.full(t.size, 14.0), np.zeros(t.size)
    )


def surest(case: Case, one: flights.TimedPath) -> tuple[float, float]:
    """Share of the speed that is lost beyond what the ground can take, and that in deviations."""
    found = flights.surest_loss(case, one)
    assert found is not None
    s, before, after, sd = found
    assert one.s[0] < s < one.s[-1]
    return (before - after) / before, (before - after) / sd


def test_a_stem_takes_speed_at_one_point(case: Case) -> None:
    share, sure = surest(case, path(case, 0.4))
    assert 0.3 < share < 0.7 and sure > 8.0


def test_free_paths_contacts_and_what_is_near_the_ground_are_no_stems(case: Case) -> None:
    assert surest(case, path(case, 1.0))[1] < 4.0
    # Friction of one on the ground takes as much as the ground pushes.
    for push in (1.0, 3.0, 6.0):
        assert surest(case, path(case, 1.0, push))[1] < 4.0
    assert flights.surest_loss(case, path(case, 0.4, height=0.3)) is None


def test_rocks_without_trees_lose_nothing_above_the_ground(case: Case) -> None:
    axes = axes_of(case)
    rock, s, before, after, sd = struck_above_ground(case, axes)
    assert rock.size == s.size == before.size == after.size == sd.size > 0
    assert np.unique(rock).size == rock.size and (sd > 0.0).all()
    assert not (((before - after) / sd > 5.0) & (after < 0.7 * before)).any()
    blind = with_observed(case, trajectories=case.observations.trajectories.take([]))
    assert struck_above_ground(blind, axes)[0].size == 0
    assert air_of_flights(blind, axes)[0].size == 0


def drag_of(values: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """Weighted mean and its standard error."""
    weight = 1.0 / sd**2
    return float((values * weight).sum() / weight.sum()), float(1.0 / np.sqrt(weight.sum()))


def test_flights_without_air_keep_their_level_velocity(case: Case) -> None:
    axes = axes_of(case)
    air = air_of_flights(case, axes)
    # Shorter ones may have met the ground without a trace.
    lasting = [
        one.rock
        for one, bounds, noted in flights.bounded_paths(case, flights.rolling_radius(axes))
        for own in flights.flights_of(case, one, bounds, noted)
        if np.ptp(one.t[own]) > 0.99
    ]
    assert air.rock.tolist() == lasting and len(lasting) > 10 and (air.speed2 > 0.0).all()
    # The rows state the errors of measurement that were put on the paths, or more.
    for pull, sd in ((air.ahead, air.ahead_sd), (air.across, air.across_sd)):
        assert np.sqrt(np.mean((pull / sd) ** 2)) < 1.3
        mean, error = drag_of(pull, sd)
        assert abs(mean) < 4.0 * error
    # Speeds say more than places do, of flights of a second or so.
    assert np.median(air.ahead_sd) < 0.7 * np.median(air.across_sd)


def slowed(case: Case, pull: float, *, stated: bool) -> Case:
    """The case with a constant deceleration of each flight (m/s²), between the same ends."""
    track = case.observations.trajectories
    x, y, speed = track.x.copy(), track.y.copy(), track.speed_mps.copy()
    rows_of = case.observations.paths_of_rocks(case.projected["trajectories"].height_m)
    for one, bounds, noted in flights.bounded_paths(case, flights.rolling_radius(axes_of(case))):
        for own in flights.flights_of(case, one, bounds, noted):
            rows = rows_of[one.rock][own]
            t = one.t[own]
            way = np.array([x[rows][-1] - x[rows][0], y[rows][-1] - y[rows][0]])
            level = np.hypot(*way) / (t[-1] - t[0])
            ahead = 0.5 * pull * (t - t[0]) * (t[-1] - t)
            x[rows] += ahead * way[0] / np.hypot(*way)
            y[rows] += ahead * way[1] / np.hypot(*way)
            speed[rows] *= 1.0 - pull * (t - t.mean()) / level
    speed = speed if stated else np.full(speed.size, np.nan)
    return with_observed(case, trajectories=replace(track, x=x, y=y, speed_mps=speed))


@pytest.mark.parametrize("stated", [True, False])
def test_air_takes_level_speed_on_flights(case: Case, stated: bool) -> None:
    pull, axes = 0.8, axes_of(case)
    free = air_of_flights(slowed(case, 0.0, stated=stated), axes)
    air = air_of_flights(slowed(case, pull, stated=stated), axes)
    assert air.rock.size > 0.8 * free.rock.size
    assert np.median(free.ahead) - np.median(air.ahead) == pytest.approx(pull, rel=0.15)
    assert abs(np.median(air.across)) < 0.3 * pull
    assert errors_of(case).position_m == 0.25 and (air.ahead_sd > 0.0).all()


def test_a_wrong_time_base_is_no_air(case: Case) -> None:
    """All times a tenth too long: rocks seem to fall more slowly, and to fly as straight."""
    track = case.observations.trajectories
    late = replace(track, t_s=1.1 * track.t_s, speed_mps=track.speed_mps / 1.1)
    air = air_of_flights(with_observed(case, trajectories=late), axes_of(case))
    mean, error = drag_of(air.ahead, air.ahead_sd)
    assert abs(mean) < 4.0 * error


def test_a_path_that_met_the_ground_between_two_noted_contacts_is_no_flight() -> None:
    rng = np.random.default_rng(5)
    t, error = np.arange(0.0, 1.6, 0.05), 0.1
    parabola = 500.0 + 2.0 * t - 0.5 * G * t**2

    def touched(z: np.ndarray) -> float:
        noise = error * rng.standard_normal((200, t.size))
        return float(np.mean([flights.touched_ground(t, z + own, error, G) for own in noise]))

    assert touched(parabola) < 0.01
    # A stem takes upward speed, and air bends a path without a kink.
    assert touched(parabola - 3.0 * np.maximum(t - 0.6, 0.0)) < 0.1
    assert touched(parabola + 0.05 * t**3) < 0.02
    # A light contact throws it up; what rolls or slides does not fall.
    assert touched(parabola + 4.0 * np.maximum(t - 0.8, 0.0)) > 0.95
    assert touched(500.0 - 6.0 * t) > 0.99
    # Stated errors of half the true ones make few flights seem touched.
    noise = error * rng.standard_normal((200, t.size))
    half = [flights.touched_ground(t, parabola + own, 0.5 * error, G) for own in noise]
    assert np.mean(half) < 0.05
