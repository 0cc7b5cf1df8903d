"""A simulated campaign in the place of what was observed."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers.simulated_slope import BASE

from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.engine.state import EVENT_DTYPE, FLIGHT
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.forward.campaign_case import with_campaign
from sassgis.gap.forward.observation_operator import TABLES, campaigns, film
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.observations.case import LOOSE, PIECE, Campaign, observed_campaign
from sassgis.settings.blocks import EffectSettings


def campaign(problem: SiteData, model: HypothesisModel = BASE) -> Campaign:
    tables = TABLES | {"trajectories"}
    lines = problem.rock_lines
    (made,) = campaigns(problem.case, lines, model, count=1, seed=2, tables=tables, everywhere=True)
    return made


def test_a_campaign_is_read_back_as_it_was_made(problem: SiteData) -> None:
    made = campaign(problem)
    seen = observed_campaign(with_campaign(problem.case, made))
    for name in ("passages", "deposits", "impacts"):
        one, other = getattr(made, name), getattr(seen, name)
        for column in {f.name for f in fields(one)} - {"x", "y", "lateral_m", "turn_deg"}:
            np.testing.assert_allclose(getattr(other, column), getattr(one, column), err_msg=name)


def test_pieces_belong_to_their_rock_and_others_to_none(problem: SiteData) -> None:
    effects = EffectSettings(
        Fragmentation(energy_jkg=5.0, smallest_m3=1e-3), Entrainment(number=0.5, classes=())
    )
    made = campaign(problem, replace(BASE, effects=effects)).deposits
    assert made is not None and {PIECE, LOOSE} <= set(made.kind.tolist())
    case = with_campaign(problem.case, campaign(problem, replace(BASE, effects=effects)))
    seen = observed_campaign(case).deposits
    assert seen is not None
    np.testing.assert_array_equal(seen.kind, made.kind)
    np.testing.assert_array_equal(seen.rock, made.rock)


def test_paths_end_where_rocks_stop_and_impacts_lie_on_them(problem: SiteData) -> None:
    case = with_campaign(problem.case, campaign(problem))
    put, track = case.projected["trajectories"], case.observations.trajectories
    stops = observed_campaign(case).deposits
    hits, hit_by = case.observations.impacts, case.observations.rock_of("impacts")
    assert stops is not None
    for rock, rows in case.observations.paths_of_rocks().items():
        # With errors of places of 0.25 m.
        assert put.s[rows[-1]] == pytest.approx(stops.s[stops.rock == rock][0], abs=2.0)
        for x, y in zip(hits.x[hit_by == rock], hits.y[hit_by == rock], strict=True):
            assert np.hypot(track.x[rows] - x, track.y[rows] - y).min() < 2.5


def test_a_film_of_a_flight_is_its_parabola() -> None:
    log = np.zeros(2, EVENT_DTYPE)
    log["phase"], log["vx_mps"], log["t_s"] = FLIGHT, 6.0, (0.0, 1.5)
    log["x_m"], log["vz_mps"] = 6.0 * log["t_s"], 4.0 - 9.81 * log["t_s"]
    log["z_m"] = 4.0 * log["t_s"] - 4.905 * log["t_s"] ** 2
    log["omega_radps"] = 2.0 * np.pi * 3.0
    t, x, y, z, speed, turns = film(log, 0.8 * log["x_m"], 0.6 * log["x_m"], 0.25)
    np.testing.assert_allclose(t, np.arange(0.0, 1.5, 0.25))
    np.testing.assert_allclose(np.hypot(x, y), 6.0 * t, atol=1e-9)
    np.testing.assert_allclose(z, 4.0 * t - 4.905 * t**2, atol=1e-9)
    np.testing.assert_allclose(speed, np.hypot(6.0, 4.0 - 9.81 * t))
    np.testing.assert_allclose(turns, 3.0)
