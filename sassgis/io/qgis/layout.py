"""Print layouts of a QGIS project: a map sheet with legend, scale, north arrow and sources.

The sheet has the map on the left and a column on the right: title, legend, scale, what the map
rests on, and what its reader must know. Everything is placed here, in mm; QGIS only draws. The
font is Arial, or what stands in for it with the same widths (Liberation Sans).
"""

from __future__ import annotations

import base64
import math
import unicodedata
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple
from xml.etree import ElementTree as ET

from sassgis.io.qgis.markup import rgba
from sassgis.io.qgis.vector_style import symbol_element
from sassgis.io.write.geopackage import VectorLayer
from sassgis.model.results import RasterLayer
from sassgis.model.styles import HILLSHADE, Symbol, class_labels, class_name

Extent = tuple[float, float, float, float]

#: Width and height of the page (mm).
PAGES: Mapping[str, tuple[float, float]] = {"A3": (420.0, 297.0), "A4": (297.0, 210.0)}
FONT = "Arial"
#: Taken where there is no Arial.
_SUBSTITUTES = ("Liberation Sans", "Helvetica", "Nimbus Sans")
#: Scales are these numbers times a power of ten.
SCALE_NUMBERS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.5)

_MM_PER_POINT = 25.4 / 72.0
_LINE = 1.22
_INK, _GREY, _PALE = "#1a1a1a", "#5a5a5a", "#f2f2f2"
#: Of the letters of Arial from the space to the tilde, in thousandths of the type size.
_WIDTHS = (
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556,
    556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667,
    611, 778, 722, 278, 500, 667, 556, 833, 722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667,
    667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500,
    222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
)  # fmt: skip
_NAMESPACE = uuid.UUID("3f7d0a52-7d2c-5b0e-9d84-5a5c7a1e0b6f")
_NORTH_ARROW = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="100" height="140" viewBox="0 0 100 140">'
    '<path d="M50 40 L82 136 L50 116 Z" fill="#1a1a1a"/>'
    '<path d="M50 40 L18 136 L50 116 Z" fill="#ffffff" stroke="#1a1a1a" stroke-width="3"'
    ' stroke-linejoin="round"/>'
    '<path d="M38 33 V4 L62 32 V3" fill="none" stroke="#1a1a1a" stroke-width="6"/></svg>'
)


@dataclass(frozen=True, slots=True)
class PrintLayout:
    """A map sheet.

    Attributes
    ----------
    name : str
        In QGIS's list of layouts; also the name of a map theme that shows the same layers.
    title, subtitle : str
    layers : tuple of str
        Keys of the layers (``LayerEntry.key``) on the map, the top first. All but the relief are
        in the legend, in this order.
    extent : (west, south, east, north)
        What the map must show (m). The scale is the largest round one at which it fits.
    facts : tuple of (str, str)
        What the map rests on: name and text, as ("Terrain", "DEM of 2 m, ...").
    notes : tuple of str
        What the reader must know; in a box of their own.
    page : {"A3", "A4"}
        Landscape.
    """

    name: str
    title: str
    subtitle: str
    layers: tuple[str, ...]
    extent: Extent
    facts: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    page: Literal["A3", "A4"] = "A3"


class ShownLayer(NamedTuple):
    """A layer as layouts need it."""

    key: str
    datasource: str
    content: RasterLayer | VectorLayer

    @property
    def provider(self) -> str:
        """QGIS's name of the program that reads it."""
        return "gdal" if isinstance(self.content, RasterLayer) else "ogr"


class Box(NamedTuple):
    """A rectangle on the page (mm)."""

    x: float
    y: float
    width: float
    height: float


# --- sizes -----------------------------------------------------------------------------------


def round_scale(extent: Extent, width_mm: float, height_mm: float) -> float:
    """Denominator of the largest round scale at which an extent fits a frame.

    Parameters
    ----------
    extent : (west, south, east, north)
        m.
    width_mm, height_mm : float
        Of the frame.

    Returns
    -------
    float
        At least 100.
    """
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


