"""Print layouts: what is placed by hand, and what the real QGIS makes of it."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from helpers import made_up_result as made_up
from helpers.in_qgis import in_qgis
from hypothesis import given
from hypothesis import strategies as st

import sassgis.outputs.qgis
from sassgis.hazard.levels import ZONE_OPACITY
from sassgis.inputs.presets import read_preset
from sassgis.outputs.qgis.entries import LayerEntry
from sassgis.outputs.qgis.layout import (
    SCALE_NUMBERS,
    drawing_on_sheet,
    layout_element,
    round_length,
    round_scale,
)
from sassgis.settings.hazard_rules import ZoningSettings

PROBE = Path(__file__).with_name("layout_probe.py")
PRINTER = Path(sassgis.outputs.qgis.__file__).with_name("export_layout.py")

#: Width and height of the page (mm).
PAGE = (420.0, 297.0)

sides = st.floats(1.0, 1e5)


@given(sides, sides, st.floats(50.0, 400.0), st.floats(50.0, 300.0))
def test_the_scale_is_round_and_the_extent_fits(
    width: float, height: float, frame_w: float, frame_h: float
) -> None:
    scale = round_scale((0.0, 0.0, width, height), frame_w, frame_h)
    number = scale / 10.0 ** np.floor(np.log10(scale) + 1e-9)
    assert any(number == pytest.approx(n) for n in SCALE_NUMBERS)
    assert width <= frame_w * scale / 1000.0 * (1 + 1e-6)
    assert height <= frame_h * scale / 1000.0 * (1 + 1e-6)
    # At half the scale it would not, unless it is the largest that is taken.
    assert scale == 100.0 or max(width / frame_w, height / frame_h) > scale / 2000.0


def test_zones_are_drawn_for_the_sheet_that_shows_them() -> None:
    rules = read_preset("ch-so").sheet
    drawn = [
        drawing_on_sheet(ZoningSettings(**own), rules, (10.0, 5.0, 2.0), (0.0, 0.0, width, 10.0))
        for width, own in ((500.0, {}), (1500.0, {}), (9000.0, {}), (1500.0, {"scale": 2000.0}))
    ]
    # A small site is no reason for finer zones, nor a large one for coarser ones than the rules.
    assert [own.scale for own in drawn] == [5000.0, 7500.0, 10_000.0, 2000.0]
    assert [own.width_m for own in drawn] == [10.0, 15.0, 20.0, 4.0]


def test_known_scales_and_lengths() -> None:
    for extent, scale in (((0, 0, 1000, 500), 5000.0), ((0, 0, 1001, 500), 7500.0)):
        assert round_scale(extent, 200.0, 200.0) == scale
    assert round_scale((0, 0, 0, 0), 200.0, 200.0) == 100.0
    assert [round_length(v) for v in (99.0, 100.0, 0.3)] == pytest.approx([50.0, 100.0, 0.2])


def shown() -> dict[str, LayerEntry]:
    layers = made_up.vector_layers() | made_up.zone_layers()
    maps = made_up.raster_layers(made_up.grid())
    return {
        **{f"vector_{k}": LayerEntry(v, "") for k, v in layers.items()},
        **{f"raster_{k}": LayerEntry(v, "") for k, v in maps.items()},
    }


def test_layers_must_be_there() -> None:
    layout = made_up.LAYOUTS[0]
    with pytest.raises(ValueError, match="no such layers in the project: \\['vector_x'\\]"):
        layout_element(replace(layout, layers=(*layout.layers, "vector_x")), shown(), "")


@pytest.mark.parametrize("times", [0, 1, 8])
def test_much_text_makes_smaller_type_and_nothing_runs_into_another(times: int) -> None:
    layout = replace(
        made_up.LAYOUTS[0], facts=made_up.FACTS * times, notes=made_up.NOTES * 2 * times
    )
    items = [
        (item.get("id", ""), *(float(v) for v in box.split(",")[:2] + size.split(",")[:2]))
        for item in layout_element(layout, shown(), "CH1903+ / LV95").findall("LayoutItem")
        for box, size in [(item.get("position", ""), item.get("size", ""))]
    ]
    apart(items, PAGE)


def apart(items: list[tuple[str, float, float, float, float]], page: tuple[float, float]) -> None:
    """No item leaves the page or covers another."""
    for name, x, y, width, height in items:
        assert min(x, y) >= 5.0, name
        assert x + width <= page[0] - 5.0 and y + height <= page[1] - 5.0, name
    for (one, ax, ay, aw, ah), (two, bx, by, bw, bh) in combinations(items, 2):
        over_x = min(ax + aw, bx + bw) - max(ax, bx)
        over_y = min(ay + ah, by + bh) - max(ay, by)
        assert over_x <= 1.0 or over_y <= 0.05, f"{one} and {two}"


@pytest.fixture(scope="module")
def project(qgis: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("made")
    made_up.make(made)
    folder = tmp_path_factory.mktemp("moved") / "sheets ü"
    shutil.move(made, folder)
    return folder / "project.qgz"


@pytest.fixture(scope="module")
def seen(project: Path) -> dict[str, Any]:
    report: dict[str, Any] = json.loads(in_qgis(PROBE, project, home=project.parent))
    for sheet in report["layouts"].values():
        sheet["item"] = {item["id"]: item for item in sheet["items"]}
    return report


@pytest.mark.qgis
def test_the_sheets_open(seen: dict[str, Any]) -> None:
    assert list(seen["layouts"]) == ["Hazard level", "Intensity & cells"]
    for layout in made_up.LAYOUTS:
        sheet = seen["layouts"][layout.name]
        assert tuple(sheet["page"]) == PAGE
        drawn = sheet["item"]["Map"]
        assert drawn["locked"] and drawn["layers"] == list(layout.layers)
        west, south, east, north = drawn["extent"]
        assert west <= made_up.EXTENT[0] and east >= made_up.EXTENT[2]
        assert south <= made_up.EXTENT[1] and north >= made_up.EXTENT[3]
        assert sheet["item"]["North arrow"]["found"]
        assert set(seen["themes"][layout.name]) == set(layout.layers)


@pytest.mark.qgis
def test_the_scale_is_the_one_that_is_written(seen: dict[str, Any]) -> None:
    for name, scale in (("Hazard level", 4000), ("Intensity & cells", 4000)):
        item = seen["layouts"][name]["item"]
        assert item["Map"]["scale"] == pytest.approx(scale)
        assert item["Scale"]["text"] == f"Scale 1:{scale:,}".replace(",", "\u00a0")
        bar = item["Scale bar"]
        assert (bar["map"], bar["unit"]) == ("Map", "m")
        length_mm = bar["segments"] * bar["units_per_segment"] * 1000.0 / scale
        assert 25.0 < length_mm < 60.0


@pytest.mark.qgis
def test_the_legend_holds_what_is_shown_and_no_more(seen: dict[str, Any]) -> None:
    assert seen["layouts"]["Hazard level"]["item"]["Legend"]["entries"] == [
        {"layer": "Hazard level", "texts": ["elevato", "medio", "basso", "residuo"]},
        {"layer": "Barriers", "texts": ["wall", "net"]},
        {"group": "Also shown"},
        {"layer": "Release areas", "texts": []},
        {"layer": "Level not settled", "texts": []},
    ]
    cells = seen["layouts"]["Intensity & cells"]["item"]["Legend"]["entries"]
    assert cells[1]["texts"] == ["elevato", "medio", "basso", "residuo (pale)"]
    assert cells[3]["texts"] == ["< 30 kJ", "30 – 300 kJ", "≥ 300 kJ"]


@pytest.mark.qgis
def test_every_text_is_there_and_fits_its_place(seen: dict[str, Any]) -> None:
    for layout in made_up.LAYOUTS:
        sheet = seen["layouts"][layout.name]
        words = " ".join(" ".join(i["text"].split()) for i in sheet["items"] if "text" in i)
        facts = [part for fact in layout.facts for part in fact]
        for text in (layout.title, layout.subtitle, *facts, *layout.notes):
            assert text.replace("\u00a0", " ") in words
        assert "CH1903+ / LV95 (EPSG:2056)" in words
        for item in sheet["items"]:
            if "needs" in item:
                _, _, width, height = item["box"]
                assert item["needs"][0] <= width and item["needs"][1] <= height, item["id"]
        apart([(i["id"], *i["box"]) for i in sheet["items"]], PAGE)


def colour_at(picture: Any, item: dict[str, Any], x: float, y: float, page: Any) -> Any:
    """Colour of a picture of the page (0 to 255) at coordinates of the map."""
    left, top, width, height = item["box"]
    west, south, east, north = item["extent"]
    mm = left + (x - west) / (east - west) * width, top + (north - y) / (north - south) * height
    rows, cols = picture.shape[:2]
    return 255.0 * picture[int(mm[1] / page[1] * rows), int(mm[0] / page[0] * cols), :3]


@pytest.mark.qgis
def test_the_printed_map_has_the_levels_where_they_are(
    project: Path, seen: dict[str, Any], tmp_path: Path
) -> None:
    out = in_qgis(
        PRINTER, project, tmp_path, "--layout", "Hazard level", "--format", "png", "--dpi", "100",
        home=tmp_path,
    )  # fmt: skip
    file = tmp_path / "Hazard level.png"
    assert out.split("\n")[0] == str(file)
    picture = matplotlib.image.imread(file)
    sheet = seen["layouts"]["Hazard level"]
    levels = {level.code: level.colour for level in made_up.preset().levels}
    for code, (first, last) in made_up.LEVEL_ROWS.items():
        x = made_up.WEST + 305 * made_up.CELL
        y = made_up.NORTH - (0.3 * first + 0.7 * last) * made_up.CELL
        found = colour_at(picture, sheet["item"]["Map"], x, y, sheet["page"])
        wanted = np.array(list(bytes.fromhex(levels[code][1:])), float)
        # Over grey relief.
        assert np.abs(found - wanted).max() <= 255.0 * (1.0 - ZONE_OPACITY) + 3.0, code
    x = made_up.WEST + 450 * made_up.CELL
    grey = colour_at(picture, sheet["item"]["Map"], x, made_up.NORTH - 300, sheet["page"])
    assert np.ptp(grey) <= 2.0 and 60.0 < grey[0] < 240.0
    legend = sheet["item"]["Legend"]["box"]
    per_mm = picture.shape[0] / sheet["page"][1]
    left, top, _, height = legend
    x0, x1, y0, y1 = (int(mm * per_mm) for mm in (left, left + 9, top, top + height))
    part = picture[y0:y1, x0:x1, :3].reshape(-1, 3)
    for code, colour in levels.items():
        over_white = 1 - ZONE_OPACITY * (1 - np.array(list(bytes.fromhex(colour[1:]))) / 255.0)
        assert (np.abs(part - over_white).max(axis=1) < 0.02).sum() > 20, code


@pytest.mark.qgis
def test_all_sheets_are_printed_to_pdf_as_text(project: Path, tmp_path: Path) -> None:
    in_qgis(PRINTER, project, tmp_path, "--dpi", "96", home=tmp_path)
    files = sorted(tmp_path.glob("*.pdf"))
    assert [file.name for file in files] == ["Hazard level.pdf", "Intensity _ cells.pdf"]
    assert all(file.read_bytes().startswith(b"%PDF") for file in files)
    reader = shutil.which("pdftotext")
    if reader is None:
        pytest.skip("pdftotext (poppler-utils) is not there to read the words of a PDF")
    text = subprocess.run(
        [reader, str(files[0]), "-"], capture_output=True, text=True, check=True
    ).stdout
    for words in ("Rockfall hazard:", "elevato", "residuo", "Reference width", "2 m (one cell)"):
        assert words in text


@pytest.mark.qgis
def test_an_unknown_layout_is_one_line(project: Path, tmp_path: Path) -> None:
    line = in_qgis(PRINTER, project, tmp_path, "--layout", "Nowhere", home=tmp_path, code=1)
    assert "no layout 'Nowhere'; it has: Hazard level, Intensity & cells" in line
    assert "Traceback" not in line


@pytest.mark.qgis
def test_local_coordinates_keep_their_scale(qgis: None, tmp_path: Path) -> None:
    made = made_up.make(tmp_path / "result", local=True)
    report = json.loads(in_qgis(PROBE, made.project, home=tmp_path))
    items = {i["id"]: i for i in report["layouts"]["Hazard level"]["items"]}
    assert items["Scale"]["text"] == "Scale 1:4\u00a0000"
    assert items["Facts"]["text"].endswith("local, in m")
    width_m = items["Map"]["extent"][2] - items["Map"]["extent"][0]
    assert width_m / items["Map"]["box"][2] == pytest.approx(4.0)
    # Four segments of 50 m: 50 mm and what the texts at the ends need.
    bar = items["Scale bar"]
    assert (bar["segments"], bar["units_per_segment"]) == (4, 50.0)
    assert 50.0 < bar["box"][2] < 62.0
