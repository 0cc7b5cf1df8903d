"""Onset frequencies in all units and tables; volumes by a power law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers.zone_slope import box, gully, place, two_areas
from scipy import stats

from sassgis.errors import InputError
from sassgis.inputs.config import load_config
from sassgis.runs.inputs import yearly_frequencies
from sassgis.runs.resumable_run import read_job
from sassgis.settings.blocks import BlockPopulation
from sassgis.settings.map_run import BlockRows
from sassgis.simulation.loop import simulate_map

#: North: 8 x 9 cells of 4 m2; south: 7 x 9.
NORTH_M2, SOUTH_M2 = 288.0, 252.0


def frequencies(config: Path) -> dict[tuple[str, str], float]:
    read = load_config(config)
    return yearly_frequencies(read, read_job(read, None, lambda _: None).run.areas)


def test_frequencies_go_with_the_area_in_plan_and_the_length_of_a_line(tmp_path: Path) -> None:
    case = two_areas(tmp_path)
    case.blocks[0]["onset_unit"] = "per_year_ha"
    case.write()
    found = frequencies(case.config)
    assert found["north", "frequent"] == pytest.approx(0.4 * NORTH_M2 / 1e4, rel=1e-12)
    assert found["south", "frequent"] == pytest.approx(0.4 * SOUTH_M2 / 1e4, rel=1e-12)
    assert found["north", "rare"] == 0.03
    case.blocks[0]["onset_unit"], case.blocks[1]["onset_unit"] = "per_year", "per_year_m"
    case.write()
    # 6 cells south, 8 cells east; and 3-4-5 times 2 m.
    lines = [
        shapely.LineString([place(6, 20), place(6, 26), place(14, 26)]),
        shapely.LineString([place(6, 40), place(9, 44)]),
    ]
    case.write_layer("release.gpkg", lines, {"name": ["north", "south"]})
    found = frequencies(case.config)
    assert found["north", "rare"] == pytest.approx(0.03 * 28.0, rel=1e-12)
    assert found["south", "rare"] == pytest.approx(0.03 * 10.0, rel=1e-9)
    assert found["south", "frequent"] == 0.4


@pytest.mark.parametrize(
    ("unit", "shape", "of_it"),
    [
        ("per_year_ha", box(4.0, 20.0, 10.0, 9.0), box(8.0, 20.0, 6.0, 9.0)),
        ("per_year_m", *(shapely.LineString([place(c, 26), place(14, 26)]) for c in (4, 8))),
    ],
)
def test_ground_that_cannot_release_has_no_frequency(
    tmp_path: Path, unit: str, shape: shapely.Geometry, of_it: shapely.Geometry
) -> None:
    case = two_areas(tmp_path)
    case.blocks[0]["onset_unit"] = unit
    case.write()
    heights = gully()
    heights[:, :8] = np.nan
    case.write_dem(heights)
    found = []
    for own in (shape, of_it):
        case.write_layer("release.gpkg", [own], {"name": ["north"]})
        found.append(frequencies(case.config))
    assert found[0]["north", "frequent"] == pytest.approx(found[1]["north", "frequent"], rel=1e-8)
    assert found[0]["north", "rare"] == 0.03


@pytest.mark.parametrize(
    ("unit", "shape", "expected"),
    [
        ("per_year_m", box(4, 20, 8, 9), "release lines"),
        ("per_year_m", shapely.Point(*place(6, 22)), "release lines"),
        ("per_year_ha", shapely.LineString([place(6, 20), place(6, 26)]), "release polygons"),
        ("per_year_ha", shapely.Point(*place(6, 22)), "release polygons"),
    ],
)
def test_a_unit_must_fit_the_shape(
    tmp_path: Path, unit: str, shape: shapely.Geometry, expected: str
) -> None:
    case = two_areas(tmp_path)
    case.blocks[0]["onset_unit"] = unit
    case.write()
    case.write_layer("release.gpkg", [shape], {"name": ["north"]})
    with pytest.raises(InputError, match=expected) as caught:
        frequencies(case.config)
    assert caught.value.field == "blocks[frequent].onset_unit"


def test_a_table_speaks_of_single_areas(tmp_path: Path) -> None:
    case = two_areas(tmp_path, hazard={"frequencies": "frequencies.csv"})
    case.write_text(
        "frequencies.csv",
        "area,scenario,frequency,unit",
        "south,frequent,12.5,per_year_ha",
        "north,rare,0,per_year",
    )
    found = frequencies(case.config)
    assert found == {
        ("north", "frequent"): 0.4,
        ("north", "rare"): 0.0,
        ("south", "frequent"): pytest.approx(12.5 * SOUTH_M2 / 1e4, rel=1e-12),
        ("south", "rare"): 0.03,
    }


# ---------------------------------------------------------------------------------------------
# Power law

LOW, HIGH, B = 0.05, 20.0, 0.8


def drawn_volumes(folder: Path, exponent: float | None) -> np.ndarray:
    case = two_areas(folder)
    block = {
        "name": "law", "volume_m3": [LOW, HIGH], "shape": [1.0, [0.7, 0.9], 0.6],
        "onset_frequency": 0.1,
    }  # fmt: skip
    if exponent is not None:
        block["volume_exponent"] = exponent
    case.blocks[:] = [block]
    case.sections["release"]["rocks_per_point"] = 250
    case.write()
    job = read_job(load_config(case.config), None, lambda _: None)
    rows: list[BlockRows] = []
    simulate_map(job.run, job.planned, on_chunk=lambda _p, _n, own: rows.append(own))
    rocks = np.concatenate([r.rocks for r in rows])
    volume: np.ndarray = rocks["mass_kg"] / rocks["density_kgm3"]
    axes = 4.0 / 3.0 * np.pi * rocks["a_m"] * rocks["b_m"] * rocks["c_m"]
    np.testing.assert_allclose(volume, axes, rtol=1e-12)
    assert np.all((rocks["c_m"] / rocks["a_m"] > 0.599) & (rocks["c_m"] / rocks["a_m"] < 0.601))
    return volume


def test_volumes_follow_the_power_law(tmp_path: Path) -> None:
    """N(V > v) ~ v^-b between the limits: F(v) = (low^-b − v^-b) / (low^-b − high^-b)."""
    volume = drawn_volumes(tmp_path, B)
    assert volume.size > 1500 and volume.min() >= LOW * 0.999 and volume.max() <= HIGH * 1.001

    def share_below(v: np.ndarray) -> np.ndarray:
        return (LOW**-B - np.clip(v, LOW, HIGH) ** -B) / (LOW**-B - HIGH**-B)

    assert stats.kstest(volume, share_below).pvalue > 0.01
    # The test can tell: another exponent, or volumes that are all equally likely, do not pass.
    assert stats.kstest(volume, lambda v: share_below(v) ** 1.2).pvalue < 1e-4


def test_without_an_exponent_all_volumes_are_equally_likely(tmp_path: Path) -> None:
    volume = drawn_volumes(tmp_path, None)
    assert stats.kstest(volume, stats.uniform(LOW, HIGH - LOW).cdf).pvalue > 0.01


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 1.3])
def test_mean_width_is_that_of_the_drawn_blocks(exponent: float) -> None:
    """Twice the mean semi-axis, over volumes and shapes."""
    blocks = BlockPopulation(
        axis_1_m=(1.0, 1.0), axis_2_m=(0.7, 0.9), axis_3_m=(0.6, 0.6),
        volume_m3=(LOW, HIGH), volume_exponent=exponent,
    )  # fmt: skip
    q = (np.arange(200_000) + 0.5) / 200_000
    if exponent == 0.0:
        volume = LOW * (HIGH / LOW) ** q
    else:
        volume = (LOW**-exponent - q * (LOW**-exponent - HIGH**-exponent)) ** (-1.0 / exponent)
    scale = np.cbrt(volume / (4.0 / 3.0 * np.pi * 1.0 * 0.8 * 0.6)).mean()
    assert blocks.mean_width_m == pytest.approx(2.0 * scale * (1.0 + 0.8 + 0.6) / 3.0, rel=0.01)
    same = replace(blocks, volume_m3=None, volume_exponent=None)
    assert same.mean_width_m == pytest.approx(1.6)


def test_the_frequency_above_a_volume_gives_that_between_the_limits(tmp_path: Path) -> None:
    """0.2 blocks above 1 m³ a year, b = 0.5, volumes from 0.25 to 4 m³.

    Above 0.25 m³ there are 0.2 · 0.25^-0.5 = 0.4 a year, above 4 m³ 0.2 · 4^-0.5 = 0.1, and 0.3
    between them.
    """
    case = two_areas(tmp_path)
    law = {
        "name": "law", "volume_m3": [0.25, 4.0], "volume_exponent": 0.5, "onset_frequency": 0.2,
        "onset_above_m3": 1.0,
    }  # fmt: skip
    case.blocks[:] = [law]
    case.write()
    assert frequencies(case.config)["north", "law"] == pytest.approx(0.3, rel=1e-12)
    # Two scenarios that share the range out have together what one has.
    case.blocks[:] = [
        {**law, "name": "small", "volume_m3": [0.25, 1.5]},
        {**law, "name": "large", "volume_m3": [1.5, 4.0]},
    ]
    case.write()
    found = frequencies(case.config)
    assert found["north", "small"] + found["north", "large"] == pytest.approx(0.3, rel=1e-12)
    assert found["north", "large"] == pytest.approx(0.2 * (1.5**-0.5 - 0.5), rel=1e-12)
