"""The readings for hazard work: rolling, tipping, corners, the start, and what they replace."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import engine_lab as lab

from sassgis.engine.ellipse import inertia, mean_radius
from sassgis.engine.simulate import moving_axes
from sassgis.errors import ConfigError
from sassgis.settings.settings import EngineSettings

G = 9.81


def share_of_way(out, phase):
    """Share of the way of all rocks in one phase."""
    in_phase, whole = 0.0, 0.0
    for log in out.event_logs:
        way = np.abs(np.diff(log["x_m"]))
        whole += way.sum()
        in_phase += way[log["phase"][:-1] == phase].sum()
    return in_phase / whole


def test_the_sets_and_what_is_given():
    assert EngineSettings().readings == "hazard"
    paper = EngineSettings(readings="1986").resolved()
    assert (paper.eta_max_rule, paper.rolling, paper.rolling_threshold) == ("scale", "round", 0.1)
    assert (paper.tipping, paper.corner) == (False, "ellipse")
    own = EngineSettings(rolling="round", rolling_threshold=0.2).resolved()
    assert (own.eta_max_rule, own.rolling, own.rolling_threshold) == ("restitution", "round", 0.2)
    assert own.resolved() == own
    with pytest.raises(ConfigError, match="readings"):
        EngineSettings(readings="1987")  # type: ignore[arg-type]


def test_the_paper_does_not_know_the_new_columns():
    line = lab.rough(4)
    plain = lab.run(line, lab.DEBRIS, lab.MIXED, n=60)
    other = dataclasses.replace(
        lab.DEBRIS, restitution=0.9, restitution_speed_mps=1e3, rolling_threshold=2.0
    )
    assert lab.run(line, other, lab.MIXED, n=60).rocks.tobytes() == plain.rocks.tobytes()


def test_the_threshold_is_that_of_the_class_unless_it_is_given():
    line = lab.rough(4)

    def rocks(column, **key):
        own = dataclasses.replace(
            lab.plain(eta_max=0.85), restitution=0.5, rolling_threshold=column
        )
        settings = dataclasses.replace(lab.HAZARD, **key)
        dropped = dataclasses.replace(lab.MIXED, drop_m=(0.5, 0.5))
        return lab.run(line, own, dropped, n=60, settings=settings).rocks.tobytes()

    assert rocks(0.5) != rocks(0.1)
    assert rocks(0.5) == rocks(0.1, rolling_threshold=0.5)


def test_a_rock_at_rest_on_steep_debris_does_not_slide_all_the_way():
    line = lab.slope((150, 40), (100, 0))
    slides = lab.run(line, lab.DEBRIS, lab.MIXED, n=60, log_events=4000)
    assert share_of_way(slides, lab.SLIDING) > 0.9
    settings = dataclasses.replace(lab.HAZARD, rolling_friction_sd=0.0)
    tips = lab.run(line, lab.DEBRIS, lab.MIXED, n=60, log_events=4000, settings=settings)
    # What slides then are rocks too flat to tip.
    round_ones = [
        log
        for log, rock in zip(tips.event_logs, tips.rocks, strict=True)
        if 0.8 * 2 * rock["a_m"] * rock["b_m"] > rock["a_m"] ** 2 - rock["b_m"] ** 2
    ]
    assert len(round_ones) > 50
    assert all((log["phase"][0] == lab.ROLLING) for log in round_ones)


@pytest.mark.parametrize(("b", "rolls"), [(0.38, True), (0.25, False)])
def test_which_ellipse_tips(b, rolls):
    # (a² − b²)/(2 a b): 0.278 and 0.75 for a = 0.5, against μ_f = 0.6.
    own = lab.plain(mu_f=0.6, mu_0=0.5)
    blocks = lab.ellipsoid(0.5, b, 0.2, orientation_rad=(0.0, 0.0), speed_mps=(6.0, 6.0))
    out = lab.run(lab.slope((60, 0)), own, blocks, settings=lab.HAZARD, log_events=40, start=5.0)
    log = out.event_logs[0]
    assert log["phase"][0] == (lab.ROLLING if rolls else lab.SLIDING)
    if rolls:
        # Angular momentum about the ground is kept, then the centre is lifted from b to r.
        r = mean_radius(0.5, b)
        share = 1.0 + inertia(0.5, b) / r**2
        speed = math.sqrt(2.0 / share * (0.5 * 36.0 / share - G * (r - b)))
        assert math.hypot(log["vx_mps"][0], log["vz_mps"][0]) == pytest.approx(speed, rel=1e-12)


def test_a_slow_rock_does_not_tip():
    # Its energy does not lift it over its longer axis, and the ground is too flat for rolling.
    blocks = lab.ellipsoid(0.5, 0.38, 0.3, orientation_rad=(0.0, 0.0), speed_mps=(1.0, 1.0))
    out = lab.run(
        lab.slope((60, 0)), lab.plain(), blocks, settings=lab.HAZARD, log_events=40,
        start=5.0,
    )  # fmt: skip
    assert set(out.event_logs[0]["phase"][:-1]) == {lab.SLIDING}
    assert out.rocks["runout_m"][0] - 5.0 == pytest.approx(1.0 / (2 * G * 0.8), rel=1e-9)


def on_a_steep_slope(mu_0):
    """The log of a rock that begins to slide where tan β > μ_f."""
    own = lab.plain(mu_f=0.5, mu_0=mu_0)
    blocks = lab.ellipsoid(0.5, 0.38, 0.3, orientation_rad=(0.0, 0.0), speed_mps=(0.1, 0.1))
    line = lab.slope((60, 35), (5, 0))
    return lab.run(line, own, blocks, settings=lab.HAZARD, log_events=40, start=5.0).event_logs[0]


def test_a_sliding_rock_tips_once_it_is_fast_enough():
    log = on_a_steep_slope(0.3)
    first = int(np.flatnonzero(log["phase"] == lab.ROLLING)[0])
    assert first > 0
    r = mean_radius(0.5, 0.38)
    share = 1.0 + inertia(0.5, 0.38) / r**2
    steep = math.radians(35)
    needed = G * math.cos(steep) * (r - 0.38) * share - 0.5 * 0.1**2
    along = (log["x_m"][first] - log["x_m"][0]) / math.cos(steep)
    pull = G * (math.sin(steep) - 0.5 * math.cos(steep))
    # The centre of a rock that tips is lifted along the normal.
    assert along == pytest.approx(needed / pull + (r - 0.38) * math.tan(steep), abs=0.01)


def test_a_rock_that_rolling_would_stop_slides_on():
    # tan β lies between μ_f and μ_r.
    log = on_a_steep_slope(0.9)
    on_slope = log[log["x_m"] < 60.0]
    assert set(on_slope["phase"]) == {lab.SLIDING}
    speed2 = on_slope["vx_mps"][-1] ** 2 + on_slope["vz_mps"][-1] ** 2
    steep = math.radians(35)
    along = (on_slope["x_m"][-1] - log["x_m"][0]) / math.cos(steep)
    pull = G * (math.sin(steep) - 0.5 * math.cos(steep))
    assert speed2 == pytest.approx(0.1**2 + 2.0 * pull * along, rel=1e-9)


@pytest.mark.parametrize("turn", [2.0, 4.0, 8.0])
def test_a_rolling_rock_loses_once_at_a_concave_corner(turn):
    own = lab.plain(eta_max=0.35, mu_0=0.4, dp_min=0.1, dp_max=0.4)
    blocks = lab.ellipsoid(0.5, 0.4, 0.3, speed_mps=(0.0, 0.0))
    line = lab.slope((60, 35), (60, 35 - turn), (200, 0))
    settings = dataclasses.replace(
        lab.HAZARD, rolling="round", rolling_threshold=0.0, rolling_friction_sd=0.0
    )
    out = lab.run(line, own, blocks, n=40, settings=settings, log_events=400, start=(5.0, 30.0))
    r = mean_radius(0.5, 0.4)
    for log in out.event_logs:
        at = np.flatnonzero((abs(log["x_m"] - 60.0) < 1.0) & (log["phase"] == lab.IMPACT))
        assert at.size == 1
        i = at[0]
        assert log["phase"][i - 1] == log["phase"][i + 1] == lab.ROLLING
        before, after = (
            0.5 * (log["vx_mps"][j] ** 2 + log["vz_mps"][j] ** 2)
            + 0.5 * inertia(0.5, 0.4) * log["omega_radps"][j] ** 2
            for j in (i, i + 1)
        )
        # As going round: μ_r v per radian; the turn of a circle itself loses (1 − cos)-like terms.
        delta = math.radians(turn)
        lost = 2.0 * 0.4 * math.sin(delta) * math.cos(delta)
        assert after / before == pytest.approx(1.0 - lost, abs=0.01)
        assert abs(log["z_m"][i + 1] - log["z_m"][i]) < 0.01 * r


def test_many_small_corners_cost_what_few_large_ones_do():
    """A concave arc of 35 degrees in 5 or 20 corners: the speed at its end hardly differs."""
    own = lab.plain(eta_max=0.35, mu_0=0.4)
    ends = []
    for n in (5, 20, 60):
        arc = [(20.0 / n, 35.0 - 35.0 * (i + 0.5) / n) for i in range(n)]
        line = lab.slope((60, 35), *arc, (200, 0))
        settings = dataclasses.replace(lab.HAZARD, rolling="round")
        out = lab.run(line, own, lab.sphere(0.4), n=20, settings=settings, start=5.0)
        ends.append(float(np.median(out.rocks["runout_m"])) - 80.0)
    assert max(ends) < 1.15 * min(ends)


def test_rolling_friction_differs_from_block_to_block():
    """On a level the way to rest is v²/(2 g μ), log-normal about that of the class."""
    own = lab.plain(mu_0=0.4, k=0.0)
    blocks = lab.sphere(0.4, speed_mps=(6.0, 6.0), spin_radps=(15.0, 15.0))
    settings = dataclasses.replace(lab.HAZARD, rolling="round", end_sliding=False)
    assert settings.resolved().rolling_friction_sd == 0.25
    out = lab.run(lab.slope((100, 0)), own, blocks, n=2000, settings=settings, start=5.0)
    ways = np.log((out.rocks["runout_m"] - 5.0) / (36.0 / (2.0 * G * 0.4)))
    assert np.mean(ways) == pytest.approx(0.0, abs=0.02)
    assert np.std(ways) == pytest.approx(0.25, rel=0.06)
    paper = lab.run(lab.slope((100, 0)), own, blocks, n=50, start=5.0)
    assert np.ptp(paper.rocks["runout_m"]) < 1e-12


@pytest.mark.parametrize("drop", [0.0, 0.05, 0.4])
def test_hops_cost_what_rolling_costs(drop):
    """A sphere that hops with 1 − η_max = μ_r (1 + I/r²): each impulse J takes μ_r J, as rolling.

    The impulse at the centre takes 1.4 μ_r J, and friction at P shares the loss with the spin.
    """
    own = dataclasses.replace(
        lab.plain(eta_max=0.3, mu_0=0.5), restitution=0.5, restitution_speed_mps=1e6
    )
    blocks = lab.sphere(0.5, speed_mps=(12.0, 12.0), spin_radps=(24.0, 24.0), drop_m=(drop, drop))
    settings = dataclasses.replace(lab.HAZARD, rolling_friction_sd=0.0)
    out = lab.run(lab.slope((100, 0)), own, blocks, settings=settings, start=5.0)
    fall = math.sqrt(2.0 * G * drop)
    v, way = 12.0, 12.0 * fall / G
    while fall**2 > 2.0 * G * 0.1 * 0.5:
        v -= 0.5 * 1.5 * fall
        fall *= 0.5
        way += v * 2.0 * fall / G
    v -= 0.5 * fall
    way += v**2 / (2.0 * 0.5 * G)
    assert out.rocks["runout_m"][0] - 5.0 == pytest.approx(way, rel=0.03)


@pytest.mark.parametrize(("longer", "ratio"), [(0.5, 1.1), (1.0, 1.4)])
def test_outline_in_the_plane_of_motion(longer, ratio):
    """A block moves as the ellipse of the stated ratio, of the same area and mass."""
    settings = dataclasses.replace(lab.HAZARD, outline_edges=0.1, outline_share=0.3)
    root = np.sqrt(0.5 * longer)
    slope, own = lab.slope((80, 38), (100, 10)), lab.plain()
    outlined = lab.ellipsoid(longer, 0.5, 0.3, drop_m=(0.5, 0.5), orientation_rad=(0.3, 0.3))
    stated = lab.ellipsoid(
        root * np.sqrt(ratio), root / np.sqrt(ratio), 0.3,
        drop_m=(0.5, 0.5), orientation_rad=(0.3, 0.3),
    )  # fmt: skip
    one = lab.run(slope, own, outlined, n=20, settings=settings, start=5.0, log_events=9)
    two = lab.run(slope, own, stated, n=20, settings=lab.HAZARD, start=5.0, log_events=9)
    for a, b in zip(one.event_logs, two.event_logs, strict=True):
        # Later contacts differ by what rounding makes of the earlier ones.
        np.testing.assert_allclose(a["z_m"][:4], b["z_m"][:4], rtol=1e-9)
    np.testing.assert_allclose(one.rocks["mass_kg"], two.rocks["mass_kg"], rtol=1e-12)


def test_paper_moves_the_ellipse_of_the_two_longer_axes():
    paper = dataclasses.replace(lab.PAPER, outline_edges=0.0, outline_share=1.0)
    assert lab.PAPER.resolved() == paper.resolved()


def test_heights_are_counted_from_the_axes_as_which_a_block_moves():
    stated = np.array([[[0.5, 0.5, 0.3]], [[1.0, 0.5, 0.3]]])
    settings = dataclasses.replace(lab.HAZARD, outline_edges=0.1, outline_share=0.3)
    moving = moving_axes(stated, settings)
    np.testing.assert_allclose(moving[..., 0] / moving[..., 1], [[1.1], [1.4]], rtol=1e-12)
    np.testing.assert_allclose(moving[..., :2].prod(-1), stated[..., :2].prod(-1), rtol=1e-12)
    assert np.array_equal(moving[..., 2], stated[..., 2])
    assert np.array_equal(moving_axes(stated, lab.PAPER), stated)
