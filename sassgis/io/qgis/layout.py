"""Print layouts of a QGIS project: a template designed in QGIS, filled in.

The templates are ``data/map_sheet_a3.qpt`` and ``map_sheet_a4.qpt`` (QGIS 3.22): the map on the
left, a column with title, legend, scale, sources and notes on the right. What a template says of
fonts, colours, widths and margins holds; the blocks of the column are moved up or down to make room
for their texts, and all type is made smaller where the column would be too short.

QGIS breaks the texts into lines; how many to make room for is measured (``text_size``).
"""

from __future__ import annotations

import copy
import functools
import math
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Literal, NamedTuple
from xml.etree import ElementTree as ET

from sassgis.io.qgis.entries import LayerEntry
from sassgis.io.qgis.markup import without_expressions
from sassgis.io.qgis.sheet_legend import fill_legend
from sassgis.io.qgis.text_size import breakable, text_height, text_width, wrapped
from sassgis.model.languages import phrase, translated

#: West, south, east, north (m).
Extent = tuple[float, float, float, float]

#: Scales are these numbers times a power of ten.
SCALE_NUMBERS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.5)

#: Type sizes that are tried, as shares of those of the template; the title shrinks less.
_SHRINKING = (1.0, 0.92, 0.85, 0.78, 0.7, 0.6, 0.5)
_LEAST_TITLE = 0.7
_SMALLER = "The zones are drawn for 1:{}: on this sheet they are smaller than the rules ask for."
_NAMESPACE = uuid.UUID("3f7d0a52-7d2c-5b0e-9d84-5a5c7a1e0b6f")


@dataclass(frozen=True, slots=True)
class PrintLayout:
    """A map sheet, at the largest round scale at which its extent fits."""

    name: str  # in QGIS's list of layouts; also that of a map theme that shows the same layers
    title: str
    subtitle: str
    #: Keys of the layers (``LayerEntry.key``) on the map, the top first. All but the relief are in
    #: the legend, in this order.
    layers: tuple[str, ...]
    extent: Extent  # what the map must show (m)
    facts: tuple[tuple[str, str], ...] = ()  # what it rests on: ("Terrain", "DEM of 2 m, ...")
    notes: tuple[str, ...] = ()  # what the reader must know; in a box of their own
    page: Literal["A3", "A4"] = "A3"  # landscape
    #: Denominator of the scale for which the zones are drawn: the sheet has no larger one. 0: any.
    drawn_for: float = 0.0


class Box(NamedTuple):
    """A rectangle on the page (mm)."""

    x: float
    y: float
    width: float
    height: float


def round_scale(extent: Extent, width_mm: float, height_mm: float) -> float:
    """Denominator of the largest round scale, at least 100, at which an extent (m) fits a frame."""
    west, south, east, north = extent
    needed = 1000.0 * max((east - west) / width_mm, (north - south) / height_mm)
    needed = max(needed, 100.0) * (1.0 - 1e-9)
    power = 10.0 ** math.floor(math.log10(needed))
    return float(
        min(n * p for p in (power, 10.0 * power) for n in SCALE_NUMBERS if n * p >= needed)
    )


def round_length(longest: float) -> float:
    """The largest of 1, 2, 5, 10, 20, ... that is not above a length."""
    power = 10.0 ** math.floor(math.log10(longest))
    return float(max(n * power for n in (1.0, 2.0, 5.0) if n * power <= longest * (1.0 + 1e-9)))


@functools.cache
def _template(page: str) -> ET.Element:
    name = f"map_sheet_{page.lower()}.qpt"
    text = resources.files("sassgis").joinpath("data", name).read_text(encoding="utf-8")
    return ET.fromstring(text)


