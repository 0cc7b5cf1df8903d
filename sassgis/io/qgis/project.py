"""A QGIS project over a result, written by hand: opens in QGIS 3.22 and later.

A ``.qgz`` is a zip of one ``.qgs``, an XML file. All paths in it are relative to the project, and
each layer carries its style, so that the folder can be moved and opened anywhere.
"""

from __future__ import annotations

import copy
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree as ET

from pyproj import CRS

from sassgis.io.qgis.layout import PrintLayout, layout_element, said_layout
from sassgis.io.qgis.markup import QGIS_VERSION, document
from sassgis.io.qgis.raster_style import raster_style_elements
from sassgis.io.qgis.sheet_legend import ShownLayer
from sassgis.io.qgis.vector_style import vector_style_elements
from sassgis.io.said_layers import said_raster, said_vector
from sassgis.io.staging import writing
from sassgis.io.vector_layer import VectorLayer
from sassgis.model.languages import said
from sassgis.model.results import RasterLayer
from sassgis.model.settings import ProjectSettings

_ZIP_TIME = (1980, 1, 1, 0, 0, 0)
_GEOMETRY_NAME = {"marker": "Point", "line": "Line", "fill": "Polygon"}


@dataclass(frozen=True, slots=True)
class LayerEntry:
    """A layer of the project.

    Attributes
    ----------
    content : RasterLayer or VectorLayer
        What is shown and how.
    source : str
        Path of the file from the folder of the project, with slashes: ``maps/energy.tif``, or
        ``result.gpkg`` (the name of the layer in it is that of the VectorLayer).
    visible : bool
        Whether it is shown when the project is opened.
    """

    content: RasterLayer | VectorLayer
    source: str
    visible: bool = True

    @property
    def key(self) -> str:
        """Identity of the layer in the project."""
        name = self.content.stem if isinstance(self.content, RasterLayer) else self.content.name
        kind = "raster" if isinstance(self.content, RasterLayer) else "vector"
        return f"{kind}_{name}"

    @property
    def datasource(self) -> str:
        """The source as QGIS writes it."""
        path = f"./{self.source}"
        if isinstance(self.content, RasterLayer):
            return path
        return f"{path}|layername={self.content.name}"


@dataclass(frozen=True, slots=True)
class LayerGroup:
    """A group of the legend; what comes first in it is drawn on top.

    Attributes
    ----------
    name : str
    layers : tuple of LayerEntry or LayerGroup
    exclusive : bool
        Whether showing one layer hides the others of the group (for maps that cover each other).
    expanded : bool
    """

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


def write_project(
    path: Path,
    *,
    title: str,
    crs: str,
    groups: Sequence[LayerGroup],
    extent: tuple[float, float, float, float],
    abstract: str = "",
    imprint: ProjectSettings | None = None,
    layouts: Sequence[PrintLayout] = (),
) -> Path:
    """Write a QGIS project.

    Parameters
    ----------
    path : Path
        Ends in ``.qgz``.
    title : str
        Of the window.
    crs : str
        Well-known text (or EPSG code); empty for local coordinates.
    groups : sequence of LayerGroup
        The first is drawn on top.
    extent : (west, south, east, north)
        What is shown at first (m).
    abstract : str
        In the properties of the project.
    imprint : ProjectSettings, optional
        Author, contact, rights and date, in the properties too.
    layouts : sequence of PrintLayout
        Map sheets; each is also a map theme, with which the window shows the same layers.

    Returns
    -------
    Path

    Raises
    ------
    OutputError
        If the disk is full or not writable.
    ValueError
        If two layers have the same key, two layouts the same name, or a layout shows a layer that
        is not there.
    """
    groups = [_said_group(group) for group in groups]
    layouts = [said_layout(layout) for layout in layouts]
    abstract = said(abstract)
    entries = [entry for group in groups for entry in group.entries]
    keys = [entry.key for entry in entries]
    if len(set(keys)) != len(keys):
        raise ValueError(f"layers of a project need one name each: {keys}")
    if len({layout.name for layout in layouts}) != len(layouts):
        raise ValueError("layouts of a project need one name each")
    root = _project(title, crs, groups, extent, abstract, imprint or ProjectSettings())
    root.append(_themes(entries, layouts))
    sheets = ET.SubElement(root, "Layouts")
    shown = {e.key: ShownLayer(e.key, e.datasource, e.content) for e in entries}
    for layout in layouts:
        sheets.append(layout_element(layout, shown, _crs_name(crs)))
    text = document(root)
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        entry = zipfile.ZipInfo(f"{path.stem}.qgs", date_time=_ZIP_TIME)
        entry.compress_type = zipfile.ZIP_DEFLATED
        entry.external_attr = 0o644 << 16
        archive.writestr(entry, text.encode("utf-8"))
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(packed.getvalue())
    return path


def without_empty(group: LayerGroup) -> LayerGroup:
    """A group without layers that have no features, and without groups that have no layers."""
    members = (without_empty(m) if isinstance(m, LayerGroup) else m for m in group.layers)
    return replace(
        group,
        layers=tuple(
            m
            for m in members
            if (m.layers if isinstance(m, LayerGroup) else not _is_empty(m.content))
        ),
    )


