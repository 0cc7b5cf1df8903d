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
from sassgis.io.interlis.mapping import ClassPlan, Step, TransferPlan
from sassgis.io.interlis.validation import XTF_NAMESPACE


@dataclass(frozen=True, slots=True)
class XtfObject:
    """An object: its identifier, its texts by attribute, its zones."""

    tid: str
    texts: dict[str, str]
    polygons: list[Any]


def document(
    plan: TransferPlan, objects: Mapping[str, Sequence[XtfObject]], namespace: uuid.UUID
) -> Iterator[str]:
    """The text of a transfer file in pieces, as it may be large.

    Parameters
    ----------
    plan : TransferPlan
    objects : mapping of str to sequence of XtfObject
        By layer.
    namespace : UUID
        From which the identifiers of the baskets are made.
    """
    yield f'<?xml version="1.0" encoding="UTF-8"?>\n<TRANSFER xmlns="{XTF_NAMESPACE}">\n'
    yield _text(_header(plan))
    yield "<DATASECTION>\n"
    numbers = count(1)
    for topic in dict.fromkeys(plan.topics.values()):
        inside = [name for name in objects if plan.topics[name] == topic]
        tids = [item.tid for name in inside for item in objects[name]]
        yield f'<{topic} BID="{uuid.uuid5(namespace, "|".join([topic, *tids]))}">\n'
        for name in inside:
            for item in objects[name]:
                yield _text(_object_element(plan.classes[name], item, numbers))
        yield f"</{topic}>\n"
    yield "</DATASECTION>\n</TRANSFER>\n"


def _text(element: ET.Element) -> str:
    return ET.tostring(element, "unicode")


def _element(tag: str, *, lines: bool = False, **attributes: str) -> ET.Element:
    """An element that ends its line; with ``lines`` its content begins on the next."""
    element = ET.Element(tag, attributes)
    element.text, element.tail = ("\n" if lines else None), "\n"
    return element


def _header(plan: TransferPlan) -> ET.Element:
    header = _element("HEADERSECTION", lines=True, SENDER=f"sassgis {__version__}", VERSION="2.3")
    models = _element("MODELS", lines=True)
    for model in (plan.model, *plan.others):
        models.append(_element("MODEL", NAME=model.name, VERSION=model.version, URI=model.uri))
    header.append(models)
    if not plan.from_model:
        comment = _element("COMMENT")
        comment.text = plan.notes[0]
        header.append(comment)
    return header


def _object_element(kind: ClassPlan, item: XtfObject, numbers: Iterator[int]) -> ET.Element:
    tid = item.tid if kind.identifier == "uuid" else str(next(numbers))
    element = _element(kind.tag, lines=True, TID=tid)
    for slot in kind.slots:
        attribute = _element(slot.name)
        if slot.geometry:
            _add_surfaces(attribute, slot.steps, item.polygons, slot.decimals)
        elif slot.name in item.texts:
            _add_text(attribute, slot.steps, item.texts[slot.name])
        else:
            continue
        element.append(attribute)
    return element


def _add_text(parent: ET.Element, steps: tuple[Step, ...], text: str) -> None:
    """Put a text into an attribute, inside the structures that the model wants around it."""
    for step in steps:
        structure = ET.SubElement(parent, step.structure)
        if step.language is not None:
            name, code = step.language
            ET.SubElement(structure, name).text = code
        parent = ET.SubElement(structure, step.attribute)
    parent.text = text


def _add_surfaces(
    parent: ET.Element, steps: tuple[Step, ...], polygons: Sequence[Any], decimals: int
) -> None:
    """Put zones into an attribute, inside the structures that the model wants around them."""
    if not steps:
        parent.append(_surface(polygons[0], decimals))
        return
    step = steps[0]
    for group in [[polygon] for polygon in polygons] if step.many else [list(polygons)]:
        structure = ET.SubElement(parent, step.structure)
        attribute = ET.SubElement(structure, step.attribute)
        _add_surfaces(attribute, steps[1:], group, decimals)


def _surface(polygon: Any, decimals: int) -> ET.Element:
    """A surface: its outline and then its holes, each a closed line of straight pieces."""
    surface = _element("SURFACE", lines=True)
    surface.tail = None
    for ring in touching_at_corners(polygon):
        boundary = _element("BOUNDARY")
        line = ET.SubElement(boundary, "POLYLINE")
        line.text = "\n"
        for x, y in ring:
            corner = _element("COORD")
            ET.SubElement(corner, "C1").text = f"{x:.{decimals}f}"
            ET.SubElement(corner, "C2").text = f"{y:.{decimals}f}"
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
