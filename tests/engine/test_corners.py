"""Concave corners and convex edges: one impact counts once, and no block is turned onto a face."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import engine_lab as lab

from sassgis.engine.ellipse import inertia

SOFT = lab.ground(
    "soft", eta_max=0.85, mu_f=0.6, mu_0=0.31, k=0.17, d_star_m=0.12, restitution=0.5,
    rolling_threshold=1.0,
)  # fmt: skip
READINGS = [
    pytest.param(lab.PAPER, lab.ROCK, 0.1, id="1986"),
    pytest.param(lab.HAZARD, SOFT, 1.0, id="hazard"),
]


def repeated_impacts(log):
    """Pairs of impacts on one segment between which the block hardly turns."""
    impacts = log[log["phase"] == lab.IMPACT]
    near = (np.abs(np.diff(impacts["theta_rad"])) < 3e-4) & (np.diff(impacts["t_s"]) < 1e-3)
    return int((near & (np.diff(impacts["segment"]) == 0)).sum())


@pytest.mark.parametrize(("settings", "ground", "threshold"), READINGS)
@pytest.mark.parametrize("turn", [8.0, 20.0, 34.6])
def test_an_impact_at_a_concave_corner_counts_once(settings, ground, threshold, turn):
    line = lab.slope((60, 35.0), (400, 35.0 - turn))
    out = lab.run(
        line, ground, lab.MIXED, n=400, settings=settings, log_events=600, start=(2.0, 20.0)
    )
    assert sum(repeated_impacts(log) for log in out.event_logs) == 0


def test_a_rolling_rock_keeps_what_one_impact_at_the_corner_leaves():
    # Of the kinetic energy at most η_max is left, and no more than a second impact would take.
    line = lab.slope((60, 35.0), (400, 0.4))
    out = lab.run(line, lab.ROCK, lab.MIXED, n=400, log_events=600, start=(2.0, 20.0))
    kept = []
    for rock, log in zip(out.rocks, out.event_logs, strict=True):
        hits = np.flatnonzero((log["phase"] == lab.IMPACT) & (log["segment"] == 1))
        if hits.size and log["phase"][hits[0] - 1] == lab.ROLLING:
            around = log[[hits[0], hits[0] + 1]]
            energy = (
                around["vx_mps"] ** 2
                + around["vz_mps"] ** 2
                + inertia(rock["a_m"], rock["b_m"]) * around["omega_radps"] ** 2
            )
            later = log[hits[0] + 1 :]
            soon = later["t_s"] < log["t_s"][hits[0]] + 1e-3
            kept.append((energy[1] / energy[0], int((later["phase"][soon] == lab.IMPACT).sum())))
    assert len(kept) > 100
    share, again = np.array(kept).T
    assert np.median(share) == pytest.approx(0.7, abs=0.02)
    assert again.max() == 0


def test_a_fast_rock_flies_off_a_convex_edge():
    """14.6 m/s off an edge of 5.7 to 36 degrees: 7.4 m/s away from the face, a flight of 27 m."""
    flat, steep, speed = math.radians(5.7), math.radians(36.0), 14.6
    line = lab.slope((20, 5.7), (120, 36.0))
    blocks = lab.ellipsoid(0.5, 0.4, 0.3, speed_mps=(speed, speed))
    ground = lab.plain(mu_f=math.tan(flat), mu_0=math.tan(flat))
    away = 2.0 * speed * math.sin(steep - flat) / (lab.G * math.cos(steep))
    reach = speed * math.cos(flat) * away
    assert reach == pytest.approx(27.0, abs=0.7)
    for settings in (lab.PAPER, lab.HAZARD):
        out = lab.run(
            line, ground, blocks, n=200, settings=settings, log_events=200, start=(5.0, 15.0)
        )
        for log in out.event_logs:
            beyond = np.flatnonzero(log["x_m"] > 20.6)
            first = log[beyond[0]]
            assert first["phase"] not in (lab.ROLLING, lab.SLIDING)
            # With the words of 1986 nothing lifts it off before the edge.
            assert settings is lab.HAZARD or first["x_m"] > 20.0 + 0.9 * reach


@pytest.mark.parametrize(("settings", "ground", "threshold"), READINGS)
def test_no_rock_is_turned_onto_a_face_that_it_leaves(settings, ground, threshold):
    """Beyond an edge a block goes on along the ground if its weight can hold it there: v² < g r."""
    rng = np.random.default_rng(3)
    turned = 0
    for k in range(12):
        first = rng.uniform(0.0, 20.0)
        second = first + rng.uniform(10.0, 45.0)
        line = lab.slope(
            (20, first), (rng.uniform(3.0, 60.0), second), (60, rng.uniform(0.0, second)), (200, 0)
        )
        speed, b = rng.uniform(4.0, 18.0), rng.uniform(0.2, 0.5)
        blocks = lab.ellipsoid(0.5, b, b, speed_mps=(speed, speed), spin_radps=(0.0, 2.0 * speed))
        out = lab.run(
            line, ground, blocks, n=60, seed=k, settings=settings, log_events=600,
            start=(5.0, 19.0),
        )  # fmt: skip
        tx, tz = np.diff(line[0]), np.diff(line[1])
        size = np.hypot(tx, tz)
        radius = (0.5 * b * b) ** (1.0 / 3.0)
        for log in out.event_logs:
            lands = np.flatnonzero(
                np.isin(log["phase"][:-1], (lab.FLIGHT, lab.IMPACT))
                & np.isin(log["phase"][1:], (lab.ROLLING, lab.SLIDING))
            )
            then = log[lands + 1]
            j = then["segment"]
            vx = log["vx_mps"][lands]
            vz = log["vz_mps"][lands] - lab.G * (then["t_s"] - log["t_s"][lands])
            away = (vz * tx[j] - vx * tz[j]) / size[j]
            soft = np.sqrt(2.0 * lab.G * tx[j] / size[j] * threshold * radius)
            held = vx**2 + vz**2 < 1.5 * lab.G * 0.5
            turned += int(((away > soft) & ~held).sum())
    assert turned == 0
