"""The table of ranges: every parameter of every class has one, and errors are one clear line."""

from __future__ import annotations

from pathlib import Path

import pytest

from sassgis.errors import InputError
from sassgis.inputs.ground_map import built_in_table, read_ranges
from sassgis.settings.ground import EVERY_CLASS, RANGED, ranges_of


def test_every_parameter_has_a_range_and_says_where_it_is_from() -> None:
    table = built_in_table()
    rules = read_ranges(table)
    assert {r.parameter for r in rules if r.class_name == EVERY_CLASS} == set(RANGED)
    assert all(r.source for r in rules)
    # Only what the paper states was read in it.
    assert {(r.class_name, r.parameter) for r in rules if r.verified} == {
        (c, p) for c in ("rock", "debris") for p in ("mu_f", "mu_0", "k")
    }
    for r in ranges_of(table, table.names, rules):
        assert r.low <= r.value <= r.high and r.low < r.high


def test_own_ranges_go_before(tmp_path: Path) -> None:
    own = tmp_path / "ranges.csv"
    own.write_text("class;parameter;kind;low;high\nrock;mu_f;value;0,65;0,75\n", encoding="utf-8")
    table = built_in_table()
    (found,) = [
        r for r in ranges_of(table, ["rock"], read_ranges(table, own)) if r.parameter == "mu_f"
    ]
    assert (found.low, found.high) == (0.65, 0.75)
    assert found.source == "own table ranges.csv" and not found.verified


@pytest.mark.parametrize(
    ("row", "wrong"),
    [
        ("rok,mu_f,value,0,1", r"row 2: unknown ground class.*'rok'.*rock"),
        ("rock,mu_f,value,1,0", r"row 2: range of rock mu_f is reversed"),
        ("rock,mu_f,value,0,1,1.5", r"sites: row 2: is not a whole number.*'1\.5'"),
        ("rock,mu_f,value,0,1,-1", r"sites: row 2: is out of range.*0 or more"),
    ],
)
def test_errors_name_row_and_column(tmp_path: Path, row: str, wrong: str) -> None:
    own = tmp_path / "ranges.csv"
    header = ("class", "parameter", "kind", "low", "high", "sites")[: row.count(",") + 1]
    own.write_text(f"{','.join(header)}\n{row}\n", encoding="utf-8")
    with pytest.raises(InputError, match=wrong):
        read_ranges(built_in_table(), own)
