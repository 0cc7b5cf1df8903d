"""Texts and legend of a map sheet: their lines, and the room that they need."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from xml.etree import ElementTree as ET

from sassgis.outputs.qgis.entries import LayerEntry
from sassgis.outputs.qgis.markup import filled, without_expressions
from sassgis.settings.languages import translated
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
