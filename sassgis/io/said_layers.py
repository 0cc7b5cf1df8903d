"""Layers in the language in which the program writes."""

from __future__ import annotations

from dataclasses import replace

from sassgis.io.vector_layer import VectorLayer
from sassgis.model.languages import said, spoken
from sassgis.model.results import RasterLayer


def said_raster(layer: RasterLayer) -> RasterLayer:
    """A map with title, note, classes and bands in the language of now."""
    if spoken() == "en":
        return layer
    return replace(
        layer,
        title=said(layer.title),
        note=said(layer.note),
        bands=tuple(
            replace(b, description=said(b.description), unit=said(b.unit)) for b in layer.bands
        ),
        classes=tuple(replace(c, label=said(c.label)) for c in layer.classes),
    )


def said_vector(layer: VectorLayer) -> VectorLayer:
    """A layer with title, description, legend and columns in the language of now.

    The values of its columns stay: they are codes.
    """
    if spoken() == "en":
        return layer
    style = replace(
        layer.style,
        classes=tuple(replace(c, label=said(c.label)) for c in layer.style.classes),
    )
    fields = {
        name: replace(
            info,
            alias=said(info.alias),
            unit=said(info.unit),
            description=said(info.description),
        )
        for name, info in layer.fields.items()
    }
    return replace(
        layer,
        title=said(layer.title),
        description=said(layer.description),
        style=style,
        fields=fields,
    )
