"""The text of an INTERLIS 2.3 transfer file (XTF).

Source: KOGIS, *INTERLIS 2 – Reference Manual*, edition of 2006 (INTERLIS 2.3), chapter 3.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterator, Mapping, Sequence
from itertools import count, pairwise
from typing import Any, NamedTuple
from xml.sax.saxutils import escape

import jinja2
import numpy as np
import shapely

from sassgis import __version__
from sassgis.io.interlis.validation import XTF_NAMESPACE
from sassgis.io.write.layers import federal_model


class XtfObject(NamedTuple):
    """An object: its identifier, its texts by attribute, its zone."""

    tid: str
    texts: Mapping[str, str]
    polygon: Any


def document(objects: Mapping[str, Sequence[XtfObject]], namespace: uuid.UUID) -> Iterator[str]:
    """The text of a transfer file in pieces, as it may be large.

    ``objects`` are those of each class; the identifier of the basket is made from ``namespace``.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("sassgis", "data"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["xml"] = escape
    tids = [item.tid for inside in objects.values() for item in inside]
    return environment.get_template("federal_model.xtf.j2").generate(
        xmlns=XTF_NAMESPACE,
        version=__version__,
        model=federal_model,
        basket=uuid.uuid5(namespace, "|".join([federal_model.TOPIC, *tids])),
        objects=[(federal_model.FEDERAL_CLASSES[name], own) for name, own in objects.items()],
        rings=touching_at_corners,
    )


def touching_at_corners(polygon: Any) -> list[list[tuple[float, float]]]:
    """Closed rings of a valid polygon, the outline first; where they touch, both have a corner.

    INTERLIS takes a corner on the edge of another ring for an intersection.
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
