"""The XML of the style of a raster layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from sassgis.io.qgis.markup import number, options, rgba, text_element
from sassgis.model.ramps import ramp_colours
from sassgis.model.results import RasterLayer
from sassgis.model.styles import (
    HILLSHADE,
    RASTER_OPACITY,
    class_colours,
    class_labels,
    class_limits,
    class_name,
    class_tint,
    with_unit,
    zero_is_nothing,
)

_RAMP_STEPS = 11


def raster_style_elements(layer: RasterLayer) -> list[ET.Element]:
    """All style elements of a raster layer.

    Parameters
    ----------
    layer : RasterLayer
        Its first band is shown: in its ``classes``, or in those of ``breaks``, or as a continuous
        ramp over the data's range, or as shaded relief if ``ramp`` is :data:`HILLSHADE`. A value
        that is none of the ``classes`` stays clear.

    Returns
    -------
    list of Element
        Children of the ``qgis`` element of a ``.qml`` and of the ``maplayer`` of a project.
    """
    pipe = ET.Element("pipe")
    relief = layer.ramp == HILLSHADE
    if relief:
        # Heights are smoothed before they are shaded: QGIS would shade the steps between cells,
        # and smoothing its shading would leave seams between the tiles that it draws.
        ET.SubElement(
            ET.SubElement(pipe, "provider"),
            "resampling",
            enabled="true",
            maxOversampling="2",
            zoomedInResamplingMethod="cubic",
            zoomedOutResamplingMethod="nearestNeighbour",
        )
    if relief:
        pipe.append(_hillshade_renderer())
    else:
        pipe.append(_palette_renderer(layer) if layer.classes else _colour_renderer(layer))
    # Pale relief: the colours of the maps over it must stay those of their legend.
    ET.SubElement(
        pipe,
        "brightnesscontrast",
        brightness="75" if relief else "0",
        contrast="-35" if relief else "0",
        gamma="1",
    )
    ET.SubElement(pipe, "huesaturation", saturation="0", grayscaleMode="0", colorizeOn="0")
    # Cells are drawn as cells: no value on the map that is not in the file.
    ET.SubElement(pipe, "rasterresampler", maxOversampling="2")
    ET.SubElement(pipe, "resamplingStage").text = "provider" if relief else "resamplingFilter"
    return [pipe, text_element("blendMode", "0")]


def _hillshade_renderer() -> ET.Element:
    renderer = ET.Element(
        "rasterrenderer",
        type="hillshade",
        band="1",
        alphaBand="-1",
        opacity="1",
        nodataColor="",
        azimuth="315",
        angle="45",
        zfactor="1",
        multidirection="1",
    )
    ET.SubElement(renderer, "rasterTransparency")
    return renderer


def _palette_renderer(layer: RasterLayer) -> ET.Element:
    renderer = ET.Element(
        "rasterrenderer",
        type="paletted",
        band="1",
        alphaBand="-1",
        opacity=f"{RASTER_OPACITY:g}",
        nodataColor="",
    )
    ET.SubElement(renderer, "rasterTransparency")
    palette = ET.SubElement(renderer, "colorPalette")
    # The most severe is listed first, as legends of hazard maps do.
    for entry in sorted(layer.classes, key=lambda entry: -entry.value):
        ET.SubElement(
            palette,
            "paletteEntry",
            value=str(entry.value),
            color=class_tint(entry),
            alpha="255",
            label=class_name(entry),
        )
    return renderer


def _colour_renderer(layer: RasterLayer) -> ET.Element:
    band = layer.bands[0]
    items = _class_items(layer) if layer.breaks else _ramp_items(layer)
    finite = [value for value, _, _ in items if math.isfinite(value)]
    low, high = _data_range(band.values, skip_zero=zero_is_nothing(band.unit))
    low, high = min([low, *finite]), max([high, *finite])
    renderer = ET.Element(
        "rasterrenderer",
        type="singlebandpseudocolor",
        band="1",
        alphaBand="-1",
        opacity=f"{RASTER_OPACITY:g}",
        nodataColor="",
        classificationMin=number(low),
        classificationMax=number(high),
    )
    transparency = ET.SubElement(renderer, "rasterTransparency")
    if zero_is_nothing(band.unit):
        pixels = ET.SubElement(transparency, "singleValuePixelList")
        ET.SubElement(pixels, "pixelListEntry", min="0", max="0", percentTransparent="100")
    origin = ET.SubElement(renderer, "minMaxOrigin")
    for tag, text in (("limits", "None"), ("extent", "WholeRaster"), ("statAccuracy", "Exact")):
        ET.SubElement(origin, tag).text = text
    shader = ET.SubElement(
        ET.SubElement(renderer, "rastershader"),
        "colorrampshader",
        colorRampType="DISCRETE" if layer.breaks else "INTERPOLATED",
        classificationMode="1",
        clip="0",
        labelPrecision="4",
        minimumValue=number(low),
        maximumValue=number(high),
    )
    shader.append(_source_ramp([colour for _, colour, _ in items]))
    for value, colour, label in items:
        ET.SubElement(shader, "item", value=number(value), color=colour, alpha="255", label=label)
    if not layer.breaks:
        ET.SubElement(
            shader,
            "rampLegendSettings",
            useContinuousLegend="1",
            direction="0",
            orientation="2",
            prefix="",
            suffix=with_unit("", band.unit),
            minimumLabel="",
            maximumLabel="",
        )
    return renderer


def _class_items(layer: RasterLayer) -> list[tuple[float, str, str]]:
    """Value, colour and label per class; QGIS colours what is <= the value of the item."""
    limits = class_limits(layer.breaks)
    return [
        (_just_below(upper), colour, label)
        for (_, upper), colour, label in zip(
            limits,
            class_colours(layer.breaks, layer.ramp),
            class_labels(layer.breaks, layer.bands[0].unit),
            strict=True,
        )
    ]


def _just_below(limit: float) -> float:
    # A limit belongs to the class above it; the cells are float32, so the next smaller float32
    # is the largest value that a cell below the limit can have.
    return (
        float(np.nextafter(np.float32(limit), np.float32(-np.inf))) if limit < math.inf else limit
    )


def _ramp_items(layer: RasterLayer) -> list[tuple[float, str, str]]:
    band = layer.bands[0]
    low, high = _data_range(band.values, skip_zero=zero_is_nothing(band.unit))
    return [
        (float(value), colour, with_unit(f"{value:.3g}", band.unit))
        for value, colour in zip(
            np.linspace(low, high, _RAMP_STEPS), ramp_colours(layer.ramp, _RAMP_STEPS), strict=True
        )
    ]


def _data_range(values: NDArray[np.float32], *, skip_zero: bool) -> tuple[float, float]:
    """Least and greatest value; widened to a proper interval where there is none."""
    shown = values[np.isfinite(values)]
    if skip_zero:
        shown = shown[shown != 0]
    low, high = (float(shown.min()), float(shown.max())) if shown.size else (0.0, 1.0)
    return (low, high) if low < high else (low, low + max(1.0, abs(low)))


def _source_ramp(colours: Sequence[str]) -> ET.Element:
    ramp = ET.Element("colorramp", type="gradient", name="[source]")
    places = np.linspace(0.0, 1.0, len(colours))
    stops = ":".join(
        f"{place:.6g};{rgba(colour)}"
        for place, colour in zip(places[1:-1], colours[1:-1], strict=True)
    )
    options(
        ramp,
        {
            "color1": rgba(colours[0]),
            "color2": rgba(colours[-1]),
            "discrete": "0",
            "rampType": "gradient",
            "stops": stops,
        },
    )
    return ramp