def _said_group(group: LayerGroup) -> LayerGroup:
    """A group with its layers in the language in which the program writes."""
    return replace(
        group,
        name=said(group.name),
        layers=tuple(
            _said_group(m) if isinstance(m, LayerGroup) else replace(m, content=_said(m.content))
            for m in group.layers
        ),
    )


def _said(content: RasterLayer | VectorLayer) -> RasterLayer | VectorLayer:
    return said_raster(content) if isinstance(content, RasterLayer) else said_vector(content)


def _is_empty(content: RasterLayer | VectorLayer) -> bool:
    return isinstance(content, VectorLayer) and content.frame.empty


def _project(
    title: str,
    crs: str,
    groups: Sequence[LayerGroup],
    extent: tuple[float, float, float, float],
    abstract: str,
    imprint: ProjectSettings,
) -> ET.Element:
    root = ET.Element("qgis", version=QGIS_VERSION, projectname=title)
    ET.SubElement(root, "homePath", path="")
    ET.SubElement(root, "title").text = title
    reference = _spatial_reference(crs)
    ET.SubElement(root, "projectCrs").append(copy.deepcopy(reference))
    root.append(_layer_tree(groups))
    entries = [entry for group in groups for entry in group.entries]
    root.append(_canvas(extent, reference))
    order = ET.SubElement(root, "layerorder")
    for entry in entries:
        ET.SubElement(order, "layer", id=entry.key)
    layers = ET.SubElement(root, "projectlayers")
    for entry in entries:
        layers.append(_map_layer(entry, reference))
    root.append(_properties())
    metadata = ET.SubElement(root, "projectMetadata")
    ET.SubElement(metadata, "type")
    ET.SubElement(metadata, "title").text = title
    ET.SubElement(metadata, "abstract").text = abstract
    if imprint.contact or imprint.author:
        contact = ET.SubElement(metadata, "contact")
        ET.SubElement(contact, "name").text = imprint.author or ""
        ET.SubElement(contact, "email").text = imprint.contact or ""
    if imprint.rights:
        ET.SubElement(metadata, "rights").text = imprint.rights
    ET.SubElement(metadata, "author").text = imprint.author or ""
    if imprint.date:
        ET.SubElement(metadata, "creation").text = f"{imprint.date}T00:00:00"
    view = ET.SubElement(root, "ProjectViewSettings", UseProjectScales="0")
    box = dict(zip(("xmin", "ymin", "xmax", "ymax"), map(repr, map(float, extent)), strict=True))
    default = ET.SubElement(view, "DefaultViewExtent", box)
    default.append(copy.deepcopy(reference))
    return root


def _horizontal(crs: CRS) -> CRS:
    """The part of a compound system of east and north; QGIS 3.22 knows no other."""
    return crs.sub_crs_list[0] if crs.is_compound else crs


def _crs_name(crs: str) -> str:
    """Name and code of the system in plan, as a reader knows it; empty for local coordinates."""
    if not crs:
        return ""
    system = _horizontal(CRS.from_user_input(crs))
    authority = system.to_authority(min_confidence=100)
    return f"{system.name} ({':'.join(authority)})" if authority else str(system.name)


def _themes(entries: Sequence[LayerEntry], layouts: Sequence[PrintLayout]) -> ET.Element:
    themes = ET.Element("visibility-presets")
    for layout in layouts:
        theme = ET.SubElement(
            themes, "visibility-preset", {"name": layout.name, "has-expanded-info": "1"}
        )
        for entry in entries:
            if entry.key in layout.layers:
                ET.SubElement(
                    theme, "layer", id=entry.key, visible="1", expanded="1", style="default"
                )
        ET.SubElement(theme, "checked-group-nodes")
        ET.SubElement(theme, "expanded-group-nodes")
    return themes


def _spatial_reference(crs: str) -> ET.Element:
    element = ET.Element("spatialrefsys", nativeFormat="Wkt")
    if not crs:
        for tag in ("wkt", "proj4", "authid", "description"):
            ET.SubElement(element, tag)
        return element
    system = _horizontal(CRS.from_user_input(crs))
    authority = system.to_authority(min_confidence=100)
    operation = system.coordinate_operation
    parts = {
        "wkt": system.to_wkt(),
        "proj4": "",
        "srsid": "0",
        "srid": authority[1] if authority and authority[1].isdigit() else "0",
        "authid": ":".join(authority) if authority else "",
        "description": system.name,
        "projectionacronym": operation.method_name if operation is not None else "",
        "ellipsoidacronym": "",
        "geographicflag": "true" if system.is_geographic else "false",
    }
    for tag, text in parts.items():
        ET.SubElement(element, tag).text = text
    return element


def _extent_element(tag: str, extent: tuple[float, float, float, float]) -> ET.Element:
    element = ET.Element(tag)
    for name, value in zip(("xmin", "ymin", "xmax", "ymax"), extent, strict=True):
        ET.SubElement(element, name).text = repr(float(value))
    return element