def text_width(text: str, points: float, *, bold: bool = False) -> float:
    """Width of a line of text in Arial (mm), a little on the safe side."""
    em = 0
    for letter in unicodedata.normalize("NFD", text.replace("\u00a0", " ")):
        if not unicodedata.combining(letter):
            place = ord(letter) - 32
            em += _WIDTHS[place] if 0 <= place < len(_WIDTHS) else 800
    return em / 1000.0 * points * _MM_PER_POINT * (1.08 if bold else 1.0) * 1.02


def wrapped(text: str, width_mm: float, points: float, *, bold: bool = False) -> list[str]:
    """Break a text into lines that fit; a word longer than the line is broken."""
    lines = []
    for paragraph in text.splitlines() or [""]:
        line = ""
        for word in paragraph.replace(" %", "\u00a0%").split(" "):
            rest = word
            while text_width(rest, points, bold=bold) > width_mm and len(rest) > 1:
                cut = len(rest) - 1
                while cut > 1 and text_width(rest[:cut], points, bold=bold) > width_mm:
                    cut -= 1
                if line:
                    lines.append(line)
                    line = ""
                lines.append(rest[:cut])
                rest = rest[cut:]
            joined = f"{line} {rest}" if line else rest
            if text_width(joined, points, bold=bold) > width_mm:
                lines.append(line)
                line = rest
            else:
                line = joined
        lines.append(line)
    return lines


def balanced(text: str, width_mm: float, points: float, *, bold: bool = False) -> list[str]:
    """As :func:`wrapped`, in as many lines, but of about equal length: for titles."""
    best = wrapped(text, width_mm, points, bold=bold)
    for share in (0.9, 0.8, 0.7, 0.6):
        narrower = wrapped(text, share * width_mm, points, bold=bold)
        if len(narrower) > len(best):
            break
        best = narrower
    return best


def _height(lines: int, points: float) -> float:
    return lines * points * _MM_PER_POINT * _LINE


class _Measures(NamedTuple):
    """Sizes on a page: lengths in mm, type in points."""

    margin: float
    column: float
    gap: float
    title: float
    subtitle: float
    text: float
    small: float
    symbol: tuple[float, float]


_MEASURES = {
    "A3": _Measures(12.0, 98.0, 6.0, 19.0, 11.5, 10.0, 8.0, (9.0, 5.0)),
    "A4": _Measures(9.0, 72.0, 4.0, 13.5, 9.0, 8.0, 6.3, (6.5, 3.7)),
}
#: Left and below the map, for the coordinates.
_GUTTER = 5.0


# --- items -----------------------------------------------------------------------------------


