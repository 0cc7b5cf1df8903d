from __future__ import annotations

import numpy as np
import pytest
from helpers.input_files import ONE_BLOCK
from helpers.one_line import one_line

from sassgis.errors import ConfigError, InputError
from sassgis.inputs.config import load_config
from sassgis.inputs.csv_table import check_on_profile, read_profile
from sassgis.inputs.ground_map import built_in_table

TABLE = built_in_table()
GOOD = "s_m,z_m,ground\n0,100,rock\n5,96.5,\n20,94,talus\n"


def test_profile_with_ground(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text(GOOD)
    profile = read_profile(path, TABLE, "debris")
    np.testing.assert_array_equal(profile.s, [0.0, 5.0, 20.0])
    np.testing.assert_array_equal(profile.z, [100.0, 96.5, 94.0])
    assert [TABLE.names[i] for i in profile.ground] == ["rock", "debris", "talus"]
    # One stretch over the whole length, in no cell.
    assert profile.cell_s.tolist() == [0.0, 20.0] and profile.cell.tolist() == [-1]


def test_columns_in_any_order_and_from_a_spreadsheet(tmp_path):
    path, sheet = tmp_path / "p.csv", tmp_path / "sheet.csv"
    path.write_text("z_m,s_m\n100,0\n96.5,5\n")
    sheet.write_bytes(b"\xef\xbb\xbfs_m;z_m\r\n0;100\r\n5;96,5\r\n;\r\n")
    one, other = read_profile(path, TABLE, "rock"), read_profile(sheet, TABLE, "rock")
    np.testing.assert_array_equal(one.z, other.z)
    np.testing.assert_array_equal(one.s, other.s)
    assert (one.ground == TABLE.index("rock")).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD.replace("5,96", "0,96"), ["row 3", "s_m", "0 after 0", "larger"]),
        (GOOD.replace("rock", "stone"), ["row 2", "ground", "'stone'", "one of rock"]),
        ("s_m,z_m\n0,1\n", ["too short", "1 row", "two rows"]),
    ],
)
def test_tables_that_cannot_be_used(tmp_path, text, words):
    path = tmp_path / "p.csv"
    path.write_text(text)
    with one_line(InputError, "p.csv", *words):
        read_profile(path, TABLE, "debris")


CONFIG = (
    f'[profile]\nfile = "p.csv"\nstart_m = [0, 5]\n{ONE_BLOCK}'
    '[[barriers]]\nname = "net"\nkind = "net"\nheight_m = 3\nchainage_m = 9\n'
)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0, 5]", "[-1, 5]", ["profile.start_m", "[-1, 5]", "0 to 20 m"]),
        ("chainage_m = 9", "chainage_m = 21", ["barriers[net].chainage_m", "21", "0 to 20 m"]),
    ],
)
def test_places_off_the_profile(tmp_path, old, new, words):
    (tmp_path / "p.csv").write_text(GOOD)
    path = tmp_path / "run.toml"
    path.write_text(CONFIG)
    profile = read_profile(tmp_path / "p.csv", TABLE, "debris")
    check_on_profile(load_config(path), profile)
    path.write_text(CONFIG.replace(old, new))
    with one_line(ConfigError, "run.toml", *words):
        check_on_profile(load_config(path), profile)
