"""Stopping, scaling laws, trends and a long search for anything that breaks."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import engine_lab as lab
from numpy.lib.recfunctions import structured_to_unstructured as matrix
from scipy import stats

from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.results import StopReason

G = 9.81


@lab.on_both_lines
@pytest.mark.parametrize("larger", [1.0, 4.0], ids=["gravity", "size"])
def test_speeds_scale_with_the_root_of_gravity_and_size(line, larger):
    """Four times the gravity, or all lengths, block and d* included: speeds double, exactly."""
    s, z = line
    names = ("axis_1_m", "axis_2_m", "axis_3_m", "drop_m")
    small = dataclasses.replace(lab.MIXED, drop_m=(0.0, 2.0))
    large = dataclasses.replace(
        small, **{k: tuple(larger * v for v in getattr(small, k)) for k in names}
    )
    coarse = dataclasses.replace(lab.ROCK, d_star_m=larger * lab.ROCK.d_star_m)
    longer, gravity = 2.0 / larger, 4.0 / larger
    one = lab.run(
        line, lab.ROCK, small, n=100, start=(10.0, 30.0), log_events=3000,
        settings=lab.with_settings(gravity_mps2=G / gravity, contact_tolerance_m=1e-6),
    )  # fmt: skip
    four = lab.run(
        (larger * s, larger * z), coarse, large, n=100, start=(larger * 10.0, larger * 30.0),
        log_events=3000, settings=lab.with_settings(contact_tolerance_m=larger * 1e-6),
    )  # fmt: skip
    apart = 0
    for u, v in zip(one.event_logs, four.event_logs, strict=True):
        k = min(4, u.shape[0], v.shape[0])
        # Chaos magnifies the shortest steps in time (1e-9 s) over the next contacts.
        ok = [
            np.allclose(factor * matrix(u[:k][list(columns)]), matrix(v[:k][list(columns)]),
                        rtol=0, atol=1e-6)
            for factor, columns in (
                (larger, ("x_m", "z_m")), (1.0, ("theta_rad", "ux", "uz")),
                (2.0, ("vx_mps", "vz_mps")), (2.0 / larger, ("omega_radps",)),
                (1.0 / longer, ("t_s",)),
            )
        ]  # fmt: skip
        apart += not all(ok)
    assert apart <= 2
    ends = [larger * one.rocks["runout_m"], four.rocks["runout_m"]]
    assert stats.ks_2samp(*ends).pvalue > 0.05
    # Rock by rock up to the onset of chaos: most short paths agree to the end.
    assert (np.abs(ends[0] - ends[1]) < larger * 1e-3).mean() > 0.3


def test_density_moves_no_rock():
    line = lab.rough(2)
    light, heavy = (
        lab.run(line, lab.ROCK, dataclasses.replace(lab.MIXED, density_kgm3=(d, d)), n=100).rocks
        for d in (2000.0, 3000.0)
    )
    assert np.array_equal(light["runout_m"], heavy["runout_m"])
    assert np.allclose(light["max_energy_kj"] * 1.5, heavy["max_energy_kj"], rtol=1e-12)


@pytest.mark.parametrize(
    ("field", "values", "sign"),
    [("mu_f", (0.5, 0.7, 0.9), -1), ("mu_0", (0.4, 0.5, 0.6), -1), ("eta_max", (0.5, 0.7, 0.9), 1)],
)
def test_mean_run_out_follows_the_parameters(field, values, sign):
    line = lab.slope((150.0, 38.0), (150.0, 15.0), (400.0, 0.0))
    blocks = dataclasses.replace(lab.MIXED, drop_m=(1.0, 3.0))
    means = []
    for value in values:
        ground = dataclasses.replace(lab.ROCK, k=0.0, **{field: value})
        means.append(lab.run(line, ground, blocks, n=800).rocks["runout_m"].mean())
    steps = sign * np.diff(means)
    if field == "mu_f":  # acts only at the very end: never the wrong way beyond noise
        assert (steps > -3.0).all()
    else:
        assert (steps > 0.0).all()


# --- stopping ---


def test_a_rock_stays_where_friction_holds_it():
    # At rest and tan β below both frictions: never started; above μ_f it slides.
    for degrees, mu_f, mu_0, moves in (
        (0.0, 0.8, 0.5, False),
        (20.0, 0.8, 0.5, False),
        (40.0, 0.8, 0.5, True),
        (42.0, 0.8, 0.95, True),
        (38.0, 0.8, 0.95, False),
    ):
        out = lab.run(
            lab.slope((100.0, degrees), (60.0, 0.0)), lab.plain(mu_f=mu_f, mu_0=mu_0),
            lab.ellipsoid(), n=20, start=(10.0, 40.0),
        )  # fmt: skip
        never = out.rocks["reason"] == StopReason.NEVER_STARTED
        assert never.all() != moves
        assert (out.rocks["runout_m"][never] == out.rocks["start_m"][never]).all()
        assert (out.rocks["max_speed_mps"][never] == 0.0).all()


def test_rest_only_where_friction_holds():
    # On long segments: a rock that comes to rest lies where tan β is below the larger friction.
    line = lab.slope((60, 45), (60, 30), (60, 42), (100, 10), (100, 0))
    blocks = dataclasses.replace(lab.MIXED, drop_m=(0.5, 2.0))
    r = lab.run(line, lab.ROCK, blocks, n=500, start=(5.0, 40.0)).rocks
    rest = r["reason"] == StopReason.REST
    assert rest.sum() > 300
    slope = np.diff(line[1]) / np.diff(line[0])
    j = np.clip(np.searchsorted(line[0], r["runout_m"][rest]) - 1, 0, slope.size - 1)
    away = np.abs(r["runout_m"][rest][:, None] - line[0][None, :]).min(axis=1)
    steep = -slope[j] > 0.85
    assert (away[steep] < 1.0).all()


PITS = {
    "V": (np.array([0, 20, 25, 30, 60.0]), np.array([20, 4, 0, 4, 20.0])),
    "narrow V": (np.array([0, 20, 20.3, 20.6, 60.0]), np.array([20, 4, 2, 4, 20.0])),
    "W": (np.array([0, 20, 21, 22, 23, 24, 60.0]), np.array([20, 2, 0, 1, 0, 2, 20.0])),
    "step up": (np.array([0, 20, 30, 30.01, 60.0]), np.array([20, 2, 2, 6, 6.0])),
    "step down": (np.array([0, 20, 20.01, 60.0]), np.array([20, 8, 2, 2.0])),
    "needles": (
        np.arange(0, 60.0, 0.2),
        20 - 0.3 * np.arange(0, 60.0, 0.2) + np.where(np.arange(300) % 5 == 0, 0.8, 0.0),
    ),
    "saw": (
        np.arange(0, 60.0, 0.2),
        20 - 0.3 * np.arange(0, 60.0, 0.2) + np.where(np.arange(300) % 2 == 0, 0.2, 0.0),
    ),
}


@pytest.mark.parametrize("name", PITS)
def test_pits_bring_rocks_to_rest_in_few_events(name):
    blocks = BlockPopulation(
        axis_1_m=(0.3, 0.8), axis_2_m=(0.3, 0.6), axis_3_m=(0.2, 0.5), drop_m=(0.0, 6.0),
        speed_mps=(0.0, 10.0), spin_radps=(-10.0, 10.0),
    )  # fmt: skip
    line = tuple(np.asarray(v, float) for v in PITS[name])
    out = lab.run(line, lab.ROCK, blocks, n=300, start=(2.0, 15.0), log_events=3000)
    r = out.rocks
    events = np.array([len(c) for c in out.event_logs])
    assert (r["reason"] != StopReason.STEP_LIMIT).all()
    assert np.isfinite(r["runout_m"]).all()
    assert np.percentile(events, 99) < 1000
    held = r["reason"] == StopReason.REST
    ground = np.interp(r["runout_m"][held], *line)
    assert (r["runout_z_m"][held] > ground).all()


def test_a_cliff_is_free_fall():
    # A ball pushed over an edge at v: range of the parabola, R above the ground.
    r, v, h = 0.5, 6.0, 30.0
    line = (np.array([0.0, 20.0, 20.0 + 1e-6, 200.0]), np.array([h, h, 0.0, 0.0]))
    mu = 0.3
    speed = math.sqrt(v * v + 2 * mu * G * 10.0)
    out = lab.run(
        line, lab.plain(mu_f=mu, eta_max=1.0), lab.sphere(r, speed_mps=(speed, speed)),
        start=10.0, log_events=10,
    )  # fmt: skip
    log = out.event_logs[0]
    lands = log[log["phase"] == lab.IMPACT][0]
    # The wait: the ball may first touch the edge, as it turns over it; at 6 m/s it does not
    # (v² > g R).
    assert lands["x_m"] == pytest.approx(20.0 + v * math.sqrt(2 * h / G), abs=1e-4)
    assert lands["vz_mps"] == pytest.approx(-math.sqrt(2 * G * h), abs=1e-4)


def test_nothing_breaks_on_rough_profiles():
    # 80 random rough profiles × 50 blocks.
    counts = np.zeros(5, int)
    below = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        lines = []
        for _ in range(10):
            step = rng.choice([0.2, 0.5, 1.0, 2.0])
            s = np.arange(0.0, 60.0 + step, step)
            amplitude = rng.uniform(0.02, 0.25) * min(1.0, step / 0.5)
            angle = rng.uniform(25.0, 55.0)
            z = -np.tan(np.radians(angle)) * np.minimum(s, 45.0)
            lines.append((s, z + rng.normal(0.0, amplitude, s.size)))
        blocks = dataclasses.replace(
            lab.MIXED, drop_m=(0.0, 3.0), spin_radps=(0.0, float(rng.choice([0.0, 10.0])))
        )
        ground = (lab.ROCK, lab.DEBRIS)[seed % 2]
        out = lab.run(lab.profile_set(*lines), ground, blocks, n=50, seed=seed)
        r = out.rocks
        for name in r.dtype.names:
            assert np.isfinite(r[name].astype(float)).all(), name
        counts += np.bincount(r["reason"], minlength=5)
        for i, line in enumerate(lines):
            own = r[(r["line"] == i) & (r["reason"] != StopReason.LEFT_PROFILE)]
            deep = own["runout_z_m"] - np.interp(own["runout_m"], *line)
            below += int((deep <= 0.0).sum())
        assert (r["furthest_m"] >= r["start_m"] - 1e-9).all()
    assert counts.sum() == 4000
    assert counts[StopReason.STEP_LIMIT] == 0
    assert below == 0