class _Sheet:
    """The items of one layout, in the order in which they are drawn."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.items: list[ET.Element] = []

    def key(self, item: str) -> str:
        """Identity of an item, the same in every writing."""
        return "{" + str(uuid.uuid5(_NAMESPACE, f"{self.name}/{item}")) + "}"

    def add(self, kind: int, name: str, box: Box, attributes: Mapping[str, str]) -> ET.Element:
        """Append an item; the attributes may replace what all items have."""
        item = _item(kind, name, box, self.key(name), len(self.items) + 1, attributes)
        self.items.append(item)
        return item

    def label(
        self,
        name: str,
        box: Box,
        text: str,
        points: float,
        *,
        bold: bool = False,
        colour: str = _INK,
        right: bool = False,
        middle: bool = False,
    ) -> None:
        """Append a text."""
        item = self.add(
            65641,
            name,
            box,
            {
                "labelText": text,
                "htmlState": "0",
                "halign": "2" if right else "1",
                "valign": "128" if middle else "32",
                "marginX": "0",
                "marginY": "0",
            },
        )
        ET.SubElement(
            item,
            "LabelFont",
            description=_font(points, bold=bold),
            style="Bold" if bold else "Regular",
        )
        red, green, blue, alpha = rgba(colour).split(",")
        ET.SubElement(item, "FontColor", red=red, green=green, blue=blue, alpha=alpha)

    def rectangle(self, name: str, box: Box, colour: str) -> None:
        """Append a filled rectangle; a thin one is a rule."""
        item = self.add(65643, name, box, {"shapeType": "1", "cornerRadiusMeasure": "0,mm"})
        item.append(symbol_element(Symbol("fill", colour), ""))


def _item(
    kind: int, name: str, box: Box, key: str, place: int, attributes: Mapping[str, str]
) -> ET.Element:
    position = f"{box.x:.3f},{box.y:.3f},mm"
    item = ET.Element(
        "LayoutItem",
        {
            "type": str(kind),
            "id": name,
            "uuid": key,
            "templateUuid": key,
            "position": position,
            "positionOnPage": position,
            "size": f"{box.width:.3f},{box.height:.3f},mm",
            "referencePoint": "0",
            "itemRotation": "0",
            "opacity": "1",
            "blendMode": "0",
            "visibility": "1",
            "positionLock": "false",
            "groupUuid": "",
            "zValue": str(place),
            "frame": "false",
            "frameJoinStyle": "miter",
            "outlineWidthM": "0.25,mm",
            "background": "false",
            "excludeFromExports": "0",
            **attributes,
        },
    )
    ink = rgba(_INK).split(",")
    ET.SubElement(
        item, "FrameColor", dict(zip(("red", "green", "blue", "alpha"), ink, strict=True))
    )
    ET.SubElement(item, "BackgroundColor", dict.fromkeys(("red", "green", "blue", "alpha"), "255"))
    return item


def _font(points: float, *, bold: bool = False) -> str:
    """A font as Qt describes it."""
    return f"{FONT},{points:g},-1,5,{75 if bold else 50},0,0,0,0,0"


def _text_style(points: float, colour: str) -> ET.Element:
    style = ET.Element(
        "text-style",
        fontFamily=FONT,
        fontSize=f"{points:g}",
        fontSizeUnit="Point",
        fontWeight="50",
        namedStyle="Regular",
        textColor=rgba(colour),
        textOpacity="1",
        multilineHeight="1",
        allowHtml="0",
    )
    families = ET.SubElement(style, "families")
    for family in _SUBSTITUTES:
        ET.SubElement(families, "family", name=family)
    return style


def _map_item(
    sheet: _Sheet, box: Box, extent: Extent, layers: Sequence[ShownLayer], points: float
) -> None:
    item = sheet.add(
        65639,
        "Map",
        box,
        {
            "frame": "true",
            "background": "true",
            "keepLayerSet": "true",
            "followPreset": "false",
            "followPresetName": "",
            "mapRotation": "0",
            "mapFlags": "0",
            "drawCanvasItems": "true",
            "isTemporal": "0",
            "labelMargin": "0,mm",
        },
    )
    west, south, east, north = (repr(float(value)) for value in extent)
    ET.SubElement(item, "Extent", xmin=west, ymin=south, xmax=east, ymax=north)
    chosen = ET.SubElement(item, "LayerSet")
    for layer in layers:
        entry = ET.SubElement(
            chosen,
            "Layer",
            name=layer.content.title,
            source=layer.datasource,
            provider=layer.provider,
        )
        entry.text = layer.key
    metres_per_mm = (extent[2] - extent[0]) / box.width
    item.append(_grid(sheet, round_length(70.0 * metres_per_mm), points))


def _grid(sheet: _Sheet, step_m: float, points: float) -> ET.Element:
    """Crosses at round coordinates, which are written left of and below the map."""
    hidden, eastings, northings = "3", "2", "1"
    digits = max(0, -math.floor(math.log10(step_m)))
    grid = ET.Element(
        "ComposerMapGrid",
        {
            "name": "Coordinates",
            "uuid": sheet.key("grid"),
            "show": "1",
            "unit": "0",
            "gridStyle": "1",
            "crossLength": "1.5",
            "intervalX": repr(step_m),
            "intervalY": repr(step_m),
            "offsetX": "0",
            "offsetY": "0",
            "position": "3",
            "blendMode": "0",
            "gridFrameStyle": "2",
            "gridFrameSideFlags": "15",
            "gridFrameWidth": "1.5",
            "gridFramePenThickness": "0.2",
            "gridFramePenColor": rgba(_INK),
            "gridFrameMargin": "0",
            "showAnnotation": "1",
            "annotationFormat": "8",
            "annotationExpression": (
                f"regexp_replace(format_number(@grid_number, {digits}, 'en'), ',', '\u00a0')"
            ),
            "annotationPrecision": "0",
            "frameAnnotationDistance": "0.8",
            "leftAnnotationDisplay": northings,
            "leftAnnotationPosition": "1",
            "leftAnnotationDirection": "1",
            "bottomAnnotationDisplay": eastings,
            "bottomAnnotationPosition": "1",
            "bottomAnnotationDirection": "0",
            "rightAnnotationDisplay": hidden,
            "topAnnotationDisplay": hidden,
        },
    )
    lines = ET.SubElement(grid, "lineStyle")
    lines.append(symbol_element(Symbol("line", _INK, opacity=0.7, size_mm=0.15), ""))
    grid.append(_text_style(points, _GREY))
    return grid


def _scale_bar(sheet: _Sheet, box: Box, step_m: float, points: float, *, local: bool) -> None:
    in_km = step_m >= 1000.0
    item = sheet.add(
        65646,
        "Scale bar",
        box,
        {
            "style": "Single Box",
            "mapUuid": sheet.key("Map"),
            # Where the coordinates are local, QGIS does not know that they are in metres.
            "unitType": "unknown" if local else "meters",
            "unitLabel": "km" if in_km else "m",
            "numMapUnitsPerScaleBarUnit": "1000" if in_km else "1",
            "numUnitsPerSegment": f"{step_m:g}",
            "numSegments": "4",
            "numSegmentsLeft": "0",
            "numSubdivisions": "1",
            "subdivisionsHeight": "1",
            "segmentSizeMode": "0",
            "minBarWidth": "20",
            "maxBarWidth": "100",
            "height": "1.8",
            "labelBarSpace": "1",
            "labelVerticalPlacement": "0",
            "labelHorizontalPlacement": "0",
            "boxContentSpace": "0",
            "alignment": "0",
            "outlineWidth": "0.2",
            "lineJoinStyle": "miter",
            "lineCapStyle": "square",
        },
    )
    item.append(_text_style(points, _INK))
    for tag, colour in (("strokeColor", _INK), ("fillColor", _INK), ("fillColor2", "#ffffff")):
        parts = dict(zip(("red", "green", "blue", "alpha"), rgba(colour).split(","), strict=True))
        ET.SubElement(item, tag, parts)
    line = Symbol("line", _INK, size_mm=0.2)
    for tag in ("lineSymbol", "divisionLineSymbol", "subdivisionLineSymbol"):
        ET.SubElement(item, tag).append(symbol_element(line, ""))
    ET.SubElement(item, "fillSymbol1").append(symbol_element(Symbol("fill", _INK), ""))
    ET.SubElement(item, "fillSymbol2").append(symbol_element(Symbol("fill", "#ffffff"), ""))


def _north_arrow(sheet: _Sheet, box: Box) -> None:
    # Within the file, so that it is there on every computer.
    picture = base64.b64encode(_NORTH_ARROW.encode()).decode("ascii")
    sheet.add(
        65640,
        "North arrow",
        box,
        {
            "file": f"base64:{picture}",
            "mode": "0",
            "resizeMode": "0",
            "anchorPoint": "1",
            "pictureRotation": "0",
            "mapUuid": sheet.key("Map"),
            "northMode": "0",
            "northOffset": "0",
        },
    )


# --- legend ----------------------------------------------------------------------------------


def _is_relief(layer: ShownLayer) -> bool:
    return isinstance(layer.content, RasterLayer) and layer.content.ramp == HILLSHADE


def _entry_texts(content: RasterLayer | VectorLayer) -> list[str]:
    """Texts of the classes below the name of a layer, in the order in which QGIS lists them."""
    if isinstance(content, VectorLayer):
        texts = [entry.label for entry in content.style.classes]
        return texts[::-1] if content.style.method == "ranges" else texts
    if content.classes:
        ordered = sorted(content.classes, key=lambda entry: -entry.value)
        return [class_name(entry) for entry in ordered]
    if content.breaks:
        return class_labels(content.breaks, content.bands[0].unit)
    return []


def _legend_rank(layer: ShownLayer) -> int:
    content = layer.content
    if isinstance(content, RasterLayer):
        return 0
    if not content.style.classes:
        return 2
    return 0 if content.style.symbol.kind == "fill" else 1


def _has_one_sign(layer: ShownLayer) -> bool:
    return _legend_rank(layer) == 2


class _LegendEntry(NamedTuple):
    """A layer of the legend: its lines and those of its classes, already broken to the width."""

    layer: ShownLayer
    title: list[str]
    classes: list[list[str]]


def _legend_entries(layers: Sequence[ShownLayer], width: float, m: _Measures) -> list[_LegendEntry]:
    """Layers with classes first, areas and cells before lines; then those of one sign."""
    beside = width - m.symbol[0] - 3.0
    out = []
    for layer in sorted(layers, key=_legend_rank):
        if _is_relief(layer):
            continue
        classes = [wrapped(text, beside, m.text) for text in _entry_texts(layer.content)]
        # A layer of one sign has its name beside it.
        title = wrapped(
            layer.content.title, width if classes else beside, m.text, bold=bool(classes)
        )
        out.append(_LegendEntry(layer, title, classes))
    return out


_SPACE_BEFORE, _SPACE_BETWEEN = 2.5, 1.2


def _legend_height(entries: Sequence[_LegendEntry], m: _Measures) -> float:
    def row(lines: Sequence[str]) -> float:
        return max(m.symbol[1], _height(len(lines), m.text)) + _SPACE_BETWEEN

    total = 0.0
    if _needs_heading(entries):
        total += _SPACE_BEFORE + _height(1, m.text) + _SPACE_BETWEEN
    for entry in entries:
        if not _has_one_sign(entry.layer):
            total += _SPACE_BETWEEN
        total += _SPACE_BEFORE
        if entry.classes:
            total += _height(len(entry.title), m.text) + sum(row(lines) for lines in entry.classes)
        elif isinstance(entry.layer.content, RasterLayer):
            # A continuous ramp: its name, and the bar with its two ends.
            total += _height(len(entry.title), m.text) + 14.0
        else:
            total += row(entry.title)
    return total


def _needs_heading(entries: Sequence[_LegendEntry]) -> bool:
    """Whether signs of their own follow classes, among which they would seem to belong."""
    return 0 < sum(_has_one_sign(entry.layer) for entry in entries) < len(entries)


def _legend(sheet: _Sheet, box: Box, entries: Sequence[_LegendEntry], m: _Measures) -> None:
    item = sheet.add(
        65642,
        "Legend",
        box,
        {
            "title": "",
            "titleAlignment": "1",
            "map_uuid": sheet.key("Map"),
            "columnCount": "1",
            "splitLayer": "0",
            "equalColumnWidth": "0",
            "columnSpace": "2",
            "boxSpace": "0",
            "lineSpacing": "0.6",
            "symbolWidth": f"{m.symbol[0]:g}",
            "symbolHeight": f"{m.symbol[1]:g}",
            "symbolAlignment": "1",
            "minSymbolSize": "0",
            "maxSymbolSize": "0",
            "wmsLegendWidth": "50",
            "wmsLegendHeight": "25",
            "rasterBorder": "1",
            "rasterBorderColor": rgba("#4d4d4d"),
            "rasterBorderWidth": "0.25",
            "resizeToContents": "1",
            "legendFilterByAtlas": "0",
            "wrapChar": "\n",
            "fontColor": _INK,
        },
    )
    styles = ET.SubElement(item, "styles")
    gap = f"{_SPACE_BETWEEN:g}"
    for name, points, bold, margins in (
        ("title", m.text, True, {"marginBottom": "2"}),
        ("group", m.text, True, {"marginTop": f"{_SPACE_BEFORE:g}", "marginBottom": gap}),
        ("subgroup", m.text, True, {"marginTop": f"{_SPACE_BEFORE:g}", "marginBottom": gap}),
        ("symbol", m.text, False, {"marginTop": f"{_SPACE_BETWEEN:g}"}),
        ("symbolLabel", m.text, False, {"marginTop": "1", "marginLeft": "2"}),
    ):
        style = ET.SubElement(
            styles, "style", {"name": name, "alignment": "1", "indent": "0", **margins}
        )
        ET.SubElement(
            style,
            "styleFont",
            description=_font(points, bold=bold),
            style="Bold" if bold else "Regular",
        )
    tree = ET.SubElement(item, "layer-tree-group")
    ET.SubElement(tree, "customproperties")
    signs = tree
    if _needs_heading(entries):
        signs = ET.Element(
            "layer-tree-group", name="Also shown", checked="Qt::Checked", expanded="1"
        )
        ET.SubElement(signs, "customproperties")
    for entry in entries:
        layer = entry.layer
        leaf = ET.SubElement(
            signs if _has_one_sign(layer) else tree,
            "layer-tree-layer",
            {
                "id": layer.key,
                "name": layer.content.title,
                "source": layer.datasource,
                "providerKey": layer.provider,
                "checked": "Qt::Checked",
                "expanded": "1",
                "legend_exp": "",
                "legend_split_behavior": "0",
                "patch_size": "0,0",
            },
        )
        _legend_texts(leaf, entry)
    if signs is not tree:
        tree.append(signs)
    ET.SubElement(tree, "custom-order", enabled="0")


def _legend_texts(leaf: ET.Element, entry: _LegendEntry) -> None:
    """The texts of a layer in the legend, broken into lines where they are long."""
    first = 0
    properties = {"legend/title-label": "\n".join(entry.title)}
    if isinstance(entry.layer.content, RasterLayer):
        # QGIS lists the name of the band before the classes.
        first = 1
        properties["legend/node-order"] = ",".join(
            str(first + place) for place in range(max(len(entry.classes), 1))
        )
    for place, lines in enumerate(entry.classes):
        properties[f"legend/label-{first + place}"] = "\n".join(lines)
    options = ET.SubElement(ET.SubElement(leaf, "customproperties"), "Option", type="Map")
    for name, value in properties.items():
        ET.SubElement(options, "Option", name=name, type="QString", value=value)


# --- the sheet -------------------------------------------------------------------------------


def layout_element(
    layout: PrintLayout, layers: Mapping[str, ShownLayer], crs_name: str
) -> ET.Element:
    """The ``Layout`` element of a project.

    Parameters
    ----------
    layout : PrintLayout
    layers : mapping of key to ShownLayer
        All layers of the project.
    crs_name : str
        Of the coordinates, as the reader knows it; empty for local ones.

    Returns
    -------
    Element

    Raises
    ------
    ValueError
        If the layout shows a layer that the project does not have, or none.
    """
    unknown = [key for key in layout.layers if key not in layers]
    if unknown or not layout.layers:
        raise ValueError(f"layout {layout.name}: no such layers in the project: {unknown}")
    shown = [layers[key] for key in layout.layers]
    width, height = PAGES[layout.page]
    base = _MEASURES[layout.page]
    tall = height - 2.0 * base.margin - _GUTTER
    column = Box(width - base.margin - base.column, base.margin, base.column, tall)
    left = base.margin + _GUTTER
    frame = Box(left, base.margin, column.x - base.gap - left, tall)
    scale = round_scale(layout.extent, frame.width, frame.height)
    sheet = _Sheet(layout.name)
    _map_item(sheet, frame, _centred(layout.extent, frame, scale), shown, base.small)
    facts = (*layout.facts, ("Coordinates", crs_name or "local, in m"))
    for factor in (1.0, 0.92, 0.85, 0.78, 0.7, 0.6, 0.5):
        m = _scaled(base, factor)
        blocks = _Blocks(layout, facts, shown, m, local=not crs_name, scale=scale)
        if blocks.total <= column.height:
            break
    blocks.place(sheet, column)
    return _document(layout.name, sheet, width, height)


def _centred(extent: Extent, frame: Box, scale: float) -> Extent:
    """What the frame shows at a scale (m), with the extent in its middle."""
    half_w, half_h = frame.width * scale / 2000.0, frame.height * scale / 2000.0
    x, y = (extent[0] + extent[2]) / 2.0, (extent[1] + extent[3]) / 2.0
    return x - half_w, y - half_h, x + half_w, y + half_h


def _scaled(m: _Measures, factor: float) -> _Measures:
    """Smaller type, and with it smaller signs; the title only as far as needs be."""
    return m._replace(
        title=m.title * max(factor, 0.7),
        subtitle=m.subtitle * max(factor, 0.7),
        text=m.text * factor,
        small=m.small * factor,
        symbol=(m.symbol[0] * factor, m.symbol[1] * factor),
    )


class _Blocks:
    """The blocks of the column: measured first, then placed from the top and from the bottom."""

    def __init__(
        self,
        layout: PrintLayout,
        facts: Sequence[tuple[str, str]],
        shown: Sequence[ShownLayer],
        m: _Measures,
        *,
        local: bool,
        scale: float,
    ) -> None:
        width = m.column
        self.m, self.local, self.scale = m, local, scale
        self.title = balanced(layout.title, width, m.title, bold=True)
        self.subtitle = balanced(layout.subtitle, width, m.subtitle) if layout.subtitle else []
        self.legend = _legend_entries(shown, width, m)
        longest = max((text_width(name, m.small, bold=True) for name, _ in facts), default=0.0)
        self.name_width = min(longest + 2.5, 0.4 * width)
        self.facts = [
            (
                wrapped(name, self.name_width - 2.0, m.small, bold=True),
                wrapped(text, width - self.name_width, m.small),
            )
            for name, text in facts
        ]
        self.notes = [wrapped(note, width - 6.0, m.small) for note in layout.notes]
        self.head_height = (
            _height(len(self.title), m.title) + _height(len(self.subtitle), m.subtitle) + 2.0
        )
        self.legend_height = _legend_height(self.legend, m) + 1.0
        self.scale_height = 17.0
        self.row_heights = [
            _height(max(len(name), len(text)), m.small) + 1.0 for name, text in self.facts
        ]
        self.notes_height = (
            sum(_height(len(note), m.small) + 1.0 for note in self.notes) + 4.0
            if self.notes
            else 0.0
        )

    @property
    def total(self) -> float:
        """Height of all blocks with the least space between them (mm)."""
        return (
            self.head_height
            + self.legend_height
            + self.scale_height
            + sum(self.row_heights)
            + self.notes_height
            + 5.0 * self.m.gap
        )

    def place(self, sheet: _Sheet, column: Box) -> None:
        """Add the items of all blocks."""
        m = self.m
        x, width = column.x, column.width
        y = column.y
        title_height = _height(len(self.title), m.title)
        sheet.label(
            "Title", Box(x, y, width, title_height + 1.0), "\n".join(self.title), m.title, bold=True
        )
        y += title_height + 1.0
        if self.subtitle:
            tall = _height(len(self.subtitle), m.subtitle)
            sheet.label(
                "Subtitle",
                Box(x, y, width, tall + 1.0),
                "\n".join(self.subtitle),
                m.subtitle,
                colour=_GREY,
            )
            y += tall + 1.0
        y += m.gap / 2.0
        sheet.rectangle("Rule below the title", Box(x, y, width, 0.4), _INK)
        y += m.gap / 2.0
        _legend(sheet, Box(x, y, width, self.legend_height), self.legend, m)

        bottom = column.y + column.height
        if self.notes:
            bottom -= self.notes_height
            self._place_notes(sheet, Box(x, bottom, width, self.notes_height))
            bottom -= m.gap / 2.0
        bottom -= sum(self.row_heights)
        self._place_facts(sheet, x, bottom, width)
        bottom -= m.gap / 2.0
        sheet.rectangle("Rule above the sources", Box(x, bottom, width, 0.2), _INK)
        bottom -= m.gap / 2.0 + self.scale_height
        self._place_scale(sheet, Box(x, bottom, width, self.scale_height))

    def _place_notes(self, sheet: _Sheet, box: Box) -> None:
        sheet.rectangle("Box of the notes", box, _PALE)
        y = box.y + 2.0
        for place, lines in enumerate(self.notes, start=1):
            tall = _height(len(lines), self.m.small)
            sheet.label(
                f"Note {place}",
                Box(box.x + 3.0, y, box.width - 6.0, tall + 0.8),
                "\n".join(lines),
                self.m.small,
            )
            y += tall + 1.0

    def _place_facts(self, sheet: _Sheet, x: float, y: float, width: float) -> None:
        for (name, text), tall in zip(self.facts, self.row_heights, strict=True):
            heading = " ".join(name)
            sheet.label(
                f"{heading}, name",
                Box(x, y, self.name_width, tall),
                "\n".join(name),
                self.m.small,
                bold=True,
            )
            sheet.label(
                heading,
                Box(x + self.name_width, y, width - self.name_width, tall),
                "\n".join(text),
                self.m.small,
            )
            y += tall

    def _place_scale(self, sheet: _Sheet, box: Box) -> None:
        arrow = 10.0
        bar_width = box.width - arrow - 16.0
        step = round_length(bar_width * self.scale / 1000.0 / 4.0)
        # QGIS fills in the scale, so that it stays true when the map is moved.
        number = (
            "regexp_replace(format_number(map_get(item_variables('Map'), 'map_scale'), 0, 'en'), "
            "',', '\u00a0')"
        )
        if self.local:
            number = "'" + f"{self.scale:,.0f}".replace(",", "\u00a0") + "'"
        sheet.label(
            "Scale",
            Box(box.x, box.y, box.width - arrow, 5.5),
            f"Scale 1:[% {number} %]",
            self.m.text,
            bold=True,
        )
        _scale_bar(
            sheet,
            Box(box.x, box.y + 6.5, bar_width + 8.0, 9.0),
            step,
            self.m.small,
            local=self.local,
        )
        _north_arrow(sheet, Box(box.x + box.width - arrow, box.y, arrow, 14.0))


def _document(name: str, sheet: _Sheet, width: float, height: float) -> ET.Element:
    layout = ET.Element("Layout", name=name, units="mm", printResolution="300", worldFileMap="")
    pages = ET.SubElement(layout, "PageCollection")
    white = Symbol("fill", "#ffffff")
    pages.append(symbol_element(white, ""))
    page = _item(
        65638, "", Box(0.0, 0.0, width, height), sheet.key("page"), 0, {"background": "true"}
    )
    page.append(symbol_element(white, ""))
    pages.append(page)
    ET.SubElement(pages, "GuideCollection", visible="1")
    # QGIS draws what comes later on top, and lists it first.
    for item in reversed(sheet.items):
        layout.append(item)
    options = ET.SubElement(ET.SubElement(layout, "customproperties"), "Option", type="Map")
    # Text stays text in a PDF: it can be searched and copied.
    ET.SubElement(options, "Option", name="pdfTextFormat", type="int", value="1")
    ET.SubElement(layout, "Atlas", enabled="0")
    return layout
