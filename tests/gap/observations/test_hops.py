"""Contacts in time and place: files, checks, hops, passages, and their numbers in calibration."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from helpers.simulated_slope import (
    BASE,
    CELL,
    LENGTH,
    observed,
    slope,
    table_with,
    with_metadata,
    with_observed,
)

from sassgis.engine.simulate_paths import PathTerrain
from sassgis.engine.state import END, EVENT_DTYPE, FLIGHT, IMPACT, ROLLING
from sassgis.gap.advice.measure_next import what_is_identifiable
from sassgis.gap.fit.linear_fit import summary_of
from sassgis.gap.fit.site_data import site_data_of
from sassgis.gap.forward.observation_operator import campaigns, contacts_in
from sassgis.gap.forward.rock_lines import rock_lines_of
from sassgis.gap.observations.case import Campaign, Case, observed_campaign, station_traces
from sassgis.gap.observations.checks import check_observations
from sassgis.gap.observations.observed import Observations
from sassgis.gap.observations.projection import (
    ContactRows,
    contact_numbers,
    contacts_of,
    hops_of,
    passages_of,
    with_passages,
)
from sassgis.gap.observations.tables import Contacts, Rocks, Stations
from sassgis.inputs.observation_files import read_observations
from sassgis.terrain.cells import heights_at

#: A ball on a plane that falls to the south by 1 in 2: each hop takes 0.4 s, leads 2 m on in plan,
#: and is followed by a contact of 0.1 s.
HOP_S, CONTACT_S, STEP_M, FALL_M, RADIUS_M, TURNS_HZ = 0.4, 0.1, 2.0, 1.0, 0.3, 2.5
SPEED_MPS = math.hypot(STEP_M, FALL_M) / (HOP_S + CONTACT_S)
HEIGHT_M = 9.81 * HOP_S**2 / 8.0
CONTACTS = 9


def columns(name: str = "A", x: float = 50.0) -> dict[str, Any]:
    """Contacts of one ball."""
    k = np.arange(CONTACTS)
    start = 7.0 + k * (HOP_S + CONTACT_S)
    return {
        "rock_id": [name] * CONTACTS, "t_start_s": start, "t_end_s": start + CONTACT_S,
        "x": np.full(CONTACTS, x), "y": 80.0 - STEP_M * k, "z": 40.3 - FALL_M * k,
        "rotation_before_hz": np.full(CONTACTS, TURNS_HZ),
        "rotation_after_hz": np.full(CONTACTS, TURNS_HZ),
    }  # fmt: skip


def hopped(**changed: Any) -> Observations:
    """Two balls, and two stations that they cross in the middle of a hop and at a quarter of one.

    ``changed``: columns of the contacts of the first one.
    """
    both = (columns() | changed, columns("B", 60.0))
    table = {name: np.concatenate([own[name] for own in both]) for name in both[0]}
    volume = 4.0 / 3.0 * math.pi * RADIUS_M**3
    rocks = Rocks.of(
        rock_id=["A", "B"], x=[50.0, 60.0], y=[80.5, 80.5], z=[45.0, 45.0],
        mass_kg=[2500.0 * volume] * 2, density_kgm3=[2500.0] * 2,
    )  # fmt: skip
    lines = [np.array([[0.0, y], [100.0, y]]) for y in (75.0, 67.5)]
    stations = Stations.of(station=["S1", "S2"], vertices=lines)
    return Observations(rocks=rocks, contacts=Contacts.of(**table), stations=stations)


def put(name: str, row: int, value: float) -> dict[str, Any]:
    values = columns()[name].copy()
    values[row] = value
    return {name: values}


# --- hops and passages -------------------------------------------------------------------------


def test_hops_of_a_ball_on_a_plane() -> None:
    hops = hops_of(contacts_of(hopped()))
    assert hops.rock.tolist() == [0] * (CONTACTS - 1) + [1] * (CONTACTS - 1)
    for own, is_ in (
        (hops.time_s, HOP_S),
        (hops.between_s, HOP_S + CONTACT_S),
        (hops.length_m, math.hypot(STEP_M, FALL_M)),
        (hops.drop_m, FALL_M),
        (hops.speed_mps, SPEED_MPS),
        (hops.height_m, HEIGHT_M),
        (hops.rotation_hz, TURNS_HZ),
    ):
        np.testing.assert_allclose(own, is_)


def test_numbers_of_a_ball_and_of_a_rock_without_contacts() -> None:
    found = contact_numbers(contacts_of(hopped()), np.array([RADIUS_M, 2.0 * RADIUS_M, 1.0]))
    rim = 2.0 * math.pi * TURNS_HZ * RADIUS_M / SPEED_MPS
    for name, values in {
        "contacts": [CONTACTS, CONTACTS],
        "fastest_second": [SPEED_MPS] * 2,
        "between_contacts": [HOP_S + CONTACT_S] * 2,
        "hop_length": [math.hypot(STEP_M, FALL_M)] * 2,
        "hop_height_90": [HEIGHT_M] * 2,
        "rim_ratio": [rim, 2.0 * rim],
    }.items():
        np.testing.assert_allclose(found[name], [*values, math.nan], err_msg=name)


def test_quantiles_and_the_fastest_second_of_one_ball_are_its_own() -> None:
    """The last hop of the first ball is twice as long in the same time."""
    longer = columns()["y"].copy()
    longer[-1] -= STEP_M
    seen = contacts_of(hopped(y=longer))
    found = contact_numbers(seen, np.full(2, RADIUS_M))
    lengths = np.array([math.hypot(STEP_M, FALL_M)] * 7 + [math.hypot(2.0 * STEP_M, FALL_M)])
    assert found["hop_length_90"][0] == pytest.approx(np.quantile(lengths, 0.9))
    assert found["hop_length_90"][1] == pytest.approx(lengths[0])
    # A second holds the last two hops with their contacts.
    assert found["fastest_second"][0] == pytest.approx(lengths[-2:].sum())
    assert found["fastest_second"][1] == pytest.approx(SPEED_MPS)


def test_passages_of_a_ball_on_a_plane() -> None:
    made = passages_of(hopped())
    assert made.rock_id.tolist() == ["A", "B", "A", "B"]
    assert made.station.tolist() == ["S1", "S1", "S2", "S2"]
    np.testing.assert_allclose(made.x, [50.0, 60.0] * 2)
    np.testing.assert_allclose(made.y, [75.0, 75.0, 67.5, 67.5])
    np.testing.assert_allclose(made.speed_mps, SPEED_MPS)
    np.testing.assert_allclose(made.rotation_hz, TURNS_HZ)
    rest = RADIUS_M / math.cos(math.atan(FALL_M / STEP_M))
    above = np.array([HEIGHT_M, HEIGHT_M, 0.75 * HEIGHT_M, 0.75 * HEIGHT_M])
    np.testing.assert_allclose(made.height_m, rest + above)
    np.testing.assert_allclose(made.z, 40.3 - 0.5 * (80.0 - made.y) + above)


def test_at_the_ends_of_a_way_the_second_beside_counts_and_a_shorter_way_has_no_speed() -> None:
    lines = [np.array([[0.0, y], [100.0, y]]) for y in (79.9, 64.1)]
    seen = replace(hopped(), stations=Stations.of(station=["first", "last"], vertices=lines))
    np.testing.assert_allclose(passages_of(seen).speed_mps, [SPEED_MPS] * 4)
    short = replace(seen, contacts=seen.contacts.take(np.array([0, 1, *range(9, 18)])))
    made = passages_of(short)
    assert made.rock_id.tolist() == ["A", "B", "B"]
    np.testing.assert_allclose(made.speed_mps, [math.nan, SPEED_MPS, SPEED_MPS])


def test_a_place_that_is_wrong_by_its_error_does_not_decide_a_speed() -> None:
    """Over the hop alone 0.3 m would be 0.6 m/s."""
    y = columns()["y"].copy()
    y[2] += 0.3
    made = passages_of(hopped(y=y))
    assert abs(made.speed_mps[0] - SPEED_MPS) < 0.3
    assert hops_of(contacts_of(hopped(y=y))).speed_mps[2] > SPEED_MPS + 0.5


def test_a_contact_without_a_place_ends_its_hop() -> None:
    nothing = {name: put(name, 3, math.nan)[name] for name in "xyz"}
    seen = hopped(**nothing)
    hops = hops_of(contacts_of(seen))
    np.testing.assert_allclose(hops.time_s, HOP_S)
    assert np.flatnonzero(np.isnan(hops.length_m)).tolist() == [2, 3]
    # The first station lies there: how high the rock was is not known, how fast is.
    made = passages_of(seen)
    np.testing.assert_allclose(made.speed_mps, SPEED_MPS)
    assert np.isnan(made.height_m).tolist() == [True, False, False, False]
    assert np.isnan(made.rotation_hz).tolist() == [True, False, False, False]


def test_passages_that_were_observed_stay() -> None:
    made = with_passages(hopped())
    assert len(made.passages) == 4
    (notice,) = made.findings
    assert notice.level == "warning" and not notice.left_out
    assert "those of 2 rocks at 2 stations are computed from contacts" in notice.problem
    fewer = replace(made, passages=made.passages.take(np.array([0])), findings=())
    assert with_passages(fewer) is fewer
    bare = replace(hopped(), stations=Stations.of())
    assert with_passages(bare) is bare


# --- checks ------------------------------------------------------------------------------------

FAULTS: dict[str, tuple[dict[str, Any], str, str, list[int], str]] = {
    "ends early": (put("t_end_s", 4, 8.9), "error", "t_end_s", [5], "ends before it starts"),
    "overlap": (
        put("t_end_s", 4, 9.6), "error", "t_end_s", [5],
        "ends after the next contact of the rock has begun",
    ),
    "no place": (
        {name: put(name, 3, math.nan)[name] for name in "xyz"}, "warning", "x, y", [4],
        "no place: time and spin alone are used",
    ),
    "stray place": (put("y", 4, 20.0), "warning", "x, y, z", [5], "farther from the contact"),
    "stray first place": (put("y", 0, 140.0), "warning", "x, y, z", [1], "farther from"),
    "too far from there on": (
        {"y": columns()["y"] - 50.0 * (np.arange(CONTACTS) > 3)}, "warning", "x, y, z", [5],
        "farther from",
    ),
    "twice": (put("t_start_s", 4, 8.5), "error", "rock_id, t_start_s", [5], "is there twice"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_a_contact_is_told_once(fault: str) -> None:
    changed, level, column, rows, text = FAULTS[fault]
    assert not check_observations(hopped())
    (found,) = check_observations(hopped(**changed))
    assert (found.level, found.table, found.column) == (level, "contacts", column)
    assert list(found.rows) == rows and text in found.problem
    assert found.left_out == {"no place": "", "twice": "row"}.get(fault, "value")


def test_spins_in_radians_are_told_and_left_out() -> None:
    seen = hopped()
    turning = {
        name: 2.0 * math.pi * getattr(seen.contacts, name)
        for name in ("rotation_before_hz", "rotation_after_hz")
    }
    (found,) = check_observations(replace(seen, contacts=replace(seen.contacts, **turning)))
    assert found.problem == "look like radians per second" and found.left_out == "value"
    assert found.column == "rotation_before_hz, rotation_after_hz"
    assert len(found.rows) == 2 * CONTACTS


# --- files -------------------------------------------------------------------------------------


def frames() -> dict[str, pd.DataFrame]:
    seen = hopped()
    contacts = pd.DataFrame({name: getattr(seen.contacts, name) for name in columns()})
    rocks = pd.DataFrame({"rock_id": ["A", "B"], "mass_kg": seen.rocks.mass_kg})
    ends = [[0.0, y, 100.0, y] for y in (75.0, 67.5)]
    stations = pd.DataFrame(ends, columns=["x0", "y0", "x1", "y1"])
    stations.insert(0, "station", ["S1", "S2"])
    return {"contacts": contacts, "rocks": rocks, "stations": stations}


def test_contacts_are_read_by_rock_and_time_and_give_passages(tmp_path: Path) -> None:
    for name, frame in frames().items():
        frame.sample(frac=1.0, random_state=3).to_csv(tmp_path / f"{name}.csv", index=False)
    seen = read_observations(tmp_path)
    assert len(seen.contacts) == 2 * CONTACTS
    same = seen.contacts.rock_id[1:] == seen.contacts.rock_id[:-1]
    assert (np.diff(seen.contacts.t_start_s)[same] > 0.0).all() and same.sum() == 2 * CONTACTS - 2
    np.testing.assert_allclose(seen.passages.speed_mps, SPEED_MPS)
    (notice,) = seen.findings
    assert str(tmp_path / "contacts.csv") in str(notice) and "computed from contacts" in str(notice)
    told = what_is_identifiable(seen)
    assert told.has("hop_time_s", "contacts") and told.has("speed_mps", "passages")


def test_contacts_of_a_geopackage_have_their_places_as_geometry(tmp_path: Path) -> None:
    frame = frames()["contacts"]
    points = shapely.points(frame.x, frame.y, frame.z)
    layer = gpd.GeoDataFrame(frame.drop(columns=["x", "y", "z"]), geometry=points, crs="EPSG:2056")
    pyogrio.write_dataframe(layer, tmp_path / "seen.gpkg", layer="contacts", driver="GPKG")
    seen = read_observations(tmp_path / "seen.gpkg")
    np.testing.assert_allclose(seen.contacts.z[:CONTACTS], columns()["z"])
    assert not len(seen.passages) and not seen.findings


def test_a_contact_without_a_time_and_another_unit_are_told(tmp_path: Path) -> None:
    frame = frames()["contacts"].rename(columns={"rotation_after_hz": "rotation_after_radps"})
    frame.loc[2, "t_start_s"] = math.nan
    frame.to_csv(tmp_path / "contacts.csv", index=False)
    seen = read_observations(tmp_path)
    text = "\n".join(str(f) for f in seen.findings)
    assert "contacts.t_start_s: row 4: point has no time; row left out" in text
    assert "expected rotation_after_hz: the values divided by 6.2832" in text
    assert len(seen.contacts) == 2 * CONTACTS - 1


# --- the engine's own contacts -----------------------------------------------------------------


def test_contacts_in_a_log() -> None:
    """Two blocks: one leaves the ground twice, and its log ends in a contact; one stops."""
    phases = [FLIGHT, IMPACT, FLIGHT, IMPACT, ROLLING, FLIGHT, IMPACT, ROLLING, ROLLING, END]
    log = np.zeros(len(phases), EVENT_DTYPE)
    log["phase"] = phases
    first, after = contacts_in(log, np.repeat([0, 1], [7, 3]))
    assert first.tolist() == [1, 3, 7] and after.tolist() == [2, 5, 9]


EXACT = {
    "speed_error_rel": 0.0, "rotation_error_rel": 0.0, "height_error_m": 0.0,
    "position_error_m": 0.0, "contact_min_interval_s": 0.0, "contact_min_normal_speed_mps": 0.0,
}  # fmt: skip


def written(case: Case, rows: ContactRows) -> Contacts:
    """Contacts of a campaign as a field table."""
    numbers = {
        "t_start_s": rows.start_s, "t_end_s": rows.end_s, "x": rows.x, "y": rows.y, "z": rows.z,
        "rotation_before_hz": rows.rotation_before_hz, "rotation_after_hz": rows.rotation_after_hz,
    }  # fmt: skip
    names = np.array(case.observations.rock_names)
    return Contacts.of(rock_id=names[rows.rock], **numbers)


@pytest.fixture(scope="module")
def recorded() -> tuple[Case, Campaign]:
    """Rocks that are followed over the terrain, recorded without an error."""
    case = with_metadata(observed(24, 3, tables=("passages", "deposits")), **EXACT)
    grid, kind = slope()
    case = replace(case, terrain=PathTerrain(grid, kind, 0.05, station_traces(case)))
    (one,) = campaigns(case, rock_lines_of(case), BASE, count=1, seed=4, everywhere=True)
    return case, one


def test_contacts_of_simulated_rocks_give_their_passages_back(recorded) -> None:
    case, sample = recorded
    seen = replace(case.observations, contacts=written(case, sample.contacts))
    made, true = passages_of(seen), sample.passages
    place = {name: i for i, name in enumerate(case.observations.rock_names)}
    station = {name: i for i, name in enumerate(case.station_names)}
    key = list(zip(true.rock.tolist(), true.station.tolist(), strict=True))
    rows = {k: i for i, k in enumerate(key)}
    named = zip(made.rock_id.tolist(), made.station.tolist(), strict=True)
    which = np.array([rows.get((place[r], station[s]), -1) for r, s in named])
    assert (which >= 0).mean() > 0.95 and len(made) > 0.9 * len(key)
    made, which = made.take(which >= 0), which[which >= 0]
    known = np.isfinite(made.speed_mps)
    assert known.mean() > 0.9
    ratio = made.speed_mps[known] / true.speed_mps[which][known]
    # Over the second a speed changes by what the slope and the contacts in it do.
    assert abs(np.median(ratio) - 1.0) < 0.06 and np.quantile(np.abs(ratio - 1.0), 0.8) < 0.2
    true_height = true.height_m[which]
    flies = np.isfinite(made.height_m) & (true_height > 1.0)
    assert flies.sum() > 10
    # In space the parabola between two contacts is that of the engine; paths know the ground to
    # the tolerance of 0.05 m, and a block that rolls leaves the ground beyond the middle.
    ground = heights_at(case.terrain.grid, made.x, made.y)
    off = (made.z - ground - true_height)[flies]
    assert np.quantile(np.abs(off), 0.8) < 0.07
    # The chord is not the ground, which sags below it where the slope gets gentler.
    off = (made.height_m - true_height)[flies]
    assert np.median(off) < 0.0 and np.quantile(off, 0.9) < 0.3
    plane = np.isfinite(made.height_m) & (true_height > 0.7) & np.isin(made.station, ["S2", "S4"])
    off = np.abs(made.height_m - true_height)[plane]
    assert off.size > 20 and np.median(off) < 0.15 and np.quantile(off, 0.8) < 0.35
    np.testing.assert_allclose(
        np.median(made.rotation_hz[flies] / true.rotation_hz[which][flies]), 1.0, atol=1e-6
    )


def test_hops_of_simulated_rocks_take_time_and_lie_on_the_slope(recorded) -> None:
    _, sample = recorded
    hops = hops_of(sample.contacts)
    assert (hops.time_s > 0.0).all() and (hops.rock == np.sort(hops.rock)).all()
    x, y = sample.contacts.x, sample.contacts.y
    assert ((x > 0.0) & (x < 60.0) & (y > 0.0) & (y < LENGTH - CELL)).all()


@pytest.fixture(scope="module")
def with_contacts() -> Case:
    """Stops and contacts of rocks on another meadow than the case knows, as a campaign has them."""
    case = observed(24, 3, table=table_with("debris", eta_max=0.4), tables=("deposits",))
    other = replace(BASE, table=table_with("debris", eta_max=0.4))
    (one,) = campaigns(
        case, rock_lines_of(case), other, count=1, seed=4,
        tables=frozenset({"contacts"}), everywhere=True,
    )  # fmt: skip
    return with_observed(case, contacts=written(case, one.contacts))


NAMES = [
    "contacts",
    "fastest_second",
    "between_contacts",
    "hop_length_90",
    "hop_height_90",
    "rim_ratio",
]


def test_calibration_compares_numbers_of_contacts(with_contacts: Case) -> None:
    problem, bare = (
        site_data_of(case, 2)
        for case in (with_contacts, with_observed(with_contacts, contacts=Contacts.of()))
    )
    assert [n for n in problem.scale.names if n not in bare.scale.names] == [
        f"contacts:{name}" for name in NAMES
    ]
    # What was there before is as it was.
    k = len(bare.scale.names)
    np.testing.assert_array_equal(problem.rows[:, :k], bare.rows[:, :k])
    own, few = summary_of(problem), summary_of(bare)
    assert own.used.sum() > few.used.sum() + 2 * len(NAMES)
    # The ground that the contacts are of is nearer to them than the configured one.
    column = [problem.scale.names.index(f"contacts:{name}") for name in NAMES]
    off = {}
    for name, model in (
        ("configured", BASE),
        ("true", replace(BASE, table=table_with("debris", eta_max=0.4))),
    ):
        numbers, _ = own.of_model(model, 3, 8)
        off[name] = np.abs((numbers - own.observed) / own.error)[column]
    assert np.mean(off["true"]) < 1.5 < 0.7 * np.mean(off["configured"])


def test_rocks_without_contacts_are_not_rocks_without_motion(with_contacts: Case) -> None:
    table = with_contacts.observations.contacts
    case = with_observed(with_contacts, contacts=table.take(table.rock_id != "R3"))
    problem = site_data_of(case, 2)
    i = problem.scale.names.index("contacts:contacts")
    assert problem.unseen[:, i].tolist() == [r == 3 for r in range(case.n_rocks)]
    seen = observed_campaign(case).contacts
    assert seen is not None and 3 not in seen.rock
