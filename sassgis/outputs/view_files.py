"""Zones and paths of a result for other viewers: GeoJSON (RFC 7946) and KML, both in WGS 84.

Sources: H. Butler et al. (2016), *The GeoJSON Format*, RFC 7946; OGC 12-007r2, *KML 2.3*; Mapbox,
*simplestyle-spec* 1.1.0 for the colours of GeoJSON.
"""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pyogrio

from sassgis.errors import InputError
from sassgis.files.atomic_output import staged_file
from sassgis.inputs.result_folder import (
    RESULT_FILE,
    ZONE_FILE,
    check_is_result,
    level_classes,
    read_layer,
)

#: Formats by suffix: driver of GDAL.
FORMATS = {".geojson": "GeoJSON", ".json": "GeoJSON", ".kml": "LIBKML"}
_LAYERS = {
    "zones": (ZONE_FILE, "hazard_zones", "hazard zones", ("label",)),
    "paths": (RESULT_FILE, "paths", "paths of blocks", ("area", "scenario")),
}
_OUTLINE, _OPACITY, _PATH = "#4d4d4d", 0.7, "#d9480f"
#: What GDAL takes the colours of a feature from, and repeats among its attributes.
_STYLE = "OGR_STYLE"
_REPEATED = (f'<SimpleField name="{_STYLE}"', f'<SimpleData name="{_STYLE}"')


def export_view(result_folder: Path, target: Path, layer: str, *, overwrite: bool = False) -> str:
    """Write hazard zones, or paths of blocks in space, as GeoJSON or KML; says what it wrote.

    Heights of paths are those of the terrain model. Equal results give equal files with the same
    version of GDAL. The suffix names the format: one of :data:`FORMATS`.
    """
    driver = FORMATS.get(target.suffix.lower())
    if driver is None:
        expected = f"a name that ends in .xtf, {', '.join(FORMATS)}"
        raise InputError("unknown format", field="--output", found=target.name, expected=expected)
    check_is_result(result_folder)
    file, name, words, columns = _LAYERS[layer]
    frame = read_layer(result_folder / file, name, columns)
    if frame is None:
        expected = f"layer {name} in {file}"
        raise InputError(f"this result has no {words}", file=result_folder, expected=expected)
    if frame.crs is None or frame.crs.is_engineering:
        raise InputError(
            f"{driver.removeprefix('LIB')} needs coordinates on the Earth",
            file=result_folder / file, found="local coordinates", expected="a coordinate system",
        )  # fmt: skip
    frame = frame.to_crs(4326)
    if layer == "paths":
        fill = [_PATH] * len(frame)
    else:
        colour = {c.label: c.colour for c in level_classes(result_folder)}
        fill = [colour.get(label, "#808080") for label in frame["label"]]
    if driver == "LIBKML":
        shown, options = _as_kml(frame, layer, fill), {}
    else:
        zone = {"stroke": _OUTLINE, "fill": fill, "fill-opacity": _OPACITY}
        shown = frame.assign(**({"stroke": fill} if layer == "paths" else zone))
        options = {"RFC7946": "YES"}
    with staged_file(target, overwrite) as work:
        pyogrio.write_dataframe(
            shown, work, layer=words, driver=driver, layer_options=options,
            geometry_type=None if len(shown) else "Unknown",
        )  # fmt: skip
        if driver == "LIBKML":
            lines = work.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = (line for line in lines if not line.lstrip().startswith(_REPEATED))
            work.write_text("".join(kept), encoding="utf-8")
    return f"Wrote {target}: {len(shown)} {words}, WGS 84."


def _as_kml(frame: gpd.GeoDataFrame, layer: str, fill: list[str]) -> gpd.GeoDataFrame:
    """Return columns under readable names with their units, and what KML has elements for."""
    names = {c: _readable(c) for c in frame.columns if c != frame.geometry.name}
    shown = frame.rename(columns=names)
    if layer == "paths":
        name = frame["area"] + ", " + frame["scenario"]
        own = {"altitudeMode": "absolute", _STYLE: [f"PEN(c:{c}ff,w:2px)" for c in fill]}
    else:
        alpha = f"{round(255 * _OPACITY):02x}"
        name = frame["label"]
        own = {_STYLE: [f"BRUSH(fc:{c}{alpha});PEN(c:{_OUTLINE}ff,w:1px)" for c in fill]}
    # Whole numbers of 64 bits would be texts in KML.
    numbers = {
        c: [float(f"{v:.6g}") for v in np.asarray(shown[c], float)]
        for c in shown.select_dtypes("number").columns
    }
    return shown.assign(Name=name, **own, **numbers)


_UNITS = {"m2": "m²", "m": "m", "kj": "kJ", "mps": "m/s", "kg": "kg"}


def _readable(column: str) -> str:
    """Name ``max_energy_kj`` as "max energy (kJ)"."""
    words = column.split("_")
    unit = _UNITS.get(words[-1]) if len(words) > 1 else None
    return " ".join(words) if unit is None else f"{' '.join(words[:-1])} ({unit})"
