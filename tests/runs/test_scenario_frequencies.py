"""From a table of volumes to lines of a configuration."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from sassgis import load_config

OPTIONS = ("--complete-from", "0.1", "--scenarios", "0.1,1,10")


@pytest.fixture
def table(tmp_path: Path) -> Path:
    u = (np.arange(200) + 0.5) / 200
    volumes = 0.05 * u ** (-1 / 0.8)
    file = tmp_path / "blocks.csv"
    rows = (f"{v:.4f},talus" for v in volumes)
    file.write_text("\n".join(["volume_m3,place", *rows]) + "\n")
    return file


def test_the_lines_are_lines_of_a_configuration(table: Path, printed) -> None:
    out = printed("frequency", table, *OPTIONS, "--years", 50, "--area-ha", 2)
    config = table.with_name("sassgis.toml")
    site = '[terrain]\ndem = "dem.tif"\n[release]\nfile = "release.gpkg"\n'
    config.write_text(site + out[out.index("[[blocks]]") :])
    found = load_config(config)
    assert [b.volume_m3 for b in found.blocks] == [(0.1, 1.0), (1.0, 10.0)]
    small, large = found.onsets.values()
    assert small.unit == "per_year_ha"
    # Of 200 blocks from 0.05 m3 on 0.5^0.8 are above 0.1 m3, 10^-0.8 of those above 1 m3.
    assert small.frequency == pytest.approx(200 * 0.5**0.8 * (1 - 10**-0.8) / 100, rel=0.05)
    assert small.frequency / large.frequency == pytest.approx(10**0.8, rel=0.1)
    assert "WARNING        columns that were not read: place" in out


def test_json_holds_the_same(table: Path, printed) -> None:
    out = printed("frequency", table, *OPTIONS, "--rate", 3, "--json")
    found = json.loads(out)
    exponent = found["fits"][0]["exponent"]
    assert exponent["lower"] < 0.8 < exponent["upper"] and found["fits"][0]["up_to_m3"] is None
    shares = [s["share"]["value"] for s in found["scenarios"]]
    rates = [s["onset_frequency"]["value"] for s in found["scenarios"]]
    assert rates == pytest.approx([3 * share for share in shares])
    assert found["fit_p"] > 0.5


def test_without_a_rate_there_are_shares_only(table: Path, printed) -> None:
    out = printed("frequency", table, *OPTIONS)
    assert "[[blocks]]" not in out
    share = float(re.search(r"0\.1 to 1 m3: ([\d.]+)", out)[1])
    assert share == pytest.approx(1 - 10**-0.8, abs=0.02)


def test_classes_with_decimal_commas(tmp_path: Path, printed) -> None:
    file = tmp_path / "classes.csv"
    file.write_text("from_m3;to_m3;count\n0,1;0,2;60\n0,2;0,5;40\n0,5;1;12\n1;;9\n")
    out = printed("frequency", file, "--complete-from", "0.1")
    assert out.startswith("blocks         121 of 121 from 0.1 m3 on")
    # Counts at the limits: about 61/121 above 0.2 m3, a slope of 1.
    assert float(re.search(r"exponent +([\d.]+)", out)[1]) == pytest.approx(
        math.log(121 / 61) / math.log(2), abs=0.15
    )


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("volume_m3\n0.3\n-2\n", "row 3: cannot be used (found -2"),
        ("volume_m3\n0.3\nx\n", "row 3: is not a number"),
        ("volume\n0.3\n", "missing column"),
        ("volume_m3\n", "has no blocks"),
        ("from_m3,to_m3,count\n1,0.5,3\n", "row 2: cannot be used (found 0.5"),
        ("from_m3,to_m3,count\n1,2,-3\n", "row 2: cannot be used (found -3"),
        (
            "from_m3,to_m3,count\n0.1,1,3\n0.5,2,3\n",
            "classes overlap (found 1, and the next from 0.5",
        ),
        ("from_m3,to_m3\n0.1,1\n", "missing column"),
    ],
)
def test_tables_that_cannot_be_read(tmp_path: Path, refusal, text: str, line: str) -> None:
    file = tmp_path / "blocks.csv"
    file.write_text(text)
    err = refusal("frequency", file, "--complete-from", "0.1")
    assert "blocks.csv" in err and line in err


@pytest.mark.parametrize(
    "options",
    [
        *(("--scenarios", limits) for limits in ("1", "1,0.5", "0.01,1", "1,2000", "a,b")),
        ("--years", "3", "--rate", "3"),
        ("--area-ha", "3", "--length-m", "3"),
        *(("--years", value) for value in ("0", "nan", "inf")),
    ],
)
def test_options_that_cannot_be_used(table: Path, refusal, options: tuple[str, ...]) -> None:
    refusal("frequency", table, "--complete-from", "0.1", *options)
