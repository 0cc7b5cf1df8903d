"""A uniform slope whose level map can be worked out by hand.

Spheres that are let go at rest on a plane roll, and nothing else: dv/dt = g (sin β − μ_r cos β), so
that x metres (in plan) below the start v² = 2 g x (tan β − μ_r). With the rotation, ω = v/r and
I = 2/5 m r², the energy is E(x) = 0.7 m v² = 1.4 m g x (tan β − μ_r). A rock's energy in a cell is
that at its lower border where it gains speed, at its upper border where it loses some.

The plane falls by 40 degrees to the east, cells are 2 m. μ_r = 0.4 as far as column 49, from column
50 on (x = 100 m) it is 1.5. What counts for a cell is the rock's centre, which is r sin β ahead of
the point where it touches the ground: it begins to lose speed at x = 100.26 m (r = 0.4 m) or
100.51 m (r = 0.8 m). All rocks of a source are equal and start in the middle of a cell of row 10, so
each cell on their way has reach probability 1.

    m = 4/3 π r³ · 2500 kg/m³
    small, r = 0.4 m: gains 1.4 m g (0.8391 − 0.4) = 4.0417 kJ a metre, then loses 6.0832
    large, r = 0.8 m: 8 times the mass, gains 32.334 kJ a metre, then loses 48.665

    area    block  start  once in  30 kJ from    300 kJ from   most       300 kJ until  30 kJ until    stops at
    top     small   5 m   2000 a   12.4 (col 6)  79.2 (col 39)  385.0 kJ  114.2 (col 57)  158.6 (col 79)  163.5 (col 81)
    middle  small  11 m    150 a   18.4 (col 9)  85.2 (col 42)  360.8 kJ  110.2 (col 55)  154.6 (col 77)  159.6 (col 79)
    low     large  51 m    200 a   51.9 (col 25) 60.3 (col 30) 1601.0 kJ  127.2 (col 63)  132.8 (col 66)  133.4 (col 66)

Where "middle" and "low" both come, rocks come 1/150 + 1/200 + 1/2000 = 0.01217 times a year: once in
82 years, so frequencies of two sources add up to another class of return period.
"""  # noqa: E501

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import shapely
from helpers.map_bands import read_band
from helpers.zone_slope import CELL, Case, box, place, plane, zoned

from sassgis.hazard.curves import rate_interval
from sassgis.runs.run import ZoneResult, zone

ROWS, COLS, ROW = 21, 90, 10
TOP, MIDDLE, LOW = 1.0 / 2000.0, 1.0 / 150.0, 1.0 / 200.0
CLASSES = (
    "name,eta_max,dp_min,dp_max,mu_f,mu_0,k,d_star_m,restitution,restitution_speed_mps,rolling_threshold,source,trust",
    "smooth,0.5,0.1,0.2,0.9,0.4,0.17,0,0,9,0.1,invented,estimate",
    "rough,0.5,0.1,0.2,0.9,1.5,0.17,0,0,9,0.1,invented,estimate",
)

#: First and last column, level of the federal matrix (1 residual, 2 slight, 3 mean, 4 substantial).
LEVELS = [
    (2, 4, 1),  # top alone, low intensity, once in 2000 years
    (5, 8, 2),  # middle comes: low intensity once in 140 years; top's 30 kJ are residual
    (9, 29, 3),  # 30 kJ once in 140 years; from 25 once in 82: both fields are "mean"
    (30, 63, 4),  # 300 kJ once in 200 years or more often
    (64, 77, 3),  # no 300 kJ any more, 30 kJ once in 140 years
    (78, 79, 2),  # the last metres of middle, below 30 kJ; top's 30 kJ are residual
    (80, 81, 1),  # top alone
]
#: Intensity: nothing comes once in 30 years.
INTENSITIES: dict[str, list[tuple[int, int, int]]] = {
    "30": [],
    # All sources together, as far as low comes; 30 kJ of middle + low; 300 kJ of middle + low.
    "100": [(25, 41, 2), (42, 55, 3), (56, 66, 2)],
    # Middle or low alone suffice.
    "300": [(5, 8, 1), (9, 29, 2), (30, 63, 3), (64, 77, 2), (78, 79, 1)],
    "extreme": [(2, 5, 1), (6, 29, 2), (30, 63, 3), (64, 79, 2), (80, 81, 1)],
}


