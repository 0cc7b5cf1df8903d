"""How layers look in QGIS: one description, one XML, used in every place that QGIS reads.

The XML made here goes into the ``.qml`` beside a raster, the ``layer_styles`` table of the
GeoPackage and the project, so that a layer looks the same wherever it is opened from. It is the
format of QGIS 3.22; later versions read it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal
from xml.etree import ElementTree as ET

import matplotlib
import numpy as np
from matplotlib.colors import to_hex, to_rgb
from numpy.typing import NDArray

from sassgis.core.results import RasterLayer

QGIS_VERSION = "3.22.0"
#: A RasterLayer of heights with this name as its ramp is shown as shaded relief.
HILLSHADE = "hillshade"
#: Maps over the shaded relief let a little of it through.
RASTER_OPACITY = 0.85

SymbolKind = Literal["marker", "line", "fill"]
Hatch = Literal["", "diagonal", "horizontal"]

_RAMP_STEPS = 11
_OPEN_END = 1e300


@dataclass(frozen=True, slots=True)
class FieldInfo:
    """What a column means.

    Attributes
    ----------
    alias : str
        Name shown to the reader, without the unit.
    unit : str
        Empty for none.
    description : str
    """

    alias: str
    unit: str = ""
    description: str = ""

    @property
    def label(self) -> str:
        """Alias with its unit, as the attribute table and the form show it."""
        return f"{self.alias} ({self.unit})" if self.unit else self.alias


@dataclass(frozen=True, slots=True)
class Symbol:
    """A drawn sign: a marker, a line or a filled area.

    Attributes
    ----------
    kind : {"marker", "line", "fill"}
    colour : str
        ``#rrggbb`` of the marker, line or filling.
    opacity : float
        Of the filling or line, 0 to 1; outlines are opaque.
    size_mm : float
        Diameter of a marker or width of a line.
    outline : str
        ``#rrggbb``; empty for none. Markers and fills only.
    outline_mm : float
    shape : str
        Of a marker: QGIS's name ("circle", "square", "triangle", "diamond", "star", ...).
    dash : {"solid", "dash", "dot"}
        Of a line.
    hatch : {"", "diagonal", "horizontal"}
        Hatch lines in place of the solid filling.
    """

    kind: SymbolKind
    colour: str
    opacity: float = 1.0
    size_mm: float = 2.0
    outline: str = ""
    outline_mm: float = 0.2
    shape: str = "circle"
    dash: Literal["solid", "dash", "dot"] = "solid"
    hatch: Hatch = ""


@dataclass(frozen=True, slots=True)
class StyleClass:
    """One entry of a legend.

    Attributes
    ----------
    label : str
    symbol : Symbol
    value : str or int or None
        Of a category; None is for all other values.
    lower, upper : float
        Of a range: lower <= value < upper.
    """

    label: str
    symbol: Symbol
    value: str | int | None = None
    lower: float = -math.inf
    upper: float = math.inf


@dataclass(frozen=True, slots=True)
class VectorStyle:
    """How the features of a layer are drawn.

    Attributes
    ----------
    symbol : Symbol
        Used as it is by a simple style; gives the kind of geometry in every style.
    method : {"simple", "categories", "ranges"}
    column : str
        Whose values choose the class.
    classes : tuple of StyleClass
        Ranges ascending.
    label_column : str
        Whose text is written beside the feature; empty for none.
    """

    symbol: Symbol
    method: Literal["simple", "categories", "ranges"] = "simple"
    column: str = ""
    classes: tuple[StyleClass, ...] = field(default=())
    label_column: str = ""

    def __post_init__(self) -> None:
        if (self.method == "simple") != (not self.classes):
            raise ValueError("classes are for the methods 'categories' and 'ranges', and needed")
        if self.classes and not self.column:
            raise ValueError("classes need the column that chooses them")
        if any(entry.symbol.kind != self.symbol.kind for entry in self.classes):
            raise ValueError("all symbols of a style are of one kind")


# --- classes and colours ---------------------------------------------------------------------


def class_limits(breaks: Sequence[float]) -> list[tuple[float, float]]:
    """Lower and upper limits of the classes that ascending ``breaks`` make.

    The limits belong to the class above: lower <= value < upper. The first class is open below,
    the last above. A first break of zero opens no class below itself, as nothing that is mapped
    is negative.

    Parameters
    ----------
    breaks : sequence of float
        Strictly ascending, not empty.

    Returns
    -------
    list of (lower, upper)

    Raises
    ------
    ValueError
        If the breaks do not ascend or there are none.
    """
    if not breaks or any(not low < high for low, high in pairwise(breaks)):
        raise ValueError(f"class limits must ascend: {tuple(breaks)}")
    edges = [*breaks, math.inf] if breaks[0] == 0 else [-math.inf, *breaks, math.inf]
    return list(pairwise(float(edge) for edge in edges))


def class_labels(breaks: Sequence[float], unit: str) -> list[str]:
    """Legend texts of the classes of :func:`class_limits`, with the unit."""
    return [_range_label(low, high, unit) for low, high in class_limits(breaks)]


def class_colours(breaks: Sequence[float], ramp: str) -> list[str]:
    """Colours (``#rrggbb``) of the classes of :func:`class_limits`.

    The classes are spread over the ramp from end to end, the one below the first break included
    even where zero as the first break leaves it out: so the palest end of a ramp can be avoided.

    Raises
    ------
    ValueError
        If the breaks do not ascend or matplotlib does not know the ramp.
    """
    return _ramp_colours(ramp, len(breaks) + 1)[-len(class_limits(breaks)) :]


def _ramp_colours(ramp: str, count: int) -> list[str]:
    try:
        colours = matplotlib.colormaps[ramp]
    except KeyError as error:
        raise ValueError(f"matplotlib has no colour map named {ramp!r}") from error
    return [to_hex(colours(float(place))) for place in np.linspace(0.0, 1.0, count)]


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}" if unit and unit != "1" else text


def _range_label(low: float, high: float, unit: str) -> str:
    if math.isinf(low):
        return _with_unit(f"< {high:g}", unit)
    if math.isinf(high):
        return _with_unit(f"≥ {low:g}", unit)
    return _with_unit(f"{low:g} – {high:g}", unit)


# --- ready styles ----------------------------------------------------------------------------


def categorised_style(
    symbol: Symbol, column: str, entries: Mapping[str | int, tuple[str, str]]
) -> VectorStyle:
    """One colour per value.

    Parameters
    ----------
    symbol : Symbol
        Its colour is replaced by that of each entry.
    column : str
    entries : mapping of value to (label, ``#rrggbb``)

    Returns
    -------
    VectorStyle
    """
    return VectorStyle(
        symbol=symbol,
        method="categories",
        column=column,
        classes=tuple(
            StyleClass(label, replace(symbol, colour=colour), value=value)
            for value, (label, colour) in entries.items()
        ),
    )


def graduated_style(
    symbol: Symbol, column: str, breaks: Sequence[float], unit: str, ramp: str
) -> VectorStyle:
    """One colour per range of a number, with the same limits and colours as a map's classes.

    Parameters
    ----------
    symbol : Symbol
        Its colour is replaced by that of each range.
    column : str
    breaks : sequence of float
    unit : str
    ramp : str
        Name of a matplotlib colour map.

    Returns
    -------
    VectorStyle
    """
    limits = class_limits(breaks)
    return VectorStyle(
        symbol=symbol,
        method="ranges",
        column=column,
        classes=tuple(
            StyleClass(label, replace(symbol, colour=colour), lower=low, upper=high)
            for (low, high), label, colour in zip(
                limits, class_labels(breaks, unit), class_colours(breaks, ramp), strict=True
            )
        ),
    )


RELEASE_AREA_STYLE = VectorStyle(
    Symbol("fill", "#6a3d9a", opacity=0.25, outline="#4a1486", outline_mm=0.5),
    label_column="name",
)
RELEASE_POINT_STYLE = VectorStyle(
    Symbol("marker", "#6a3d9a", size_mm=1.6, outline="#ffffff", outline_mm=0.15, shape="triangle")
)
FALL_LINE_STYLE = VectorStyle(Symbol("line", "#404040", opacity=0.7, size_mm=0.2))
STOP_STYLE = VectorStyle(
    Symbol("marker", "#1a1a1a", opacity=0.8, size_mm=1.2, outline="#ffffff", outline_mm=0.1)
)
STATION_STYLE = VectorStyle(
    Symbol("line", "#08519c", size_mm=0.5, dash="dash"), label_column="name"
)
_WALL = Symbol("line", "#00441b", size_mm=1.2)
BARRIER_STYLE = VectorStyle(
    _WALL,
    "categories",
    "kind",
    (
        StyleClass("wall", _WALL, value="wall"),
        StyleClass("net", replace(_WALL, dash="dot"), value="net"),
    ),
    label_column="name",
)
FOOTPRINT_STYLE = VectorStyle(
    Symbol("fill", "#e31a1c", opacity=0.4, outline="#b10026", outline_mm=0.1)
)


# --- XML -------------------------------------------------------------------------------------


def _rgba(colour: str, opacity: float = 1.0) -> str:
    red, green, blue = (round(255 * part) for part in to_rgb(colour))
    return f"{red},{green},{blue},{round(255 * opacity)}"


def _number(value: float) -> str:
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return repr(float(value))


def _options(parent: ET.Element, items: Mapping[str, str]) -> None:
    options = ET.SubElement(parent, "Option", type="Map")
    for name, value in items.items():
        ET.SubElement(options, "Option", name=name, type="QString", value=value)


def _symbol_layer(symbol: ET.Element, kind: str, items: Mapping[str, str]) -> ET.Element:
    layer = ET.SubElement(
        symbol, "layer", {"class": kind, "enabled": "1", "locked": "0", "pass": "0"}
    )
    _options(layer, items)
    return layer


def _symbol_element(symbol: Symbol, name: str) -> ET.Element:
    element = ET.Element(
        "symbol", type=symbol.kind, name=name, alpha="1", clip_to_extent="1", force_rhr="0"
    )
    outline = {
        "outline_color": _rgba(symbol.outline or symbol.colour),
        "outline_style": "solid" if symbol.outline else "no",
        "outline_width": f"{symbol.outline_mm:g}",
        "outline_width_unit": "MM",
    }
    if symbol.kind == "marker":
        _symbol_layer(
            element,
            "SimpleMarker",
            {
                "name": symbol.shape,
                "color": _rgba(symbol.colour, symbol.opacity),
                "size": f"{symbol.size_mm:g}",
                "size_unit": "MM",
                "scale_method": "diameter",
                "joinstyle": "bevel",
                "angle": "0",
                **outline,
            },
        )
    elif symbol.kind == "line":
        _symbol_layer(
            element,
            "SimpleLine",
            _line_options(symbol.colour, symbol.opacity, symbol.size_mm, symbol.dash),
        )
    else:
        _fill_layers(element, symbol, outline)
    return element


def _line_options(colour: str, opacity: float, width_mm: float, dash: str) -> dict[str, str]:
    return {
        "line_color": _rgba(colour, opacity),
        "line_style": dash,
        "line_width": f"{width_mm:g}",
        "line_width_unit": "MM",
        "capstyle": "round",
        "joinstyle": "round",
    }


def _fill_layers(element: ET.Element, symbol: Symbol, outline: Mapping[str, str]) -> None:
    if symbol.hatch:
        hatching = _symbol_layer(
            element,
            "LinePatternFill",
            {
                "angle": "45" if symbol.hatch == "diagonal" else "0",
                "distance": "2",
                "distance_unit": "MM",
                "line_width": "0.3",
                "line_width_unit": "MM",
                "color": _rgba(symbol.colour),
            },
        )
        place = len(element.findall("layer")) - 1
        lines = ET.SubElement(
            hatching,
            "symbol",
            type="line",
            name=f"@{element.get('name')}@{place}",
            alpha="1",
            clip_to_extent="1",
            force_rhr="0",
        )
        _symbol_layer(
            lines, "SimpleLine", _line_options(symbol.colour, symbol.opacity, 0.3, "solid")
        )
    _symbol_layer(
        element,
        "SimpleFill",
        {
            "color": _rgba(symbol.colour, symbol.opacity),
            "style": "no" if symbol.hatch or symbol.opacity == 0 else "solid",
            "joinstyle": "round",
            **outline,
        },
    )


def vector_renderer(style: VectorStyle) -> ET.Element:
    """The ``renderer-v2`` element of a vector layer.

    Parameters
    ----------
    style : VectorStyle

    Returns
    -------
    Element
    """
    common = {"forceraster": "0", "enableorderby": "0", "symbollevels": "0"}
    if style.method == "simple":
        renderer = ET.Element("renderer-v2", {"type": "singleSymbol", **common})
        ET.SubElement(renderer, "symbols").append(_symbol_element(style.symbol, "0"))
        return renderer
    if style.method == "categories":
        renderer = ET.Element(
            "renderer-v2", {"type": "categorizedSymbol", "attr": style.column, **common}
        )
        entries = ET.SubElement(renderer, "categories")
        for place, entry in enumerate(style.classes):
            value = "" if entry.value is None else str(entry.value)
            value_type = "integer" if isinstance(entry.value, int) else "string"
            ET.SubElement(
                entries,
                "category",
                value=value,
                type=value_type,
                symbol=str(place),
                label=entry.label,
                render="true",
            )
    else:
        renderer = ET.Element(
            "renderer-v2",
            {
                "type": "graduatedSymbol",
                "attr": style.column,
                "graduatedMethod": "GraduatedColor",
                **common,
            },
        )
        entries = ET.SubElement(renderer, "ranges")
        # QGIS takes the first range that holds a value, both limits included. Listed from the
        # highest, a limit goes to the class above it, as it does on the maps.
        for place, entry in reversed(list(enumerate(style.classes))):
            ET.SubElement(
                entries,
                "range",
                lower=_number(max(entry.lower, -_OPEN_END)),
                upper=_number(min(entry.upper, _OPEN_END)),
                symbol=str(place),
                label=entry.label,
                render="true",
            )
    symbols = ET.SubElement(renderer, "symbols")
    for place, entry in enumerate(style.classes):
        symbols.append(_symbol_element(entry.symbol, str(place)))
    source = ET.SubElement(renderer, "source-symbol")
    source.append(_symbol_element(style.symbol, "0"))
    return renderer


def _labeling(style: VectorStyle) -> ET.Element:
    labeling = ET.Element("labeling", type="simple")
    settings = ET.SubElement(labeling, "settings", calloutType="simple")
    text = ET.SubElement(
        settings,
        "text-style",
        fieldName=style.label_column,
        isExpression="0",
        fontFamily="Sans Serif",
        fontSize="8",
        fontSizeUnit="Point",
        fontWeight="50",
        textColor="0,0,0,255",
        textOpacity="1",
        namedStyle="Regular",
    )
    ET.SubElement(
        text,
        "text-buffer",
        bufferDraw="1",
        bufferSize="0.8",
        bufferSizeUnits="MM",
        bufferColor="255,255,255,255",
        bufferOpacity="1",
        bufferJoinStyle="128",
    )
    placement = {"marker": "6", "line": "2", "fill": "1"}[style.symbol.kind]
    ET.SubElement(
        settings,
        "placement",
        placement=placement,
        placementFlags="10",
        dist="1",
        distUnits="MM",
        priority="5",
        centroidInside="1",
    )
    ET.SubElement(settings, "rendering", drawLabels="1", obstacle="1", displayAll="0")
    return labeling


def vector_style_elements(
    style: VectorStyle, columns: Sequence[str], fields: Mapping[str, FieldInfo]
) -> list[ET.Element]:
    """All style elements of a vector layer: renderer, labels, aliases.

    Parameters
    ----------
    style : VectorStyle
    columns : sequence of str
        The columns in the order of the table, the key ``fid`` first, without the geometry.
    fields : mapping of column to FieldInfo

    Returns
    -------
    list of Element
        Children of the ``qgis`` element of a ``.qml`` and of the ``maplayer`` of a project.
    """
    elements = [vector_renderer(style)]
    if style.label_column:
        elements.append(_labeling(style))
    elements.append(_text_element("blendMode", "0"))
    elements.append(_text_element("featureBlendMode", "0"))
    elements.append(_text_element("layerOpacity", "1"))
    configuration = ET.Element("fieldConfiguration")
    aliases = ET.Element("aliases")
    for index, column in enumerate(columns):
        entry = ET.SubElement(configuration, "field", name=column)
        widget = ET.SubElement(
            entry, "editWidget", type="Hidden" if column == "fid" else "TextEdit"
        )
        ET.SubElement(ET.SubElement(widget, "config"), "Option", type="Map")
        label = fields[column].label if column in fields else ""
        ET.SubElement(aliases, "alias", field=column, index=str(index), name=label)
    elements += [configuration, aliases]
    if style.label_column:
        elements.append(_text_element("previewExpression", f'"{style.label_column}"'))
    return elements


def _text_element(tag: str, text: str) -> ET.Element:
    element = ET.Element(tag)
    element.text = text
    return element


def raster_style_elements(layer: RasterLayer) -> list[ET.Element]:
    """All style elements of a raster layer.

    Parameters
    ----------
    layer : RasterLayer
        Its first band is shown: in the classes of ``breaks``, or as a continuous ramp over the
        data's range, or as shaded relief if ``ramp`` is :data:`HILLSHADE`.

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
    pipe.append(_hillshade_renderer() if relief else _colour_renderer(layer))
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
    return [pipe, _text_element("blendMode", "0")]


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


def zero_is_nothing(unit: str) -> bool:
    """Whether a value of 0 in this unit stays clear on the map.

    A passing height of 0 m is a rock that rolls; a count, probability or energy of 0 is no rock.
    """
    return unit != "m"


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
        classificationMin=_number(low),
        classificationMax=_number(high),
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
        minimumValue=_number(low),
        maximumValue=_number(high),
    )
    shader.append(_source_ramp([colour for _, colour, _ in items]))
    for value, colour, label in items:
        ET.SubElement(shader, "item", value=_number(value), color=colour, alpha="255", label=label)
    if not layer.breaks:
        ET.SubElement(
            shader,
            "rampLegendSettings",
            useContinuousLegend="1",
            direction="0",
            orientation="2",
            prefix="",
            suffix=_with_unit("", band.unit),
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
        (float(value), colour, _with_unit(f"{value:.3g}", band.unit))
        for value, colour in zip(
            np.linspace(low, high, _RAMP_STEPS), _ramp_colours(layer.ramp, _RAMP_STEPS), strict=True
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
        f"{place:.6g};{_rgba(colour)}"
        for place, colour in zip(places[1:-1], colours[1:-1], strict=True)
    )
    _options(
        ramp,
        {
            "color1": _rgba(colours[0]),
            "color2": _rgba(colours[-1]),
            "discrete": "0",
            "rampType": "gradient",
            "stops": stops,
        },
    )
    return ramp


def qml(elements: Sequence[ET.Element], *, labels: bool = False) -> str:
    """The text of a ``.qml`` file.

    Parameters
    ----------
    elements : sequence of Element
        From :func:`raster_style_elements` or :func:`vector_style_elements`.
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