class _Sheet:
    """A copy of a template, whose items are found by their names."""

    def __init__(self, page: str, name: str) -> None:
        self.root = copy.deepcopy(_template(page))
        self.root.set("name", name)
        self.items = {item.get("id", ""): item for item in self.root.findall("LayoutItem")}

    def box(self, name: str) -> Box:
        x, y = self.items[name].get("position", "").split(",")[:2]
        width, height = self.items[name].get("size", "").split(",")[:2]
        return Box(float(x), float(y), float(width), float(height))

    def put(self, name: str, box: Box) -> None:
        item = self.items[name]
        for key in ("position", "positionOnPage"):
            item.set(key, f"{box.x:.3f},{box.y:.3f},mm")
        item.set("size", f"{box.width:.3f},{box.height:.3f},mm")

    def move(self, name: str, y: float, height: float | None = None) -> None:
        box = self.box(name)
        self.put(name, box._replace(y=y, height=box.height if height is None else height))

    def remove(self, name: str) -> None:
        self.root.remove(self.items.pop(name))

    def clone(self, name: str, new: str) -> None:
        """Put a copy of an item beside it."""
        item = copy.deepcopy(self.items[name])
        key = "{" + str(uuid.uuid5(_NAMESPACE, new)) + "}"
        item.attrib.update({"id": new, "uuid": key, "templateUuid": key})
        self.items[new] = item
        self.root.insert(list(self.root).index(self.items[name]), item)

    def shrink(self, factor: float) -> None:
        """Make all type smaller, and with it the signs of the legend."""
        for name, item in self.items.items():
            share = max(factor, _LEAST_TITLE) if name in ("Title", "Subtitle") else factor
            for font in (*item.iter("LabelFont"), *item.iter("styleFont")):
                family, points, rest = font.get("description", "").split(",", 2)
                font.set("description", f"{family},{float(points) * share:g},{rest}")
        for key in ("symbolWidth", "symbolHeight"):
            self.items["Legend"].set(key, f"{float(self.items['Legend'].get(key, '')) * factor:g}")

    def font(self, name: str) -> tuple[float, bool]:
        return _font(self.items[name].find("LabelFont"))

    def text_height(self, name: str, text: str, width: float | None = None) -> float:
        """Room that a text needs in a label (mm)."""
        points, bold = self.font(name)
        width = self.box(name).width if width is None else width
        return text_height(len(wrapped(text, width, points, bold=bold)), points)

    def write(self, name: str, text: str) -> None:
        """Set the text of a label, whose width is final."""
        points, bold = self.font(name)
        words = breakable(text, self.box(name).width, points, bold=bold)
        self.items[name].set("labelText", without_expressions(words))


def _font(element: ET.Element | None) -> tuple[float, bool]:
    """Type size (points), and whether it is bold."""
    assert element is not None
    parts = element.get("description", "").split(",")
    return float(parts[1]), int(parts[4]) > 50


def layout_element(
    layout: PrintLayout, layers: Mapping[str, LayerEntry], crs_name: str
) -> ET.Element:
    """The ``Layout`` element of a project; ``crs_name`` is empty for local coordinates.

    Raises
    ------
    ValueError
        If the layout shows a layer that the project does not have, or none.
    """
    unknown = [key for key in layout.layers if key not in layers]
    if unknown or not layout.layers:
        raise ValueError(f"layout {layout.name}: no such layers in the project: {unknown}")
    shown = [layers[key] for key in layout.layers]
    facts = (*layout.facts, (translated("Coordinates"), crs_name or translated("local, in m")))
    for factor in _SHRINKING:
        sheet = _Sheet(layout.page, layout.name)
        scale = _fill_map(sheet, layout.extent, shown, layout.drawn_for)
        notes = layout.notes
        if 0.0 < layout.drawn_for < scale:
            notes = (*notes, translated(phrase(_SMALLER, scale_text(layout.drawn_for))))
        sheet.shrink(factor)
        end = _fill_head(sheet, layout.title, layout.subtitle)
        legend = sheet.items["Legend"]
        points, _ = _font(legend.find("styles/style[@name='symbolLabel']/styleFont"))
        height = fill_legend(legend, shown, sheet.box("Legend").width, points)
        sheet.move("Legend", end, height)
        end += height
        start = _fill_notes(sheet, notes)
        start = _fill_facts(sheet, start, facts)
        start = _fill_scale(sheet, start, scale, local=not crs_name)
        if end + _gap(sheet) / 2.0 <= start:
            break
    for number, item in enumerate(reversed(sheet.root.findall("LayoutItem")), start=1):
        item.set("zValue", str(number))
    return sheet.root


def scale_text(scale: float) -> str:
    """The number of a scale as QGIS writes it."""
    return f"{scale:,.0f}".replace(",", "\u00a0")


def _gap(sheet: _Sheet) -> float:
    """Space between the map and the column, and between two blocks of the column (mm)."""
    frame = sheet.box("Map")
    return sheet.box("Title").x - frame.x - frame.width


def _fill_map(
    sheet: _Sheet, extent: Extent, shown: Sequence[LayerEntry], drawn_for: float
) -> float:
    """Show an extent, in the middle of the map; returns the scale."""
    frame, item = sheet.box("Map"), sheet.items["Map"]
    scale = max(round_scale(extent, frame.width, frame.height), drawn_for)
    half_w, half_h = frame.width * scale / 2000.0, frame.height * scale / 2000.0
    x, y = (extent[0] + extent[2]) / 2.0, (extent[1] + extent[3]) / 2.0
    sides = {"xmin": x - half_w, "ymin": y - half_h, "xmax": x + half_w, "ymax": y + half_h}
    _child(item, "Extent").attrib.update({name: repr(float(v)) for name, v in sides.items()})
    chosen = _child(item, "LayerSet")
    for layer in shown:
        entry = ET.SubElement(
            chosen, "Layer", name=layer.content.title, source=layer.datasource,
            provider=layer.provider,
        )  # fmt: skip
        entry.text = layer.key
    step_m = round_length(0.07 * scale)
    digits = max(0, -math.floor(math.log10(step_m)))
    number = f"regexp_replace(format_number(@grid_number, {digits}, 'en'), ',', '\u00a0')"
    _child(item, "ComposerMapGrid").attrib.update(
        intervalX=repr(step_m), intervalY=repr(step_m), annotationExpression=number
    )
    return scale


