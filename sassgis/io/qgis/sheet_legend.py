"""The legend of a map sheet: its layers, their classes, and the room that they need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree as ET

from sassgis.io.qgis.entries import LayerEntry
from sassgis.io.qgis.markup import filled, without_expressions
from sassgis.io.qgis.text_size import text_height, wrapped
from sassgis.io.vector_layer import VectorLayer
from sassgis.model.languages import translated
from sassgis.model.results import RasterLayer
from sassgis.model.styles import HILLSHADE, PICTURE, class_labels, class_name

#: Space before a layer and between the rows (mm), as in the templates of the sheets.
_SPACE_BEFORE, _SPACE_BETWEEN = 2.5, 1.2
#: Height of a continuous ramp with the values at its ends (mm).
_RAMP_HEIGHT = 14.0


class _LegendEntry(NamedTuple):
    """A layer of the legend: its lines and those of its classes, already broken to the width."""

    layer: LayerEntry
    title: list[str]
    classes: list[list[str]]
    one_sign: bool  # without classes, its name beside the sign

    @property
    def texts(self) -> dict[str, str]:
        """What QGIS shows of it in the legend, by the name of the property."""
        raster = isinstance(self.layer.content, RasterLayer)
        texts = {"legend/title-label": "\n".join(self.title)}
        if raster:
            # QGIS lists the name of the band before the classes.
            places = range(1, 1 + max(len(self.classes), 1))
            texts["legend/node-order"] = ",".join(map(str, places))
        for place, lines in enumerate(self.classes, start=int(raster)):
            texts[f"legend/label-{place}"] = "\n".join(lines)
        return {key: without_expressions(text) for key, text in texts.items()}


def _class_texts(content: RasterLayer | VectorLayer) -> list[str]:
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


def _rank(layer: LayerEntry) -> int:
    """Layers with classes come first, areas and cells before lines; then those of one sign."""
    content = layer.content
    if isinstance(content, RasterLayer):
        return 0
    if not content.style.classes:
        return 2
    return 0 if content.style.symbol.kind == "fill" else 1


def _legend_entries(
    layers: Sequence[LayerEntry], width: float, symbol_width: float, points: float
) -> list[_LegendEntry]:
    beside = width - symbol_width - 3.0
    out = []
    for layer in sorted(layers, key=_rank):
        if isinstance(layer.content, RasterLayer) and layer.content.ramp in (HILLSHADE, PICTURE):
            continue
        classes = [wrapped(text, beside, points) for text in _class_texts(layer.content)]
        one_sign = _rank(layer) == 2
        room = beside if one_sign else width
        title = wrapped(layer.content.title, room, points, bold=not one_sign)
        out.append(_LegendEntry(layer, title, classes, one_sign))
    return out


def _legend_height(
    entries: Sequence[_LegendEntry], points: float, symbol_height: float, *, heading: bool
) -> float:
    def row(lines: Sequence[str]) -> float:
        return max(symbol_height, text_height(len(lines), points)) + _SPACE_BETWEEN

    total = _SPACE_BEFORE + text_height(1, points) + _SPACE_BETWEEN if heading else 0.0
    for entry in entries:
        total += _SPACE_BEFORE
        if entry.one_sign:
            total += row(entry.title)
            continue
        total += _SPACE_BETWEEN + text_height(len(entry.title), points)
        total += sum(row(lines) for lines in entry.classes) if entry.classes else _RAMP_HEIGHT
    return total


def fill_legend(
    item: ET.Element, shown: Sequence[LayerEntry], width: float, points: float
) -> float:
    """Put layers, the top first, into the legend of a template; returns the height it needs (mm).

    The legend is ``width`` wide (mm); ``points`` is the type size of the classes.
    """
    symbol_width, symbol_height = (
        float(item.get(key, "")) for key in ("symbolWidth", "symbolHeight")
    )
    entries = _legend_entries(shown, width, symbol_width, points)
    single = [entry for entry in entries if entry.one_sign]
    classed = [entry for entry in entries if not entry.one_sign]
    tree = item.find("layer-tree-group")
    assert tree is not None
    tree.clear()
    # Signs of their own would seem to belong to the classes before them.
    heading = translated("Also shown") if single and classed else ""
    tree.extend(filled("qgis_legend.xml.j2", classed=classed, single=single, heading=heading))
    return _legend_height(entries, points, symbol_height, heading=bool(heading)) + 1.0
