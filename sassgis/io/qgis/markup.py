"""Words of QGIS's XML that all its documents share. The format is that of QGIS 3.22."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

from sassgis.model.ramps import rgb

QGIS_VERSION = "3.22.0"


def rgba(colour: str, opacity: float = 1.0) -> str:
    """A colour ``#rrggbb`` as QGIS writes it: red, green, blue and opacity, 0 to 255."""
    return ",".join(map(str, (*rgb(colour), round(255 * opacity))))


def number(value: float) -> str:
    """A number with all its digits."""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return repr(float(value))


def without_expressions(text: str) -> str:
    """A text in which QGIS finds nothing to compute: ``[% ... %]`` would be an expression."""
    return text.replace("[%", "[\N{WORD JOINER}%")


def options(parent: ET.Element, items: Mapping[str, str]) -> None:
    """Add a map of names to texts."""
    entries = ET.SubElement(parent, "Option", type="Map")
    for name, value in items.items():
        ET.SubElement(entries, "Option", name=name, type="QString", value=value)


def text_element(tag: str, text: str) -> ET.Element:
    """An element that holds nothing but text."""
    element = ET.Element(tag)
    element.text = text
    return element


def qml(elements: Sequence[ET.Element], *, labels: bool = False) -> str:
    """The text of a ``.qml`` file.

    Parameters
    ----------
    elements : sequence of Element
        From :func:`sassgis.io.qgis.raster_style.raster_style_elements` or
        :func:`sassgis.io.qgis.vector_style.vector_style_elements`.
    labels : bool
        Whether the layer writes labels on the map.

    Returns
    -------
    str
    """
    root = ET.Element(
        "qgis",
        version=QGIS_VERSION,
        styleCategories="AllStyleCategories",
        labelsEnabled="1" if labels else "0",
        hasScaleBasedVisibilityFlag="0",
    )
    root.extend(elements)
    return document(root)


def document(root: ET.Element) -> str:
    """A QGIS document as text: the element, indented, after QGIS's document type."""
    ET.indent(root, " ")
    text = ET.tostring(root, "unicode")
    return f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{text}\n"
