"""Layers and groups of a QGIS project, and QGIS's XML from ``data/qgis_*.xml.j2``."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass, replace
from functools import cache
from xml.etree import ElementTree as ET

import jinja2
import numpy as np
from markupsafe import Markup, escape

from sassgis.files.plain_file import NO_XML
from sassgis.files.vector_layer import VectorLayer, translated_raster, translated_vector
from sassgis.settings import styles
from sassgis.settings.languages import translated
from sassgis.settings.results import RasterLayer


@dataclass(frozen=True, slots=True)
class LayerEntry:
    """A layer of the project; its source is a path from there, as ``maps/energy.tif``."""

    content: RasterLayer | VectorLayer
    source: str
    visible: bool = True
    though_empty: bool = False  # kept though it has no features
    part: str = ""  # name of a part of the layer that is shown by itself
    part_where: str = ""  # which features are in it: a condition in SQL

    @property
    def key(self) -> str:
        """Identity of the layer in the project."""
        if isinstance(self.content, RasterLayer):
            return f"raster_{self.content.stem}"
        return "_".join(filter(None, ("vector", self.content.name, self.part)))

    @property
    def datasource(self) -> str:
        """The source as QGIS writes it."""
        if isinstance(self.content, RasterLayer):
            return f"./{self.source}"
        subset = f"|subset={self.part_where}" if self.part_where else ""
        return f"./{self.source}|layername={self.content.name}{subset}"

    @property
    def provider(self) -> str:
        """QGIS's name of the program that reads it."""
        return "gdal" if isinstance(self.content, RasterLayer) else "ogr"

    @property
    def translated(self) -> LayerEntry:
        """The same in the language in which the program writes."""
        if isinstance(self.content, RasterLayer):
            return replace(self, content=translated_raster(self.content))
        return replace(self, content=translated_vector(self.content))


@dataclass(frozen=True, slots=True)
class LayerGroup:
    """A group of the legend, the first on top; an ``exclusive`` one shows one layer at a time."""

    name: str
    layers: tuple[LayerEntry | LayerGroup, ...]
    exclusive: bool = False
    expanded: bool = True

    @property
    def entries(self) -> list[LayerEntry]:
        """All layers of the group and of the groups in it, the top first."""
        out: list[LayerEntry] = []
        for member in self.layers:
            out += member.entries if isinstance(member, LayerGroup) else [member]
        return out

    @property
    def first_shown(self) -> int:
        """Place of the first layer that is shown; -1 for none."""
        shown = (isinstance(m, LayerEntry) and m.visible for m in self.layers)
        return next((place for place, visible in enumerate(shown) if visible), -1)

    @property
    def translated(self) -> LayerGroup:
        """The same in the language in which the program writes."""
        return replace(
            self, name=translated(self.name), layers=tuple(m.translated for m in self.layers)
        )


def without_empty(group: LayerGroup) -> LayerGroup:
    """Return group without layers that have no features, and without groups that have no layers."""

    def filled(member: LayerEntry | LayerGroup) -> bool:
        if isinstance(member, LayerGroup):
            return bool(member.layers)
        if isinstance(member.content, RasterLayer) or member.though_empty:
            return True
        return not member.content.frame.empty

    members = (without_empty(m) if isinstance(m, LayerGroup) else m for m in group.layers)
    return replace(group, layers=tuple(m for m in members if filled(m)))


QGIS_VERSION = "3.22.0"
#: Columns that the tip of a feature shows.
_TIP_COLUMNS = 8
_RAMP_STEPS = 11
#: In attributes, XML would take these for blanks.
_BREAKS = {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}


def qml(content: RasterLayer | VectorLayer) -> str:
    """Return the style of a layer: text of a ``.qml`` file, and of the table ``layer_styles``."""
    return document(filled("qgis_layer.xml.j2", content=content))


def document(root: ET.Element) -> str:
    """Return a QGIS document as text: the element, indented, after QGIS's document type."""
    ET.indent(root, " ")
    text = NO_XML.sub("", ET.tostring(root, "unicode"))
    return f"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n{text}\n"


