"""Stems and viscous forests against counts and formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import engine_lab as lab
from scipy import stats
from scipy.integrate import trapezoid

from sassgis.engine.effects import trees
from sassgis.engine.effects.forms import OFF
from sassgis.engine.effects.trees import Trees, energy_ratios
from sassgis.errors import ConfigError
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.results import ControlLine, ControlLineCrossings

ANGLE = 30.0
RADIUS = 0.4
#: A sphere rolls here at constant speed: friction is the tangent of the slope.
EVEN = lab.plain(mu_0=math.tan(math.radians(ANGLE)))
LINE = lab.slope((300.0, ANGLE))
V0 = 12.0
ROLLING = lab.sphere(
    RADIUS, speed_mps=(V0, V0), spin_radps=(V0 / RADIUS, V0 / RADIUS), orientation_rad=(0.0, 0.0)
)
MASS = lab.sphere_mass(RADIUS)
ROLLING_ENERGY = 0.5 * MASS * V0**2 * 1.4
ONE_STEM = 38.7 * 30.0**2.31  # J, DBH 30 cm


def control_lines(*chainages):
    return ControlLineCrossings.same_for_all(
        [ControlLine(f"S{i}", "station") for i in range(len(chainages))], list(chainages), 1
    )


def energy_at(out, control_line):
    rows = out.passages[out.passages["control_line"] == control_line]
    return 1e3 * (rows["energy_trans_kj"] + rows["energy_rot_kj"])


def stems_met(effects, flat, stems, n=1500, chainages=(205.0,)):
    """Stems that each rolling rock has met up to each station; each takes 1e-4 of its energy."""
    out = lab.run(
        flat, EVEN, ROLLING, effects, n=n, start=5.0, control_lines=control_lines(*chainages),
        forest=lab.forest(flat, stems),
    )  # fmt: skip
    counts = [(ROLLING_ENERGY - energy_at(out, i)) / FEW for i in range(len(chainages))]
    for c in counts:
        assert c.size == n
        assert np.abs(c - np.rint(c)).max() < 1e-4
    return [np.rint(c).astype(int) for c in counts]


FEW = 1e-4 * ROLLING_ENERGY
WEAK = EffectSettings(Trees("full_stems", efficiency=FEW / ONE_STEM))


@pytest.mark.parametrize("cell", [0.5, 2.0, 50.0])
def test_stems_met_on_a_long_roll_are_poisson(cell):
    density = 0.012
    mean = density * (2.0 * RADIUS + 0.3) * 200.0
    (counts,) = stems_met(WEAK, lab.profile_set(LINE, cell=cell), density)
    top = 7
    seen = np.bincount(np.minimum(counts, top), minlength=top + 1)
    expected = stats.poisson(mean).pmf(np.arange(top))
    expected = counts.size * np.append(expected, 1.0 - expected.sum())
    assert stats.chisquare(seen, expected).pvalue > 1e-3
    assert counts.mean() == pytest.approx(mean, abs=4.0 * math.sqrt(mean / counts.size))


def test_the_same_stems_whatever_the_cells():
    fine, coarse = (
        stems_met(WEAK, lab.profile_set(LINE, cell=cell), 0.012)[0] for cell in (0.5, 50.0)
    )
    assert (fine == coarse).all()


def test_nothing_is_met_outside_the_stand():
    flat = lab.profile_set(LINE)
    middle = flat.cell_s[:-1] + 1.0
    stems = np.where((middle > 100.0) & (middle < 150.0), 0.03, 0.0)
    before, inside, after, end = stems_met(WEAK, flat, stems, chainages=(99.9, 125.0, 150.1, 250.0))
    assert (before == 0).all()
    assert (after == end).all()
    mean = 0.03 * (2.0 * RADIUS + 0.3)
    for counts, way in ((inside, 25.0), (after, 50.0)):
        assert counts.mean() == pytest.approx(mean * way, abs=4.0 * math.sqrt(mean * way / 1500))


def test_a_stem_takes_what_the_formula_says():
    stand = trees.prepare(Trees("full_stems", efficiency=0.5), True)
    for dbh in (30.0, 45.2):
        taken = trees.stem_loss(stand, np.uint64(5), 0, 0.01 * dbh)
        assert taken == pytest.approx(0.5 * 38.7 * dbh**2.31, rel=1e-12)
    # Dorren and Berger (2006): some 100 kJ for a fir of 30 cm, several hundred for one of 50 cm.
    assert pytest.approx(100e3, rel=0.05) == ONE_STEM


@pytest.mark.parametrize("species", list(energy_ratios()))
def test_species_scale_what_a_stem_takes(species):
    stand = trees.prepare(Trees("full_stems", species=species, efficiency=0.5), True)
    taken = trees.stem_loss(stand, np.uint64(5), 0, 0.3)
    assert taken == pytest.approx(0.5 * energy_ratios()[species] * ONE_STEM, rel=1e-12)


def test_species_have_the_ratios_that_are_cited():
    # Rockyfor3D: conifers 0.93, broadleaved 1.59; fir is the reference, spruce about 0.9.
    known = energy_ratios()
    assert known["fir"] == 1.0
    assert known["spruce"] == 0.9
    assert (known["conifers"], known["broadleaved"]) == (0.93, 1.59)
    assert all(1.3 <= known[name] <= 1.7 for name in ("larch", "maple", "beech"))


def test_an_unknown_species_is_told():
    with pytest.raises(ConfigError, match="spruce") as caught:
        Trees(species="palm")
    assert caught.value.field == "species" and "palm" in str(caught.value)


def test_where_a_stem_is_hit_matters():
    offsets = np.linspace(0.0, 1.0, 201)
    share = np.array([trees.share_taken(x) for x in offsets])
    assert (np.diff(share) <= 0.0).all()
    assert share[0] == pytest.approx(0.98, abs=1e-3)
    assert share[-1] == 0.0
    assert trees.share_taken(0.58) == pytest.approx(-0.046 + 0.5 * (0.98 + 0.046), rel=1e-12)
    stand = trees.prepare(Trees(), True)
    taken = [trees.stem_loss(stand, np.uint64(9), i, 0.3) for i in range(4000)]
    exact = ONE_STEM * trapezoid(share, offsets)
    assert np.mean(taken) == pytest.approx(exact, rel=0.03)
    assert min(taken) >= 0.0 and max(taken) <= ONE_STEM


# --- flight ---


def landing(effects, flat, stems, n=1, speed=20.0, drop=40.0, blocks=None):
    blocks = blocks or lab.sphere(RADIUS, drop_m=(drop, drop), speed_mps=(speed, speed))
    out = lab.run(
        flat, lab.plain(), blocks, effects, n=n, log_events=600, forest=lab.forest(flat, stems)
    )
    return np.array([lab.first(c, lab.IMPACT) for c in out.event_logs])


@pytest.mark.parametrize("cell", [0.5, 2.0, 100.0])
def test_stems_are_met_below_their_height_only(cell):
    flat = lab.profile_set(lab.slope((200.0, 0.0)), cell=cell)
    height, density, speed = 15.0, 0.05, 20.0
    take = 0.05 * MASS
    effects = EffectSettings(Trees("full_stems", efficiency=take / ONE_STEM, height_m=height))
    n = 800
    met = landing(effects, flat, density, n, speed)
    full = 0.5 * MASS * (speed**2 + 2.0 * lab.G * 40.0)
    left = 0.5 * MASS * (met["vx_mps"] ** 2 + met["vz_mps"] ** 2)
    # What a stem takes is no longer gained by falling, so counts are whole but for that.
    counts = (full - left) / take
    falls = math.sqrt(2.0 * (40.0 + RADIUS - height) / lab.G), math.sqrt(2.0 * 40.0 / lab.G)
    mean = density * (2.0 * RADIUS + 0.3) * speed * (falls[1] - falls[0])
    assert counts.mean() == pytest.approx(mean, abs=4.0 * math.sqrt(mean / n))
    assert counts.var() == pytest.approx(mean, rel=0.2)
    tall = landing(
        EffectSettings(Trees("full_stems", efficiency=take / ONE_STEM, height_m=60.0)),
        flat, density, n, speed,
    )  # fmt: skip
    whole = density * (2.0 * RADIUS + 0.3) * speed * falls[1]
    left = 0.5 * MASS * (tall["vx_mps"] ** 2 + tall["vz_mps"] ** 2)
    assert ((full - left) / take).mean() == pytest.approx(whole, abs=4.0 * math.sqrt(whole / n))


def test_a_viscous_forest_slows_a_flight_exponentially():
    k, drop, speed = 600.0, 60.0, 15.0
    effects = EffectSettings(Trees("viscous", drag_kgps=k, height_m=100.0))
    for cell in (0.5, 2.0, 100.0):
        flat = lab.profile_set(lab.slope((200.0, 0.0)), cell=cell)
        (met,) = landing(effects, flat, 0.01, speed=speed, drop=drop)
        t = met["t_s"]
        decay = math.exp(-k * t / MASS)
        assert decay < 0.4
        assert met["vx_mps"] == pytest.approx(speed * decay, rel=1e-9)
        assert met["vz_mps"] == pytest.approx(-MASS * lab.G / k * (1.0 - decay), rel=1e-3)
        way = MASS * lab.G / k * (t - MASS / k * (1.0 - decay))
        assert way == pytest.approx(drop, rel=2e-3)
    flat = lab.profile_set(lab.slope((200.0, 0.0)))
    still = lab.run(
        flat, lab.plain(), lab.sphere(RADIUS, drop_m=(drop, drop)), effects, log_events=600,
        forest=lab.forest(flat, 0.01),
    )  # fmt: skip
    # Also where it falls straight down, and not at all where no tree stands.
    assert still.rocks["max_speed_mps"][0] < 0.8 * math.sqrt(2.0 * lab.G * drop)
    (free,) = landing(effects, flat, 0.0, speed=speed, drop=drop)
    assert free["vx_mps"] == speed


@pytest.mark.parametrize("cell", [0.5, 2.0, 50.0])
def test_a_viscous_forest_stops_a_rolling_rock(cell):
    # At constant speed but for the forest: dv/dx = -k/m, so that it ends at m v/k.
    k = 60.0
    effects = EffectSettings(Trees("viscous", drag_kgps=k))
    flat = lab.profile_set(LINE, cell=cell)
    out = lab.run(
        flat,
        EVEN,
        ROLLING,
        effects,
        n=1,
        control_lines=control_lines(55.0, 105.0),
        forest=lab.forest(flat, 0.01),
    )
    cosine = math.cos(math.radians(ANGLE))
    for control_line, way in ((0, 50.0), (1, 100.0)):
        speed = out.passages["speed_mps"][out.passages["control_line"] == control_line]
        assert speed == pytest.approx(V0 - k / MASS * way / cosine, abs=0.1)
    assert out.rocks["reason"][0] == lab.REST
    end = 5.0 + MASS * V0 / k * cosine
    # Its centre starts and ends beside its foot.
    assert out.rocks["runout_m"][0] == pytest.approx(end, abs=0.02 * end)


@pytest.mark.parametrize("k", [60.0, 600.0, 6000.0])
def test_a_viscous_forest_lets_a_rolling_rock_come_to_its_steady_speed(k):
    # g (sin β − μ cos β) m/k, whether it starts faster or slower.
    pull = 1.0
    slope_of = math.radians(ANGLE)
    ground = lab.plain(mu_0=math.tan(slope_of) - pull / (lab.G * math.cos(slope_of)))
    effects = EffectSettings(Trees("viscous", drag_kgps=k))
    flat = lab.profile_set(lab.slope((2000.0, ANGLE)))
    at = control_lines(1900.0)
    out = lab.run(
        flat, ground, ROLLING, effects, n=1, control_lines=at, forest=lab.forest(flat, 0.01)
    )
    assert out.passages["speed_mps"] == pytest.approx(pull * MASS / k, rel=1e-3)


@pytest.mark.parametrize("k", [1e-3, 1e-5, 1e-9, 1e-53, 2e-308])
def test_hardly_any_viscous_drag_is_none(k):
    stand = trees.prepare(Trees("viscous", drag_kgps=k), has_stems=True)
    # Pull over drag would be no number.
    assert (stand.form == OFF) == (k < 1e-6)
    for pull in (-2.0, 0.0, 2.0):
        found = trees.gain_over(stand, 0.01, MASS, 3.0, 3.0 * pull, 1.5)
        assert found == pytest.approx(3.0 * pull, abs=3e-9 + 30.0 * k / MASS)
    flat = lab.profile_set(LINE, cell=2.0)
    rocks = [
        lab.run(flat, EVEN, ROLLING, EffectSettings(Trees("viscous", drag_kgps=drag)), n=1,
            forest=lab.forest(flat, 0.01)).rocks
        for drag in (0.0, k)
    ]  # fmt: skip
    assert rocks[1]["runout_m"] == pytest.approx(rocks[0]["runout_m"], rel=1e-3)


def test_a_strong_stem_stops_a_rock_where_it_is_met():
    # Ways to the first stem are exponential. Friction is just above the slope, so that a rock that
    # has been stopped stays.
    ground = lab.plain(mu_0=(1.0 + 1e-9) * math.tan(math.radians(ANGLE)))
    flat = lab.profile_set(lab.slope((2000.0, ANGLE)))
    effects = EffectSettings(Trees("full_stems"))
    out = lab.run(flat, ground, ROLLING, effects, n=800, forest=lab.forest(flat, 0.02))
    assert ONE_STEM > ROLLING_ENERGY
    assert (out.rocks["reason"] == lab.REST).all()
    ways = out.rocks["runout_m"] - 5.0
    assert stats.kstest(ways, "expon", (0.0, 1.0 / (0.02 * (2.0 * RADIUS + 0.3)))).pvalue > 1e-3


@pytest.mark.parametrize("cell", [0.5, 2.0, 100.0])
def test_the_loss_in_a_forest_does_not_depend_on_the_cells(cell):
    # A rough run through a real forest: the mean run-out agrees with that on cells of 2 m.
    effects = EffectSettings(Trees())
    runs = []
    for size in (2.0, cell):
        flat = lab.profile_set(lab.rough_slope(5), cell=size)
        out = lab.run(
            flat,
            lab.ground(),
            lab.MIXED,
            effects,
            n=1500,
            start=(3.0, 20.0),
            forest=lab.forest(flat, 0.04),
        )
        runs.append(out.rocks["runout_m"])
    error = math.hypot(*(r.std() / math.sqrt(r.size) for r in runs))
    assert runs[0].mean() == pytest.approx(runs[1].mean(), abs=3.0 * error)