def _child(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    assert found is not None
    return found


def _fill_head(sheet: _Sheet, title: str, subtitle: str) -> float:
    """Title and subtitle; returns where the legend begins."""
    y, half_gap = sheet.box("Title").y, _gap(sheet) / 2.0
    for name, text in (("Title", title), ("Subtitle", subtitle)):
        if not text:
            sheet.remove(name)
            continue
        height = sheet.text_height(name, text) + 1.0
        sheet.move(name, y, height)
        sheet.write(name, text)
        y += height
    sheet.move("Rule below the title", y + half_gap)
    return y + 2.0 * half_gap


def _fill_notes(sheet: _Sheet, notes: Sequence[str]) -> float:
    """Notes in their box, at the foot of the column; returns where the block begins."""
    frame, note = sheet.box("Map"), sheet.box("Note")
    padding = note.y - sheet.box("Box of the notes").y
    bottom = frame.y + frame.height
    heights = [sheet.text_height("Note", text) + 1.0 for text in notes]
    top = bottom - sum(heights) - 2.0 * padding
    y = top + padding
    for number, (text, height) in enumerate(zip(notes, heights, strict=True), start=1):
        name = f"Note {number}"
        sheet.clone("Note", name)
        sheet.put(name, note._replace(y=y, height=height - 0.2))
        sheet.write(name, text)
        y += height
    sheet.remove("Note")
    if not notes:
        sheet.remove("Box of the notes")
        return bottom
    sheet.move("Box of the notes", top, bottom - top)
    return top - _gap(sheet) / 2.0


def _fill_facts(sheet: _Sheet, bottom: float, facts: Sequence[tuple[str, str]]) -> float:
    """What the map rests on, name and text in two columns; returns where the block begins."""
    left, right = sheet.box("Source name"), sheet.box("Source")
    width = right.x + right.width - left.x
    points, bold = sheet.font("Source name")
    longest = max(text_width(name, points, bold=bold) for name, _ in facts)
    first = min(longest + 2.5, 0.4 * width)
    left, right = left._replace(width=first), Box(left.x + first, 0.0, width - first, 0.0)
    heights = [
        1.0 + max(
            sheet.text_height("Source name", name, first - 2.0),
            sheet.text_height("Source", text, right.width),
        )
        for name, text in facts
    ]  # fmt: skip
    top = y = bottom - sum(heights)
    for (name, text), height in zip(facts, heights, strict=True):
        for item, new, words, place in (
            ("Source name", f"{name}, name", name, left._replace(width=first - 2.0)),
            ("Source", name, text, right),
        ):
            sheet.clone(item, new)
            sheet.put(new, place._replace(y=y, height=height))
            sheet.write(new, words)
        y += height
    sheet.remove("Source name")
    sheet.remove("Source")
    half_gap = _gap(sheet) / 2.0
    sheet.move("Rule above the sources", top - half_gap)
    return top - 2.0 * half_gap


def _fill_scale(sheet: _Sheet, bottom: float, scale: float, *, local: bool) -> float:
    """Scale in numbers, scale bar and north arrow; returns where the block begins."""
    boxes = {name: sheet.box(name) for name in ("Scale", "Scale bar", "North arrow")}
    first = min(box.y for box in boxes.values())
    top = bottom - max(box.y + box.height for box in boxes.values()) + first
    for name, box in boxes.items():
        sheet.move(name, top + box.y - first)
    # QGIS fills in the scale, so that it stays true when the map is moved. Where the coordinates
    # are local, it does not know that they are in metres.
    text = sheet.items["Scale"].get("labelText", "").removeprefix("Scale 1:")
    if local:
        text = scale_text(scale)
    sheet.items["Scale"].set("labelText", f"{translated('Scale')} 1:{text}")
    room = boxes["North arrow"].x - boxes["Scale bar"].x - 16.0
    step_m = round_length(room * scale / 1000.0 / 4.0)
    in_km = step_m >= 1000.0
    sheet.items["Scale bar"].attrib.update(
        unitType="unknown" if local else "meters",
        unitLabel="km" if in_km else "m",
        numMapUnitsPerScaleBarUnit="1000" if in_km else "1",
        numUnitsPerSegment=f"{step_m:g}",
    )
    sheet.put("Scale bar", sheet.box("Scale bar")._replace(width=room + 8.0))
    return top
