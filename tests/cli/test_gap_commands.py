"""Observations through the command line."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import pandas as pd
from helpers.small_slope import Slope


def test_what_a_filled_template_identifies_is_printed(tmp_path: Path, printed) -> None:
    folder = tmp_path / "observed"
    printed("gap", "template", folder)
    deposits = folder / "deposits.csv"
    columns = deposits.read_text().splitlines()[0].split(",")
    rows = [
        ",".join(
            {"rock_id": f"R{i}", "x": str(10 + i), "y": "5", "z": "1"}.get(c, "") for c in columns
        )
        for i in range(3)
    ]
    deposits.write_text("\n".join([",".join(columns), *rows]) + "\n")
    out = printed("gap", "validate", folder)
    assert "not identifiable" in out and "deposits" in out


def test_errors_are_printed_once_and_the_command_ends_with_code_one(tmp_path: Path, call) -> None:
    folder = tmp_path / "observed"
    folder.mkdir()
    rows = [f"R{k},{k},5,1,{1000 * k},{k}" for k in (1, 2, 3)]
    head = "rock_id,x,y,z,mass_kg,volume_m3"
    (folder / "rocks.csv").write_text("\n".join([head, *rows]) + "\n")
    (folder / "deposits.csv").write_text("rock_id,x,y\nR1,3,4\nR1,3,4\n")
    code, out, err = call("gap", "validate", folder)
    told = [line for line in (out + err).splitlines() if "the same stop is there twice" in line]
    assert (code, len(told)) == (1, 1) and told[0].startswith("error: ")
    (folder / "deposits.csv").write_text("rock_id,x,y\nR1,3,4\n")
    assert call("gap", "validate", folder)[0] == 0


def test_what_a_diagnosis_would_refuse_of_the_configuration_is_refused(
    slope: Slope, printed, refusal
) -> None:
    folder = slope.folder / "observed"
    folder.mkdir()
    (folder / "deposits.csv").write_text("rock_id,x,y\nR1,2700060,1149950\n")
    printed("gap", "validate", folder, "--config", slope.config)
    file = slope.folder / "release.gpkg"
    areas = gpd.read_file(file)
    pd.concat([areas, areas]).to_file(file)
    assert "name is used twice" in refusal("gap", "validate", folder, "--config", slope.config)
