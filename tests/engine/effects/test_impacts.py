"""Soft ground, rough ground and the third axis: single impacts against formulas by hand."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from helpers import engine_lab as lab
from scipy import stats
from scipy.integrate import trapezoid

from sassgis.engine.effects import rock_shape, roughness, soft_ground
from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.rock_shape import RockShape
from sassgis.engine.effects.roughness import Roughness
from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.engine.ellipse import contact_frame
from sassgis.errors import ConfigError
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundTable
from sassgis.settings.settings import EngineSettings

pytestmark = pytest.mark.kernels

FLAT = lab.slope((200.0, 0.0))
DATA = Path(__file__).parents[4] / "shared/data"
VX, VZ, OMEGA = "vx_mps", "vz_mps", "omega_radps"
#: Lands on its corner, so that it rebounds.
TILTED = lab.ellipsoid(
    0.6, 0.4, 0.3, drop_m=(5.0, 5.0), speed_mps=(4.0, 4.0), orientation_rad=(2.2, 2.2)
)


def first_impact(effects, blocks=TILTED, table=None, line=FLAT):
    """Rows of the first impact of a rock and of what follows."""
    out = lab.run(line, table or lab.plain(), blocks, effects, log_events=8)
    log = out.event_logs[0]
    i = int(np.flatnonzero(log["phase"] == lab.IMPACT)[0])
    return log[i], log[i + 1], out.rocks[0]


def soft(*args, **settings):
    settings.setdefault("classes", ())
    return EffectSettings(SoftGround(*args, **settings))


# --- soft ground ---


@pytest.mark.parametrize("reference", [2.0, 9.144])
def test_velocity_scaled_reduces_the_normal_rebound_only(reference):
    met, hard, _ = first_impact(None)
    _, yields, _ = first_impact(soft(reference_speed_mps=reference))
    assert hard[0] == lab.FLIGHT and hard[VZ] > 0.1
    into = -met[VZ]
    assert yields[VX] == pytest.approx(hard[VX], rel=1e-12)
    assert yields[OMEGA] == pytest.approx(hard[OMEGA], rel=1e-12)
    assert yields[VZ] == pytest.approx(hard[VZ] / (1.0 + (into / reference) ** 2), rel=1e-12)


@pytest.mark.parametrize(("modulus", "factor"), [(10.0, 2.0), (2.0, 2.0), (10.0, 20.0)])
def test_the_scar_takes_what_its_drag_takes(modulus, factor):
    met, hard, rock = first_impact(None)
    _, yields, _ = first_impact(soft("scar", modulus_mpa=modulus, depth_scale=factor))
    mass, into = rock["mass_kg"], -met[VZ]
    radius = (rock["a_m"] * rock["b_m"] * rock["c_m"]) ** (1 / 3)
    depth = min(factor * 0.16 * mass**0.25 * (1e3 * modulus) ** -0.4 * into**0.8, radius)
    # Segment of a circle below the surface, and its chord, by integration.
    y = np.linspace(radius - depth, radius, 200_001)
    section = 2.0 * trapezoid(np.sqrt(radius**2 - y**2), y)
    chord = 2.0 * math.sqrt(radius**2 - (radius - depth) ** 2)
    left = math.exp(-1.0 * 1800.0 * section * chord / mass)
    for column in (VX, VZ, OMEGA):
        assert yields[column] == pytest.approx(math.sqrt(left) * hard[column], rel=1e-4)
    assert left < 0.97


def depth(law, mass, radius, speed, modulus=10.0, scale=1.0):
    settings = SoftGround("scar", modulus_mpa=modulus, depth_law=law, depth_scale=scale)
    return soft_ground.scar_depth(soft_ground.prepare(settings), mass, radius, speed)


def test_scars_are_as_deep_as_their_laws_say():
    # 1 t, 10 m/s, R 0.45 m, M_E 10 MPa, computed by hand from the two forms.
    assert depth("lu", 1000.0, 0.45, 10.0) == pytest.approx(0.1426, rel=1e-3)
    force = 1.765 * 1e4**0.4 * 0.45**0.2 * 50.0**0.6  # kN
    assert depth("astra", 1000.0, 0.45, 10.0) == pytest.approx(100.0 / force, rel=1e-12)
    assert 100.0 / force == pytest.approx(0.16, abs=0.005)
    assert depth("astra", 1000.0, 0.45, 10.0, scale=2.0) == pytest.approx(200.0 / force)
    assert depth("lu", 1000.0, 0.45, -1.0) == depth("astra", 1000.0, 0.45, 0.0) == 0.0


def test_scars_of_chant_sura_are_as_deep_as_terrain_differences_show():
    """Six scars of 780 kg (Caviezel et al. 2019); M_E was not measured: 10 MPa, the default."""
    file = DATA / "chant_sura_2020/scarring_esurf2019/chant_sura_esurf_2019_impacts.csv"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for law in ("lu", "astra"):
        ratio = {}
        for column in ("observed_scarring_depth_m", "observed_scarring_depth_ifm_m"):
            logs = [
                math.log(
                    depth(law, float(r["mass_kg"]), float(r["radius_m"]),
                          float(r["incoming_normal_speed_mps"])) / float(r[column])
                )
                for r in rows
            ]  # fmt: skip
            ratio[column] = math.exp(sum(logs) / len(logs))
        assert ratio["observed_scarring_depth_m"] == pytest.approx(1.0, rel=0.25)
        assert 0.3 < ratio["observed_scarring_depth_ifm_m"] < 0.5


@pytest.mark.compiled
def test_slip_is_the_rule_of_coulomb_with_its_own_friction():
    line, table = lab.rough_slope(2), lab.ground(mu_f=0.3)
    slips = lab.run(line, table, lab.MIXED, soft("slip", friction=0.3), n=60, start=(3.0, 20.0))
    rule = lab.run(
        line, table, lab.MIXED, n=60, start=(3.0, 20.0),
        settings=EngineSettings(readings="1986", eta_max_rule="coulomb"),
    )  # fmt: skip
    assert lab.same(slips, rule)


def test_slip_leaves_a_spin_deficit():
    # Without slip the contact point rests after an impact: v_t' = y ω'.
    for effects, slides in ((None, False), (soft("slip", friction=0.05), True)):
        met, leaves, rock = first_impact(effects, table=lab.plain(eta_max=1.0))
        _, y, _ = contact_frame(rock["a_m"], rock["b_m"], met["theta_rad"])
        deficit = leaves[VX] - y * leaves[OMEGA]
        assert (abs(deficit) > 0.5) == slides
        assert slides or abs(deficit) < 1e-9


def test_only_soft_classes_are_soft():
    table = GroundTable((lab.plain("rock"), lab.plain("meadow"), lab.plain("soil")))
    on = soft(reference_speed_mps=1.0, classes=("meadow", "soil"))
    for kind, changes in ((0, False), (1, True), (2, True)):
        flat = lab.profile_set(FLAT, classes=kind)
        _, hard, _ = first_impact(None, table=table, line=flat)
        _, yields, _ = first_impact(on, table=table, line=flat)
        assert (yields[VZ] != hard[VZ]) == changes
    flat = lab.profile_set(FLAT)
    everywhere = first_impact(soft(reference_speed_mps=1.0), table=table, line=flat)
    assert everywhere[1][VZ] < first_impact(None, table=table, line=flat)[1][VZ]


@pytest.mark.parametrize("family", ["soft_ground", "roughness", "entrainment"])
def test_a_class_that_is_none_is_refused(family):
    kind = {"soft_ground": SoftGround, "roughness": Roughness, "entrainment": Entrainment}[family]
    with pytest.raises(ConfigError) as caught:
        first_impact(EffectSettings(kind(classes=("rock", "marsh"))))
    error = caught.value
    assert error.field == f"effects.{family}.classes"
    assert "marsh" in str(error) and "rock" in str(error.expected)


# --- roughness ---


def tilts(form, radius, obstacle=0.05, wavelength=2.0, n=6000):
    rough = roughness.prepare(Roughness(form, obstacle, wavelength))
    return np.array([roughness.tilt(rough, np.uint64(k), 1, radius) for k in range(n)])


def test_uniform_tilts_lie_within_the_angle_of_the_obstacle():
    for radius in (0.2, 0.5, 2.0):
        own = tilts("uniform", radius)
        most = math.atan(0.05 / radius)
        assert np.abs(own).max() <= most
        assert stats.kstest(own, "uniform", (-most, 2.0 * most)).pvalue > 1e-3


@pytest.mark.parametrize("form", ["uniform", "wave"])
def test_the_spread_of_tilts_falls_as_one_over_the_radius(form):
    # Where blocks bridge the waves.
    sd = [tilts(form, r, 0.02, wavelength=0.4).std() for r in (0.3, 0.6, 1.2)]
    assert sd[0] / sd[1] == pytest.approx(2.0, rel=0.03)
    assert sd[1] / sd[2] == pytest.approx(2.0, rel=0.03)


def test_the_wave_has_the_slopes_of_a_sine():
    own = tilts("wave", 0.3, obstacle=0.1, wavelength=2.0)
    steepest = math.pi * 0.1 / 2.0
    assert np.tan(np.abs(own)).max() <= steepest * (1 + 1e-12)
    # Slopes of a sine at random phases follow the arcsine law.
    law = stats.arcsine(-steepest, 2.0 * steepest)
    assert stats.kstest(np.tan(own), law.cdf).pvalue > 1e-3


@pytest.mark.compiled
def test_a_sphere_leaves_rough_ground_at_the_angle_of_its_tilt():
    # It keeps what runs along the surface it met, so that its angle of reflection is the tilt.
    radius, obstacle = 0.5, 0.2
    blocks = lab.sphere(radius, drop_m=(1.0, 1.0), speed_mps=(10.0, 10.0))
    out = lab.run(
        FLAT, lab.plain(eta_max=1.0), blocks,
        EffectSettings(Roughness(obstacle_m=obstacle)), n=3000, log_events=8,
    )  # fmt: skip
    angles, forward = [], 0
    for log in out.event_logs:
        i = int(np.flatnonzero(log["phase"] == lab.IMPACT)[0])
        leaves = log[i + 1]
        forward += int(leaves[0] != lab.FLIGHT)
        if leaves[0] == lab.FLIGHT:
            angles.append(math.atan2(leaves[VZ], leaves[VX]))
    most = math.atan(obstacle / radius)
    assert stats.kstest(angles, "uniform", (0.0, most)).pvalue > 1e-3
    # A surface that is tilted forwards does not throw it up: it rolls on.
    assert forward == pytest.approx(1500, abs=110)


def test_roughness_only_on_rough_classes():
    table = GroundTable((lab.plain("rock"), lab.plain("talus")))
    rough = EffectSettings(Roughness(obstacle_m=0.3, classes=("talus",)))
    for kind in (0, 1):
        flat = lab.profile_set(FLAT, classes=kind)
        one = lab.run(flat, table, lab.MIXED, n=20)
        other = lab.run(flat, table, lab.MIXED, rough, n=20)
        assert lab.same(one, other)  # they never start on the flat
        blocks = lab.ellipsoid(0.6, 0.4, 0.3, drop_m=(5.0, 5.0), speed_mps=(5.0, 5.0))
        one = lab.run(flat, table, blocks, n=20)
        other = lab.run(flat, table, blocks, rough, n=20)
        assert lab.same(one, other) == (kind == 0)


# --- rock shape ---


@pytest.mark.compiled
def test_flat_landings_stop_the_spin_as_often_as_the_block_is_flat():
    for c, strength in ((0.1, 1.0), (0.3, 1.0), (0.3, 0.5)):
        chance = strength * (1.0 - c / 0.4)
        blocks = lab.ellipsoid(
            0.6, 0.4, c, drop_m=(5.0, 5.0), speed_mps=(4.0, 4.0), orientation_rad=(1.9, 2.8)
        )
        out = lab.run(
            FLAT, lab.plain(), blocks, EffectSettings(RockShape(strength=strength)),
            n=2000, log_events=6,
        )  # fmt: skip
        spins = []
        for log in out.event_logs:
            i = int(np.flatnonzero(log["phase"] == lab.IMPACT)[0])
            if log["phase"][i + 1] == lab.FLIGHT:
                spins.append(log[OMEGA][i + 1])
        assert len(spins) > 500
        flat = int(np.sum(np.array(spins) == 0.0))
        assert stats.binomtest(flat, len(spins), chance).pvalue > 1e-3


@pytest.mark.compiled
def test_flat_blocks_stop_early_and_round_ones_where_they_did():
    line = lab.rough_slope(4)
    on = EffectSettings(RockShape())
    ends = [
        lab.run(
            line, lab.ground(), lab.ellipsoid(0.5, 0.45, 0.1), e, n=400, start=(3.0, 20.0)
        ).rocks
        for e in (None, on)
    ]
    assert ends[1]["runout_m"].mean() < 0.9 * ends[0]["runout_m"].mean()
    cubes = lab.ellipsoid(0.5, 0.3, 0.3)
    assert lab.same(
        lab.run(line, lab.ground(), cubes, n=50), lab.run(line, lab.ground(), cubes, on, n=50)
    )


def test_mean_inertia_is_the_mean_of_the_three():
    a, b, c = 0.7, 0.5, 0.2
    rng = np.random.default_rng(1)
    p = rng.normal(size=(400_000, 3))
    p *= (rng.random(len(p)) ** (1 / 3) / np.linalg.norm(p, axis=1))[:, None]
    p *= [a, b, c]
    moments = [(p**2).sum(axis=1).mean() - (p[:, i] ** 2).mean() for i in range(3)]
    assert rock_shape.tumbling_inertia(a, b, c) == pytest.approx(np.mean(moments), rel=3e-3)
    # At an impact: ω' = (I ω + y v_x − x v_y) / (I + x² + y²), with that I.
    form = EffectSettings(RockShape("mean_inertia"))
    met, leaves, rock = first_impact(form, table=lab.plain(eta_max=1.0))
    x, y, _ = contact_frame(rock["a_m"], rock["b_m"], met["theta_rad"])
    inertia = rock_shape.tumbling_inertia(rock["a_m"], rock["b_m"], rock["c_m"])
    after = (inertia * met[OMEGA] + y * met[VX] - x * met[VZ]) / (inertia + x * x + y * y)
    assert leaves[OMEGA] == pytest.approx(after, rel=1e-9)


def test_it_does_not_depend_on_the_mass():
    line, on = lab.rough_slope(4), EffectSettings(RockShape())
    light, heavy = (
        lab.run(
            line, lab.ground(), lab.ellipsoid(0.5, 0.4, 0.2, density_kgm3=(d, d)), on, n=50
        ).rocks
        for d in (1000.0, 4000.0)
    )
    assert (light["runout_m"] == heavy["runout_m"]).all()
