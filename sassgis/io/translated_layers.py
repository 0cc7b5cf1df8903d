"""Layers in the language in which the program writes."""

from __future__ import annotations

from dataclasses import replace

from sassgis.io.vector_layer import VectorLayer
from sassgis.model.languages import current_language, with_translated
from sassgis.model.results import RasterLayer


def translated_raster(layer: RasterLayer) -> RasterLayer:
    """A map with its title, note, classes and bands."""
    if current_language() == "en":
        return layer
    return replace(
        with_translated(layer, "title", "note"),
        bands=tuple(with_translated(band, "description", "unit") for band in layer.bands),
        classes=tuple(with_translated(entry, "label") for entry in layer.classes),
    )


def translated_vector(layer: VectorLayer) -> VectorLayer:
    """A layer with its title, description, legend and columns.

    The values of its columns stay: they are codes.
    """
    if current_language() == "en":
        return layer
    classes = tuple(with_translated(entry, "label") for entry in layer.style.classes)
    fields = {
        name: with_translated(info, "alias", "unit", "description")
        for name, info in layer.fields.items()
    }
    style = replace(layer.style, classes=classes)
    return replace(with_translated(layer, "title", "description"), style=style, fields=fields)
