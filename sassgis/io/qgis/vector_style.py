"""The XML of the style of a vector layer."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

from sassgis.io.qgis.markup import number, options, rgba, text_element
from sassgis.model.styles import FieldInfo, Symbol, VectorStyle

#: Names are written at this scale and larger ones.
LABEL_SCALE = 100_000.0
#: Columns that the tip of a feature shows.
_TIP_COLUMNS = 8

_OPEN_END = 1e300
_HATCH_ANGLE = {"diagonal": "45", "horizontal": "0", "falling": "135"}


def _symbol_layer(symbol: ET.Element, kind: str, items: Mapping[str, str]) -> ET.Element:
    layer = ET.SubElement(
        symbol, "layer", {"class": kind, "enabled": "1", "locked": "0", "pass": "0"}
    )
    options(layer, items)
    return layer


def symbol_element(symbol: Symbol, name: str) -> ET.Element:
    """The ``symbol`` element of a drawn sign."""
    element = ET.Element(
        "symbol", type=symbol.kind, name=name, alpha="1", clip_to_extent="1", force_rhr="0"
    )
    outline = {
        "outline_color": rgba(symbol.outline or symbol.colour),
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
                "color": rgba(symbol.colour, symbol.opacity),
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
        "line_color": rgba(colour, opacity),
        "line_style": dash,
        "line_width": f"{width_mm:g}",
        "line_width_unit": "MM",
        "capstyle": "round",
        "joinstyle": "round",
    }


def _fill_layers(element: ET.Element, symbol: Symbol, outline: Mapping[str, str]) -> None:
    if symbol.hatch:
        if symbol.ground:
            _symbol_layer(
                element,
                "SimpleFill",
                {
                    "color": rgba(symbol.ground, symbol.opacity),
                    "style": "solid",
                    "outline_style": "no",
                },
            )
        hatching = _symbol_layer(
            element,
            "LinePatternFill",
            {
                "angle": _HATCH_ANGLE[symbol.hatch],
                "distance": f"{symbol.hatch_step_mm:g}",
                "distance_unit": "MM",
                "line_width": f"{symbol.hatch_mm:g}",
                "line_width_unit": "MM",
                "color": rgba(symbol.colour),
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
            lines,
            "SimpleLine",
            _line_options(symbol.colour, symbol.opacity, symbol.hatch_mm, "solid"),
        )
    _symbol_layer(
        element,
        "SimpleFill",
        {
            "color": rgba(symbol.colour, symbol.opacity),
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
        ET.SubElement(renderer, "symbols").append(symbol_element(style.symbol, "0"))
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
                lower=number(max(entry.lower, -_OPEN_END)),
                upper=number(min(entry.upper, _OPEN_END)),
                symbol=str(place),
                label=entry.label,
                render="true",
            )
    symbols = ET.SubElement(renderer, "symbols")
    for place, entry in enumerate(style.classes):
        symbols.append(symbol_element(entry.symbol, str(place)))
    source = ET.SubElement(renderer, "source-symbol")
    source.append(symbol_element(style.symbol, "0"))
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
    # What QGIS 3.22 calls scaleMax is the denominator of the smallest scale.
    ET.SubElement(
        settings,
        "rendering",
        drawLabels="1",
        obstacle="1",
        displayAll="0",
        scaleVisibility="1",
        scaleMin="0",
        scaleMax=f"{LABEL_SCALE:.0f}",
    )
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
    elements.append(text_element("blendMode", "0"))
    elements.append(text_element("featureBlendMode", "0"))
    elements.append(text_element("layerOpacity", "1"))
    elements += _form(columns, fields)
    elements.append(text_element("mapTip", _map_tip(columns, fields)))
    if style.label_column:
        elements.append(text_element("previewExpression", f'"{style.label_column}"'))
    return elements


def _map_tip(columns: Sequence[str], fields: Mapping[str, FieldInfo]) -> str:
    """What QGIS shows of a feature under the pointer: the first columns with their units."""
    rows = (
        f'<tr><td>{html.escape(fields[name].alias)}</td><td><b>[% "{name}" %]</b> '
        f"{html.escape(fields[name].unit)}</td></tr>"
        for name in [name for name in columns if name in fields][:_TIP_COLUMNS]
    )
    return f"<table>{''.join(rows)}</table>"


def _form(columns: Sequence[str], fields: Mapping[str, FieldInfo]) -> list[ET.Element]:
    """How attributes are entered: a list of choices, a number within limits, or text."""
    configuration = ET.Element("fieldConfiguration")
    aliases = ET.Element("aliases")
    constraints = ET.Element("constraints")
    for index, column in enumerate(columns):
        info = fields.get(column)
        entry = ET.SubElement(configuration, "field", name=column)
        kind = "Hidden" if column == "fid" else _widget(info)
        config = ET.SubElement(ET.SubElement(entry, "editWidget", type=kind), "config")
        entries = ET.SubElement(config, "Option", type="Map")
        if info is not None and kind == "ValueMap":
            listed = ET.SubElement(entries, "Option", name="map", type="List")
            for choice in info.choices:
                one = ET.SubElement(listed, "Option", type="Map")
                ET.SubElement(one, "Option", name=choice, type="QString", value=choice)
        elif info is not None and kind == "Range":
            for name, value in (("Min", info.low), ("Max", info.high)):
                ET.SubElement(entries, "Option", name=name, type="double", value=f"{value:g}")
            ET.SubElement(entries, "Option", name="AllowNull", type="bool", value="true")
            ET.SubElement(entries, "Option", name="Style", type="QString", value="SpinBox")
        label = "" if info is None else info.label
        ET.SubElement(aliases, "alias", field=column, index=str(index), name=label)
        if info is not None and (info.needed or info.unique):
            ET.SubElement(
                constraints,
                "constraint",
                field=column,
                # QGIS counts 1 for "not empty" and 2 for "unique"; strength 1 refuses to save.
                constraints=str((1 if info.needed else 0) + (2 if info.unique else 0)),
                notnull_strength="1" if info.needed else "0",
                unique_strength="1" if info.unique else "0",
                exp_strength="0",
            )
    return [configuration, aliases, *([constraints] if len(constraints) else [])]


def _widget(info: FieldInfo | None) -> str:
    if info is not None and info.choices:
        return "ValueMap"
    # QGIS would fill an end that is not stated with the limits of the number's type.
    limited = info is not None and info.low is not None and info.high is not None
    return "Range" if limited else "TextEdit"
