"""Reading, checking and telling what observations support."""

from __future__ import annotations

import csv
import sqlite3

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from helpers.observed_slope import LV95, NORTH, TABLES, TOP, at, setting

from sassgis.errors import InputError, OutputError
from sassgis.gap.advice.measure_next import what_is_identifiable
from sassgis.gap.observations.case import drop_and_density
from sassgis.gap.observations.checks import check_observations
from sassgis.gap.observations.observed import (
    Observations,
    parent_of,
    rock_masses_kg,
    rock_radii_m,
    root_of,
)
from sassgis.gap.observations.tables import TABLES as KNOWN
from sassgis.gap.observations.tables import (
    Deposits,
    Impacts,
    Metadata,
    Passages,
    Rocks,
    Trajectories,
)
from sassgis.grid import Grid
from sassgis.inputs.observation_files import read_observations, validate_observations
from sassgis.outputs.geopackage import FIXED_TIME
from sassgis.outputs.site_template import observations_template
from sassgis.settings.blocks import BlockPopulation


def lines(observations, grid=None):
    return [str(f) for f in validate_observations(observations, grid)]


def only(observations, grid=None):
    """The single finding, as one line."""
    found = lines(observations, grid)
    assert len(found) == 1, found
    assert "\n" not in found[0]
    return found[0]


# --- reading -----------------------------------------------------------------------------------


def test_a_folder_is_read_whole(folder, slope):
    path = folder()
    observed = read_observations(path, slope)
    assert [len(t) for t in observed.tables.values()] == [5, 2, 10, 5, 0, 7, 16]
    assert observed.rock_names == ("R1", "R2", "R3", "R4", "R5")
    assert observed.rocks.mass_kg[0] == 540.0
    assert observed.passages.station.tolist()[:2] == ["S1", "S2"]
    assert observed.passages.row.tolist()[:2] == [2, 3]
    assert observed.impacts.vn_in_mps[3] == -5.0
    assert observed.stations.vertices[1].shape == (2, 2)
    assert observed.metadata.fps == 25.0
    assert np.isnan(observed.metadata.height_error_m)
    assert observed.metadata.others == {"place": "made up"}
    assert "rotation_hz" not in observed.trajectories.present
    assert observed.present["deposits"] == {"x", "y", "z", "mass_kg", "volume_m3"}
    # One block belongs to no rock, and nothing else is odd.
    assert only(observed, slope) == (
        f"warning: {path / 'deposits.csv'}: deposits.rock_id: row 8: not in the table of rocks: "
        "taken as unattributed blocks (found no name)"
    )


def test_pieces_belong_to_their_rock(folder, slope):
    observed = read_observations(folder(), slope)
    assert observed.rock_of("deposits").tolist() == [0, 1, 2, 3, 4, 4, -1]
    assert observed.is_piece("deposits").tolist() == [False] * 4 + [True, True, False]


def test_names_of_pieces():
    assert parent_of("R7.2") == "R7"
    assert parent_of("R7") is None
    assert parent_of("R7.") is None
    assert root_of("R7.2.1", {"R7", "R7.2"}) == "R7"
    assert root_of("R7.2", {"R7.2"}) == "R7.2"
    assert root_of("X.1", {"R7"}) == "X.1"
    bare = Observations(deposits=Deposits.of(rock_id=["A", "A.1", "A.2", "B.1", "B.2", ""]))
    assert bare.rock_names == ("A", "B.1", "B.2")
    assert bare.rock_of("deposits").tolist() == [0, 0, 0, 1, 2, -1]


def test_missing_tables_and_columns_are_fine(folder, slope):
    path = folder(rocks=None, stations=None, impacts=None, trajectories=None, metadata=None)
    for file in path.iterdir():
        if file.stem not in ("passages", "deposits"):
            file.unlink()
    observed = read_observations(path, slope)
    assert len(observed.rocks) == 0
    assert observed.rock_names[:5] == ("R1", "R2", "R3", "R4", "R5")
    assert lines(observed, slope) == []


def geopackage(path, crs=LV95, only=None, shift=(0.0, 0.0)):
    """The made-up tables as layers with geometry, metadata without."""
    for name, (header, rows) in TABLES.items():
        if only and name not in only:
            continue
        frame = pd.DataFrame([list(r) for r in rows], columns=header.split(","))
        if name == "metadata":
            frame["value"] = frame["value"].astype(str)
            pyogrio.write_dataframe(frame, path, layer=name, driver="GPKG")
            continue
        if name == "stations":
            shapes = [shapely.LineString([(r.x0, r.y0), (r.x1, r.y1)]) for r in frame.itertuples()]
            frame = frame[["station"]]
        else:
            shapes = shapely.points(frame.x + shift[0], frame.y + shift[1], frame.z)
            frame = frame.drop(columns=["x", "y", "z"])
        layer = gpd.GeoDataFrame(frame, geometry=shapes, crs=LV95)
        if crs is not None:
            layer = layer.to_crs(crs)
        pyogrio.write_dataframe(layer, path, layer=name, driver="GPKG")
    return path


