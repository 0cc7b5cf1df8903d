"""A QGIS project over a result, written by hand: opens in QGIS 3.22 and later.

A ``.qgz`` is a zip of one ``.qgs``, an XML file. All paths in it are relative to the project, and
each layer carries its style, so that the folder can be moved and opened anywhere.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from pyproj import CRS

from sassgis.files.atomic_output import writing
from sassgis.grid import Bounds
from sassgis.outputs.qgis.entries import LayerGroup, document, filled
from sassgis.outputs.qgis.layout import PrintLayout, layout_element
from sassgis.settings.crs import crs_parts
from sassgis.settings.languages import translated, with_translated
from sassgis.settings.settings import ProjectSettings

_ZIP_TIME = (1980, 1, 1, 0, 0, 0)


def write_project(
    path: Path,
    *,
    title: str,
    crs: str,
    groups: Sequence[LayerGroup],
    extent: Bounds,
    abstract: str = "",
    imprint: ProjectSettings | None = None,
    layouts: Sequence[PrintLayout] = (),
) -> Path:
    """Write a QGIS project, a file that ends in ``.qgz``.

    ``crs`` is empty for local coordinates. The first group is drawn on top; the extent (west,
    south, east, north; m) is shown at first. Each layout is a map sheet, and also a map theme.
    ValueError if two layers have the same key, two layouts the same name, or one shows a layer that
    is not there.
    """
    groups = [group.translated for group in groups]
    # The title of a sheet is the user's.
    layouts = [with_translated(own, "name", "subtitle", "facts", "notes") for own in layouts]
    entries = [entry for group in groups for entry in group.entries]
    keys = [entry.key for entry in entries]
    if len(set(keys)) != len(keys):
        raise ValueError(f"layers of a project need one name each: {keys}")
    if len({layout.name for layout in layouts}) != len(layouts):
        raise ValueError("layouts of a project need one name each")
    system = _spatial_reference(crs)
    root = filled(
        "qgis_project.xml.j2",
        title=title,
        crs=system,
        groups=groups,
        entries=entries,
        extent=extent,
        abstract=translated(abstract),
        imprint=imprint or ProjectSettings(),
        layouts=layouts,
    )
    shown = {entry.key: entry for entry in entries}
    sheets = root.find("Layouts")
    assert sheets is not None
    code = f" ({system['authid']})" if system["authid"] else ""
    name = f"{system['description']}{code}"
    sheets.extend(layout_element(layout, shown, name) for layout in layouts)
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


def _spatial_reference(crs: str) -> dict[str, str]:
    """Return QGIS's notes on a system, by tag."""
    if not crs:
        return dict.fromkeys(("wkt", "proj4", "authid", "description"), "")
    # The part of east and north; QGIS 3.22 knows no other.
    system, _ = crs_parts(CRS.from_user_input(crs))
    authority = system.to_authority(min_confidence=100)
    operation = system.coordinate_operation
    return {
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
