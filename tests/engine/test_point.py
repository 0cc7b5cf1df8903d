"""Mass points, the first model of Bozzolo and Pamini (1986), against closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers.engine_lab import FLIGHT, HAZARD, IMPACT, SLIDING, G, ellipsoid, plain, run, slope

from sassgis.engine.simulate import moving_axes
from sassgis.errors import ConfigError
from sassgis.settings.settings import EngineSettings

pytestmark = pytest.mark.kernels

POINT = dataclasses.replace(HAZARD, block="point", slope_variation="off")
#: Ground without a resistance that grows with the speed, and without ploughing.
BARE = plain(mu_f=0.6, eta_max=1.0, restitution=0.5, restitution_speed_mps=1e6, mu_v=0.0)


def test_a_point_slides_down_as_friction_says() -> None:
    angle, mu = math.radians(45.0), 0.6
    result = run(
        slope((60.0, 45.0), (5.0, 0.0)), BARE, ellipsoid(), settings=POINT, n=5, log_events=200
    )
    for log in result.event_logs:
        assert log["phase"][0] == SLIDING and np.abs(log["omega_radps"]).max() < 1e-6
        end = log[1]
        way = math.hypot(end["x_m"] - log["x_m"][0], end["z_m"] - log["z_m"][0])
        speed2 = 2.0 * G * way * (math.sin(angle) - mu * math.cos(angle))
        assert end["vx_mps"] ** 2 + end["vz_mps"] ** 2 == pytest.approx(speed2, rel=1e-9)


def test_a_point_rebounds_with_restitution_and_friction_and_gets_no_spin() -> None:
    drop, e, mu, level = 5.0, 0.5, 0.6, 12.0
    thrown = ellipsoid(speed_mps=(level, level), drop_m=(drop, drop))
    result = run(slope((200.0, 0.01)), BARE, thrown, settings=POINT, n=5, log_events=200)
    for log in result.event_logs:
        first = int(np.flatnonzero(log["phase"] == IMPACT)[0])
        before, after = log[first], log[first + 1]
        assert after["phase"] == FLIGHT
        assert after["vz_mps"] == pytest.approx(-e * before["vz_mps"], rel=5e-3)
        lost = mu * (1.0 + e) * -before["vz_mps"]
        assert before["vx_mps"] - after["vx_mps"] == pytest.approx(lost, rel=5e-3)
        assert np.abs(log["omega_radps"]).max() < 1e-6
    # The shape of a block does not matter, its volume only where it touches.
    round_, flat = (
        run(slope((60.0, 40.0), (60.0, 5.0)), BARE, own, settings=POINT, n=5).rocks["runout_m"]
        for own in (ellipsoid(0.4, 0.4, 0.4, drop_m=(2.0, 2.0)),
                    ellipsoid(0.8, 0.4, 0.2, drop_m=(2.0, 2.0)))
    )  # fmt: skip
    assert round_ == pytest.approx(flat, abs=1.0)


def test_a_point_needs_a_law_of_impact_that_leaves_it_a_speed() -> None:
    with pytest.raises(ConfigError, match="mass point"):
        EngineSettings(block="point", readings="1986")
    assert EngineSettings(block="point", readings="1986", eta_max_rule="coulomb")


def test_heights_of_a_point_are_counted_from_its_sphere() -> None:
    moving = moving_axes(np.array([[0.8, 0.4, 0.2]]), EngineSettings(block="point"))
    assert moving == pytest.approx(np.full((1, 3), 0.4))
