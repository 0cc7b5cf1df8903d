from __future__ import annotations

import numpy as np
import pytest
from helpers.input_files import NORTH, ONE_BLOCK, WEST, at

from sassgis.errors import InputError
from sassgis.inputs.config import load_config
from sassgis.runs.check_inputs import check_inputs

TEXT = f"""
[terrain]
dem = "dem.tif"
vertical_datum = "LN02"
[release]
file = "release.gpkg"
name_field = "title"
spacing_m = 10
[ground]
file = "ground.gpkg"
class_field = "kind"
{ONE_BLOCK}[[stations]]
name = "road"
line = [[{WEST + 10}, {NORTH - 150}], [{WEST + 200}, {NORTH - 150}]]
[[barriers]]
name = "net"
kind = "net"
height_m = 4
capacity_kj = 500
line = [[{WEST + 10}, {NORTH - 120}], [{WEST + 200}, {NORTH - 120}]]
"""


@pytest.fixture
def config(tmp_path, make_dem, make_layer):
    values = np.broadcast_to(1000.0 - 10.0 * np.arange(20.0)[:, None], (20, 30)).copy()
    values[:, 27:] = -9999.0
    make_dem(values, nodata=-9999.0)
    make_layer([at(10, 20, 110, 60)], title=["north"])
    make_layer([at(0, 0, 134, 100)], "ground.gpkg", kind=["talus"])
    (tmp_path / "run.toml").write_text(TEXT)
    return tmp_path / "run.toml"


def test_report_says_what_the_inputs_hold(config):
    report = check_inputs(load_config(config))
    dem = report.dem
    assert dem is not None
    numbers = [dem[key] for key in ("n_rows", "n_cols", "cell_size", "lowest", "highest")]
    assert numbers == [20, 30, 10.0, 810.0, 1000.0]
    assert dem["nodata_share"] == pytest.approx(0.1)
    (area,) = report.areas
    assert area["size"] == pytest.approx(4000.0)
    # The multiples of 10 m inside: 9 columns, 3 rows.
    assert report.points == area["points"] == 27
    # Columns 0 to 12 have their centre under the polygon, of 27 with heights; half the rows.
    shares = {c["name"]: c["share"] for c in report.classes}
    assert shares == pytest.approx({"talus": 130 / 540, "debris": 410 / 540})
    assert [g.name for g in report.control_lines] == ["road", "net"]
    (share,) = (w for w in report.warnings if "debris 76 %" in w)
    assert "Estimated ground classes" in share
    lines = report.lines()
    assert not any("\n" in line for line in lines)
    text = "\n".join(lines)
    for word in (
        "20 rows x 30 columns of 10 m, 10.0 % nodata",
        "heights 810.0 to 1000.0 m, height system LN02",
        "EPSG:2056",
        "north: 4000 m2, 27 release points, blocks large",
        "talus, on 24.1 % of the cells: estimate",
        "net: 4 m high, 500 kJ",
        "note ",
    ):
        assert word in text


def test_notices_of_the_readers_are_in_the_report_and_not_in_the_log(config, make_layer, caplog):
    outside = at(250, 20, 350, 60)
    make_layer([outside], crs="EPSG:2056", to="EPSG:21781", title=["east"])
    report = check_inputs(load_config(config))
    assert any("of it lies outside the DEM" in w for w in report.warnings)
    assert any("of it is nodata" in w for w in report.warnings)
    assert any("reprojected from" in n for n in report.notices)
    assert not caplog.records
    make_layer([at(1000, 31, 1100, 58)], title=["far"])
    with pytest.raises(InputError, match="outside the DEM"):
        check_inputs(load_config(config))


def test_profile_runs_are_checked_without_a_map(tmp_path):
    path = tmp_path / "profile.toml"
    path.write_text(
        '[profile]\nfile = "p.csv"\nstart_m = [0, 5]\n'
        f'{ONE_BLOCK}[[stations]]\nname = "road"\nchainage_m = 9\n'
    )
    (tmp_path / "p.csv").write_text("s_m,z_m,ground\n0,100,rock\n5,96,\n20,94,\n")
    report = check_inputs(load_config(path))
    assert report.dem is None
    assert report.areas == ()
    assert [g.name for g in report.control_lines] == ["road"]
    assert {c["name"]: c["share"] for c in report.classes} == {"rock": 0.25, "debris": 0.75}
    text = "\n".join(report.lines())
    assert "3 vertices, chainage 0 to 20 m, heights 94.0 to 100.0 m" in text
    assert "debris, on 75.0 % of the profile: estimate" in text
    assert "blocks         large" in text


def test_of_many_areas_some_are_listed_and_the_verdict_is_last(config, make_layer, printed):
    names = [f"area {k}" for k in range(20)]
    make_layer([at(10 + 5 * k, 20, 14 + 5 * k, 60) for k in range(20)], title=names)
    short, full = printed("validate", config), printed("validate", config, "--all")
    assert sum(line.startswith("release area") for line in full.splitlines()) == 20
    listed = [line for line in short.splitlines() if line.startswith("release area")]
    assert len(listed) == 8 and "and 12 more: sassgis validate --all" in short
    assert "release points in 20 areas in all" in short
    assert short.splitlines()[-1].startswith("not ready for  risk")


def test_the_time_of_zone_is_stated_where_it_can_be_made(config):
    plain = check_inputs(load_config(config)).estimate
    assert plain is not None and plain.zone_seconds is None
    assert "zone" not in plain.lines()[2]
    keys = {"hazard.ref_width_m": 10.0, "hazard.preset": "ch-so", "hazard.compare_barriers": False}
    text = config.read_text().replace("[[blocks]]", "[[blocks]]\nonset_frequency = 0.1")
    config.write_text(text)
    given = check_inputs(load_config(config, keys)).estimate
    assert given is not None and given.zone_seconds is not None
    least, most = given.zone_seconds
    # All of the blocks once, and drawing: longer than the blocks by themselves.
    assert least == most > given.seconds
    assert "; of zone, " in given.lines()[2] and "drawing included" in given.lines()[2]
    auto = check_inputs(load_config(config, keys | {"hazard.blocks": "auto"})).estimate
    limited = {"hazard.blocks": "auto", "hazard.minutes_max": 2.0}
    short = check_inputs(load_config(config, keys | limited)).estimate
    assert auto is not None and auto.zone_seconds is not None
    assert short is not None and short.zone_seconds is not None
    assert auto.zone_seconds[0] == least and auto.zone_seconds[1] > 1800.0
    assert 120.0 < short.zone_seconds[1] < 180.0
