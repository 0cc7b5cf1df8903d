"""Risk of a house and a stretch of road, every term by hand, and what must hold of all tables."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers.worked_example import COUNTS, ENERGIES, HOUSE, ROAD, SOURCES, counts, vulnerability
from hypothesis import given, settings
from hypothesis import strategies as st

from sassgis.hazard.curves import hazard_curves
from sassgis.hazard.risk import (
    ADDITIVE,
    QUANTITIES,
    RiskTable,
    assess_risk,
    object_rows,
    source_rows,
    total_rows,
    vehicles_in_strip,
    weighted_variance,
)
from sassgis.settings.exposure import ExposedObject
from sassgis.settings.hazard_rules import Source, SourceCounts


def close(value):
    return pytest.approx(value, rel=1e-12, abs=0.0)


def assessed(objects, sources, rows) -> RiskTable:
    return assess_risk(objects, sources, rows, ENERGIES, ENERGIES, vulnerability())


# --- by hand ---------------------------------------------------------------------------------
#
# One rock of "frequent" stands for 0.5 / 1000 = 5e-4 blocks a year, one of "rare" for
# 0.1 / 500 = 2e-4. Of "frequent", 20 rocks come to the house, 8 of them with 30 kJ and more and
# 2 with 300 kJ and more: 12 low, 6 mean, 2 high. Of "rare": 0 low, 2 mean, 3 high.
#
#   hits         low                mean               high
#   frequent     12 * 5e-4 = 6e-3   6 * 5e-4 = 3e-3    2 * 5e-4 = 1e-3
#   rare          0                 2 * 2e-4 = 4e-4    3 * 2e-4 = 6e-4


def test_hits_of_the_house_by_hand(example):
    assert example.hits[:, 0] == close(np.array([[6e-3, 3e-3, 1e-3], [0.0, 4e-4, 6e-4]]))
    assert example.of_object("hits")[0] == close(1.1e-2)


def test_loss_of_the_house_by_hand(example):
    # frequent: 600 000 * (6e-3 * 0.01 + 3e-3 * 0.1 + 1e-3 * 0.5) = 600 000 * 8.6e-4 = 516
    # rare:     600 000 * (4e-4 * 0.1 + 6e-4 * 0.5)               = 600 000 * 3.4e-4 = 204
    assert example.values["property_loss"][:, 0] == close(np.array([516.0, 204.0]))
    assert example.of_object("loss")[0] == close(720.0)
    assert not example.values["vehicle_loss"][:, 0].any()


def test_risk_to_people_in_the_house_by_hand(example):
    # frequent: 0.5 * (6e-3 * 0 + 3e-3 * 0.01 + 1e-3 * 0.2) = 0.5 * 2.3e-4  = 1.15e-4
    # rare:     0.5 * (4e-4 * 0.01 + 6e-4 * 0.2)            = 0.5 * 1.24e-4 = 6.2e-5
    assert example.values["individual_risk"][:, 0] == close(np.array([1.15e-4, 6.2e-5]))
    # Four people.
    assert example.of_object("deaths")[0] == close(4 * 1.77e-4)


def test_vehicles_by_hand(example):
    # 4800 a day are 200 an hour; one has a part of itself in a strip of 1 m for
    # (5 + 1) / 60 000 = 1e-4 hours: 0.02 vehicles.
    assert vehicles_in_strip(4800.0, 60.0, 5.0, 1.0) == close(0.02)
    # 40 rocks, of which 10 with 30 kJ: 30 * 5e-4 = 1.5e-2 low, 5e-3 mean.
    assert example.hits[0, 1] == close(np.array([1.5e-2, 5e-3, 0.0]))
    assert example.values["vehicles_hit"][0, 1] == close(0.02 * 2e-2)
    # 0.02 * 30 000 * (1.5e-2 * 0.2 + 5e-3 * 0.6) = 600 * 6e-3
    assert example.values["vehicle_loss"][0, 1] == close(3.6)
    # 0.02 * 1.5 * (1.5e-2 * 0.05 + 5e-3 * 0.3) = 0.03 * 2.25e-3
    assert example.values["deaths"][0, 1] == close(6.75e-5)
    # Two trips a day: 2 / 24 * 1e-4 * 2.25e-3
    assert example.values["individual_risk"][0, 1] == close(2.0 / 24.0 * 2.25e-7)


def test_loss_of_the_road_itself_by_hand(example):
    # No damage length is stated: the block's width of 1 m at 2000 a metre.
    # 2000 * 1 * (1.5e-2 * 0.1 + 5e-3 * 0.3) = 2000 * 3e-3
    assert example.values["property_loss"][0, 1] == close(6.0)
    assert example.of_object("loss")[1] == close(6.0 + 3.6)
    assert not example.values["loss"][1, 1]  # No rock of "rare" comes to the road.


def test_standard_error_of_the_house_by_hand(example):
    # Every rock is on a line of its own, so its variance is that of single hits:
    # k (n - 1) / (n - 1) = k, and Var loss = Σ rate of a rock * hits * cost².
    # frequent: 5e-4 * (6e-3 * 6000² + 3e-3 * 60 000² + 1e-3 * 300 000²)
    #         = 5e-4 * (216 000 + 10 800 000 + 90 000 000) = 50 508
    # rare:     2e-4 * (4e-4 * 60 000² + 6e-4 * 300 000²) = 2e-4 * 55 440 000 = 11 088
    assert example.variances["loss"][:, 0] == close(np.array([50_508.0, 11_088.0]))
    assert example.standard_error("loss")[0] == close(math.sqrt(61_596.0))


def test_a_damage_length_takes_the_place_of_the_width():
    long = replace(ROAD, damage_length_m=8.0)
    table = assessed((HOUSE, long), SOURCES, COUNTS)
    assert table.values["property_loss"][0, 1] == close(8 * 6.0)
    # Traffic is met over the block's width all the same.
    assert table.values["vehicles_hit"][0, 1] == close(4e-4)


def test_the_page_tells_the_numbers_of_the_example(example, repository):
    text = (repository / "docs" / "risk.md").read_text(encoding="utf-8")
    told = re.findall(r"<!-- (\w+) (\w+) -->\s*\**([\d.e−-]+)\**", text)
    place = {"house": 0, "road": 1}
    assert {(o, q) for o, q, _ in told} >= {
        *((o, q) for o in place for q in ("hits", "loss", "deaths", "individual_risk")),
        ("house", "loss_se"),
        ("road", "vehicles_hit"),
    }
    for thing, quantity, number in told:
        name = quantity.removesuffix("_se")
        values = example.standard_error(name) if name != quantity else example.of_object(name)
        assert float(number.replace("−", "-")) == pytest.approx(values[place[thing]], rel=1e-3)


# --- dimensions ------------------------------------------------------------------------------


def scaled(**factors: float) -> RiskTable:
    """The example with other units: each factor multiplies what is stated in one of them."""
    money, length, time = (factors.get(k, 1.0) for k in ("money", "length", "time"))
    house = replace(HOUSE, value=HOUSE.value * money)
    assert ROAD.traffic is not None
    traffic = replace(
        ROAD.traffic,
        vehicle_value=ROAD.traffic.vehicle_value * money,
        vehicle_length_m=ROAD.traffic.vehicle_length_m * length,
        speed_kmh=ROAD.traffic.speed_kmh * length,
    )
    road = replace(ROAD, value_per_m=ROAD.value_per_m * money / length, traffic=traffic)
    sources = [
        replace(s, frequency=s.frequency / time, block_width_m=s.block_width_m * length)
        for s in SOURCES
    ]
    return assessed((house, road), sources, COUNTS)


@pytest.mark.parametrize(
    ("unit", "powers"),
    [
        ("money", {"property_loss": 1, "vehicle_loss": 1, "loss": 1}),
        ("length", {}),
        ("time", dict.fromkeys(QUANTITIES, -1)),
    ],
)
def test_other_units_give_the_same_risk(example, unit, powers):
    other = scaled(**{unit: 3.0})
    for q in QUANTITIES:
        expected = example.of_object(q) * 3.0 ** powers.get(q, 0)
        assert other.of_object(q) == pytest.approx(expected, rel=1e-12), q
        error = example.standard_error(q) * 3.0 ** powers.get(q, 0)
        assert other.standard_error(q) == pytest.approx(error, rel=1e-12), q


# --- sums ------------------------------------------------------------------------------------


@st.composite
def tables(draw) -> RiskTable:
    n_objects, n_sources = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    kinds = ("building", "road", "line", "people")
    objects = []
    for i in range(n_objects):
        kind = draw(st.sampled_from(kinds))
        if kind == "building":
            thing = replace(HOUSE, name=f"h{i}", value=draw(st.floats(0, 1e7)))
        elif kind == "people":
            thing = ExposedObject(f"p{i}", "people", persons=draw(st.floats(0, 50)), presence=0.3)
        else:
            traffic = ROAD.traffic if kind == "road" else None
            thing = ExposedObject(
                f"{kind} {i}", kind, parent=kind, value_per_m=333.3, length_m=7.7, traffic=traffic
            )
        objects.append(thing)
    sources, rows = [], []
    for s in range(n_sources):
        rate, width = draw(st.floats(1e-4, 10.0)), draw(st.floats(0.1, 3.0))
        own = {"random_points": draw(st.booleans()), "block_width_m": width}
        sources.append(Source(f"area {s % 2}", f"blocks {s}", rate, 200, 10, **own))
        count = [
            sorted(draw(st.lists(st.integers(0, 200), min_size=3, max_size=3)), reverse=True)
            for _ in objects
        ]
        rows.append(counts(range(n_objects), count))
    return assessed(objects, sources, rows)


@given(tables())
@settings(max_examples=30)
def test_totals_and_sources_are_the_exact_sums_of_their_rows(table):
    rows, totals = object_rows(table), total_rows(table)
    sources = [r | {"source": f"{r['area']} / {r['scenario']}"} for r in source_rows(table)]
    for total in totals:
        scope, name = total["scope"], total["name"]
        column = "part_of" if scope == "whole" else scope
        own = [r for r in (sources if scope == "source" else rows) if r.get(column, name) == name]
        for q in ADDITIVE:
            column = f"{q}_per_year"
            assert total[column] == math.fsum(float(r[column]) for r in own), (total["name"], q)
    for row in rows:
        own = [p for p in sources if p["name"] == row["name"]]
        for q in QUANTITIES:
            assert row[f"{q}_per_year"] == math.fsum(float(p[f"{q}_per_year"]) for p in own)
        if row["loss_per_year"]:
            assert math.fsum(float(p["share_of_loss"]) for p in own) == pytest.approx(1.0)
    for scope in ("source", "kind"):
        for q in ADDITIVE:
            added = math.fsum(t[f"{q}_per_year"] for t in totals if t["scope"] == scope)
            assert added == pytest.approx(totals[-1][f"{q}_per_year"], rel=1e-14)


def test_one_user_passes_all_stretches_of_a_road():
    second = replace(ROAD, name="road 0+050–0+100", from_m=50.0)
    both = assessed((ROAD, second), SOURCES[:1], [counts([0, 1], [[40, 10, 0], [40, 10, 0]])])
    (road,) = (t for t in total_rows(both) if t["scope"] == "whole")
    assert road["name"] == "road" and road["objects"] == 2
    assert road["individual_risk_largest_per_year"] == close(2 * 2.0 / 24.0 * 2.25e-7)
    houses = (HOUSE, replace(HOUSE, name="another"))
    both = assessed(houses, SOURCES[:1], [counts([0, 1], [[20, 8, 2], [20, 8, 2]])])
    # Nobody lives in two houses.
    assert total_rows(both)[-1]["individual_risk_largest_per_year"] == close(1.15e-4)


# --- what cannot be ---------------------------------------------------------------------------


def test_counts_of_no_object_are_refused():
    with pytest.raises(ValueError, match="no object"):
        assessed((HOUSE,), SOURCES, COUNTS)


def test_an_object_that_nothing_reaches_has_no_risk_and_says_so():
    none = [SourceCounts.none(3), SourceCounts.none(3)]
    table = assessed((HOUSE, ROAD), SOURCES, none)
    for q in QUANTITIES:
        assert not table.of_object(q).any() and not table.standard_error(q).any()
    assert not table.one_rock.any()
    assert source_rows(table) == []


def test_more_energies_than_classes_change_nothing(example):
    fine = (0.0, 10.0, 30.0, 100.0, 300.0)
    k = [[[20, 15, 8, 4, 2], [40, 22, 10, 3, 0]], [[5, 5, 5, 4, 3]]]
    rows = [
        SourceCounts(c.places, np.array(n, np.int64), np.array(n, np.int64))
        for c, n in zip(COUNTS, k, strict=True)
    ]
    table = assess_risk((HOUSE, ROAD), SOURCES, rows, fine, ENERGIES, vulnerability())
    for q in QUANTITIES:
        assert (table.of_object(q) == example.of_object(q)).all()


# --- the standard error against repetitions ----------------------------------------------------


@given(
    st.integers(2, 12),
    st.booleans(),
    st.lists(st.floats(0.0, 10.0), min_size=3, max_size=3),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=80)
def test_the_bound_is_never_below_the_exact_variance(n, random_points, cost, seed):
    """With all products of counts at hand, the variance of the sample is never above the bound."""
    rng = np.random.default_rng(seed)
    lines = int(rng.integers(2, 9))
    chance = rng.dirichlet([1.0, 1.0, 1.0, 1.0], lines) ** 2
    chance[:, 0] += 1.0 - chance.sum(axis=1)
    k = rng.multinomial(n, chance)[:, 1:]
    y = k @ np.array(cost)
    if random_points:
        exact = lines / (lines - 1) * (np.sum(y**2) - y.sum() ** 2 / lines)
    else:
        exact = (n * (k @ np.square(cost)).sum() - np.sum(y**2)) / (n - 1)
    nested = k[:, ::-1].cumsum(axis=1)[:, ::-1]
    source = Source("a", "b", float(n * lines), n * lines, n, random_points)  # one rock: 1/year
    own = SourceCounts(
        np.zeros(1, np.int64), nested.sum(axis=0)[None], (nested**2).sum(axis=0)[None]
    )
    curves = hazard_curves([source], [own], ENERGIES)
    bound = weighted_variance(np.array([cost]), curves.rate, curves.variance, source)
    assert bound[0] >= exact * (1 - 1e-9) - 1e-9


@pytest.mark.parametrize(
    ("rocks", "per_line", "random_points", "k", "square", "error"),
    [
        # One rock per line is bounded by single hits, one random line tells no error, and where
        # every rock of every line hits with full force there is no spread.
        (100, 1, False, [10, 4, 1], [10, 4, 1], 0.01 * math.sqrt(10.0)),
        (50, 50, True, [10, 4, 1], [100, 16, 1], math.nan),
        (100, 10, False, [100] * 3, [1000] * 3, 0.0),
    ],
    ids=["one rock per line", "one random line", "all hit"],
)
def test_errors_of_special_samples(rocks, per_line, random_points, k, square, error):
    source = Source("a", "b", 1.0, rocks, per_line, random_points=random_points)
    own = SourceCounts(np.zeros(1, np.int64), np.array([k]), np.array([square]))
    table = assessed((HOUSE,), (source,), [own])
    assert table.standard_error("hits")[0] == pytest.approx(error, rel=1e-12, nan_ok=True)


def test_scenarios_that_start_from_the_same_random_points_share_their_chance(example):
    """Standard errors of hits add up over the scenarios of an area, by class as in all."""
    sources = tuple(replace(s, random_points=True) for s in SOURCES)
    table = assessed((HOUSE, ROAD), sources, COUNTS)
    (row, *_) = object_rows(table)
    for code in table.intensities:
        added = np.sqrt(table.variances[f"hits_{code}"][:, 0]).sum()
        assert row[f"hits_{code}_per_year_se"] == pytest.approx(added, rel=1e-12) and added > 0.0
    (row, *_) = object_rows(example)
    for code in example.intensities:
        apart = math.sqrt(math.fsum(example.variances[f"hits_{code}"][:, 0].tolist()))
        assert row[f"hits_{code}_per_year_se"] == apart


def test_the_bound_of_rare_hits_holds_for_a_block_that_counts_several_times():
    """One of ten blocks that count 8 times each hits: its variance is that of one of weight 8."""
    source = Source("a", "b", 1.0, 80, 10, heaviest=8)
    rate = np.array([[0.1, 0.0, 0.0]])
    unknown = np.full(rate.shape, np.nan)
    assert weighted_variance(np.ones(rate.shape), rate, unknown, source) == close([0.01])
    own = SourceCounts(np.zeros(1, np.int64), np.array([[8, 0, 0]]), np.array([[-496, 0, 0]]))
    assert assessed((HOUSE,), (source,), [own]).one_rock == close([0.1])