def _canvas(extent: tuple[float, float, float, float], reference: ET.Element) -> ET.Element:
    canvas = ET.Element("mapcanvas", name="theMapCanvas", annotationsVisible="1")
    ET.SubElement(canvas, "units").text = "meters"
    canvas.append(_extent_element("extent", extent))
    ET.SubElement(canvas, "rotation").text = "0"
    ET.SubElement(canvas, "destinationsrs").append(copy.deepcopy(reference))
    ET.SubElement(canvas, "rendermaptile").text = "0"
    return canvas


def _checked(visible: bool) -> str:
    return "Qt::Checked" if visible else "Qt::Unchecked"


def _layer_tree(groups: Sequence[LayerGroup]) -> ET.Element:
    tree = ET.Element("layer-tree-group")
    ET.SubElement(tree, "customproperties")
    for group in groups:
        tree.append(_branch(group))
    ET.SubElement(tree, "custom-order", enabled="0")
    return tree


def _branch(group: LayerGroup) -> ET.Element:
    attributes = {
        "name": group.name,
        "checked": "Qt::Checked",
        "expanded": "1" if group.expanded else "0",
    }
    if group.exclusive:
        shown = [
            place
            for place, member in enumerate(group.layers)
            if isinstance(member, LayerEntry) and member.visible
        ]
        attributes["mutually-exclusive"] = "1"
        attributes["mutually-exclusive-child"] = str(shown[0] if shown else -1)
    branch = ET.Element("layer-tree-group", attributes)
    ET.SubElement(branch, "customproperties")
    for member in group.layers:
        branch.append(_branch(member) if isinstance(member, LayerGroup) else _leaf(member))
    return branch


def _leaf(entry: LayerEntry) -> ET.Element:
    leaf = ET.Element(
        "layer-tree-layer",
        {
            "id": entry.key,
            "name": entry.content.title,
            "source": entry.datasource,
            "providerKey": "gdal" if isinstance(entry.content, RasterLayer) else "ogr",
            "checked": _checked(entry.visible),
            # Legends of hidden layers would push the shown ones out of sight.
            "expanded": "1" if entry.visible else "0",
            "legend_exp": "",
        },
    )
    ET.SubElement(leaf, "customproperties")
    return leaf


def _map_layer(entry: LayerEntry, reference: ET.Element) -> ET.Element:
    content = entry.content
    attributes = {
        "autoRefreshEnabled": "0",
        "autoRefreshTime": "0",
        "hasScaleBasedVisibilityFlag": "0",
        "refreshOnNotifyEnabled": "0",
        "styleCategories": "AllStyleCategories",
    }
    if isinstance(content, RasterLayer):
        note = content.note
        style = raster_style_elements(content)
        provider = "gdal"
        layer = ET.Element("maplayer", {"type": "raster", **attributes})
    else:
        note = content.description
        style = vector_style_elements(content.style, content.columns, content.fields)
        provider = "ogr"
        if content.style.smallest_scale:
            attributes |= {
                "hasScaleBasedVisibilityFlag": "1",
                "minScale": f"{content.style.smallest_scale:g}",
                "maxScale": "0",
            }
        layer = ET.Element(
            "maplayer",
            {
                "type": "vector",
                "geometry": _GEOMETRY_NAME[content.style.symbol.kind],
                "labelsEnabled": "1" if content.style.label_column else "0",
                "simplifyDrawingHints": "1",
                **attributes,
            },
        )
    ET.SubElement(layer, "id").text = entry.key
    ET.SubElement(layer, "datasource").text = entry.datasource
    ET.SubElement(layer, "layername").text = content.title
    ET.SubElement(layer, "abstract").text = note
    ET.SubElement(layer, "srs").append(copy.deepcopy(reference))
    resource = ET.SubElement(layer, "resourceMetadata")
    ET.SubElement(resource, "title").text = content.title
    ET.SubElement(resource, "abstract").text = note
    ET.SubElement(resource, "crs").append(copy.deepcopy(reference))
    source = ET.SubElement(layer, "provider")
    source.text = provider
    if provider == "ogr":
        source.set("encoding", "UTF-8")
    manager = ET.SubElement(layer, "map-layer-style-manager", current="default")
    ET.SubElement(manager, "map-layer-style", name="default")
    layer.extend(style)
    return layer


def _properties() -> ET.Element:
    properties = ET.Element("properties")
    paths = ET.SubElement(properties, "Paths")
    ET.SubElement(paths, "Absolute", type="bool").text = "false"
    projections = ET.SubElement(properties, "SpatialRefSys")
    ET.SubElement(projections, "ProjectionsEnabled", type="int").text = "1"
    measurement = ET.SubElement(properties, "Measurement")
    ET.SubElement(measurement, "DistanceUnits", type="QString").text = "meters"
    ET.SubElement(measurement, "AreaUnits", type="QString").text = "m2"
    gui = ET.SubElement(properties, "Gui")
    for part in ("Red", "Green", "Blue"):
        ET.SubElement(gui, f"CanvasColor{part}Part", type="int").text = "255"
    return properties
