"""The numbers of the model's equations, each with its source."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import engine_lab as lab

from sassgis.engine.ellipse import contact_frame, inertia, mean_radius
from sassgis.engine.impact import COULOMB, SCALE, energy_kept, impact, turn_about_contact

pytestmark = pytest.mark.kernels

G = 9.81

# Bozzolo and Pamini (1986), Fig. 9: share of energy kept (%) at ω_0 = 0, by γ (angle between OP and
# the major semi-axis) and α (angle of incidence, from the normal), computed from the closed form
# η_min = R²/(R² + I) sin²(α ∓ δ).
FIG_9 = {
    0.76: {
        0: (0, 19.00, 57.01, 76.02),
        30: (4.87, 4.89, 36.43, 67.95),
        60: (2.70, 6.72, 37.62, 64.48),
        90: (0, 16.17, 48.50, 64.67),
        120: (2.70, 29.56, 60.46, 64.48),
        150: (4.87, 36.40, 67.94, 67.95),
        180: (0, 19.00, 57.01, 76.02),
    },
    0.40: {
        0: (0, 20.29, 60.88, 81.17),
        30: (31.99, 4.09, 4.64, 33.10),
        60: (8.15, 0.39, 15.55, 38.46),
        90: (0, 10.20, 30.61, 40.82),
        120: (8.15, 31.06, 46.21, 38.46),
        150: (31.99, 60.44, 61.00, 33.10),
        180: (0, 20.29, 60.88, 81.17),
    },
}


@pytest.mark.parametrize(
    ("ratio", "gamma", "alpha", "percent"),
    [
        pytest.param(r, g, a, p, id=f"Fig. 9, b/a={r}, gamma={g}, alpha={a}")
        for r, rows in FIG_9.items()
        for g, row in rows.items()
        for a, p in zip((0, 30, 60, 90), row, strict=True)
    ],
)
def test_energy_kept_meets_figure_9(ratio, gamma, alpha, percent):
    # OP from the geometry of the ellipse alone: a point at polar angle γ and the normal there.
    b = ratio
    gam = math.radians(gamma)
    r = b / math.sqrt((b * math.cos(gam)) ** 2 + math.sin(gam) ** 2)
    phi = math.atan2(math.sin(gam), b * b * math.cos(gam))
    delta = phi - gam
    # γ < 90°: P leads the centre, so the centre is behind it, x < 0.
    x, y = -r * math.sin(delta), r * math.cos(delta)
    a0 = math.radians(alpha)
    got = energy_kept(x, y, inertia(1.0, b), math.sin(a0), -math.cos(a0), 0.0)
    assert abs(100.0 * got - percent) <= 0.005 + 1e-9


@pytest.mark.parametrize("ratio", [0.76, 0.40])
@pytest.mark.parametrize("gamma", [1, 30, 60, 90, 120, 150, 179])
def test_contact_frame_finds_the_point_with_the_ground_as_tangent(ratio, gamma):
    # sass_model, "For an ellipse whose major axis stands at θ": the point of contact by geometry.
    gam = math.radians(gamma)
    r = ratio / math.sqrt((ratio * math.cos(gam)) ** 2 + math.sin(gam) ** 2)
    phi = math.atan2(math.sin(gam), ratio**2 * math.cos(gam))
    # Outward normal at P makes φ with the major axis; it points into the ground, along −90°.
    x, y, _ = contact_frame(1.0, ratio, -0.5 * math.pi - phi)
    assert x == pytest.approx(r * math.sin(phi - gam), abs=1e-14)
    assert y == pytest.approx(r * math.cos(phi - gam), abs=1e-14)


def test_contact_frame_derivatives():
    # x = dy/dθ and curvature = d²y/dθ² by central differences.
    h = 1e-4
    for theta in np.linspace(0.0, math.pi, 37):
        x, y, bend = contact_frame(0.6, 0.35, theta)
        low, high = contact_frame(0.6, 0.35, theta - h)[1], contact_frame(0.6, 0.35, theta + h)[1]
        assert x == pytest.approx((high - low) / (2 * h), abs=1e-7)
        assert bend == pytest.approx((high - 2 * y + low) / h**2, abs=1e-6)


def test_mean_radius_is_the_perimeter_over_two_pi():
    angle = (np.arange(200_000) + 0.5) * (2.0 * np.pi / 200_000)
    for a, b in ((1.0, 1.0), (0.5, 0.38), (1.0, 0.4)):
        exact = np.mean(np.hypot(a * np.sin(angle), b * np.cos(angle)))
        assert mean_radius(a, b) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(("vx", "vy"), [(9.0, -5.0), (3.0, -12.0), (-4.0, -1.0), (6.0, 0.0)])
def test_sphere_in_synchronous_spin(vx, vy):
    # Synchronous spin ω_0 = v_0x/R: η_min = 1.4 v_0x²/(1.4 v_0x² + v_0y²).
    x, y, _ = contact_frame(0.5, 0.5, 0.3)
    got = energy_kept(x, y, inertia(0.5, 0.5), vx, vy, vx / 0.5)
    assert got == pytest.approx(1.4 * vx**2 / (1.4 * vx**2 + vy**2), rel=1e-14)


@pytest.mark.parametrize(
    ("eta_max", "after"),
    [(1.0, (8.401235, -2.322376, 19.364381)), (0.7, (7.411660, -2.048825, 17.083466))],
)
def test_the_worked_impact(eta_max, after):
    # Impact, a = 0.5, b = 0.38, θ = 0.7 rad, v_0 = (9, −5), ω_0 = 12, free and with η_max = 0.70.
    a, b = 0.5, 0.38
    x, y, _ = contact_frame(a, b, 0.7)
    i = inertia(a, b)
    free = energy_kept(x, y, i, 9.0, -5.0, 12.0)
    assert (x, y, free) == pytest.approx((0.1199303, 0.4338499, 0.8994009), abs=5e-8)
    vx, vy, w = impact(x, y, i, 9.0, -5.0, 12.0, eta_max, SCALE, 0.8)
    assert (vx, vy, w) == pytest.approx(after, abs=5e-7)
    kept = (i * w * w + vx * vx + vy * vy) / (i * 144.0 + 106.0)
    assert kept == pytest.approx(min(free, eta_max), rel=1e-14)


@pytest.mark.parametrize("seed", range(20))
def test_impact_laws_for_any_state(seed):
    # Equations (3) to (6), (7), and fact 1: the projection never gains energy.
    rng = np.random.default_rng(seed)
    a = rng.uniform(0.2, 3.0)
    b = a * rng.uniform(0.1, 1.0)
    x, y, _ = contact_frame(a, b, rng.uniform(-7.0, 7.0))
    i = inertia(a, b)
    v = rng.normal(0.0, 15.0, 2)
    w0 = rng.normal(0.0, 20.0)
    wx, wy, w = turn_about_contact(x, y, i, v[0], v[1], w0)
    before = i * w0**2 + v @ v
    after = i * w**2 + wx**2 + wy**2
    assert i * w + y * wx - x * wy == pytest.approx(i * w0 + y * v[0] - x * v[1], rel=1e-11)  # (3)
    assert (wx, wy) == pytest.approx((y * w, -x * w), rel=1e-14)  # (4)
    kept = energy_kept(x, y, i, v[0], v[1], w0)
    assert kept == pytest.approx(after / before, rel=1e-11)  # (6)
    assert kept <= 1.0 + 1e-14
    for eta_max in (0.0, 0.3, 0.55, 1.0):
        sx, sy, sw = impact(x, y, i, v[0], v[1], w0, eta_max, SCALE, 0.8)
        share = (i * sw**2 + sx**2 + sy**2) / before
        assert share == pytest.approx(min(kept, eta_max), rel=1e-11, abs=1e-15)  # (7)
        assert (sx - y * sw, sy + x * sw) == pytest.approx((0.0, 0.0), abs=1e-12)  # no slip


# --- through the whole simulation ---


def from_20_m(line, ground, blocks, **more):
    """Blocks that start at 20 m, with all that happens to the first one."""
    out = lab.run(line, ground, blocks, start=20.0, log_events=200, **more)
    return out.rocks[0], out.event_logs[0]


def test_sphere_falling_on_a_slope_met_flatter():
    # Sphere R = 0.5 falling straight down at 10 m/s on β = 44° met as β' = 35°: speed after
    # 4.096975, η = 0.234993, launch 9° above the slope, next contact after 0.181645 s,
    # 0.847454 m down-slope.
    u = 1.0 - math.tan(math.radians(35.0)) / math.tan(math.radians(44.0))
    _, log = from_20_m(
        lab.slope((200.0, 44.0)), lab.plain(eta_max=1.0, dp_min=u, dp_max=u),
        lab.sphere(0.5, drop_m=(100.0 / (2 * G),) * 2),
        settings=lab.with_settings(contact_tolerance_m=1e-10),
    )  # fmt: skip
    # The second landing is below the threshold of rolling, v_n²/(2 g cos β) = 0.029 m < R/10.
    assert log["phase"][:4].tolist() == [lab.FLIGHT, lab.IMPACT, lab.FLIGHT, lab.ROLLING]
    met, leaves, lands = log[1], log[2], log[3]
    before = np.hypot(met["vx_mps"], met["vz_mps"])
    assert before == pytest.approx(10.0, abs=2e-6)
    v = leaves["vx_mps"], leaves["vz_mps"]
    speed = np.hypot(*v)
    assert speed == pytest.approx(4.096975, abs=2e-6)
    kept = (speed**2 + 0.4 * 0.25 * leaves["omega_radps"] ** 2) / before**2
    assert kept == pytest.approx(0.234993, abs=5e-7)
    launch = 44.0 + math.degrees(math.atan2(v[1], v[0]))
    assert launch == pytest.approx(9.0, abs=1e-9)
    assert lands["t_s"] - leaves["t_s"] == pytest.approx(0.181645, abs=2e-6)
    way = [lands[name] - leaves[name] for name in ("x_m", "z_m")]
    assert np.hypot(*way) == pytest.approx(0.847454, abs=3e-6)


@pytest.mark.parametrize(
    ("mu", "degrees", "speed", "length"),
    [
        pytest.param(0.8, 20.0, 5.0, 3.109847, id="sliding 0.8, 20 deg, 5 m/s"),
        pytest.param(0.6, 0.0, 10.0, 8.494733, id="sliding 0.6, 0 deg, 10 m/s"),
        pytest.param(1.0, 30.0, 8.0, 8.911888, id="sliding 1.0, 30 deg, 8 m/s"),
    ],
)
@pytest.mark.parametrize("pieces", [1, 64])
def test_sliding_to_rest(mu, degrees, speed, length, pieces):
    # L = v²/[2 g (μ cos β − sin β)], on one segment and on the same slope cut into 64.
    line = lab.slope(*[(100.0 / pieces, degrees)] * pieces)
    rock, _ = from_20_m(line, lab.plain(mu_f=mu), lab.ellipsoid(speed_mps=(speed, speed)))
    assert rock["reason"] == 0
    along = (rock["runout_m"] - 20.0) / math.cos(math.radians(degrees))
    assert along == pytest.approx(length, abs=5e-7)
    pull = G * (mu * math.cos(math.radians(degrees)) - math.sin(math.radians(degrees)))
    assert rock["time_s"] == pytest.approx(speed / pull, rel=1e-9)


@pytest.mark.parametrize("pieces", [1, 64])
def test_rolling_to_rest(pieces):
    # Rolling to rest, μ_r = 0.6, 20°, 5 m/s: 5.744979 m. A sphere in synchronous spin.
    r = 0.5
    line = lab.slope(*[(100.0 / pieces, 20.0)] * pieces)
    block = lab.sphere(r, speed_mps=(5.0, 5.0), spin_radps=(5.0 / r, 5.0 / r))
    rock, _ = from_20_m(line, lab.plain(mu_0=0.6), block)
    assert rock["reason"] == 0
    along = (rock["runout_m"] - 20.0) / math.cos(math.radians(20.0))
    assert along == pytest.approx(5.744979, abs=5e-7)


def test_rolling_friction_grows_with_the_ground_blocks():
    # Equation (2): μ_r = μ_0 + k d*/d, with d the diameter of the rock.
    r, mu_0, k, d_star = 0.4, 0.4, 0.2, 0.3
    block = lab.sphere(r, speed_mps=(4.0, 4.0), spin_radps=(10.0, 10.0))
    ground = lab.plain(mu_0=mu_0, k=k, d_star_m=d_star)
    rock, _ = from_20_m(lab.slope((100.0, 10.0)), ground, block)
    mu = mu_0 + k * d_star / (2 * r)
    beta = math.radians(10.0)
    length = 16.0 / (2 * G * (mu * math.cos(beta) - math.sin(beta)))
    assert rock["runout_m"] - 20.0 == pytest.approx(length * math.cos(beta), rel=1e-12)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("degrees", "eta_max", "low", "high"),
    [
        pytest.param(44.0, 0.70, 0.0, 0.3, id="Table 1, rock"),
        pytest.param(57.0, 0.55, 0.2, 0.6, id="Table 1, debris"),
    ],
)
def test_table_1_slope_variation_is_met_at_impacts(degrees, eta_max, low, high):
    # Table 1: limits of Δp/p with p = tan β. The slope met at each impact fills them evenly.
    from scipy import stats

    out = lab.run(
        lab.slope((300.0, degrees)), lab.plain(eta_max=eta_max, dp_min=low, dp_max=high),
        dataclasses.replace(lab.MIXED, drop_m=(1.0, 3.0)), n=600, start=(5.0, 10.0),
        log_events=120,
    )  # fmt: skip
    hits = np.concatenate([x[x["phase"] == lab.IMPACT] for x in out.event_logs])
    u = 1.0 - (-hits["uz"] / hits["ux"]) / math.tan(math.radians(degrees))
    assert hits.shape[0] > 500
    assert u.min() >= low - 1e-12
    assert u.max() <= high + 1e-12
    assert stats.kstest(u, "uniform", (low, high - low)).pvalue > 0.01


def test_a_sphere_never_bounces_without_variation():
    # Fact 3: Δp = 0 leaves no normal velocity, and the rock rolls after its first contact.
    line = lab.slope((200.0, 40.0), (100.0, 0.0))
    _, log = from_20_m(line, lab.plain(), lab.sphere(0.5, drop_m=(3.0, 3.0)))
    phases = log["phase"].tolist()
    assert phases[:3] == [lab.FLIGHT, lab.IMPACT, lab.ROLLING]
    assert lab.FLIGHT not in phases[1:]


@pytest.mark.parametrize("variation", [0.05, 0.2, 0.5])
def test_a_sphere_leaves_at_the_angle_of_the_variation(variation):
    # Fact 3: with the variation the launch angle above the mean slope is β − β'.
    ground = lab.plain(eta_max=0.6, dp_min=variation, dp_max=variation)
    _, log = from_20_m(lab.slope((200.0, 44.0)), ground, lab.sphere(0.5, drop_m=(5.0, 5.0)))
    leaves = log[2]
    launch = math.atan2(leaves["vz_mps"], leaves["vx_mps"]) + math.radians(44.0)
    met = math.atan(math.tan(math.radians(44.0)) * (1.0 - variation))
    assert launch == pytest.approx(math.radians(44.0) - met, abs=1e-12)


def test_half_of_all_orientations_leave_the_centre_falling():
    # Fact 4: ω_0 = 0 and b/a = 0.76, half of all orientations give v_y < 0.
    falling = 0
    angles = (np.arange(1000) + 0.5) * (math.pi / 1000)
    for theta in angles:
        x, y, _ = contact_frame(1.0, 0.76, theta)
        falling += turn_about_contact(x, y, inertia(1.0, 0.76), 5.0, -5.0, 0.0)[1] < 0.0
    # Falling when ω x > 0; ω > 0 unless the normal velocity turns the rock back.
    assert 450 <= falling <= 550


@pytest.mark.parametrize("alpha", [0, 10, 30, 45, 60, 90])
def test_sphere_keeps_five_sevenths_of_the_tangential_share(alpha):
    # Sphere, ω_0 = 0: η_min = (5/7) sin² α.
    a0 = math.radians(alpha)
    x, y, _ = contact_frame(0.5, 0.5, 1.1)
    got = energy_kept(x, y, inertia(0.5, 0.5), 7.0 * math.sin(a0), -7.0 * math.cos(a0), 0.0)
    assert got == pytest.approx(5.0 / 7.0 * math.sin(a0) ** 2, abs=1e-15)


@pytest.mark.parametrize("seed", range(30))
def test_coulomb_impact_stays_in_the_cone(seed):
    # The rule "coulomb": impulse within the friction cone, contact does not go deeper, no gain.
    rng = np.random.default_rng(100 + seed)
    a = rng.uniform(0.2, 2.0)
    b = a * rng.uniform(0.3, 1.0)
    x, y, _ = contact_frame(a, b, rng.uniform(0.0, math.pi))
    i = inertia(a, b)
    v = np.array([rng.normal(0.0, 10.0), -abs(rng.normal(0.0, 10.0))])
    w0 = rng.normal(0.0, 15.0)
    if v[1] + x * w0 > 0.0:  # the point of contact must approach
        w0 = -w0
    mu = rng.uniform(0.1, 1.0)
    sx, sy, sw = impact(x, y, i, v[0], v[1], w0, 1.0, COULOMB, mu)
    jx, jy = sx - v[0], sy - v[1]
    assert jy >= -1e-12
    assert abs(jx) <= mu * jy * (1.0 + 1e-9) + 1e-12
    assert i * (sw - w0) == pytest.approx(x * jy - y * jx, abs=1e-10)
    assert sy + x * sw == pytest.approx(0.0, abs=1e-10)  # P does not go into the ground
    assert i * sw**2 + sx**2 + sy**2 <= (i * w0**2 + v @ v) * (1.0 + 1e-12)
