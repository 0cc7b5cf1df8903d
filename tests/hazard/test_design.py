"""Design values of barriers: what is exceeded once in so many years, by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import shapely

from sassgis.hazard.curves import Arrivals
from sassgis.hazard.design import (
    arrivals,
    net_class,
    rocks_beyond,
    value_at_rate,
    value_limits,
)
from sassgis.hazard.sources import Sampled, line_parts
from sassgis.outputs.zone_tables import (
    design_table,
    places_table,
    protection_table,
    stays_above,
)
from sassgis.report.map_report import control_line_tables
from sassgis.report.page import sensible
from sassgis.report.protection_page import needs_table
from sassgis.runs.publish import line_facts
from sassgis.settings.hazard_rules import HazardCurves, Source, SourceCounts
from sassgis.settings.results import PASSAGE_DTYPE, ControlLine, Outcome
from sassgis.simulation.control_lines import ControlLineSums, control_line_rows, energy_behind


def curve_of(edges: np.ndarray, above: np.ndarray, w: float, largest: float) -> Arrivals:
    """The curve of so many blocks of a weight at or above each edge."""
    curves = HazardCurves(
        np.zeros(1, int), edges, w * above[None], w * w * above[None], np.array([w])
    )
    return Arrivals(edges, w * above, above, largest, curves)


#: Ten, four and one rocks a year at 0, 10 and 20 m or more; none above 23 m. Each simulated one is
#: a tenth of a rock a year.
CURVE = curve_of(np.array([0.0, 10.0, 20.0, 30.0]), np.array([100, 40, 10, 0]), 0.1, 23.0)


@pytest.mark.parametrize(
    ("rate", "value"),
    [
        # From 4 to 1 a year over 10 m: 2.5 a year are exceeded half way.
        (2.5, 15.0),
        (7.0, 5.0),
        # None lies above the largest that was seen.
        (0.1, 23.0),
        # Rocks come less often.
        (10.0, math.nan),
        (12.0, math.nan),
    ],
)
def test_values_lie_between_the_edges_as_if_rocks_were_spread_evenly(
    rate: float, value: float
) -> None:
    assert value_at_rate(CURVE, rate) == pytest.approx(value, rel=0.0, abs=0.0, nan_ok=True)
    assert rocks_beyond(CURVE, 2.5) == 10


def test_where_no_rock_comes_there_is_no_design_value() -> None:
    nothing = curve_of(CURVE.edges, np.zeros(4, int), 0.0, math.nan)
    assert math.isnan(value_at_rate(nothing, 0.01))
    assert all(math.isnan(v) for v in value_limits(nothing, 0.01, 0.95))


def test_limits_hold_the_value_of_all_blocks() -> None:
    """Energies of an exponential law: limits of 90 % hold the truth in some 90 % of samples."""
    rng, edges, rate, years = np.random.default_rng(4), np.arange(0.0, 200.5, 0.5), 0.5, 100.0
    truth = 10.0 * math.log(rate * years)
    blocks, inside = 400, 0
    for _ in range(300):
        came = rng.poisson(blocks)
        counts, _ = np.histogram(rng.exponential(10.0, came), edges)
        above = np.append(np.cumsum(counts[::-1])[::-1], 0)
        w = rate / blocks
        curve = curve_of(edges, above, w, 1e3)
        low, high = value_limits(curve, 1.0 / years, 0.9)
        assert low <= value_at_rate(curve, 1.0 / years) <= high
        inside += low <= truth <= high
    assert 0.87 <= inside / 300 <= 0.97


def test_limits_end_where_the_sample_does() -> None:
    low, high = value_limits(CURVE, 2.5, 0.95)
    assert 10.0 < low < 15.0 < high < 20.0
    # Less than four blocks beyond a value do not say where it ends.
    assert math.isnan(value_limits(CURVE, 0.3, 0.95)[1])
    # Blocks may come less often than ten times a year.
    assert value_limits(CURVE, 9.9, 0.95)[0] == 0.0
    # Weights of two blocks each, half as many: wider.
    coarse = curve_of(CURVE.edges, CURVE.rocks // 2, 0.2, 23.0)
    assert value_limits(coarse, 2.5, 0.95)[0] < low and value_limits(coarse, 2.5, 0.95)[1] > high


def test_class_of_a_net_is_the_lowest_that_takes_the_energy() -> None:
    assert [net_class(e) for e in (99.0, 100.0, 100.1, 2500.0, 4500.1)] == list("00168")
    assert net_class(math.nan) == ""


def test_what_goes_on_behind_a_net_is_all_over_it_the_rest_through_it_and_nothing_else() -> None:
    outcome = np.array(
        [Outcome.STOPPED, Outcome.HELD_BY_NET, Outcome.OVERTOPPED, Outcome.BROKE_THROUGH], np.uint8
    )
    behind = energy_behind(np.full(4, 700.0), outcome, np.full(4, 500.0), np.zeros(4))
    assert list(behind) == [0.0, 0.0, 700.0, 200.0]


def test_what_goes_on_behind_a_gallery_is_what_leaves_its_roof() -> None:
    outcome = np.full(2, Outcome.ON_ROOF, np.uint8)
    left = np.array([0.0, 30.0])
    assert list(energy_behind(np.full(2, 700.0), outcome, np.full(2, np.inf), left)) == [0.0, 30.0]


def passages(outcome: list[Outcome]) -> np.ndarray:
    """A hundred blocks of 2700 kg, 5 m high and of 1 to 100 kJ, with outcomes in turn."""
    rows = np.zeros(100, PASSAGE_DTYPE)
    rows["outcome"] = np.resize(outcome, 100)
    rows["energy_trans_kj"] = np.arange(1, 101)
    rows["height_m"], rows["mass_kg"] = 5.0, 2700.0
    return rows


NET = ControlLine("net", "net", 4.0, 1000.0)


def sampled(sums: ControlLineSums, per_year: float = 1.0) -> list[Sampled]:
    """A source of a hundred blocks of which only what comes to the lines is known."""
    none = SourceCounts.none(1)
    return [Sampled(Source("cliff", "block", per_year, 100, 10), none, none, sums)]


def test_a_block_that_counts_several_times_is_one_block() -> None:
    sums = ControlLineSums((NET,))
    sums.add(passages([Outcome.PASSED])[:10], weight=8)
    own = sampled(sums)
    own = [replace(one, source=replace(one.source, heaviest=8)) for one in own]
    curve = arrivals(own, 0, "energy_kj")
    assert curve.curves.rate_of_a_rock == pytest.approx([0.08])
    assert curve.rate[0] == pytest.approx(0.8)


def test_the_mean_of_many_large_blocks_is_that_of_one() -> None:
    """More millionths of a kJ than there are whole numbers of 64 bits."""
    rows = passages([Outcome.PASSED])
    rows["energy_trans_kj"] = np.linspace(0.9e7, 1.1e7, 100)
    rows["mass_kg"] = 1e7 + 0.25
    one, many = (ControlLineSums((NET,)) for _ in range(2))
    one.add(rows)
    many.add(rows, weight=100_000)
    many.add_sums(ControlLineSums.from_state((NET,), one.state()), np.array([0]))
    for name, mean in (("energy_kj", 1e7), ("mass_kg", 1e7 + 0.25)):
        for sums, count in ((one, 100), (many, 10_000_100)):
            found = sums.distribution(0, name)
            assert found.count == count and found.mean == pytest.approx(mean, rel=1e-12)


def test_blocks_released_never_are_no_share_of_the_released() -> None:
    sums = ControlLineSums((NET,))
    sums.add(passages([Outcome.PASSED]))
    design = design_table([NET], sampled(sums, 0.0), (30.0,))
    places = places_table(design, [("net", 0.0, 500.0)], 0.0)
    assert places["arrivals_per_year"][0] == 0.0 and pd.isna(places["share"][0])


def test_a_sheet_of_a_net_that_no_block_reaches_has_dashes() -> None:
    idle = sampled(ControlLineSums((NET,)))
    needs = protection_table([NET], idle, idle, (30.0,), 2700.0)
    table = needs_table(design_table([NET], idle, (30.0,)).iloc[0], needs)
    assert table.rows == (("30", *(None,) * 6),)


def test_table_of_protection_by_hand() -> None:
    before, after = (ControlLineSums((NET,)) for _ in range(2))
    before.add(passages([Outcome.PASSED]))
    after.add(passages([Outcome.OVERTOPPED, Outcome.STOPPED, Outcome.STOPPED, Outcome.STOPPED]))
    table = protection_table([NET], sampled(before), sampled(after), (2.0, 10.0), 2700.0)
    often, rare = (table.iloc[k] for k in range(2))
    # A hundredth of a block a year each: half of them below 50 kJ, a tenth above 90 kJ.
    assert often["energy_kj"] == pytest.approx(50.0, rel=0.06)
    assert rare["energy_kj"] == pytest.approx(90.0, rel=0.06)
    assert rare["net_class"] == "0" and often["energy_kj_low"] < 50.0 < often["energy_kj_high"]
    wall = replace(NET, kind="wall")
    of_wall = protection_table([wall], sampled(before), sampled(after), (10.0,), 2700.0).iloc[0]
    assert (of_wall["net_class"], of_wall["net_class_high"]) == ("", "")
    # A sphere of a cubic metre on top of 5 m.
    assert rare["block_m"] == pytest.approx(1.24, abs=0.01)
    assert rare["net_height_m"] == pytest.approx(6.24, abs=0.12)
    # A quarter goes on, of which four tenths once in ten years: every fourth from 61 kJ on.
    assert often["behind_per_year"] == pytest.approx(0.25) and math.isnan(often["energy_behind_kj"])
    assert rare["energy_behind_kj"] == pytest.approx(59.0, abs=4.0)
    assert rare["arrivals_per_year"] == pytest.approx(1.0)


def test_table_of_protection_of_a_gallery_by_hand() -> None:
    """Of a hundred blocks, one a year in all: stopped, over it, half of them on the roof."""
    gallery = ControlLine("roof", "gallery", 5.0, width_m=8.0, cushion_kpa=3200.0)
    rows = passages([Outcome.STOPPED, Outcome.OVERTOPPED, Outcome.ON_ROOF, Outcome.ON_ROOF])
    on_roof = rows["outcome"] == Outcome.ON_ROOF
    rows["roof_energy_kj"][on_roof] = 100.0
    rows["roof_left_kj"][2::4] = 40.0
    sums = ControlLineSums((gallery,))
    sums.add(rows)
    needs = protection_table([gallery], sampled(sums), sampled(sums), (3.0,), 2700.0)
    row = needs.iloc[0]
    assert row["hits_per_year"] == 0.5 and row["over_per_year"] == 0.25
    # Half of those on the roof end there.
    assert row["behind_per_year"] == 0.5 and row["side_per_year"] == 0.25
    # All on the roof alike; a cubic metre has a radius of 0.62 m.
    force = 1.765 * 3200.0**0.4 * 0.6204**0.2 * 100.0**0.6
    assert row["force_kn"] == pytest.approx(force, rel=0.06) and row["load_kj"] <= 100.0
    # What flies over comes once in four years, not in three.
    assert pd.isna(row["energy_over_kj"])
    of_layer = control_line_rows(sums)[0]
    assert of_layer["force_kn_max"] == pytest.approx(force, rel=1e-3)
    assert of_layer["force_kn_q95"] == pytest.approx(force, rel=0.06)
    assert (of_layer["hits"], of_layer["on_roof"], of_layer["overtopped"]) == (75, 50, 25)
    assert of_layer["rocks"] == 100 and of_layer["stopped"] == 25
    sheet = needs_table(design_table([gallery], sampled(sums), (3.0,)).iloc[0], needs)
    heads = [name for name, _ in sheet.columns]
    assert heads[-4:] == [
        "energy behind",
        "energy into the roof",
        "force on the roof",
        "energy over the top",
    ]
    assert str(sheet.rows[0][-2]).startswith(f"{row['force_kn']:.0f}") and sheet.rows[0][-1] is None
    _, roofs = control_line_tables(sums)
    assert roofs.rows[0][:5] == ("roof", 100, 25, 50, 25)
    run: Any = SimpleNamespace(control_lines=[(gallery, np.zeros((2, 2)))])
    facts = line_facts(run, sampled(sums), sampled(sums), (1.0, 3.0))["gallery", "roof"]
    # On the roof comes one in two years: rarer than once a year.
    assert dict(facts[0])["force on the roof"] == f"3 years: {sensible(row['force_kn'])} kN"


def test_a_wall_is_loaded_by_what_it_stops_and_topped_by_the_rest() -> None:
    wall = ControlLine("dam", "wall", 4.0)
    sums = ControlLineSums((wall,))
    sums.add(passages([Outcome.OVERTOPPED, Outcome.STOPPED]))
    needs = protection_table([wall], sampled(sums), sampled(sums), (10.0,), 2700.0)
    row = needs.iloc[0]
    assert row["hits_per_year"] == row["over_per_year"] == 0.5
    sheet = needs_table(design_table([wall], sampled(sums), (10.0,)).iloc[0], needs)
    heads = [name for name, _ in sheet.columns]
    assert heads[-3:] == ["wall height", "energy of hits", "energy over the top"]
    # A tenth a year above 80 kJ of each half.
    assert row["load_kj"] == pytest.approx(80.0, rel=0.06)
    assert row["energy_over_kj"] == pytest.approx(80.0, rel=0.06)
    assert pd.isna(row["force_kn"]) and control_line_rows(sums)[0]["force_kn_max"] is None


def test_a_line_moved_over_an_object_is_no_longer_above_it() -> None:
    bent = np.array([[0.0, 0.0], [50.0, 10.0], [100.0, 0.0]])
    house = shapely.box(40.0, -12.0, 60.0, -5.0)
    assert stays_above(bent, bent - [0.0, 10.0], [house])
    assert not stays_above(bent, bent - [0.0, 20.0], [house])
    # Within the hull of both, but beside the way.
    assert stays_above(bent, np.add(bent, [0.0, 5.0]), [shapely.box(20.0, 0.0, 80.0, 2.0)])


def test_a_line_has_one_95_percent_value() -> None:
    """Weak blocks come often, strong ones seldom: the layer and the design table agree."""
    weak, strong = (ControlLineSums((NET,)) for _ in range(2))
    rows = passages([Outcome.PASSED])
    weak.add(rows)
    rows["energy_trans_kj"] += 1000.0
    strong.add(rows)
    both = sampled(weak, 1.0) + sampled(strong, 0.01)
    row = control_line_rows(weak, line_parts(both))[0]
    design = design_table([NET], both, (30.0,)).iloc[0]
    assert row["energy_kj_q95"] == pytest.approx(design["energy_q95_kj"], rel=1e-4)
    assert row["energy_kj_q95"] < 100.0 < row["energy_kj_max"] and row["rocks"] == 100
    assert row["energy_kj_mean"] == pytest.approx((50.5 + 0.01 * 1050.5) / 1.01, rel=1e-4)
    # Blocks that count alike are as blocks without a weight.
    assert control_line_rows(weak, [(0.3, weak)]) == control_line_rows(weak)