def test_a_geopackage_holds_the_same(folder, slope, tmp_path):
    from_csv = read_observations(folder(), slope)
    from_gpkg = read_observations(geopackage(tmp_path / "o.gpkg"), slope)
    for name, table in from_csv.tables.items():
        other = from_gpkg.tables[name]
        for column, values in table.numbers.items():
            np.testing.assert_allclose(other.numbers[column], values, err_msg=f"{name}.{column}")
        for column in (c.name for c in KNOWN[name] if c.text):
            assert getattr(other, column).tolist() == getattr(table, column).tolist()
    np.testing.assert_allclose(from_gpkg.stations.vertices, from_csv.stations.vertices)
    assert from_gpkg.metadata == from_csv.metadata


def test_other_coordinates_are_brought_into_those_of_the_dem(slope, tmp_path):
    observed = read_observations(geopackage(tmp_path / "o.gpkg", crs="EPSG:4326"), slope)
    np.testing.assert_allclose(observed.rocks.x[0], at(2.0, 20.0)[0], atol=0.01)
    # Heights stay: no datum of heights is stated.
    np.testing.assert_allclose(observed.rocks.z[0], at(2.0, 20.0)[2], atol=0.01)


def test_one_layer_elsewhere_is_left_out_all_layers_are_refused(slope, tmp_path):
    path = geopackage(tmp_path / "o.gpkg", only=["rocks", "passages", "stations"])
    geopackage(path, only=["deposits"], shift=(50_000.0, 0.0))
    observed = read_observations(path, slope)
    assert len(observed.deposits) == 0 and len(observed.passages) == 10
    assert any("error" in line and "deposits" in line for line in lines(observed, slope))
    far = geopackage(tmp_path / "far.gpkg", only=["rocks", "deposits"], shift=(50_000.0, 0.0))
    with pytest.raises(InputError, match=r"far.gpkg.*outside the DEM"):
        read_observations(far, slope)


def test_names_that_are_numbers_and_decimal_commas(tmp_path):
    (tmp_path / "deposits.csv").write_text(
        "\ufeffROCK_ID; X_m;y;mass_kg\n7,0;1,5;2;10\n8.0;2;3;\n;4;n/a;5\n\n", "utf-8"
    )
    observed = read_observations(tmp_path)
    assert observed.deposits.x.tolist()[:2] == [1.5, 2.0]
    assert np.isnan(observed.deposits.mass_kg[1])
    frame = gpd.GeoDataFrame(
        {"rock_id": [7.0, 7.2, np.nan]}, geometry=gpd.points_from_xy([1, 2, 3], [1, 2, 3])
    )
    frame.to_file(tmp_path / "n.gpkg", layer="deposits", engine="pyogrio")
    assert read_observations(tmp_path / "n.gpkg").deposits.rock_id.tolist() == ["7", "7.2", ""]


NO_LOOSE_BLOCK = {"deposits": lambda rows: rows[:-1]}

# --- what is left out and said so -----------------------------------------------------------------


def test_bad_cells_name_file_table_column_and_row(folder, slope):
    path = folder(
        passages=setting("speed_mps", "fast", [3]),
        rocks=setting("mass_kg", lambda m: -m, [1]),
        **NO_LOOSE_BLOCK,
    )
    with (path / "impacts.csv").open("a") as file:
        file.write("R1,2\n")
    observed = read_observations(path, slope)
    assert lines(observed, slope) == [
        f"error: {path / 'impacts.csv'}: impacts: row 7: does not fit the header (expected 13 "
        "values (texts with a , in quotes)); row left out",
        f"error: {path / 'rocks.csv'}: rocks.mass_kg: row 3: cannot be (found -540; expected "
        "above 0 kg); value left out",
        f"error: {path / 'passages.csv'}: passages.speed_mps: row 5: is not a number (found "
        "'fast'; expected a number); value left out",
    ]
    assert np.isnan(observed.rocks.mass_kg[1]) and observed.rocks.mass_kg[0] == 540.0
    assert np.isnan(observed.passages.speed_mps[3])
    assert len(observed.impacts) == 5


