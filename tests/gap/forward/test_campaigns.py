"""Simulated campaigns: the observed rocks released again in a model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.simulated_slope import BASE

from sassgis.engine.effects.trees import Trees as Forest
from sassgis.gap.causes.cause import ParameterDraws
from sassgis.gap.fit.hypothesis_fit import draw
from sassgis.gap.fit.site_data import SiteData
from sassgis.gap.forward.observation_operator import campaigns, rock_quantities, share_left
from sassgis.gap.forward.released_rocks import (
    ForestStand,
    HypothesisModel,
    MeasurementError,
    ReleaseError,
)
from sassgis.gap.forward.rock_lines import dips_at, heights_at_chainage
from sassgis.gap.observations.case import LOOSE, PIECE, Campaign, main_blocks, observed_campaign
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundTable


def made(
    problem: SiteData, count: int, model: HypothesisModel = BASE, number: int = 0
) -> list[Campaign]:
    return campaigns(problem.case, problem.rock_lines, model, count=count, seed=2, number=number)


def speed(rows: list[Campaign], *stations: int) -> float:
    """Mean of the passages, at some stations or at all (m/s)."""
    passed = [r.passages for r in rows if r.passages is not None]
    own = [p.speed_mps[np.isin(p.station, stations)] if stations else p.speed_mps for p in passed]
    return float(np.mean(np.concatenate(own)))


def test_what_the_base_model_shows_is_what_it_made(problem: SiteData) -> None:
    """The field is the engine itself: its own campaigns look like it, station by station."""
    seen = rock_quantities(problem.case, observed_campaign(problem.case))
    shown = [rock_quantities(problem.case, sample) for sample in made(problem, 30)]
    for name in ("stop:runout", "S0:speed", "S1:rotation", "S0:height"):
        means = np.array([np.nanmean(one[name]) for one in shown])
        assert abs(np.nanmean(seen[name]) - means.mean()) < 4.5 * means.std(), name


def test_campaigns_are_the_same_however_they_are_asked_for(problem: SiteData) -> None:
    one, again, other = (made(problem, 2, number=number)[0].deposits for number in (7, 7, 8))
    assert one is not None and again is not None and other is not None
    np.testing.assert_array_equal(one.s, again.s)
    assert not np.array_equal(one.s, other.s)


def test_rocks_that_run_off_the_terrain_are_counted(problem: SiteData) -> None:
    smooth = GroundTable(
        tuple(replace(c, eta_max=0.95, mu_f=0.05, mu_0=0.02, k=0.0) for c in BASE.table.classes)
    )
    case, lines = problem.case, problem.rock_lines
    few, many = (share_left(case, lines, replace(BASE, table=t), 3) for t in (BASE.table, smooth))
    assert few < 0.1 and many > 0.5


def test_measurement_scales_what_is_read(problem: SiteData) -> None:
    scaled = replace(BASE, measurement=MeasurementError(scale=1.2))
    measured, plain = (speed(made(problem, 10, model)) for model in (scaled, BASE))
    assert measured == pytest.approx(1.2 * plain, rel=1e-9)


def test_release_moves_the_start(problem: SiteData) -> None:
    rows = made(problem, 10, replace(BASE, release=ReleaseError(shift_m=5.0)))
    aside = np.concatenate([r.deposits.lateral_m for r in rows if r.deposits is not None])
    assert np.mean(aside) == pytest.approx(5.0, abs=0.2)


def test_a_stand_takes_energy_only_where_it_stands(problem: SiteData) -> None:
    stand = ForestStand(46.0, 79.0, 4000.0, 50.0)
    model = replace(BASE, stand=stand, effects=EffectSettings(Forest()))
    with_trees, without = made(problem, 20, model), made(problem, 20)
    assert speed(with_trees, 0) == pytest.approx(speed(without, 0), rel=0.02)
    assert speed(with_trees, 1) < 0.5 * speed(without, 1)


def test_pieces_and_loose_blocks_keep_to_their_campaign(problem: SiteData) -> None:
    for family, kind in (("fragmentation", PIECE), ("entrainment", LOOSE)):
        names = "fragmentation.form", "fragmentation.energy_jkg", "entrainment.form"
        parameter_draws = {**dict.fromkeys(names, 0.1), "entrainment.number": 0.9}
        draws = ParameterDraws(np.random.default_rng(1), parameter_draws)
        for sample in made(problem, 3, draw(problem.case, (family,), draws).model):
            rows = sample.deposits
            assert rows is not None
            assert (rows.kind == kind).any()
            assert rows.rock.max() < sample.n_rocks
            assert ((rows.rock == -1) == (rows.kind == LOOSE)).all()
            main = main_blocks(rows, sample.n_rocks)
            assert (rows.rock[main[main >= 0]] == np.flatnonzero(main >= 0)).all()


def test_profiles_are_read_where_they_are(problem: SiteData) -> None:
    bare = problem.rock_lines.unforested
    for i in (0, 5):
        s, z = bare.vertices(i)
        at = np.linspace(s[0] + 0.5, s[-1] - 0.5, 40)
        which = np.full(at.size, i)
        np.testing.assert_allclose(heights_at_chainage(bare, which, at), np.interp(at, s, z))
        ahead = np.interp(at + 1e-6, s, z) - np.interp(at, s, z)
        np.testing.assert_allclose(np.tan(dips_at(bare, which, at)), ahead / 1e-6, atol=1e-4)
