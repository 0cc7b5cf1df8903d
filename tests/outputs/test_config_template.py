"""The configurations that `sassgis init` writes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from sassgis.inputs.config import declared_sections, load_config, resolved
from sassgis.inputs.ground_map import built_in_table
from sassgis.outputs.config_template import config_template, short_template

GIVEN = [
    ("terrain", {"dem": "tiles"}),
    ("release", {"file": "site.gpkg", "layer": "release_areas"}),
    ("objects", {"name": "buildings", "kind": "building", "file": "site.gpkg"}),
    ("objects", {"name": "roads", "kind": "road", "file": "site.gpkg"}),
    ("effects.trees", {"file": "site.gpkg", "stems_field": "stems", "dbh_cm": 30.0}),
]


def loaded(folder: Path, text: str) -> dict[str, object]:
    file = folder / "run.toml"
    file.write_text(text)
    return resolved(load_config(file))


def test_the_short_one_has_few_keys_and_loads(tmp_path: Path) -> None:
    text = short_template()
    assert len(re.findall(r"^(?:# )?\w+ = ", text, re.M)) == 12
    plain = loaded(tmp_path, text)
    assert plain["terrain"]["dem"] == str(tmp_path / "dem.tif")  # type: ignore[index]
    # How often blocks are released is never made up.
    assert plain["blocks"][0]["name"] == "1 m3" and plain["onsets"]["1 m3"]["frequency"] is None  # type: ignore[index]
    assert plain["hazard"]["ref_width_m"] is None  # type: ignore[index]
    # What is shown in comments can be taken as it stands.
    zoned = loaded(tmp_path, re.sub(r"^# (\w+ = )", r"\1", text, flags=re.M))
    assert zoned["onsets"]["1 m3"]["frequency"] == 0.1  # type: ignore[index]
    assert zoned["hazard"]["ref_width_m"] == 10.0  # type: ignore[index]


@pytest.mark.parametrize("template", [short_template, config_template])
def test_what_is_known_stands_in_it(template, tmp_path: Path) -> None:
    plain = loaded(tmp_path, template(GIVEN))
    assert plain["terrain"]["dem"] == str(tmp_path / "tiles")
    assert plain["release"]["layer"] == "release_areas"
    assert {(o["name"], o["kind"]) for o in plain["objects"]} == {
        ("buildings", "building"),
        ("roads", "road"),
    }
    trees = plain["effects"]["trees"]
    assert (trees["stems_field"], trees["dbh_cm"], trees["form"]) == ("stems", 30.0, "stems")
    assert plain["barriers"] == [] and plain["effects"]["wind"] is None


def test_every_key_says_what_it_is_in_more_than_a_word_or_two() -> None:
    for section, keys in declared_sections().items():
        for key, own in keys.items():
            words = own.description.split()
            assert len(words) >= 3, f"{section}.{key}: {own.description}"


def test_the_short_one_has_a_line_for_each_ground_class() -> None:
    lines = re.findall(r"^#   (\w+) +\S", short_template(), re.M)
    assert sorted(lines) == sorted(built_in_table().names)
