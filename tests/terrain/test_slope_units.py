"""Cliffs from the distribution of slope angles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sassgis.errors import InputError
from sassgis.grid import Grid
from sassgis.terrain.slope_units import cliff_patches, slope_units, slopes_deg

PLAIN, SLOPE, CLIFF = (6.0, 3.0, 0.35), (31.0, 6.0, 0.60), (60.0, 7.0, 0.05)


#: A unit as mean, standard deviation (degrees) and share of the surface.
Unit = tuple[float, float, float]


def drawn(*units: Unit, cells: int = 60_000, seed: int = 3) -> np.ndarray:
    """Slopes of cells of a terrain whose *surface* is shared by the units."""
    rng = np.random.default_rng(seed)
    parts = []
    for mean, sd, share in units:
        own = rng.normal(mean, sd, round(2.0 * share * cells))
        own = own[(own > 0.0) & (own < 85.0)]
        # A cell in plan carries 1 / cos of its surface.
        parts.append(own[rng.random(own.size) < np.cos(np.radians(own))])
    return np.concatenate(parts)


def crossing(one: Unit, two: Unit) -> float:
    """Where two Gaussians are equally dense, between their means (closed form)."""
    (m1, s1, p1), (m2, s2, p2) = one, two
    a = 1.0 / s2**2 - 1.0 / s1**2
    b = 2.0 * (m1 / s1**2 - m2 / s2**2)
    c = m2**2 / s2**2 - m1**2 / s1**2 + 2.0 * math.log(p1 * s2 / (p2 * s1))
    roots = np.roots([a, b, c]) if a else np.array([-c / b])
    return float(next(r for r in roots if m1 < r < m2))


def test_units_and_their_limits_are_found_again() -> None:
    found = slope_units(drawn(PLAIN, SLOPE, CLIFF))
    assert [u.name for u in found.units] == ["plains", "steep slopes", "cliffs"]
    for unit, (mean, sd, share) in zip(found.units, (PLAIN, SLOPE, CLIFF), strict=True):
        assert unit.mean_deg == pytest.approx(mean, abs=0.8)
        assert unit.sd_deg == pytest.approx(sd, abs=0.8)
        assert unit.share == pytest.approx(share, rel=0.12)
    assert found.cliff_deg == pytest.approx(crossing(SLOPE, CLIFF), abs=0.8)
    assert found.steep_deg == pytest.approx(crossing(PLAIN, SLOPE), abs=0.8)
    assert found.misfit < 0.002


def test_shares_of_the_surface_make_up_the_surface() -> None:
    """Half of a unit of plains about 0 degrees lies beyond the slopes that there are."""
    found = slope_units(drawn((0.0, 3.0, 0.6), (31.0, 6.0, 0.6), (60.0, 7.0, 0.1)))
    assert [u.surface_share for u in found.units] == pytest.approx([0.3, 0.6, 0.1], abs=0.02)


def test_a_unit_of_one_percent_is_not_lost() -> None:
    rare = (62.0, 5.0, 0.01)
    found = slope_units(drawn((25.0, 7.0, 0.99), rare))
    assert found.units[-1].mean_deg == pytest.approx(rare[0], abs=2.0)
    assert found.cliff_deg == pytest.approx(crossing((25.0, 7.0, 0.99), rare), abs=1.5)


def test_two_units_have_one_limit() -> None:
    found = slope_units(drawn((20.0, 5.0, 0.7), (50.0, 5.0, 0.3)))
    assert len(found.units) == 2 and found.steep_deg == found.cliff_deg
    # Equal widths: mean of the means, moved by s² ln(p1 / p2) / (m2 - m1).
    want = 35.0 + 25.0 * math.log(0.7 / 0.3) / 30.0
    assert found.cliff_deg == pytest.approx(want, abs=0.5)


def valley() -> tuple[Grid, np.ndarray]:
    """A plain, a slope and a cliff in bands, with dents; and where the cliff is."""
    rng = np.random.default_rng(11)
    angles = np.repeat([6.0, 31.0, 60.0, 31.0], [60, 80, 12, 48]) + rng.normal(0.0, 2.0, 200)
    drop = np.concatenate([[0.0], np.cumsum(2.0 * np.tan(np.radians(angles)))[:-1]])
    rows = rng.normal(0.0, 0.03, (120, 1))
    heights = drop[None, :] + rows + rng.normal(0.0, 0.05, (120, 200))
    cliff = np.zeros((120, 200), bool)
    cliff[:, 140:152] = True
    return Grid(heights, 2_700_000.0, 1_150_000.0, 2.0), cliff


def test_the_cliff_of_a_terrain_of_known_units_is_proposed() -> None:
    grid, cliff = valley()
    slopes = slopes_deg(grid.values, grid.cell_size, grid.cell_size)
    found = slope_units(slopes)
    assert 36.0 < found.cliff_deg < 56.0
    patches = cliff_patches(slopes, found.cliff_deg, 10)
    assert patches.max() == 1
    # Slopes are between neighbours on both sides: the rim is one cell uncertain.
    assert (patches[:, 142:150] == 1).all()
    assert not patches[:, :139].any() and not patches[:, 153:].any()
    assert (patches > 0).sum() == pytest.approx(cliff.sum(), rel=0.1)


def test_rock_on_steep_slopes_counts_and_patches_are_ordered() -> None:
    slopes = np.full((20, 20), 35.0)
    slopes[2:6, 2:6] = 60.0
    slopes[10, 10] = 60.0
    rock = np.zeros((20, 20), bool)
    rock[12:18, 12:18] = True
    rock[0, 19] = True
    slopes[12, 12] = np.nan
    patches = cliff_patches(slopes, 50.0, 2, rock, 30.0)
    assert np.bincount(patches.ravel())[1:].tolist() == [35, 16]
    assert patches[13, 13] == 1 and patches[12, 12] == 0 and patches[10, 10] == 0
    assert cliff_patches(slopes, 50.0, 2).max() == 1


def test_too_few_cells_make_no_distribution() -> None:
    with pytest.raises(InputError, match="too few cells"):
        slope_units(np.full(100, 30.0))


def test_slopes_without_cliffs_are_reported() -> None:
    with pytest.raises(InputError, match="no cliffs"):
        slope_units(drawn((6.0, 3.0, 0.4), (30.0, 5.0, 0.6)))
