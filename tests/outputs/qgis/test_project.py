"""The real QGIS opens the project and shows what it should."""

from __future__ import annotations

import json
import shutil
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from helpers import made_up_result as made_up
from helpers.in_qgis import in_qgis
from matplotlib.colors import to_rgb

from sassgis.hazard.levels import ZONE_OPACITY
from sassgis.outputs.qgis.entries import LayerEntry, LayerGroup
from sassgis.outputs.qgis.project import write_project
from sassgis.settings.statistics_table import STATISTICS, Statistic
from sassgis.settings.styles import RASTER_OPACITY, class_colours, class_labels

PROBE = Path(__file__).with_name("probe.py")


def probe(project: Path, picture: Path, *more: str) -> dict[str, Any]:
    out = in_qgis(PROBE, project, picture, *more, home=picture.parent)
    return json.loads(out)  # type: ignore[no-any-return]


def at(x: float, y: float) -> str:
    """A place of the made-up slope, in m from its north-west corner."""
    return f"{made_up.WEST + x},{made_up.NORTH - y}"


#: Cells of the energy map whose class is known, away from lines and labels.
PLACES = {
    "high": at(460, 150), "mean": at(440, 550), "low": at(600, 660),
    "limit 30": at(490, 205), "below 30": at(490, 250), "limit 300": at(490, 290),
    "zero": at(490, 330), "outside": at(900, 400), "barrier": at(600, 500),
    "lowest line": at(380, 530), "highest line": at(620, 530),
}  # fmt: skip


#: Middle of each band of levels, clear of the stripes' edges.
LEVEL_PLACES = {
    code: at(300 * made_up.CELL, (first + last) / 2 * made_up.CELL)
    for code, (first, last) in made_up.LEVEL_ROWS.items()
}


