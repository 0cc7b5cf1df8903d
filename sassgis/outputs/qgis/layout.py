"""Map sheets of a QGIS project: a print layout designed in QGIS, filled in.

The template ``data/map_sheet.qpt`` (QGIS 3.22, A3) has the map on the left, and a column with
title, legend, scale, facts and notes on the right. What it says of fonts, colours, widths and
margins holds; its labels show variables of the layout. Texts are broken into lines here, after a
wide letter, so that the blocks of the column are as high as their lines; all type is made smaller
where the column would be too short.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import zip_longest
from xml.etree import ElementTree as ET

from sassgis.grid import Bounds
from sassgis.outputs.qgis.entries import LayerEntry, filled, without_expressions
from sassgis.settings.hazard_rules import Drawing, SheetRules, ZoningSettings
from sassgis.settings.languages import phrase, translated
from sassgis.settings.results import RasterLayer
from sassgis.settings.styles import HILLSHADE, PICTURE, class_labels, class_name

MM_PER_POINT = 25.4 / 72.0
#: Width of a letter in type sizes, of a wide font; the same in bold; from one line to the next.
_LETTER, _BOLD, _LINE = 0.6, 0.68, 1.22
#: Space before a layer and between the rows (mm), as in the template of the sheets.
_SPACE_BEFORE, _SPACE_BETWEEN = 2.5, 1.2
#: Height of a continuous ramp with the values at its ends (mm).
_RAMP_HEIGHT = 14.0


def child(element: ET.Element, path: str) -> ET.Element:
    """Return the element at a path, which must be there."""
    found = element.find(path)
    assert found is not None
    return found


def wrapped(text: str, width_mm: float, font: ET.Element) -> list[str]:
    """Break a text into lines that fit; a number stays with its per cent."""
    _, points, _, _, weight, *_ = font.get("description", "").split(",")
    letter = (_BOLD if int(weight) > 50 else _LETTER) * float(points) * MM_PER_POINT
    paragraphs = text.replace(" %", "\u00a0%").splitlines()
    letters = max(1, int(width_mm / letter))
    return [line for part in paragraphs for line in textwrap.wrap(part, letters)]


def text_height(lines: int, font: ET.Element) -> float:
    """Return the height of some lines of text (mm)."""
    return lines * float(font.get("description", "").split(",")[1]) * MM_PER_POINT * _LINE


def _class_texts(layer: LayerEntry) -> list[str]:
    """List the texts of the classes below a layer's name, in the order of QGIS."""
    content = layer.content
    if not isinstance(content, RasterLayer):
        texts = [entry.label for entry in content.style.classes]
        return texts[::-1] if content.style.method == "ranges" else texts
    if content.classes:
        ordered = sorted(content.classes, key=lambda entry: -entry.value)
        return [class_name(entry) for entry in ordered]
    return class_labels(content.breaks, content.bands[0].unit) if content.breaks else []


def _rank(layer: LayerEntry) -> int:
    """Rank layers with classes first, areas and cells before lines; then those of one sign."""
    content = layer.content
    if isinstance(content, RasterLayer):
        return 0
    if not content.style.classes:
        return 2
    return 0 if content.style.symbol.kind == "fill" else 1


def _legend_texts(layer: LayerEntry, title: str, classes: Sequence[str]) -> dict[str, str]:
    """Return QGIS's legend texts of a layer, by the name of the property."""
    raster = isinstance(layer.content, RasterLayer)
    texts = {"legend/title-label": title}
    if raster:
        # QGIS lists the name of the band before the classes.
        texts["legend/node-order"] = ",".join(map(str, range(1, 1 + max(len(classes), 1))))
    texts |= {f"legend/label-{k}": text for k, text in enumerate(classes, start=int(raster))}
    return {key: without_expressions(text) for key, text in texts.items()}


