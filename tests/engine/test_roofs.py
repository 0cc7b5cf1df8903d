"""Roofs of galleries: where blocks land on them, and the force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import engine_lab as lab

from sassgis.engine.roofs import roof_force_kn, roof_landing
from sassgis.settings.results import ControlLine, ControlLineCrossings, Outcome

G = 9.81
STATION = ControlLine("line", "station")
GALLERY = ControlLine("line", "gallery", 1.0, width_m=0.5, roof_slope_deg=10.0, cushion_kpa=3200.0)
AT = 60.0


def past(line: ControlLine):
    """Blocks on a rough slope that meet a control line on their way down."""
    crossings = ControlLineCrossings.same_for_all([line], [AT], 1)
    return lab.run(
        lab.LINES["rough"], lab.ROCK, lab.MIXED, n=300, start=(10.0, 30.0),
        control_lines=crossings,
    )  # fmt: skip


def landing(above: float, vx: float, vz: float, slope: float) -> tuple[float, float]:
    found = roof_landing(np.array([above]), np.array([vx]), np.array([vz]), slope, G)
    return float(found[0][0]), float(found[1][0])


def test_a_block_lands_on_a_level_roof_where_its_parabola_does() -> None:
    # 1 s to fall 4.905 m: 8 m further at 8 m/s, at 9.81 m/s downward.
    assert landing(4.905, 8.0, 0.0, 0.0) == pytest.approx((8.0, 9.81))
    # Thrown up with 4.905 m/s from the edge it is back after 1 s.
    assert landing(0.0, 3.0, 4.905, 0.0) == pytest.approx((3.0, 4.905))


def test_a_block_lands_on_a_sloping_roof_where_small_steps_come_to_it() -> None:
    slope, x, y, vx, vz, step = math.tan(0.3), 0.0, 2.0, 6.0, 1.0, 1e-5
    while y > -slope * x:
        x, y, vz = x + vx * step, y + (vz - 0.5 * G * step) * step, vz - G * step
    into = -(vx * math.sin(0.3) + vz * math.cos(0.3))
    assert landing(2.0, 6.0, 1.0, slope) == pytest.approx((x, into), abs=1e-3)


def test_a_block_that_rolls_onto_a_roof_meets_it_at_its_edge() -> None:
    """Down 45° onto 10°: the angle between them is 35°."""
    distance, into = landing(0.0, 5.0, -5.0, math.tan(math.radians(10.0)))
    assert distance == 0.0
    assert into == pytest.approx(math.hypot(5.0, 5.0) * math.sin(math.radians(35.0)))


def test_force_by_hand() -> None:
    """A sphere of 0.5 m radius and 100 kJ on 3200 kPa: 1.765 · 25.240 · 0.87055 · 15.849."""
    mass = 2700.0 * 4.0 / 3.0 * math.pi * 0.125
    assert roof_force_kn(100.0, mass, 3200.0) == pytest.approx(614.6, rel=1e-3)


def test_a_gallery_moves_no_block_otherwise_than_a_wall_of_its_height() -> None:
    wall, gallery = past(ControlLine("line", "wall", 1.0)), past(GALLERY)
    assert (wall.rocks == gallery.rocks).all()
    assert not wall.passages["roof_energy_kj"].any()
    for name in ("control_line", "rock", "vx_mps", "vz_mps", "height_m", "energy_rot_kj"):
        assert (wall.passages[name] == gallery.passages[name]).all(), name
    before, after = wall.passages["outcome"], gallery.passages["outcome"]
    on_roof = after == Outcome.ON_ROOF
    # Each that tops the wall lands on the roof or flies over it.
    assert (after[~on_roof] == before[~on_roof]).all()
    assert (before[on_roof] == Outcome.OVERTOPPED).all()
    assert 0 < on_roof.sum() < (before == Outcome.OVERTOPPED).sum()
    assert ((gallery.passages["roof_energy_kj"] > 0.0) == on_roof).all()
    energy = gallery.passages["energy_trans_kj"]
    fallen = G * 1e-3 * gallery.passages["mass_kg"] * (gallery.passages["height_m"] + 6.0)
    assert (gallery.passages["roof_energy_kj"] < energy + fallen).all()


def test_nothing_flies_over_a_wide_gallery_and_nothing_lands_on_a_strip() -> None:
    wide, strip = (past(replace(GALLERY, width_m=w)).passages for w in (200.0, 1e-9))
    assert Outcome.OVERTOPPED not in wide["outcome"] and Outcome.ON_ROOF in wide["outcome"]
    # But for those whose centre passes lower than it would lie on the roof.
    assert (strip["height_m"][strip["outcome"] == Outcome.ON_ROOF] <= GALLERY.height_m).all()
    assert Outcome.OVERTOPPED in strip["outcome"]


def test_a_roof_level_with_the_ground_lets_all_blocks_pass() -> None:
    station, gallery = past(STATION), past(replace(GALLERY, height_m=0.0, width_m=200.0))
    assert (station.rocks == gallery.rocks).all()
    assert (gallery.passages["outcome"] == Outcome.ON_ROOF).all()