def test_texts_that_no_report_can_show_are_left_out(folder, slope):
    path = folder(
        rocks=setting("rock_id", "R" * 5000, [1]),
        passages=setting("station", "S\0", [3]),
        metadata=lambda rows: [*rows, {"key": "note", "value": "n" * 5000}],
        **NO_LOOSE_BLOCK,
    )
    observed = read_observations(path, slope)
    found = lines(observed, slope)
    rock, station = (
        next(x for x in found if f"{t}: row" in x) for t in ("rocks.rock_id", "passages.station")
    )
    assert "row 3: text is too long (found 5000 characters: 'RRRRRRRRRRRRRRRRRRRR'..." in rock
    assert "row 5: holds a character that cannot be shown" in station
    assert len(observed.rocks) == 4 and observed.passages.station[3] == ""
    assert observed.metadata.others["note"] == ""
    assert not [x for x in found if len(x) > 1000]


def renamed(old, new):
    return changed(lambda row: {new if k == old else k: v for k, v in row.items()})


def changed(change):
    return lambda rows: [change(row) for row in rows]


def longer_axes(factor):
    return changed(
        lambda r: r | {f"semi_axis_{k}_m": factor * r[f"semi_axis_{k}_m"] for k in "abc"}
    )


def repeated(*which):
    return lambda rows: [*rows, *(dict(rows[i]) for i in which)]


