"""The tutorials: every command runs, in their order, and what they show is what comes out.

In the usual suite with few blocks; as they stand as a battery.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pandas as pd
import pyogrio
import pytest
from helpers.pages import rows, shown, steps
from helpers.samples import with_given_blocks

QUICK = {"spacing_m": 12.0, "rocks_per_point": 6}
both = pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.battery)])


def changed(text: str, values: dict[str, object]) -> str:
    """A configuration with other values of keys, each at its first place."""
    for key, value in values.items():
        text, found = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text, count=1)
        assert found == 1, key
    return text


def followed(page: str, folder: Path, quick: bool, call) -> dict[str, str]:
    """Do what a tutorial says; gives what each command printed."""
    said = {}
    for kind, name, text in steps(page):
        if kind == "commands":
            for line in text.splitlines():
                words = line.split("#")[0].split()
                if words[0] == "cp":
                    shutil.copytree(*words[2:])
                    if quick:
                        config = folder / words[-1] / "config.toml"
                        text = with_given_blocks(config.read_text("utf-8"))
                        config.write_text(changed(text, QUICK), "utf-8")
                    continue
                code, said[words[1]], err = call(*words[1:])
                assert code == 0, (line, err)
        elif kind == "file":
            (folder / name).write_text(changed(text, QUICK) if quick else text, "utf-8")
        else:
            values = dict(re.findall(r"^(\w+) = (\S+)$", text, re.M))
            config = folder / name
            config.write_text(changed(config.read_text("utf-8"), values), "utf-8")
    return said


@pytest.fixture
def place(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample_dem").symlink_to(repository / "sample_dem")
    return tmp_path


@pytest.mark.battery
@both
def test_from_tiles_to_a_hazard_sheet(repository: Path, place: Path, quick: bool, call) -> None:
    page = (repository / "docs" / "tutorials" / "hazard_sheet.md").read_text(encoding="utf-8")
    said = followed(page, place, quick, call)
    assert said["validate"].splitlines()[-3:] == shown(page, "validate")
    # What stands in the configuration is what the step before printed.
    for line in re.findall(r"^(?:volume|onset)\w* = .*$", said["frequency"], re.M):
        assert f"\n{line}\n" in page
    assert (place / "zones" / "project.qgz").is_file()
    assert pyogrio.read_info(place / "zones" / "hazard.gpkg", layer="hazard_zones")["features"]


@pytest.mark.battery
@both
def test_design_of_a_net(repository: Path, place: Path, quick: bool, call) -> None:
    page = (repository / "docs" / "tutorials" / "net.md").read_text(encoding="utf-8")
    followed(page, place, quick, call)
    outcomes, passing = [], []
    for name in ("before", "after"):
        nets = pyogrio.read_dataframe(place / name / "result.gpkg", layer="barriers")
        height = nets[nets["name"] == "net Mitte"]["height_m"].iloc[0]
        sheet = pd.read_csv(place / name / "tables" / "protection.csv")
        left = sheet[sheet["line"] == "net Mitte"].iloc[-1]
        assert left["return_period_years"] == 300.0
        passing.append(left["behind_per_year"])
        energy = left["energy_behind_kj"]
        energy = "–" if pd.isna(energy) else f"{energy:.0f}"
        outcomes.append([str(height), f"{passing[-1]:.3f}", energy])
    assert passing[0] <= passing[1] and [own[0] for own in outcomes] == ["4.0", "2.5"]
    design = pd.read_csv(place / "before" / "tables" / "design.csv").set_index("line")
    net = design.loc["net Mitte"]
    made = [
        [str(y), f"{net[f'energy_{y}y_kj']:.0f}", f"{net[f'height_{y}y_m']:.1f}"]
        for y in (30, 100, 300)
    ]
    assert [row[0] for row in rows(page, "design")] == [row[0] for row in made]
    if not quick:
        assert rows(page, "design") == made
        assert [row[1:] for row in rows(page, "outcome")] == outcomes
