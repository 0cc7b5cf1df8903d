"""What a configuration is complete for."""

from __future__ import annotations

from pathlib import Path

import pytest

from sassgis.inputs.config import load_config
from sassgis.runs.check_inputs import readiness

BASE = """
[terrain]
dem = "dem.tif"
[release]
file = "release.gpkg"
[[blocks]]
name = "a"
volume_m3 = 1
{onset}
[[blocks]]
name = "b"
volume_m3 = 2
onset_frequency = 0.1
"""
ONSET = {"onset": "onset_frequency = 0.2"}
HOUSES = '[[objects]]\nname = "h"\nkind = "building"\nfile = "h.gpkg"\n'
WIDTH = "[hazard]\nref_width_m = 10\n"
HARM = '[risk]\nvulnerability = "v.csv"\n'


def missing(folder: Path, text: str) -> dict[str, list[str]]:
    file = folder / "run.toml"
    file.write_text(text)
    return {own.task: list(own.missing) for own in readiness(load_config(file))}


@pytest.mark.parametrize(
    ("text", "zone", "risk"),
    [
        (
            BASE.format(onset=""),
            ["blocks[a].onset_frequency (or hazard.frequencies)", "hazard.ref_width_m"],
            ["risk.vulnerability", "[[objects]]"],
        ),
        (BASE.format(**ONSET) + WIDTH, [], ["risk.vulnerability", "[[objects]]"]),
        (
            BASE.format(onset="") + WIDTH + 'frequencies = "f.csv"\n',
            [],
            ["risk.vulnerability", "[[objects]]"],
        ),
        # A zoning with objects stops where it cannot compute their risk.
        (
            BASE.format(**ONSET) + WIDTH + HOUSES + "persons = 2\npresence = 0.5\n",
            ["risk.vulnerability"],
            ["risk.vulnerability"],
        ),
        (
            BASE.format(**ONSET) + WIDTH + HOUSES + HARM,
            [],
            ["objects[h].value, persons or traffic_per_day"],
        ),
        (BASE.format(**ONSET) + WIDTH + HOUSES + 'value_field = "v"\n' + HARM, [], []),
    ],
)
def test_missing_for_zones_and_risk(tmp_path: Path, text: str, zone, risk) -> None:
    found = missing(tmp_path, text)
    assert found["run"] == [] and found["zone"] == zone
    assert found["risk"] == zone + [key for key in risk if key not in zone]


def test_a_profile_needs_no_map(tmp_path: Path) -> None:
    text = '[profile]\nfile = "p.csv"\n[[blocks]]\nname = "a"\nvolume_m3 = 1\n'
    found = missing(tmp_path, text)
    assert found["run"] == ["terrain.dem", "release.file"] and found["profile"] == []


def test_validate_says_what_is_missing_and_still_reads_what_is_there(
    slope, printed, refusal
) -> None:
    out = printed("validate", slope.config)
    last = out.splitlines()[-3:]
    assert last[0] == "ready for      run"
    assert last[1].startswith("not ready for  zone: missing blocks[b].onset_frequency")
    assert last[2].startswith("not ready for  risk: missing ") and "[[objects]]" in last[2]
    slope.config.write_text(slope.config.read_text() + HOUSES)
    assert "h.gpkg: objects[h].file: file not found" in refusal("validate", slope.config)
