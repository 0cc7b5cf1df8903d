"""The XML of an INTERLIS 2.3 transfer file (XTF).

Source: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3), chapter 3.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import shapely

from sassgis import __version__
from sassgis.io.interlis.validation import XTF_NAMESPACE
from sassgis.io.write.layers.federal_model import (
    DECIMALS,
    FEDERAL_CLASSES,
    MODEL_NAME,
    MODEL_URI,
    MODEL_VERSION,
    TOPIC,
    FederalClass,
)


@dataclass(frozen=True, slots=True)
class XtfObject:
    """An object: its identifier, its texts by attribute, its zone."""

    tid: str
    texts: Mapping[str, str]
    polygon: Any


def document(objects: Mapping[str, Sequence[XtfObject]], namespace: uuid.UUID) -> Iterator[str]:
    """The text of a transfer file in pieces, as it may be large.

    Parameters
    ----------
    objects : mapping of str to sequence of XtfObject
        By class.
    namespace : UUID
        From which the identifier of the basket is made.
    """
    yield f'<?xml version="1.0" encoding="UTF-8"?>\n<TRANSFER xmlns="{XTF_NAMESPACE}">\n'
    yield _text(_header())
    yield "<DATASECTION>\n"
    tids = [item.tid for inside in objects.values() for item in inside]
    yield f'<{TOPIC} BID="_{uuid.uuid5(namespace, "|".join([TOPIC, *tids]))}">\n'
    for name, inside in objects.items():
        for item in inside:
            yield _text(_object_element(FEDERAL_CLASSES[name], item))
    yield f"</{TOPIC}>\n</DATASECTION>\n</TRANSFER>\n"


def _text(element: ET.Element) -> str:
    return ET.tostring(element, "unicode")


def _element(tag: str, *, lines: bool = False, **attributes: str) -> ET.Element:
    """An element that ends its line; with ``lines`` its content begins on the next."""
    element = ET.Element(tag, attributes)
    element.text, element.tail = ("\n" if lines else None), "\n"
    return element


def _header() -> ET.Element:
    header = _element("HEADERSECTION", lines=True, SENDER=f"sassgis {__version__}", VERSION="2.3")
    models = _element("MODELS", lines=True)
    models.append(_element("MODEL", NAME=MODEL_NAME, VERSION=MODEL_VERSION, URI=MODEL_URI))
    header.append(models)
    return header


def _object_element(kind: FederalClass, item: XtfObject) -> ET.Element:
    """An object; its surface comes first, as in the model."""
    element = _element(f"{TOPIC}.{kind.name}", lines=True, TID=item.tid)
    zone = _element(kind.geometry)
    zone.append(_surface(item.polygon))
    element.append(zone)
    for attribute in kind.attributes:
        if attribute.name in item.texts:
            child = _element(attribute.name)
            child.text = item.texts[attribute.name]
            element.append(child)
    return element


def _surface(polygon: Any) -> ET.Element:
    """A surface: its outline and then its holes, each a closed line of straight pieces."""
    surface = _element("SURFACE", lines=True)
    surface.tail = None
    for ring in touching_at_corners(polygon):
        boundary = _element("BOUNDARY")
        line = ET.SubElement(boundary, "POLYLINE")
        line.text = "\n"
        for x, y in ring:
            corner = _element("COORD")
            ET.SubElement(corner, "C1").text = f"{x:.{DECIMALS}f}"
            ET.SubElement(corner, "C2").text = f"{y:.{DECIMALS}f}"
            line.append(corner)
        surface.append(boundary)
    return surface


def touching_at_corners(polygon: Any) -> list[list[tuple[float, float]]]:
    """Corners of the outline and of each hole; where they touch, both have a corner.

    INTERLIS takes a corner on the edge of another ring for an intersection.

    Parameters
    ----------
    polygon : Polygon
        Valid.

    Returns
    -------
    list of list of (x, y)
        Closed rings, the outline first.
    """
    rings = [list(ring.coords) for ring in (polygon.exterior, *polygon.interiors)]
    if len(rings) == 1:
        return rings
    edges = np.array([edge for ring in rings for edge in pairwise(ring)])
    corners = np.unique(np.concatenate([np.array(ring) for ring in rings]), axis=0)
    tree = shapely.STRtree(shapely.linestrings(edges))  # type: ignore[arg-type]
    which, edge = tree.query(shapely.points(corners), predicate="intersects")
    inner = (corners[which] != edges[edge, 0]).any(axis=1)
    inner &= (corners[which] != edges[edge, 1]).any(axis=1)
    added: dict[int, list[tuple[float, float]]] = {}
    for corner, at in zip(corners[which[inner]].tolist(), edge[inner].tolist(), strict=True):
        added.setdefault(at, []).append((corner[0], corner[1]))
    numbers = count()
    whole = []
    for ring in rings:
        corners_of = [ring[0]]
        for start, end in pairwise(ring):
            between = [
                (math.dist(start, corner), corner) for corner in added.get(next(numbers), [])
            ]
            corners_of += [*(corner for _, corner in sorted(between)), end]
        whole.append(corners_of)
    return whole
