"""Sudden losses on flights: what a stem takes, and what a contact or air does not look like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import observed

from sassgis.gap.observations.case import Case
from sassgis.gap.residuals import flights
from sassgis.gap.residuals.flights import sudden_losses

G = 9.81


@pytest.fixture(scope="module")
def case() -> Case:
    seen = observed(12, 3)
    return replace(seen, engine=replace(seen.engine, gravity_mps2=G))


def flight(kept: float, upward: float = 0.0, height: float = 8.0, drag: float = 0.0) -> object:
    """A parabola that keeps a share of its horizontal speed at the middle and is thrown up."""
    t = np.linspace(0.0, 1.6, 33)
    after = t >= 0.8
    ahead = np.where(after, kept, 1.0) * 14.0 * np.exp(-drag * t)
    up = 2.0 - G * t + np.where(after, upward, 0.0)
    z = 500.0 + 2.0 * t - 0.5 * G * t**2 + upward * np.maximum(t - 0.8, 0.0)
    x = np.cumsum(ahead) * (t[1] - t[0])
    speed = np.hypot(ahead, up) * (1.0 + 0.02 * np.sin(40.0 * t))
    return flights._Path(0, t, x, 0.0 * t, z, x, np.full(t.size, height), speed, 0.0 * t)


def loss(case: Case, path: object) -> tuple[float, float, float] | None:
    return flights._sudden_loss(case, path, slice(0, 33))  # type: ignore[arg-type]


def test_a_stem_takes_energy_at_one_point(case: Case) -> None:
    found = loss(case, flight(0.5))
    assert found is not None
    before, after, sd = found
    assert before - after == pytest.approx(0.5 * 14.0**2 * (1.0 - 0.5**2), rel=0.15)
    assert (before - after) / sd > 5.0


def test_air_contacts_and_low_flights_are_no_stems(case: Case) -> None:
    for path in (flight(1.0), flight(1.0, drag=0.15)):
        found = loss(case, path)
        assert found is not None and (found[0] - found[1]) / found[2] < 3.0
    # A contact that nobody noted throws the rock up.
    assert loss(case, flight(0.5, upward=4.0)) is None
    assert loss(case, flight(0.5, height=0.8)) is None


def test_every_flight_of_a_case_has_one_row_at_most(case: Case) -> None:
    axes = np.repeat(case.semi_axes_m[:, None, :], 2, axis=1)
    rock, before, after, sd = sudden_losses(case, axes)
    assert rock.size == before.size == after.size == sd.size > 0
    assert (sd > 0.0).all() and ((before - after) / sd < 6.0).mean() > 0.97
    nothing = case.observations.trajectories.take(
        np.zeros(len(case.observations.trajectories), bool)
    )
    blind = replace(case, observations=replace(case.observations, trajectories=nothing))
    assert sudden_losses(blind, axes)[0].size == 0


def test_a_path_that_met_the_ground_between_two_noted_contacts_is_no_flight() -> None:
    rng = np.random.default_rng(5)
    t, error = np.arange(0.0, 1.6, 0.05), 0.1
    parabola = 500.0 + 2.0 * t - 0.5 * G * t**2

    def touched(z: np.ndarray) -> float:
        noise = error * rng.standard_normal((200, t.size))
        return float(np.mean([flights._touched(t, z + own, error, G) for own in noise]))

    assert touched(parabola) < 0.01
    # A stem takes upward speed, and air bends a path without a kink.
    assert touched(parabola - 3.0 * np.maximum(t - 0.6, 0.0)) < 0.1
    assert touched(parabola + 0.05 * t**3) < 0.02
    # A light contact throws it up; what rolls or slides does not fall.
    assert touched(parabola + 4.0 * np.maximum(t - 0.8, 0.0)) > 0.95
    assert touched(500.0 - 6.0 * t) > 0.99
    # Stated errors of half the true ones make few flights seem touched.
    noise = error * rng.standard_normal((200, t.size))
    half = [flights._touched(t, parabola + own, 0.5 * error, G) for own in noise]
    assert np.mean(half) < 0.05