def sphere(name: str, radius: float, **more: object) -> dict[str, object]:
    axes = {f"axis_{i}_m": radius for i in (1, 2, 3)}
    return {"name": name, **axes, "density_kgm3": 2500.0, **more}


def rolling_case(folder: Path) -> Case:
    case = Case(
        folder,
        {
            "terrain": {"dem": "dem.tif"},
            "release": {
                "file": "release.gpkg", "name_field": "name", "scenario_field": "scenario",
                "rocks_per_point": 3,
            },
            "ground": {"default": "smooth", "classes": "classes.csv", "file": "ground.gpkg"},
            # Without chance a path that is followed is the fall line of the plane.
            "engine": {
                "slope_variation": "off", "side_tilt_deg": 0.0, "drift_deg": 0.0,
                "rolling_friction_sd": 0.0, "outline_edges": 0.0,
            },
            # Zones that are the cells themselves.
            "zones": {"min_area_m2": 0.0, "closing_m": 0.0, "min_width_m": 0.0, "tolerance_m": 0.0},
            "hazard": {"frequencies": "frequencies.csv", "ref_width_m": 2.0},
            "run": {"seed": 3, "jobs": 1},
        },
        [sphere("small", 0.4), sphere("large", 0.8)],
    )  # fmt: skip
    case.write_dem(plane(ROWS, COLS))
    starts = [shapely.Point(*place(col + 0.5, ROW + 0.5)) for col in (2, 5, 25)]
    case.write_layer(
        "release.gpkg",
        starts,
        {"name": ["top", "middle", "low"], "scenario": ["small", "small", "large"]},
    )
    case.write_layer("ground.gpkg", [box(50, 0, COLS - 50, ROWS)], {"class": ["rough"]})
    case.write_text("classes.csv", *CLASSES)
    case.write_text(
        "frequencies.csv",
        "area,scenario,frequency,unit",
        f"top,small,{TOP!r},per_year",
        f"middle,small,{MIDDLE!r},per_year",
        f"low,large,{LOW!r},per_year",
    )
    case.write()
    return case


@pytest.fixture(scope="module")
def rolled(tmp_path_factory: pytest.TempPathFactory) -> ZoneResult:
    folder = tmp_path_factory.mktemp("rolled")
    return zone(rolling_case(folder).config, folder / "out", jobs=1)


def strip(spans: list[tuple[int, int, int]]) -> np.ndarray:
    """Classes on the grid: those of the spans in the row of the rocks, 0 elsewhere."""
    out = np.zeros((ROWS, COLS), np.int64)
    for first, last, value in spans:
        out[ROW, first : last + 1] = value
    return out


def test_the_energies_are_those_of_the_formula(rolled: ZoneResult) -> None:
    """Without this, the spans above would mean nothing."""
    gain = 1.4 * (4.0 / 3.0 * np.pi * 0.4**3 * 2500.0) * 9.81e-3
    tan = np.tan(np.radians(40.0))
    borders = CELL * np.arange(COLS + 1)

    def energy(start: float, radius: float) -> np.ndarray:
        """Largest in each column."""
        turn = 100.0 + radius * np.sin(np.radians(40.0))
        x = np.sort(np.append(borders, turn))
        e = (tan - 0.4) * (np.minimum(x, turn) - start) + (tan - 1.5) * np.maximum(x - turn, 0.0)
        e = np.where(x < start, 0.0, (radius / 0.4) ** 3 * gain * np.maximum(e, 0.0))
        return np.array([e[(x >= a) & (x <= a + CELL)].max() for a in borders[:-1]])

    most = np.max([energy(5.0, 0.4), energy(11.0, 0.4), energy(51.0, 0.8)], axis=0)
    found = read_band(rolled.run.folder, "energy", "max").filled(0)
    np.testing.assert_allclose(found[ROW], most, rtol=1e-6)
    assert not np.delete(found, ROW, axis=0).any()


def test_level_map(rolled: ZoneResult) -> None:
    found = read_band(rolled.run.folder, "hazard_level", "level").filled(0)
    assert np.array_equal(found, strip(LEVELS))


@pytest.mark.parametrize("years", INTENSITIES)
def test_intensity_maps(rolled: ZoneResult, years: str) -> None:
    found = read_band(rolled.run.folder, f"intensity_{years}", "intensity").filled(0)
    assert np.array_equal(found, strip(INTENSITIES[years]))


