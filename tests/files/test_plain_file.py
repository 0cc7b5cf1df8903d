"""What a text, a table or a TOML file may be before anybody asks what it says."""

from __future__ import annotations

import pytest

from sassgis.errors import InputError
from sassgis.files.plain_file import LONGEST_TEXT, check_text, read_text, toml_table
from sassgis.inputs.csv_table import CsvColumn, csv_cells, csv_rows
from sassgis.inputs.result_folder import read_manifest


def nested(depth: int) -> str:
    return "a = " + "[" * depth + "]" * depth


def dotted(depth: int) -> str:
    return ".".join(["a"] * depth) + " = 1"


@pytest.mark.parametrize(
    ("good", "bad", "word"),
    [
        (nested(20), nested(21), "nested too deeply"),
        (dotted(20), dotted(22), "nested too deeply"),
        ("'a'.\"b\" . c = 1", "'a' . \"b\" . " * 10 + "c = 1", "nested too deeply"),
        (f"a = {2**63 - 1}", f"a = {2**63}", "64 bits"),
        (f"a = '{'b' * 1000}'", f"a = '{'b' * 1001}'", "1001 characters"),
        (f"{'b' * 1000} = 1", f"{'b' * 1001} = 1", "1001 characters"),
        (f"a = ['{'b' * 1000}']", f"a = ['{'b' * 1001}']", "1001 characters"),
        (r'a = "\t\n\u00e9\U0001F600\uFFFD"', r'a = "\u0007"', r"'\\x07'"),
        (r'a = "\u007f"', r'a = "\ufffe"', "ufffe"),
    ],
)
def test_limits_of_toml(good: str, bad: str, word: str) -> None:
    assert toml_table(good, "a.toml")
    with pytest.raises(InputError, match=word) as refused:
        toml_table(bad, "a.toml")
    assert str(refused.value).startswith("a.toml: ")


@pytest.mark.parametrize("delimiter", [",", ";"])
def test_limits_of_tables(delimiter: str) -> None:
    """Ten million columns would take minutes to be compared with those that are known."""
    columns = [f"c{i}" for i in range(1000)]
    assert csv_cells(delimiter.join(columns), "a.csv")[0] == columns
    with pytest.raises(InputError, match=r"row 1: has too many columns \(found 1001; expected"):
        csv_cells(delimiter.join([*columns, "c"]), "a.csv")


def test_limits_of_texts() -> None:
    for fine in ("n" * LONGEST_TEXT, 7, None, 2.5, "\N{SNOWMAN}"):
        check_text(fine, "a.gpkg", "name")
    with pytest.raises(InputError, match=r"^a\.gpkg: name: feature 3: text is too long"):
        check_text("n" * (LONGEST_TEXT + 1), "a.gpkg", "name", "feature 3")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (f"name,area\nb,{'n' * 1001}\n", r"a\.csv: area: row 2: text is too long"),
        ("name,area\nb,c\x1b[2J\n", r"a\.csv: area: row 2: holds a character"),
        (f"name,area\nb,{'n' * 200_000}\n", r"a\.csv: row 2: cannot be read \(found field larger"),
        ('name,area\nb,"c\n' + "d\n" * 100_000 + '"\n', r"a\.csv: area: row \d+: text is too long"),
        ('name,area\na,b\nb,"c\nd,e\nf,g\n', r"a\.csv: row 3: cannot be read .*quotes in pairs"),
        ('name,"area\nb,c\n', r"a\.csv: row 1: cannot be read .*quotes in pairs"),
        ('name,area\n"b"c,d\n', r"a\.csv: row 2: cannot be read .*quotes in pairs"),
    ],
)
def test_limits_of_cells(tmp_path, text: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        list(csv_rows(text, tmp_path / "a.csv", {"name": CsvColumn(), "area": CsvColumn()}))


def test_limits_of_files(tmp_path) -> None:
    file = tmp_path / "a.csv"
    with file.open("wb") as stream:
        stream.truncate(300_000_000)  # takes no room on the disk
    with pytest.raises(
        InputError, match=r"too large \(found 300 MB; expected a table of at most 200"
    ):
        read_text(file, None, "a table")


def test_nested_json(tmp_path) -> None:
    text = "[" * 100_000
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=r"manifest\.json: cannot be read"):
        read_manifest(tmp_path)