def filled(template: str, **values: object) -> ET.Element:
    """Return the root of a template, filled in; without the blanks between its elements."""
    root = ET.fromstring(_environment().get_template(template).render(**values))
    for element in root.iter():
        if not (element.text or "").strip():
            element.text = None
        element.tail = None
    return root


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("sassgis", "data"),
        undefined=jinja2.StrictUndefined,
        autoescape=True,
        finalize=_escaped,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "rgba": rgba, "digits": number, "g": lambda value: f"{value:g}",
        "class_tint": styles.class_tint, "class_name": styles.class_name,
    }  # fmt: skip
    environment.tests["raster"] = lambda content: isinstance(content, RasterLayer)
    environment.globals |= {
        "version": QGIS_VERSION, "opacity": styles.RASTER_OPACITY,
        "shading": _shading, "map_tip": _map_tip,
    }  # fmt: skip
    return environment


def _escaped(value: object) -> Markup:
    if isinstance(value, Markup):
        return value
    text = str(escape(NO_XML.sub("", str(value))))
    return Markup("".join(_BREAKS.get(c, c) for c in text))


def rgba(colour: str, opacity: float = 1.0) -> str:
    """Return a colour ``#rrggbb`` as QGIS writes it: red, green, blue and opacity, 0 to 255."""
    return ",".join(map(str, (*styles.rgb(colour), round(255 * opacity))))


def number(value: float) -> str:
    """Return a number with all its digits; "inf" for infinity."""
    return repr(float(value))


def without_expressions(text: str) -> str:
    """Return text in which QGIS finds nothing to compute: ``[% ... %]`` would be an expression."""
    return text.replace("[%", "[\N{WORD JOINER}%")


def _shading(layer: RasterLayer) -> dict[str, object]:
    """Shade a map in the classes of its ``breaks``, or as a ramp over the data's range."""
    band = layer.bands[0]
    clear = styles.zero_is_nothing(band.unit)
    shown = band.values[np.isfinite(band.values)]
    shown = shown[shown != 0] if clear else shown
    low, high = (float(shown.min()), float(shown.max())) if shown.size else (0.0, 1.0)
    high = high if low < high else low + max(1.0, abs(low))
    if layer.breaks:
        # A limit belongs to the class above it; the cells are float32, so the next smaller float32
        # is the largest value that a cell below the limit can have.
        values = [
            float(np.nextafter(np.float32(upper), np.float32(-np.inf))) if upper < np.inf else upper
            for _, upper in styles.class_limits(layer.breaks)
        ]
        colours = styles.class_colours(layer.breaks, layer.ramp)
        labels = styles.class_labels(layer.breaks, band.unit)
    else:
        values = np.linspace(low, high, _RAMP_STEPS).tolist()
        colours = styles.ramp_colours(layer.ramp, _RAMP_STEPS)
        labels = [styles.with_unit(f"{value:.3g}", band.unit) for value in values]
    finite = [value for value in values if math.isfinite(value)]
    places = np.linspace(0.0, 1.0, len(colours))
    stops = [f"{p:.6g};{rgba(c)}" for p, c in zip(places, colours, strict=True)]
    return {
        # QGIS takes values up to each.
        "steps": list(zip(values, colours, labels, strict=True)),
        "low": min([low, *finite]),
        "high": max([high, *finite]),
        "zero_is_clear": clear,
        "stops": ":".join(stops[1:-1]),
        "suffix": styles.with_unit("", band.unit),
    }


def _map_tip(layer: VectorLayer) -> str:
    """Write the map tip of a feature in QGIS: the first columns with their units."""
    rows = (
        f'<tr><td>{html.escape(layer.fields[name].alias)}</td><td><b>[% "{name}" %]</b> '
        f"{html.escape(layer.fields[name].unit)}</td></tr>"
        for name in [name for name in layer.columns if name in layer.fields][:_TIP_COLUMNS]
    )
    return f"<table>{''.join(rows)}</table>"
