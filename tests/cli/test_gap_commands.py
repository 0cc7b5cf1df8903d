"""Observations through the command line."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
from helpers.small_slope import Slope

from sassgis.gap.advice.power import PlannedCampaign, PlannedTrial, Power


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


def test_a_template_for_a_site_says_what_a_campaign_would_name(
    slope: Slope, printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    def power_of(planned: PlannedCampaign, trial: PlannedTrial) -> Power:
        assert {n: own.case.n_rocks for n, own in planned.usual.items()} == {
            20: 20,
            40: 40,
            100: 100,
        }
        named = trial.cause == "air_drag" and trial.strength == "strong"
        return Power(trial, 1.5, (False, False, False, named))

    monkeypatch.setattr("sassgis.gap.advice.power.power_of", power_of)
    folder = slope.folder / "observed"
    out = printed("gap", "template", folder, "--site", slope.config)
    (drag,) = [line for line in out.splitlines() if line.startswith("air drag (C_d)")]
    assert drag.endswith("1.5 / 1.5 / 1.5") and drag.count("–") == 9
    rows = pd.read_csv(folder / "power.csv")
    assert len(rows) == 10 * 4 * 3
    found = rows[rows.weakest_named != "not named"]
    assert set(found.cause) == {"air_drag"} and found.rocks.tolist() == [20, 40, 100]
    # The folder is read as observations later.
    (folder / "deposits.csv").write_text("rock_id,x,y\nR1,2700060,1149950\n")
    assert "power" not in printed("gap", "validate", folder)
    layer = slope.folder / "observed.gpkg"
    printed("gap", "template", layer, "--site", slope.config)
    assert gpd.read_file(layer, layer="deposits").crs == "EPSG:2056"
    assert (slope.folder / "observed_power.csv").is_file()


def test_without_a_usable_site_no_template_is_written(slope: Slope, refusal) -> None:
    folder = slope.folder / "observed"
    missing = slope.folder / "missing.toml"
    assert "file not found" in refusal("gap", "template", folder, "--site", missing)
    slope.write_config(release__file="")
    assert "release.file" in refusal("gap", "template", folder, "--site", slope.config)
    slope.write_config()
    slope.write_dem(np.full((50, 70), 1500.0))
    assert "no fall line" in refusal("gap", "template", folder, "--site", slope.config)
    assert not folder.exists()