#: What the table holds in place of what it should, and other tables that are not there.
CASES = {
    "unknown column": (
        "passages", renamed("speed_mps", "speed_kmh"),
        "passages.speed_kmh: column is not known and is not read "
        "(expected speed_mps: the values divided by 3.6)",
    ),
    "column without unit": (
        "passages", renamed("speed_mps", "speed"), "expected speed_mps, with its unit",
    ),
    "misspelt column": ("passages", renamed("height_m", "hieght_m"), "nearest: height_m"),
    "rock twice": (
        "rocks", repeated(1),
        "rocks.rock_id: row 7: is there twice; the first one is taken (found 'R2'",
    ),
    "passage twice": (
        "passages", repeated(2),
        "row 12: is there twice; the first one is taken (found 'R2 at S1'",
    ),
    "station twice": ("stations", repeated(0), "stations.station: row 4: is there twice"),
    "impact twice": ("impacts", repeated(0), "impacts.rock_id, impact: row 7: is there twice"),
    "stop twice": (
        "deposits", repeated(0), "deposits.rock_id: row 8: the same stop is there twice",
    ),
    "rock not listed": (
        "rocks", lambda rows: rows[:4],
        "passages.rock_id: rows 10, 11: not in the table of rocks: taken as unattributed blocks "
        "(found 'R5'; expected one of 'R1', 'R2', 'R3', 'R4')",
        "impacts", "trajectories", "deposits",
    ),
    "no such station": (
        "passages", setting("station", "S3", [9]),
        "passages.station: row 11: no such station: the passages are used by their x and y alone "
        "(found 'S3'; expected one of 'S1', 'S2'",
    ),
    "km/h": (
        "passages", setting("speed_mps", lambda v: 3.6 * v),
        "passages.speed_mps: rows 2, 3, 4, 5, 6 and 5 more: look like km/h",
    ),
    "km/h along a path": (
        "trajectories", setting("speed_mps", lambda v: 3.6 * v),
        "trajectories.speed_mps: rows 2, 3, 4, 5, 6 and 11 more: look like km/h (found 3.60 times",
    ),
    "one too fast": (
        "passages", setting("speed_mps", 60.0, [0]),
        "passages.speed_mps: row 2: faster than the drop allows (found 60.0 m/s after a drop of ",
    ),
    "impact too fast": (
        "impacts", setting("vt_in_mps", 45.0, [2]),
        "impacts.vt_in_mps: row 4: faster than the drop allows",
    ),
    "rad/s": (
        "passages", setting("rotation_hz", lambda f: 2 * np.pi * f),
        "passages.rotation_hz: rows 2, 3, 4, 5, 6 and 5 more: look like radians per second",
    ),
    "deg/s": (
        "impacts", setting("omega_in_radps", lambda w: 57.3 * w),
        "impacts.omega_in_radps: rows 2, 3, 4, 5, 6: look like degrees per second",
    ),
    "turns a minute": (
        "passages", setting("rotation_hz", lambda f: 60.0 * f),
        "passages.rotation_hz: rows 2, 3, 4, 5, 6 and 5 more: look like turns per minute",
    ),
    "spins of no unit": (
        "passages", setting("rotation_hz", lambda f: 35.0 * f),
        "passages.rotation_hz: rows 2, 3, 4, 5, 6 and 5 more: too fast for the sizes and speeds",
    ),
    "milliseconds": (
        "trajectories", setting("t_s", lambda t: 1000.0 * t),
        "trajectories.t_s: rows 2, 3, 4, 5, 6 and 11 more: look like milliseconds (found 0.006",
    ),
    "axes in cm": ("rocks", longer_axes(100), "rows 2, 3, 4, 5, 6: look like centimetres"),
    "tonnes, no volume": (
        "rocks", changed(lambda r: r | {"mass_kg": 2.7 * r["volume_m3"], "volume_m3": ""}),
        "rocks.mass_kg: rows 2, 3, 4, 5, 6: look like tonnes: mass and semi-axes do not go",
        "deposits",
    ),
    "full axes": (
        "rocks", longer_axes(2),
        "look like full axes, not semi-axes (found ellipsoids of 8 times the volume",
    ),
    "tonnes": (
        "rocks", setting("mass_kg", 0.54),
        "rocks.mass_kg: rows 2, 3, 4, 5, 6: look like tonnes: mass and volume do not go together",
        "deposits",
    ),
    "normal inward": (
        "impacts", setting("vn_in_mps", 5.0, [1]),
        "impacts.vn_in_mps, vn_out_mps: row 3: the rock leaves the ground before it hits it "
        "(found vn_in = 5 m/s; expected below zero",
    ),
    "energy gained": (
        "impacts", setting("vt_out_mps", 15.0, [4]),
        "impacts.vt_out_mps: row 6: more energy after the impact than before (found 1.83 "
        "times; expected at most 1, 1.42 with",
    ),
    "before and after swapped": (
        "impacts",
        changed(
            lambda r: r
            | {"vt_in_mps": 8, "vn_in_mps": -2, "omega_in_radps": 16}
            | {"vt_out_mps": 11, "vn_out_mps": 5, "omega_out_radps": 12}
        ),
        "before and after look swapped: more energy",
    ),
    "radians": (
        "impacts", setting("slope_deg", 0.61),
        "impacts.slope_deg: rows 2, 3, 4, 5, 6: look like radians or tangents",
    ),
    "slope over the edge": (
        "impacts", setting("slope_deg", 135, [0]), "found 135; expected -90 to 90 °",
    ),
    "x and y swapped": (
        "deposits", changed(lambda r: r | {"x": r["y"], "y": r["x"]}),
        "deposits.x, y: rows 2, 3, 4, 5, 6 and 1 more: no row lies on the DEM",
    ),
    "outside": (
        "deposits", setting("y", NORTH - 301.0, [0]),
        "deposits.x, y: row 2: lies outside the DEM",
    ),
    "other heights": (
        "deposits", setting("z", lambda z: z + 48.0),
        "deposits.z: rows 2, 3, 4, 5, 6 and 1 more: heights are offset from the DEM: "
        "another height system? (found +48.00 m",
    ),
    "one stray height": (
        "deposits", setting("z", lambda z: z - 300.0, [0]),
        "deposits.z: row 2: height is far from the DEM (found -300.0 m",
    ),
    "path under ground": (
        "trajectories", setting("z", lambda z: z - 10.0), "paths run under the ground",
    ),
    "listed upward": (
        "passages", lambda rows: [rows[1], rows[0], *rows[2:]],
        "passages.station: row 3: passages are not listed down the slope",
    ),
    "above the release": (
        "rocks", lambda rows: [rows[0] | dict(zip("xyz", at(2, 150), strict=True)), *rows[1:]],
        "passages.station: row 2: passages lie above the release of the rock",
        "trajectories", "impacts",
    ),
    "far from the station": (
        "passages", setting("x", lambda x: x + 90.0, [0]),
        "passages.x, y: row 2: passages lie away from the station that they name (found "
        "up to 32.5 m",
    ),
    "pieces too heavy": (
        "deposits", setting("mass_kg", 500.0, [4]),
        "deposits.mass_kg: rows 6, 7: blocks of R5 are more than the rock itself (found "
        "700 kg; expected 654.6 kg at most",
    ),
    "pieces of several rocks too heavy": (
        "deposits", setting("mass_kg", 900.0, [0, 1]),
        "deposits.mass_kg: rows 2, 3: blocks of R1, R2 are more than the rock itself (found 900 kg",
    ),
    "pieces without suffix": (
        "deposits", setting("rock_id", "R5", [4, 5]),
        "deposits.rock_id: row 7: several stops of one rock are taken to be its pieces "
        "(found 'R5'; expected names with a suffix, such as R5.1",
    ),
    "percent": (
        "metadata", setting("value", 5, [1]),
        "metadata.value: row 3: speed_error_rel cannot be used: looks like percent (found '5'",
    ),
    "half a place": (
        "deposits", setting("y", "", [0]),
        "deposits.x, y: row 2: x or y is missing; value left out",
    ),
    "empty table": ("impacts", lambda rows: rows.clear() or [], "table has no rows"),
    "no line": ("stations", setting("x0", "", [0]), "station has no line"),
    "no time": (
        "trajectories", setting("t_s", "", [3]),
        "trajectories.t_s: row 5: point has no time; row left out",
    ),
    "no name": (
        "trajectories", setting("rock_id", "", [3]),
        "trajectories.rock_id: row 5: has no name; row left out",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_each_fault_is_found_once_and_named(case, folder, slope):
    table, change, text, *gone = CASES[case]
    # One block belongs to no rock: that is told in another test.
    own = (lambda rows: change(rows[:-1])) if table == "deposits" else change
    changes = {**NO_LOOSE_BLOCK, table: own, **dict.fromkeys(gone)}
    found = lines(read_observations(folder(**changes), slope), slope)
    assert any(text in line for line in found), found
    # The fault is told once, not in three lines.
    assert len(found) <= (2 if case in ("other heights", "above the release") else 1), found


def test_values_left_out_are_gone_and_the_rest_stays(folder, slope):
    change = setting("speed_mps", lambda v: 3.6 * v)
    observed = read_observations(folder(passages=change), slope)
    assert "speed_mps" not in observed.passages.present
    assert {"height_m", "rotation_hz"} <= observed.passages.present
    # Findings survive the reading; a second look adds none.
    assert validate_observations(observed, slope) == validate_observations(observed, slope)
    assert sum("km/h" in line for line in lines(observed, slope)) == 1


def test_a_rock_cannot_climb():
    down = {"A": (80.0, 40.0), "B": (81.0, 41.0), "C": (79.0, 95.0)}
    observed = Observations(
        passages=Passages.of(
            rock_id=[name for name in down for _ in (0, 1)],
            station=["S1", "S2"] * 3,
            z=[z for pair in down.values() for z in pair],
        )
    )
    line = only(observed)
    assert line.startswith("error: passages.z: row 6: the rock climbs from one station to the next")


def test_made_up_observations_can_be_checked_too():
    observed = Observations(
        impacts=Impacts.of(
            rock_id=["A", "A"],
            impact=["1", "2"], vt_in_mps=[5.0, 5.0], vn_in_mps=[-2.0, 2.0], vt_out_mps=[4.0, 4.0],
            vn_out_mps=[1.0, 1.0],
        )
    )  # fmt: skip
    assert only(observed).startswith("error: impacts.vn_in_mps, vn_out_mps: row 2: the rock leaves")
    with pytest.raises(ValueError, match=r"speed_mps: 1 values, not 2"):
        Passages.of(rock_id=["A", "B"], speed_mps=[1.0])
    with pytest.raises(TypeError, match="no such column: speed"):
        Passages.of(rock_id=["A"], speed=[1.0])


@pytest.mark.parametrize(("factor", "said"), [(1.0, ""), (3.6, "look like km/h")])
def test_speeds_of_slow_rocks_are_judged_over_distances_that_show(factor, said):
    """Ten points a second of a rock at 2 m/s, each a quarter of a metre off."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 20.0, 0.1)
    observed = Observations(
        trajectories=Trajectories.of(
            rock_id=["A"] * t.size,
            t_s=t,
            x=2.0 * t + rng.normal(0.0, 0.25, t.size),
            y=rng.normal(0.0, 0.25, t.size),
            z=rng.normal(0.0, 0.25, t.size),
            speed_mps=np.full(t.size, 2.0 * factor),
        ),
        metadata=Metadata(position_error_m=0.25),
    )
    assert any("trajectories.speed_mps" in line for line in lines(observed)) == bool(said)
    assert said in "".join(lines(observed))


def test_pieces_spin_as_small_as_they_are():
    """A piece that turns fast has little energy in it; one of its rock's size would have much."""
    hit = {"vt_in_mps": 10.0, "vn_in_mps": -4.0, "omega_in_radps": 5.0}
    after = {"vt_out_mps": 7.0, "vn_out_mps": 2.0, "omega_out_radps": 30.0}

    def found(rock_id, mass_kg):
        return lines(
            Observations(
                rocks=Rocks.of(rock_id=["A"], mass_kg=[3000.0], density_kgm3=[2700.0]),
                impacts=Impacts.of(
                    rock_id=[rock_id],
                    impact=["1"],
                    mass_kg=[mass_kg],
                    **{k: [v] for k, v in (hit | after).items()},
                ),
            )
        )

    assert any("more energy after" in line for line in found("A", 3000.0))
    assert not any("more energy after" in line for line in found("A.1", 24.0))


def test_rocks_may_be_let_go_above_the_ground(folder, slope):
    for height, n in ((3.0, 0), (8.0, 1)):
        raised = setting("z", lambda z, height=height: z + height)
        found = lines(read_observations(folder(**NO_LOOSE_BLOCK, rocks=raised), slope), slope)
        assert len(found) == n
    assert "rocks.z" in found[0] and "heights are offset" in found[0]


def test_noise_of_the_stated_size_is_not_a_fault(folder, slope):
    rng = np.random.default_rng(0)

    def noisy(rows):
        for row in rows:
            for c in ("vt_in_mps", "vn_in_mps", "vt_out_mps"):
                row[c] *= 1 + 0.05 * rng.normal()
        return rows

    path = folder(**NO_LOOSE_BLOCK, impacts=noisy)
    assert lines(read_observations(path, slope), slope) == []


# --- hopeless ------------------------------------------------------------------------------------


def test_hopeless_input_is_one_error(folder, slope, tmp_path):
    with pytest.raises(InputError, match=r"nowhere: observations: not found \(expected a GeoPack"):
        read_observations(tmp_path / "nowhere")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="holds no table of observations"):
        read_observations(empty)
    text = tmp_path / "o.gpkg"
    text.write_text("no database")
    with pytest.raises(InputError, match=r"o.gpkg: observations: cannot be read"):
        read_observations(text)
    with pytest.raises(InputError, match="holds no observed rock"):
        read_observations(observations_template(tmp_path / "template"))


def degrees(rows):
    return [r | {"x": 8.6, "y": 46.4} for r in rows]


def test_everything_beside_the_dem_is_refused_with_a_guess(folder, slope):
    tables = dict.fromkeys(("rocks", "passages", "impacts", "deposits", "trajectories"), degrees)
    with pytest.raises(InputError, match=r"rocks: no row lies on the DEM: .*look like degrees"):
        read_observations(folder(**tables), slope)
    local = Grid(slope.values, 0.0, 300.0, 2.0)
    with pytest.raises(InputError, match="no row lies on the DEM: another coordinate system"):
        read_observations(folder(), local)


def test_unknown_tables_are_named(folder, slope):
    path = folder(**NO_LOOSE_BLOCK)
    (path / "passage.csv").write_text("rock_id\nR1\n")
    line = only(read_observations(path, slope), slope)
    assert "table passage is not one of observations" in line and "nearest: passages" in line


# --- templates -----------------------------------------------------------------------------------


def test_template_of_csv_files_has_all_columns_and_can_be_filled_in(tmp_path, slope):
    path = observations_template(tmp_path / "new" / "observed")
    for name, columns in KNOWN.items():
        with (path / f"{name}.csv").open() as file:
            assert next(csv.reader(file)) == [c.name for c in columns]
    guide = (path / "README.txt").read_text("utf-8")
    for columns in KNOWN.values():
        for column in columns:
            assert column.name in guide and column.meaning in guide
    with pytest.raises(OutputError, match="exists already"):
        observations_template(path)
    with pytest.raises(InputError, match=r"expected a folder or a \.gpkg file"):
        observations_template(tmp_path / "observed.xlsx")
    with pytest.raises(InputError, match="--crs: is no coordinate system"):
        observations_template(tmp_path / "observed.gpkg", crs="EPSG:999999")
    with (path / "deposits.csv").open("a") as file:
        x, y, z = at(0, 250)
        file.write(f"R1,{x},{y},{z},100,\n")
    (path / "metadata.csv").write_text("key,value\nfps,50\nspeed_error_rel,\n")
    observed = read_observations(path, slope)
    assert observed.deposits.mass_kg.tolist() == [100.0]
    assert observed.metadata.fps == 50.0
    assert all("table has no rows" in line for line in lines(observed, slope))


def test_template_of_a_geopackage_can_be_filled_in(tmp_path, slope):
    path = observations_template(tmp_path / "observed.gpkg", crs=LV95)
    layers = dict(pyogrio.list_layers(path).tolist())
    assert layers["stations"] == "LineString" and layers["deposits"] == "Point Z"
    assert layers["metadata"] is None
    for name, columns in KNOWN.items():
        fields = set(pyogrio.read_info(path, layer=name)["fields"])
        places = {"x", "y", "x0", "y0", "x1", "y1"}
        assert fields == {c.name for c in columns} - places
    with sqlite3.connect(path) as database:
        times = database.execute("SELECT DISTINCT last_change FROM gpkg_contents").fetchall()
    assert times == [(FIXED_TIME,)]
    frame = gpd.GeoDataFrame(
        {"rock_id": ["R1"], "mass_kg": [100.0]}, geometry=[shapely.Point(*at(0, 250))], crs=LV95
    )
    pyogrio.write_dataframe(frame, path, layer="deposits", append=True)
    with sqlite3.connect(path) as database:
        database.execute("UPDATE metadata SET value = '50' WHERE key = 'fps'")
        (note,) = database.execute(
            "SELECT title FROM gpkg_data_columns WHERE table_name = 'passages' "
            "AND column_name = 'speed_mps'"
        ).fetchone()
        assert note == "speed_mps [m/s]"
    observed = read_observations(path, slope)
    assert observed.deposits.z.tolist() == [pytest.approx(TOP - 0.7 * 250)]
    assert observed.metadata.fps == 50.0
    with pytest.raises(OutputError, match="exists already"):
        observations_template(path)


# --- what can be told -----------------------------------------------------------------------------


def test_full_data_can_tell_nearly_everything(folder, slope):
    told = what_is_identifiable(read_observations(folder(), slope))
    assert told.rocks == 5 and told.unattributed == 1
    kept = next(q for q in told.quantities if q.name == "energy_kept")
    assert kept.rocks == 5 and kept.values == 5
    stops = next(q for q in told.quantities if q.name == "runout_m")
    assert stops.values == 7 and stops.rocks == 5
    text = " ".join(told.not_identifiable)
    assert "With 5 rocks, a gap remains undetected below 1.25 standard deviations" in text
    assert "same mass" in text
    assert "No " not in text


def test_stops_alone_cannot_tell_much(folder, slope):
    observed = read_observations(folder(), slope)
    told = what_is_identifiable(Observations(deposits=observed.deposits))
    assert {q.name for q in told.quantities} == {
        "runout_m",
        "lateral_m",
        "block_mass_kg",
        "block_volume_m3",
    }
    text = " ".join(told.not_identifiable)
    for missing in ("release points", "speeds at stations", "trajectories in time", "semi-axes"):
        assert f"No {missing}" in text
    assert "No deposits" not in text
    nothing = what_is_identifiable(Observations())
    assert nothing.quantities == () and "No rocks" in nothing.not_identifiable[0]


def test_masses_and_radii_from_what_is_there():
    observed = Observations(
        rocks=Rocks.of(
            rock_id=["A", "B", "C", "D", "A.1"],
            mass_kg=[100.0, np.nan, np.nan, np.nan, 3.0],
            volume_m3=[9.9, 2.0, np.nan, np.nan, np.nan],
            density_kgm3=[np.nan, 2500.0, np.nan, np.nan, np.nan],
            semi_axis_a_m=[np.nan, np.nan, 0.5, np.nan, np.nan],
            semi_axis_b_m=[np.nan, np.nan, 0.5, np.nan, np.nan],
            semi_axis_c_m=[np.nan, np.nan, 0.5, np.nan, np.nan],
        )
    )
    assert observed.rock_names == ("A", "B", "C", "D")
    ball = 4 / 3 * np.pi * 0.125
    np.testing.assert_allclose(rock_masses_kg(observed), [100.0, 5000.0, 2700 * ball, np.nan])
    np.testing.assert_allclose(rock_radii_m(observed)[2], 0.5)


def hops(scale, wrong=()):
    """Impacts at 5 places down the slope: a half of the energy is lost at each, 5 % in the air."""

    def change(_records):
        made = []
        for i in range(1, 6):
            square, before = 2.0 * 9.81 * 14.0, None
            for k, down in enumerate((40.0, 62.0, 85.0, 110.0, 140.0), 1):
                place = at(2.0 * i, down)
                if before is not None:
                    square = 0.5 * square + 0.95 * 2.0 * 9.81 * (before - place[2])
                before = place[2]
                fast = scale * (3.0 if (i, k) in wrong else 1.0) * np.sqrt(square)
                slow = scale * np.sqrt(0.5 * square)
                made.append(
                    {
                        "rock_id": f"R{i}", "impact": k + 6, "x": place[0], "y": place[1],
                        "z": place[2], "vt_in_mps": 0.8 * fast, "vn_in_mps": -0.6 * fast,
                        "vt_out_mps": 0.9 * slow, "vn_out_mps": np.sqrt(0.19) * slow,
                    }
                )  # fmt: skip
        return made

    return change


@pytest.fixture
def hopped(folder, slope):
    """Observations of ``hops``, without stops and paths."""

    def read(scale, wrong=(), **changes):
        path = folder(impacts=hops(scale, wrong), deposits=None, trajectories=None, **changes)
        return read_observations(path, slope)

    return read


def test_a_wrong_scale_of_speeds_is_named_and_the_rows_are_kept(hopped, slope):
    found = only(read := hopped(1.2), slope)
    assert "impacts.vt_in_mps" in found and "speeds are too high for all" in found
    # The air takes 5 % of the energy: 1.2 times √(1 − 0.05 × fall over gain).
    assert "found 17 % more" in found and "20 flights" in found
    assert np.isfinite(read.impacts.vt_in_mps).all()
    assert lines(hopped(1.0)) == []


def test_speeds_at_impacts_in_another_unit_are_left_out(hopped, slope):
    found = only(read := hopped(3.6), slope)
    assert "look like km/h, or another unit (found 3.5 times what the falls" in found
    assert np.isnan(read.impacts.vt_in_mps).all() and np.isnan(read.impacts.vn_out_mps).all()


def test_rocks_too_fast_for_the_stated_start_speak_against_it_and_stay(hopped, slope):
    # Those of hops fell 14 m before their first impact: here they start 12 m too low.
    def low(records):
        out = [dict(r) for r in records]
        for i, own in enumerate(out[:5], 1):
            own["x"], own["y"], own["z"] = at(2.0 * i, 38.0)
        return out

    found = only(read := hopped(1.0, rocks=low, passages=None), slope)
    assert "the drop from the stated start allows, at 5 of 5 rocks; they are kept" in found
    assert "m higher" in found
    assert np.isfinite(read.impacts.vt_in_mps).all()


def test_sizes_are_compared_at_the_density_of_the_configured_blocks():
    light = (
        BlockPopulation(density_kgm3=(550.0, 650.0)),
        BlockPopulation(density_kgm3=(600.0, 600.0)),
    )
    axes = np.array([0.5, 0.4])
    rocks = Rocks.of(
        rock_id=["A", "B"], mass_kg=600.0 * 4.0 / 3.0 * np.pi * axes**3,
        semi_axis_a_m=axes, semi_axis_b_m=axes, semi_axis_c_m=axes,
    )  # fmt: skip
    observed = Observations(rocks=rocks)
    assert drop_and_density(light)[1] == pytest.approx(600.0)
    assert check_observations(observed, None, *drop_and_density(light)) == []
    assert "full axes" in str(check_observations(observed)[0])


def test_a_rock_that_hardly_comes_down_is_no_error():
    impacts = Impacts.of(
        rock_id=["A"] * 4, impact=["1", "2", "3", "4"], vt_in_mps=[10.0] * 4,
        vn_in_mps=[-2.0, -3.0, 0.4, 2.5], vt_out_mps=[8.0] * 4, vn_out_mps=[1.0] * 4,
    )  # fmt: skip
    # Three errors of 5 % of the speed are 1.5 m/s.
    error, warning = check_observations(Observations(impacts=impacts))
    assert (error.level, error.rows) == ("error", (4,)) and "2.5 m/s" in error.found
    assert (warning.level, warning.rows) == ("warning", (3,)) and "0.4 m/s" in warning.found


def test_a_speed_at_the_release_counts_as_the_height_that_gives_it():
    slow, fast = (BlockPopulation(speed_mps=(0.0, v), drop_m=(0.0, 0.5)) for v in (0.0, 4.0))
    assert drop_and_density([fast, slow])[0] - drop_and_density([slow])[0] == pytest.approx(
        16.0 / 19.62
    )


def test_one_impact_too_fast_is_left_out_whatever_the_scale(hopped):
    for scale in (1.0, 1.2):
        read = hopped(scale, [(2, 4)])
        assert np.flatnonzero(np.isnan(read.impacts.vt_in_mps)).tolist() == [8]


def test_blocks_that_are_let_go_above_the_ground_may_be_as_fast(folder, slope):
    def first(records):
        place = at(2.0, 20.5)
        return [
            records[0] | {"x": place[0], "y": place[1], "z": place[2], "vt_in_mps": 5.0,
                          "vn_in_mps": -7.5},
            *records[1:],
        ]  # fmt: skip

    path = folder(impacts=first, rocks=setting("z", ""), deposits=None, trajectories=None)
    assert "faster than the drop allows" in only(read_observations(path, slope), slope)
    read = read_observations(path, slope, 4.0)
    assert validate_observations(read, slope, 4.0) == []
    assert np.isfinite(read.impacts.vt_in_mps).all()


def test_a_height_taken_from_the_terrain_is_as_wrong_as_the_place_makes_it(folder, slope):
    def first(z):
        place = at(2.0, 20.5)
        own = {"x": place[0], "y": place[1], "z": z(place[2]), "vt_in_mps": 5.0, "vn_in_mps": -6.0}
        return lambda records: [records[0] | own, *records[1:]]

    fine, rough = (
        lambda rows, e=e: [*rows, {"key": "position_error_m", "value": e}] for e in (0.1, 2.0)
    )
    for metadata, z, kept in (
        (fine, lambda z: "", False),
        (rough, lambda z: "", True),
        (rough, lambda z: z, False),
    ):
        path = folder(
            impacts=first(z), metadata=metadata, deposits=None, trajectories=None, passages=None
        )
        read = read_observations(path, slope)
        assert bool(np.isfinite(read.impacts.vt_in_mps[0])) is kept


def test_a_table_without_its_names_is_left_out_as_a_whole(tmp_path):
    (tmp_path / "rocks.csv").write_text("x,y,mass_kg\n1,2,300\n", encoding="utf-8")
    (tmp_path / "deposits.csv").write_text("rock_id,x,y\nR1,1,2\n", encoding="utf-8")
    (finding,) = [f for f in read_observations(tmp_path).findings if f.left_out]
    line = str(finding)
    assert "rocks.csv" in line and "(found x, y, mass_kg; expected rock_id); table left" in line