def test_rates_are_the_frequencies_themselves(rolled: ZoneResult) -> None:
    curves = rolled.found.hazard.curves
    rate = np.zeros((COLS, 3))
    assert (curves.places // COLS == ROW).all()
    columns = [curves.column(e) for e in (0.0, 30.0, 300.0)]
    rate[curves.places % COLS] = curves.rate[:, columns]
    wanted = np.zeros((COLS, 3))
    for frequency, spans in (
        (TOP, [(2, 81), (6, 79), (39, 57)]),
        (MIDDLE, [(5, 79), (9, 77), (42, 55)]),
        (LOW, [(25, 66), (25, 66), (30, 63)]),
    ):
        for i, (first, last) in enumerate(spans):
            wanted[first : last + 1, i] += frequency
    np.testing.assert_allclose(rate, wanted, rtol=1e-14)
    # Every rock does the same: nothing is left to chance.
    assert np.all(curves.variance == 0.0)


def test_zones_are_the_rectangles(rolled: ZoneResult) -> None:
    zones = gpd.read_file(rolled.run.folder / "hazard.gpkg", layer="hazard_zones")
    codes = ["residual_hazard", "slight", "mean", "substantial"]
    assert len(zones) == len(LEVELS)
    for first, last, level in LEVELS:
        wanted = box(first, ROW, last + 1 - first, 1)
        same = [g.symmetric_difference(wanted).area < 1e-9 for g in zones.geometry]
        assert sum(same) == 1
        row = zones[same].iloc[0]
        assert row["hazard_level"] == codes[level - 1]
        assert row["area_m2"] == (last + 1 - first) * CELL**2 == row["cells"] * CELL**2
    # Who makes the level: at the deciding energy middle has 1/150 of 1/150 + 1/2000 ...
    west = zones[[g.contains(shapely.Point(*place(6.5, 10.5))) for g in zones.geometry]].iloc[0]
    share = 100.0 * MIDDLE / (MIDDLE + TOP)
    assert west["governing_area"] == "middle"
    assert west["share_by_area"] == f"middle {share:.0f} %, top {100.0 - share:.0f} %"


def test_a_reach_probability_that_is_known(tmp_path: Path) -> None:
    """One source of spheres, r = 0.4 m, of densities evenly spread from 2000 to 3000 kg/m³.

    E is proportional to the density, so that at a border x metres below the start
    P(E >= e) = (3000 − 2500 e/E_2500(x)) / 1000 within 0 and 1, with E_2500 = 4.0417 kJ/m · x.
    """
    case = rolling_case(tmp_path)
    n, frequency = 400, 0.02
    case.blocks[0]["density_kgm3"] = [2000.0, 3000.0]
    case.sections["release"]["rocks_per_point"] = n
    case.write_text(
        "frequencies.csv", "area,scenario,frequency,unit", f"middle,small,{frequency},per_year"
    )
    case.write()
    found = zoned(case.config, tmp_path / "work", areas=["middle"]).found.hazard
    curves = found.curves
    gain = 1.4 * (4.0 / 3.0 * np.pi * 0.4**3 * 2500.0) * 9.81e-3
    gain *= np.tan(np.radians(40.0)) - 0.4
    col = curves.places % COLS
    faster = col < 50
    energy = gain * (CELL * (col + 1) - 11.0)
    lower, upper = rate_interval(curves, 0.9999)
    for e in (30.0, 300.0):
        at = curves.column(e)
        p = np.clip((3000.0 - 2500.0 * e / energy) / 1000.0, 0.0, 1.0)[faster]
        some = (p > 0.02) & (p < 0.98)
        assert some.sum() >= (2 if e == 30.0 else 8)
        rate = curves.rate[faster, at]
        assert np.all(rate[p == 1.0] == frequency) and np.all(rate[p == 0.0] == 0.0)
        assert np.all((lower[faster, at] <= frequency * p) & (frequency * p <= upper[faster, at]))
        # The variance of a share: f² p (1 − p)/(n − 1), with the share that was found.
        share = rate[some] / frequency
        wanted = frequency**2 * share * (1.0 - share) / (n - 1)
        np.testing.assert_allclose(curves.variance[faster, at][some], wanted, rtol=1e-9)
    # Once in 50 years is "mean" at any energy below 300 kJ.
    assert set(found.levels.classes) == {3, 4}
