"""Roofs of galleries: where blocks land on them, and the force."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import engine_lab as lab

from sassgis.engine.roofs import roof_force_kn, roof_landing
from sassgis.settings.results import ControlLine, ControlLineCrossings, Outcome

G = 9.81
STATION = ControlLine("line", "station")
GALLERY = ControlLine("line", "gallery", 1.0, width_m=0.5, roof_slope_deg=10.0, cushion_kpa=3200.0)
AT = 60.0


def past(*lines: ControlLine, at: float = AT, **changes: Any):
    """Blocks on a rough slope that meet control lines on their way down, one after another."""
    places = [at + 10.0 * i for i in range(len(lines))]
    crossings = ControlLineCrossings.same_for_all(lines, places, 1)
    case = {"line": lab.LINES["rough"], "table": lab.ROCK, "blocks": lab.MIXED, "n": 300}
    case |= {"start": (10.0, 30.0)} | changes
    return lab.run(
        case.pop("line"), case.pop("table"), case.pop("blocks"), control_lines=crossings, **case
    )


def landing(above: float, vx: float, vz: float, slope: float) -> tuple[float, float]:
    return tuple(roof_landing(above, vx, vz, slope, G)[:2])


def on_a_roof(speed: float, **roof: float):
    """A sphere that slides down an even slope of 40° onto a roof, and is passed by once more."""
    gallery = replace(GALLERY, height_m=0.0, **roof)
    found = past(
        gallery, STATION, line=lab.slope((300, 40)), table=lab.plain(mu_f=0.8391),
        blocks=lab.sphere(0.5, speed_mps=(speed, speed)), n=1, start=10.0, at=30.0,
    )  # fmt: skip
    return found.rocks[0], found.passages


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


def test_a_gallery_hits_as_a_wall_and_carries_what_goes_over_it() -> None:
    wall, gallery = past(ControlLine("line", "wall", 1.0)), past(GALLERY)
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
    other = np.isin(wall.rocks["rock"], gallery.passages["rock"][on_roof])
    assert (wall.rocks[~other] == gallery.rocks[~other]).all()


def test_a_block_ends_on_a_roof_or_leaves_it_at_its_lower_edge() -> None:
    roof = replace(GALLERY, height_m=0.0, width_m=9.0)
    wide = past(roof, STATION, start=(30.0, 58.0))
    came = wide.passages[wide.passages["outcome"] == Outcome.ON_ROOF]
    ends = wide.rocks[np.searchsorted(wide.rocks["rock"], came["rock"])]
    stays = ends["reason"] == lab.BARRIER
    assert 0 < stays.sum() < stays.size
    assert (ends["runout_m"][stays] == AT).all() and (ends["furthest_m"][~stays] > AT + 9.0).all()
    # What comes on to the station has not gained more than it has fallen.
    beyond = wide.passages[wide.passages["control_line"] == 1]
    both = np.intersect1d(came["rock"][~stays], beyond["rock"])
    assert both.size > 10
    first, then = (rows[np.isin(rows["rock"], both)] for rows in (came, beyond))
    gained = sum(then[q] - first[q] for q in ("energy_trans_kj", "energy_rot_kj"))
    fallen = 10.0 * math.tan(math.radians(36.0)) + first["height_m"] + 1.5
    assert (gained < 1e-3 * G * first["mass_kg"] * fallen).all()


def test_a_block_that_slides_onto_a_roof_leaves_it_by_hand() -> None:
    """Down 40° onto 10°: cos 30° of the speed is left, two sevenths of it go into the spin."""
    ends, passages = on_a_roof(12.0, width_m=4.0)
    speed = 12.0 * math.cos(math.radians(30.0)) / 1.4
    slope, length = math.radians(10.0), 4.0 / math.cos(math.radians(10.0))
    left2 = speed**2 + 2.0 * G * (math.sin(slope) - 0.45 * math.cos(slope)) * length
    assert passages["outcome"][0] == Outcome.ON_ROOF
    # The lower edge lies 2.65 m above the ground; the station is 6 m away in plan.
    vx, vz = (math.sqrt(left2) * part for part in (math.cos(slope), -math.sin(slope)))
    fallen = vz * 6.0 / vx - 0.5 * G * (6.0 / vx) ** 2
    above = 0.5 / math.cos(slope) - 4.0 * math.tan(slope) + 10.0 * math.tan(math.radians(40.0))
    height = above + fallen - 0.5 / math.cos(math.radians(40.0))
    assert height > 0.0
    assert passages["vx_mps"][1] == pytest.approx(vx, rel=1e-3)
    assert passages["height_m"][1] == pytest.approx(height, abs=0.02)
    at_station = passages["energy_trans_kj"][1] + passages["energy_rot_kj"][1]
    gained = -1e-3 * G * passages["mass_kg"][0] * fallen
    assert passages["roof_left_kj"][0] == pytest.approx(at_station - gained, rel=1e-3)
    # On a level roof of 20 m, 0.45 g over its length is more than it has.
    ends, passages = on_a_roof(12.0, width_m=20.0, roof_slope_deg=0.0)
    assert (ends["reason"], ends["runout_m"], len(passages)) == (lab.BARRIER, 30.0, 1)
    assert passages["roof_left_kj"][0] == 0.0


def test_a_block_that_ends_on_a_roof_lies_on_it() -> None:
    roof = replace(GALLERY, height_m=3.0, width_m=30.0, roof_slope_deg=0.0)
    found = past(
        roof, line=lab.slope((300, 40)), blocks=lab.sphere(0.5, drop_m=(8, 8), speed_mps=(8, 8)),
        n=1, start=25.0, at=30.0,
    )  # fmt: skip
    edge = 500.0 - 30.0 * math.tan(math.radians(40.0)) + 3.0
    assert found.rocks["runout_m"][0] == 30.0
    assert found.rocks["runout_z_m"][0] == pytest.approx(edge + 0.5)


def test_a_block_pays_for_its_rise_where_a_roof_ends_in_the_ground() -> None:
    """Without friction on the way the energy would be that of its height on the line."""
    steep = replace(GALLERY, height_m=0.0, width_m=20.0, roof_slope_deg=60.0)
    for foot, ends in ((20.0, False), (-20.0, True)):
        found = past(
            steep, line=lab.slope((30, 40), (20, foot), (50, 0)), table=lab.plain(mu_f=0.8391),
            blocks=lab.sphere(0.5, speed_mps=(12, 12)), n=1, start=10.0, at=30.0, log_events=9,
        )  # fmt: skip
        assert (found.rocks["reason"][0] == lab.BARRIER) == ends
        over, off = found.event_logs[0][1:3]
        assert math.hypot(over["ux"], over["uz"]) == pytest.approx(1.0)
        energy = 0.5 * (off["vx_mps"] ** 2 + off["vz_mps"] ** 2 + 0.1 * off["omega_radps"] ** 2)
        assert energy < 0.5 * 12.0**2 + G * (over["z_m"] - off["z_m"])


def test_a_block_through_a_net_at_the_edge_of_a_roof_lands_there() -> None:
    net = ControlLine("net", "net", 2.0, 5.0)
    roof = replace(GALLERY, height_m=0.0, width_m=4.0)
    both = [
        lab.run(
            lab.slope((300, 40)), lab.plain(mu_f=0.8391), lab.sphere(0.5, speed_mps=(12, 12)),
            start=10.0,
            control_lines=ControlLineCrossings.same_for_all([*lines, STATION], [30, 30, 40], 1),
        )
        for lines in ((net, roof), (roof, net))
    ]  # fmt: skip
    outcomes = [set(found.passages["outcome"]) for found in both]
    assert outcomes == 2 * [{Outcome.BROKE_THROUGH, Outcome.ON_ROOF, Outcome.PASSED}]
    assert both[0].rocks == both[1].rocks
    alone = on_a_roof(12.0, width_m=4.0)[1]
    assert both[0].passages["vx_mps"][2] < alone["vx_mps"][1]


def test_no_block_on_a_roof_reaches_the_cells_under_it() -> None:
    gallery = replace(GALLERY, height_m=0.0, width_m=20.0, roof_slope_deg=30.0)
    free, covered = (past(line).kept["exceed"][:, 0] for line in (STATION, gallery))
    under = slice(31, 39)  # cells of 2 m
    assert (free[under] > 0).all() and not covered[under].any()
    assert (covered[:30] == free[:30]).all() and covered[41] > 0


def test_nothing_flies_over_a_wide_gallery_and_nothing_lands_on_a_strip() -> None:
    wide, strip = (past(replace(GALLERY, width_m=w)).passages for w in (200.0, 1e-9))
    assert Outcome.OVERTOPPED not in wide["outcome"] and Outcome.ON_ROOF in wide["outcome"]
    # But for those whose centre passes lower than it would lie on the roof.
    assert (strip["height_m"][strip["outcome"] == Outcome.ON_ROOF] <= GALLERY.height_m).all()
    assert Outcome.OVERTOPPED in strip["outcome"]


def test_a_roof_level_with_the_ground_hits_no_block() -> None:
    station, gallery = past(STATION), past(replace(GALLERY, height_m=0.0, width_m=200.0))
    assert (station.passages["vx_mps"] == gallery.passages["vx_mps"]).all()
    assert (gallery.passages["outcome"] == Outcome.ON_ROOF).all()