@pytest.fixture(scope="session")
def seen(qgis: None, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    made = tmp_path_factory.mktemp("made")
    made_up.make(made)
    # Moved as a whole: nothing in it may point to where it was made.
    folder = tmp_path_factory.mktemp("moved") / "my result ü"
    shutil.move(made, folder)
    more = [word for place in PLACES.values() for word in ("--at", place)]
    for source in ("maps/energy.tif", "maps/terrain.tif", "maps/level.tif"):
        more += ["--alone", str(folder / source)]
    for name in [*made_up.vector_layers(), *made_up.zone_layers()]:
        more += ["--alone", f"{folder / 'result.gpkg'}|layername={name}"]
    report = probe(folder / "project.qgz", folder / "map.png", *more)
    report["files"] = sorted(file.name for file in folder.rglob("*"))
    report["project"] = folder / "project.qgz"
    report["colour"] = {
        name: tuple(bytes.fromhex(report["at"][place][1:])) for name, place in PLACES.items()
    }
    return report


def layer(report: dict[str, Any], name: str) -> dict[str, Any]:
    (found,) = [entry for entry in report["layers"] if entry["name"] == name]
    return found  # type: ignore[no-any-return]


@pytest.mark.qgis
def test_the_project_opens_whole(seen: dict[str, Any]) -> None:
    assert seen["opened"] and not seen["error"] and not seen["render_errors"]
    assert seen["title"] == "Made-up slope – Ü & <test>"
    assert (seen["crs"], seen["crs_valid"]) == ("EPSG:2056", True)
    assert seen["absolute_paths"] is False
    assert tuple(seen["extent"]) == made_up.EXTENT
    assert len(seen["layers"]) == 17
    assert all(entry["valid"] for entry in seen["layers"])
    assert {entry["crs"] for entry in seen["layers"]} == {"EPSG:2056"}
    # The project as a whole draws something.
    assert seen["blank_share"] < 0.01
    assert seen["colours"] > 100
    # Looking leaves no files behind.
    assert not [name for name in seen["files"] if name.endswith((".aux.xml", "-wal", "-shm"))]


@pytest.mark.qgis
def test_the_legend_is_grouped(seen: dict[str, Any]) -> None:
    groups = [group["group"] for group in seen["tree"]]
    assert groups == ["Fall lines and stops", "Hazard", "Maps", "Terrain"]
    maps = seen["tree"][2]
    assert maps["exclusive"] is True
    assert maps["layers"] == [
        {"layer": "Energy, 95 % (kJ)", "visible": True},
        {"layer": "Reach probability (1)", "visible": False},
        {"layer": "Passing height, 95 % (m)", "visible": False},
        {"layer": "Hazard level on cells", "visible": False},
    ]
    inner = seen["tree"][1]["layers"][-1]
    assert (inner["group"], inner["exclusive"]) == ("Intensity maps", True)
    assert inner["layers"] == [{"layer": "Intensity, 100 years", "visible": False}]
    titles = [entry.title for entry in made_up.vector_layers().values()]
    assert [entry["layer"] for entry in seen["tree"][0]["layers"]] == titles


@pytest.mark.qgis
def test_rasters_are_styled(seen: dict[str, Any]) -> None:
    energy = layer(seen, "Energy, 95 % (kJ)")
    assert energy["renderer"]["type"] == "singlebandpseudocolor"
    assert energy["renderer"]["ramp_type"] == 1  # discrete
    labels = [item["label"] for item in energy["renderer"]["items"]]
    assert labels == ["< 30 kJ", "30 – 300 kJ", "≥ 300 kJ"]
    assert energy["bands"][1] == "Band 2: Greatest energy (kJ)"
    assert "reference width 3 m" in energy["abstract"]
    reach = layer(seen, "Reach probability (1)")
    assert reach["renderer"]["ramp_type"] == 0  # interpolated
    assert reach["renderer"]["transparent"] == [[0.0, 0.0, 100.0]]
    assert layer(seen, "Passing height, 95 % (m)")["renderer"]["transparent"] == []
    assert layer(seen, "Terrain (relief)")["renderer"]["type"] == "hillshade"
    level = layer(seen, "Hazard level on cells")["renderer"]
    assert level["type"] == "paletted"
    assert [tuple(item.values()) for item in level["items"]] == [
        (4, "#e60000", "elevato"), (3, "#2b6cff", "medio"), (2, "#ffe000", "basso"),
        (1, "#fff080", "residuo (pale)"),
    ]  # fmt: skip


@pytest.mark.qgis
def test_layers_opened_by_themselves_bring_the_same_style(seen: dict[str, Any]) -> None:
    in_project = {Path(entry["source"]).name: entry for entry in seen["layers"]}
    assert len(seen["alone"]) == 3 + len(made_up.vector_layers()) + len(made_up.zone_layers())
    for entry in seen["alone"]:
        twin = in_project[Path(entry["source"]).name]
        assert entry["valid"]
        for key in ("renderer", "aliases", "labels", "bands", "crs"):
            assert entry.get(key) == twin.get(key)


@pytest.mark.qgis
def test_vectors_have_their_classes_in_their_colours(seen: dict[str, Any]) -> None:
    kinds = {"simple": "single", "categories": "categorized", "ranges": "graduated"}
    for own in (*made_up.vector_layers().values(), *made_up.zone_layers().values()):
        found, style = layer(seen, own.title), own.style
        drawn = found["renderer"]
        assert drawn["type"] == f"{kinds[style.method]}Symbol"
        assert drawn.get("column", "") == style.column
        assert found["labels"] == (style.label_column or None)
        assert found["features"] == len(own.frame)
        assert {k: found["aliases"][k] for k in own.fields} == {
            k: info.label for k, info in own.fields.items()
        }
        classes = style.classes[::-1] if style.method == "ranges" else style.classes
        for entry, shown in zip(classes, drawn.get("classes", []), strict=True):
            assert shown["label"] == entry.label
            # What is hatched is lines over white.
            assert entry.symbol.hatch or shown["colour"] == entry.symbol.colour
        if style.method == "simple" and style.symbol.hatch:
            assert drawn["symbol_layers"] == ["LinePatternFill", "SimpleFill"]


@pytest.mark.qgis
@pytest.mark.parametrize(
    ("name", "opacity"), [("Hazard level", ZONE_OPACITY), ("Hazard level on cells", RASTER_OPACITY)]
)
def test_levels_are_drawn_in_their_colours(
    seen: dict[str, Any], tmp_path: Path, name: str, opacity: float
) -> None:
    places = [word for place in LEVEL_PLACES.values() for word in ("--at", place)]
    unreached = at(350 * made_up.CELL, 200 * made_up.CELL)
    row = sum(made_up.RESIDUAL_ROWS) / 2
    striped = [at((200 + step) * made_up.CELL, row * made_up.CELL) for step in range(100)]
    more = [word for place in (unreached, *striped) for word in ("--at", place)]
    report = probe(seen["project"], tmp_path / "map.png", "--only", name, *places, *more)
    assert not report["render_errors"]
    levels = {level.code: level.colour for level in made_up.preset().levels}
    for code, place in LEVEL_PLACES.items():
        # Over white, as nothing else is drawn.
        wanted = [round(255 - opacity * (255 - part)) for part in bytes.fromhex(levels[code][1:])]
        assert close(tuple(bytes.fromhex(report["at"][place][1:])), tuple(wanted), 3), code
    assert report["at"][unreached] == "#ffffff"
    if name == "Hazard level":
        # Residual hazard is striped on white.
        blue = np.array([bytes.fromhex(report["at"][place][1:])[2] for place in striped])
        assert blue.min() < 255 * (1 - ZONE_OPACITY) + 20 and blue.max() > 250
        assert 0.2 < (blue < 180).mean() < 0.7


def close(colour: tuple[int, ...], other: tuple[int, ...], tolerance: float) -> bool:
    return all(abs(a - b) <= tolerance for a, b in zip(colour, other, strict=True))


def nearest(classes: dict[str, tuple[int, ...]], colour: tuple[int, ...]) -> str:
    def distance(label: str) -> int:
        return sum(abs(a - b) for a, b in zip(classes[label], colour, strict=True))

    return min(classes, key=distance)


@pytest.mark.qgis
def test_the_picture_shows_the_classes(seen: dict[str, Any]) -> None:
    colour = seen["colour"]
    classes = {
        item["label"]: tuple(bytes.fromhex(item["colour"][1:]))
        for item in layer(seen, "Energy, 95 % (kJ)")["renderer"]["items"]
    }
    # What may shine through from the relief.
    tolerance = (1 - RASTER_OPACITY) * 255
    shown = {
        "high": "≥ 300 kJ", "mean": "30 – 300 kJ", "low": "< 30 kJ",
        "limit 30": "30 – 300 kJ", "below 30": "< 30 kJ", "limit 300": "≥ 300 kJ",
    }  # fmt: skip
    for place, label in shown.items():
        assert nearest(classes, colour[place]) == label, place
        assert close(colour[place], classes[label], tolerance), place
    for place in ("zero", "outside"):  # nothing but grey relief
        red, green, blue = colour[place]
        assert red == green == blue, place
        assert 60 < red < 250, place
    assert close(colour["barrier"], (0x00, 0x44, 0x1B), 3)
    lines = {
        entry["label"]: tuple(bytes.fromhex(entry["colour"][1:]))
        for entry in layer(seen, "Fall lines: furthest rock (kJ)")["renderer"]["classes"]
    }
    assert close(colour["lowest line"], lines["< 30 kJ"], 3)
    assert close(colour["highest line"], lines["≥ 300 kJ"], 3)


@pytest.mark.qgis
def test_local_coordinates(qgis: None, tmp_path: Path) -> None:
    made = made_up.make(tmp_path / "result", local=True)
    report = probe(made.project, tmp_path / "map.png", "--at", PLACES["mean"])
    assert report["opened"]
    assert (report["crs"], report["crs_valid"]) == ("", False)
    assert all(entry["valid"] for entry in report["layers"])
    red, _, blue = bytes.fromhex(report["at"][PLACES["mean"]][1:])
    assert red > blue + 100


def document(project: Path) -> ET.Element:
    with zipfile.ZipFile(project) as archive:
        (name,) = archive.namelist()
        assert name == f"{project.stem}.qgs"
        return ET.fromstring(archive.read(name).decode("utf-8"))


def test_paths_are_relative_and_the_crs_is_whole(tmp_path: Path) -> None:
    root = document(made_up.make(tmp_path).project)
    sources = [element.text or "" for element in root.iter("datasource")]
    assert all(source.startswith(("./maps/", "./result.gpkg|layername=")) for source in sources)
    assert str(tmp_path) not in ET.tostring(root, "unicode")
    for wkt in root.iter("wkt"):
        assert wkt.text is not None and wkt.text.startswith("PROJCRS[")
    # Of a compound system the plane part is taken.
    path = write_project(
        tmp_path / "p.qgz", title="t", crs="EPSG:2056+5728", groups=[], extent=made_up.EXTENT
    )
    assert document(path).findtext("projectCrs/spatialrefsys/authid") == "EPSG:2056"


def test_equal_input_gives_equal_bytes(tmp_path: Path) -> None:
    first, second = made_up.make(tmp_path / "a"), made_up.make(tmp_path / "b")
    assert first.project.read_bytes() == second.project.read_bytes()


def test_layers_and_sheets_need_one_name_each(tmp_path: Path) -> None:
    entry, sheet = LayerEntry(made_up.vector_layers()["stops"], "result.gpkg"), made_up.LAYOUTS[0]
    for groups, sheets, words in (
        ([LayerGroup("a", (entry, entry))], [], "one name each"),
        ([], [sheet, sheet], "layouts of a project need one name each"),
    ):
        with pytest.raises(ValueError, match=words):
            write_project(
                tmp_path / "p.qgz", title="t", crs="", groups=groups, extent=made_up.EXTENT,
                layouts=sheets,
            )  # fmt: skip


@pytest.mark.parametrize("row", STATISTICS, ids=lambda row: row.stem)
def test_darker_means_more_and_the_palest_class_is_no_grey(row: Statistic) -> None:
    colours = [to_rgb(colour) for colour in class_colours(row.breaks, row.ramp)]
    assert all(a > b for a, b in pairwise(np.dot(colours, (0.3, 0.59, 0.11))))
    assert np.ptp(colours[0]) > 0.1
    # No class is of numbers that cannot occur.
    assert not class_labels(row.breaks, row.unit)[0].startswith("<")