def fill_legend(item: ET.Element, shown: Sequence[LayerEntry], width: float) -> float:
    """Put layers, the top first, into a legend so wide; returns the height it needs (mm)."""
    plain, bold = (
        child(item, f"styles/style[@name='{name}']/styleFont")
        for name in ("symbolLabel", "subgroup")
    )
    sign_width, sign_height = (float(item.get(f"symbol{key}", "")) for key in ("Width", "Height"))
    beside = width - sign_width - 3.0

    def row(text: str) -> float:
        return max(sign_height, text_height(1 + text.count("\n"), plain)) + _SPACE_BETWEEN

    height = 1.0
    classed: list[dict[str, object]] = []
    single: list[dict[str, object]] = []
    for layer in sorted(shown, key=_rank):
        if isinstance(layer.content, RasterLayer) and layer.content.ramp in (HILLSHADE, PICTURE):
            continue
        one_sign = _rank(layer) == 2
        room = (beside, plain) if one_sign else (width, bold)
        title = "\n".join(wrapped(layer.content.title, *room))
        classes = ["\n".join(wrapped(text, beside, plain)) for text in _class_texts(layer)]
        height += _SPACE_BEFORE + row(title)
        if not one_sign:
            height += sum(map(row, classes)) if classes else _RAMP_HEIGHT
        entry = {"layer": layer, "texts": _legend_texts(layer, title, classes)}
        (single if one_sign else classed).append(entry)
    # Separate signs would seem to belong to the classes before them.
    heading = translated("Also shown") if single and classed else ""
    tree = child(item, "layer-tree-group")
    tree.clear()
    tree.extend(filled("qgis_legend.xml.j2", classed=classed, single=single, heading=heading))
    return height + (_SPACE_BEFORE + row(heading) if heading else 0.0)


#: Scales are these numbers times a power of ten.
SCALE_NUMBERS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.5)

#: Type sizes that are tried, as shares of those of the template; the title shrinks less.
_SHRINKING = (1.0, 0.92, 0.85, 0.78, 0.7, 0.6, 0.5, 0.4)
_LEAST_TITLE = 0.7
_SMALLER = "The zones are drawn for 1:{}. On this sheet some are smaller than the rules require."


@dataclass(frozen=True, slots=True)
class PrintLayout:
    """A map sheet, at the largest round scale at which its extent fits."""

    name: str  # in QGIS's list of layouts; also that of a map theme that shows the same layers
    title: str
    subtitle: str
    #: Keys of the layers (``LayerEntry.key``) on the map, the top first. All but the relief are in
    #: the legend, in this order.
    layers: tuple[str, ...]
    extent: Bounds  # what the map must show (m)
    facts: tuple[tuple[str, str], ...] = ()  # what it rests on: ("Terrain", "DEM of 2 m, ...")
    notes: tuple[str, ...] = ()  # what the reader must know; in a separate box
    #: Denominator of the scale for which the zones are drawn: the sheet has no larger one. 0: any.
    drawn_for: float = 0.0


def round_scale(extent: Bounds, width_mm: float, height_mm: float) -> float:
    """Return the largest round scale's denominator, 100 or more, at which an extent (m) fits."""
    west, south, east, north = extent
    needed = 1000.0 * max((east - west) / width_mm, (north - south) / height_mm)
    needed = max(needed, 100.0) * (1.0 - 1e-9)
    power = 10.0 ** math.floor(math.log10(needed))
    return min(n * p for p in (power, 10.0 * power) for n in SCALE_NUMBERS if n * p >= needed)


def with_margin(extent: Sequence[float]) -> Bounds:
    """Return the extent of what a sheet shows around that of the zones (m)."""
    west, south, east, north = map(float, extent)
    margin = 0.04 * max(east - west, north - south)
    return west - margin, south - margin, east + margin, north + margin


def map_frame(extent: Bounds, drawn_for: float = 0.0) -> tuple[float, Bounds]:
    """Return the scale of the sheet that shows an extent (m), and all that its map shows (m).

    The extent is in the middle of the map; ``drawn_for`` is that of PrintLayout.
    """
    _, _, width, height = _Sheet("", 1.0).box("Map")
    scale = max(round_scale(extent, width, height), drawn_for)
    half_w, half_h = width * scale / 2000.0, height * scale / 2000.0
    x, y = (extent[0] + extent[2]) / 2.0, (extent[1] + extent[3]) / 2.0
    return scale, (x - half_w, y - half_h, x + half_w, y + half_h)


