"""Bad input of a zoning: one clear line that names file and field, no traceback, no result."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers.zone_slope import Case, box, gully, two_areas

FREQUENCIES = "area,scenario,frequency,unit"


def preset_text() -> str:
    """The federal preset, to be spoilt."""
    folder = resources.files("sassgis") / "data" / "presets"
    return (folder / "ch-so.toml").read_text(encoding="utf-8")


def hazard(**keys: object) -> Callable[[Case], None]:
    return lambda case: case.sections["hazard"].update(keys)


def without_ref_width(case: Case) -> None:
    del case.sections["hazard"]["ref_width_m"]


def block(**keys: object) -> Callable[[Case], None]:
    def spoil(case: Case) -> None:
        for key, value in keys.items():
            if value is None:
                del case.blocks[0][key]
            else:
                case.blocks[0][key] = value

    return spoil


def table(*rows: str, head: str = FREQUENCIES) -> Callable[[Case], None]:
    def spoil(case: Case) -> None:
        case.sections["hazard"]["frequencies"] = "frequencies.csv"
        case.write_text("frequencies.csv", head, *rows)

    return spoil


def preset(old: str, new: str) -> Callable[[Case], None]:
    def spoil(case: Case) -> None:
        text = preset_text()
        assert old in text
        case.write_text("own.toml", text.replace(old, new, 1))
        case.sections["hazard"]["preset"] = "own.toml"

    return spoil


def houses(*shapes: shapely.Geometry, crs: str = "EPSG:2056", **change: object):
    """Buildings as they should be, with a change of the configuration (None: key left out)."""

    def spoil(case: Case) -> None:
        names = [f"house {i + 1}" for i in range(len(shapes) or 1)]
        places = shapes or (box(60.0, 33.0, 3.0, 3.0),)
        worth = {"name": names, "worth": [None] * len(names)}
        case.expose("houses", "building", dict(zip(names, places, strict=True)))
        case.write_layer("houses.gpkg", places, worth, crs)
        (own,) = case.lists["objects"]
        own |= {"value": 1e6, "persons": 3.0, "presence": 0.7, **change}
        case.lists["objects"] = [{k: v for k, v in own.items() if v is not None}]

    return spoil


def without_vulnerability(file: bool) -> Callable[[Case], None]:
    def spoil(case: Case) -> None:
        houses()(case)
        (case.folder / "vulnerability.csv").unlink()
        if not file:
            del case.sections["risk"]

    return spoil


BAD: dict[str, tuple[Callable[[Case], None], str, list[str]]] = {
    "no frequency": (
        block(onset_frequency=None), "config.toml",
        [r"blocks\[frequent\].onset_frequency", "missing"],
    ),
    "table: scenario twice": (
        table("north,rare,0.1,per_year", "south,rare,0.1,per_year", "north,rare,0.2,per_year"),
        "frequencies.csv", ["north, rare", "twice", "(row|line) [34]"],
    ),
    "table: negative": (
        table("north,rare,-0.1,per_year"), "frequencies.csv", ["frequency", "-0.1", "0 or more"]
    ),
    "table: unknown area": (
        table("nort,rare,0.1,per_year"), "frequencies.csv", ["area", "nort'", "north"]
    ),
    "table: unknown scenario": (
        table("north,rarer,0.1,per_year"), "frequencies.csv", ["scenario", "rarer", "rare"]
    ),
    "table: unknown unit": (
        table("north,rare,0.1,yearly"), "frequencies.csv", ["unit", "yearly", "per_year"]
    ),
    "above without a law": (
        block(onset_above_m3=1.0), "config.toml", ["onset_above_m3", "volume_exponent"]
    ),
    "table: column missing": (
        table("north,rare,0.1", head="area,scenario,frequency"), "frequencies.csv", ["unit"]
    ),
    "table: missing": (
        hazard(frequencies="nowhere.csv"), "nowhere.csv", ["hazard.frequencies", "not found"]
    ),
    "unknown preset": (
        hazard(preset="ch-fedral"), "config.toml", ["hazard.preset", "ch-fedral", "ch-so"]
    ),
    "too narrow": (
        hazard(ref_width_m=1.5), "config.toml", ["hazard.ref_width_m", "1.5 m", "2 m", "finer"]
    ),
    "no reference width": (
        without_ref_width, "config.toml", ["hazard.ref_width_m", "missing", "width"]
    ),
    "no objects file": (
        houses(file="none.gpkg"), "none.gpkg", [r"objects\[houses\]", "not found"]
    ),
    "vulnerability not named": (
        without_vulnerability(False), "config.toml", ["risk.vulnerability", "missing"]
    ),
    "vulnerability file missing": (
        without_vulnerability(True), "vulnerability.csv", ["risk.vulnerability", "not found"]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_one_line_and_no_result(tmp_path: Path, refusal, name: str) -> None:
    case = two_areas(tmp_path)
    spoil, file, words = BAD[name]
    spoil(case)
    case.write()
    out = tmp_path / "result"
    line = refusal("zone", case.config, "-o", out)
    assert file in line
    for word in words:
        assert re.search(word, line), (word, line)
    assert not out.exists()


def test_what_is_not_bad_goes_through(tmp_path: Path, printed) -> None:
    """The same files unspoilt, with objects: otherwise the lines above might mean anything."""
    case = two_areas(tmp_path, hazard={"ref_width_m": 4.0})
    houses()(case)
    table("north,rare,0.1,per_year", "south,rare,2,per_year_ha")(case)
    preset("Matrix", "Matrix")(case)
    case.write()
    out = printed("zone", case.config, "-o", tmp_path / "result", "--jobs", "1")
    words = r"^\d+ blocks, \d+ zones. With another random seed, [\d.]+ % of the zoned area"
    assert re.search(words, out)
    assert (tmp_path / "result" / "hazard.gpkg").is_file()


def test_objects_on_nodata_are_told(tmp_path: Path, call) -> None:
    case = two_areas(tmp_path)
    heights = gully()
    heights[60:66, 70:80] = np.nan
    case.write_dem(heights)
    houses(box(73.0, 62.0, 2.0, 2.0))(case)
    case.write()
    code, _, err = call("zone", case.config, "-o", tmp_path / "result", "--jobs", "1")
    assert code == 0 and "house 1 lies on nodata" in err