def drawing_on_sheet(
    zones: ZoningSettings,
    sheet: SheetRules | None,
    metres: tuple[float, float, float],
    extent: Bounds,
) -> Drawing:
    """Return how zones of an extent are drawn on the sheet that shows them.

    ``sheet`` are the rules of the preset; ``metres``: reference width, spacing of the release
    points, cell.
    """
    scale, _ = map_frame(with_margin(extent))
    return zones.at_scale(scale).drawing(sheet, *metres)


def round_length(longest: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, ... that is not above a length."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(n * power for n in (1.0, 2.0, 5.0) if n * power <= longest * (1.0 + 1e-9))


def scale_text(scale: float) -> str:
    """Return the number of a scale as QGIS writes it."""
    return f"{scale:,.0f}".replace(",", "\u00a0")


def layout_element(
    layout: PrintLayout, layers: Mapping[str, LayerEntry], crs_name: str
) -> ET.Element:
    """Return the ``Layout`` element of a project; ``crs_name`` is empty for local coordinates.

    ValueError if the layout shows a layer that the project does not have, or none.
    """
    unknown = [key for key in layout.layers if key not in layers]
    if unknown or not layout.layers:
        raise ValueError(f"layout {layout.name}: no such layers in the project: {unknown}")
    shown = [layers[key] for key in layout.layers]
    coordinates = translated("Coordinates"), crs_name or translated("local, in m")
    for factor in _SHRINKING:
        sheet = _Sheet(layout.name, factor)
        scale = _fill_map(sheet, layout.extent, shown, layout.drawn_for)
        notes = layout.notes
        if 0.0 < layout.drawn_for < scale:
            notes = (*notes, translated(phrase(_SMALLER, scale_text(layout.drawn_for))))
        end = _fill_above(sheet, layout, shown)
        start = _fill_below(sheet, (*layout.facts, coordinates), notes)
        if end + sheet.gap <= start:
            break
    sheet.variables |= {
        # QGIS writes the scale, so that it stays true when the map is moved. Where the
        # coordinates are local, it does not know that they are in metres.
        "sheet_local_scale": "" if crs_name else scale_text(scale),
        "sheet_scale_word": translated("Scale"),
    }
    sheet.items["Scale bar"].set("unitType", "meters" if crs_name else "unknown")
    sheet.set_variables()
    return sheet.root


class _Sheet:
    """The template, its type made smaller, whose items are found by their names."""

    def __init__(self, name: str, factor: float) -> None:
        file = resources.files("sassgis").joinpath("data", "map_sheet.qpt")
        self.root = ET.fromstring(file.read_text(encoding="utf-8"))
        self.root.set("name", name)
        self.items = {item.get("id", ""): item for item in self.root.findall("LayoutItem")}
        self.variables: dict[str, str] = {}
        for own, item in self.items.items():
            share = max(factor, _LEAST_TITLE) if own in ("Title", "Subtitle") else factor
            for font in (*item.iter("LabelFont"), *item.iter("styleFont")):
                family, points, rest = font.get("description", "").split(",", 2)
                font.set("description", f"{family},{float(points) * share:g},{rest}")
        for key in ("symbolWidth", "symbolHeight"):
            self.items["Legend"].set(key, f"{float(self.items['Legend'].get(key, '')) * factor:g}")
        _, self.top, _, height = self.box("Map")
        self.bottom = self.top + height
        #: Between two blocks of the column (mm).
        self.gap = 3.0

    def box(self, name: str) -> tuple[float, float, float, float]:
        """Return left, top, width and height of an item (mm)."""
        item = self.items[name]
        x, y = item.get("position", "").split(",")[:2]
        width, height = item.get("size", "").split(",")[:2]
        return float(x), float(y), float(width), float(height)

    def move(self, name: str, y: float, height: float | None = None) -> None:
        """Put an item at a height of the page, and make it so high (mm)."""
        x, _, width, own = self.box(name)
        for key in ("position", "positionOnPage"):
            self.items[name].set(key, f"{x:.3f},{y:.3f},mm")
        self.items[name].set("size", f"{width:.3f},{own if height is None else height:.3f},mm")

    def lines(self, name: str, text: str) -> list[str]:
        """Break a text into the lines of a label."""
        item = self.items[name]
        width = self.box(name)[2] - 2.0 * float(item.get("marginX", ""))
        return wrapped(text, width, child(item, "LabelFont"))

    def write(self, name: str, variable: str, lines: Sequence[str]) -> float:
        """Set the lines of a label; returns the room that they need (mm), 0 without any."""
        self.variables[variable] = "\n".join(lines)
        if not lines:
            self.root.remove(self.items.pop(name))
            return 0.0
        item = self.items[name]
        room = text_height(len(lines), child(item, "LabelFont"))
        return room + 2.0 * float(item.get("marginY", "")) + 1.0

    def set_variables(self) -> None:
        """Write the variables of the layout as QGIS keeps them."""
        kept = child(self.root, "customproperties/Option")
        for key, values in (("Names", self.variables), ("Values", self.variables.values())):
            option = ET.SubElement(kept, "Option", type="StringList", name=f"variable{key}")
            for value in values:
                ET.SubElement(option, "Option", type="QString", value=value)


def _fill_map(
    sheet: _Sheet, extent: Bounds, shown: Sequence[LayerEntry], drawn_for: float
) -> float:
    """Show an extent, in the middle of the map; returns the scale."""
    item = sheet.items["Map"]
    scale, frame = map_frame(extent, drawn_for)
    sides = zip(("xmin", "ymin", "xmax", "ymax"), frame, strict=True)
    child(item, "Extent").attrib.update({name: repr(float(v)) for name, v in sides})
    for layer in shown:
        source = {"source": layer.datasource, "provider": layer.provider}
        entry = ET.SubElement(
            child(item, "LayerSet"), "Layer", {"name": layer.content.title, **source}
        )
        entry.text = layer.key
    step_m = round_length(0.07 * scale)
    child(item, "ComposerMapGrid").attrib.update(intervalX=f"{step_m:g}", intervalY=f"{step_m:g}")
    segment_m = round_length(0.017 * scale)
    in_km = segment_m >= 1000.0
    sheet.items["Scale bar"].attrib.update(
        unitLabel="km" if in_km else "m",
        numMapUnitsPerScaleBarUnit="1000" if in_km else "1",
        numUnitsPerSegment=f"{segment_m / 1000.0 if in_km else segment_m:g}",
    )
    return scale


def _fill_above(sheet: _Sheet, layout: PrintLayout, shown: Sequence[LayerEntry]) -> float:
    """Return title, subtitle and legend from the top of the column; returns where they end."""
    y = sheet.top
    for name, text in (("Title", layout.title), ("Subtitle", layout.subtitle)):
        height = sheet.write(name, f"sheet_{name.lower()}", sheet.lines(name, text))
        if height:
            sheet.move(name, y, height)
        y += height
    sheet.move("Rule below the title", y + sheet.gap / 2.0)
    y += sheet.gap
    height = fill_legend(sheet.items["Legend"], shown, sheet.box("Legend")[2])
    sheet.move("Legend", y, height)
    return y + height


def _fill_below(sheet: _Sheet, facts: Sequence[tuple[str, str]], notes: Sequence[str]) -> float:
    """Return notes, facts and scale from the foot of the column up; returns where they begin."""
    lines = [line for note in notes for line in sheet.lines("Notes", f"\u2013\u00a0{note}")]
    height = sheet.write("Notes", "sheet_notes", lines)
    y = sheet.bottom - height
    if height:
        sheet.move("Notes", y, height)
        y -= sheet.gap
    labels = {"Names of the facts": "sheet_fact_names", "Facts": "sheet_facts"}
    rows = [
        row for fact in facts for row in zip_longest(*map(sheet.lines, labels, fact), fillvalue="")
    ]
    height = max(map(sheet.write, labels, labels.values(), zip(*rows, strict=True)))
    y -= height
    for name in labels:
        sheet.move(name, y, height)
    sheet.move("Rule above the facts", y - sheet.gap / 2.0)
    y -= sheet.gap
    names = ("Scale", "Scale bar", "North arrow")
    tops = {name: sheet.box(name)[1] for name in names}
    y -= max(sum(sheet.box(name)[1::2]) for name in names) - min(tops.values())
    for name, top in tops.items():
        sheet.move(name, y + top - min(tops.values()))
    return y
