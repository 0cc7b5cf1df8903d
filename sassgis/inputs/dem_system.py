"""The coordinate and height system of a terrain model: metres in plan, in the place it says."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import pyproj
from pyproj.exceptions import CRSError, ProjError

from sassgis.errors import InputError, notice
from sassgis.grid import Bounds
from sassgis.settings.crs import crs_parts, parse_crs, same_crs
from sassgis.settings.schema import Input

#: What is wrong with a terrain model that states no coordinate system.
NO_SYSTEM = "has no coordinate system"
#: What the settings are called as options of commands that read no configuration.
_AS_OPTIONS = {"terrain.override_crs": "--override-crs", "terrain.crs": "--crs"}

#: Outside the area of use of a coordinate system by more than this, a warning is due (degrees).
_AREA_MARGIN_DEG = 1.0
#: Departure of the map scale from 1 that draws a warning, and that is refused.
_SCALE_WARNING, _SCALE_ERROR = 0.005, 0.05


def dem_system(
    dataset: Any,
    file: Input,
    configured: str | None,
    configured_datum: str | None,
    bounds: Bounds,
    override: bool = False,
) -> tuple[pyproj.CRS | None, str, float]:
    """Return horizontal system (None: local), height system's name, metres per unit of height."""
    wrong = partial(InputError, file=file, field="terrain.crs")
    local = configured is not None and configured.strip().lower() == "local"
    stated = None if override else _stated_crs(dataset, file)
    wanted = None
    if configured is not None and not local:
        wanted = parse_crs(configured, file=file, field="terrain.crs")
    if stated is None and configured is None:
        found = None
        if isinstance(file, Path) and (beside := file.with_suffix(".prj")).exists():
            found = f"{beside.name}, which states none that is understood"
        expected = 'its system as terrain.crs, such as "EPSG:2056" (or "local")'
        raise wrong(NO_SYSTEM, found=found, expected=expected)
    agree = wanted is None or stated is None or same_crs(crs_parts(stated)[0], crs_parts(wanted)[0])
    if stated is not None and (local or not agree):
        raise wrong(
            "the coordinate systems of the file and of terrain.crs differ",
            found=f"{stated.name} in the file, {configured} as terrain.crs",
            expected="the same; if that of the file is wrong: terrain.override_crs as well",
        )
    if stated is None and local:
        return None, configured_datum or "", 1.0
    full = stated if stated is not None else wanted
    assert full is not None
    plane, vertical = crs_parts(full)
    if vertical is None and wanted is not None:
        vertical = crs_parts(wanted)[1]
    _check_plane(plane, file, bounds)
    datum, unit = _height_system(vertical, configured_datum, file)
    return plane, datum, unit


def extent_text(west: float, south: float, east: float, north: float) -> str:
    """Return an extent in words."""
    return f"x {west:.10g} to {east:.10g}, y {south:.10g} to {north:.10g}"


def beyond_degrees(west: float, south: float, east: float, north: float) -> bool:
    """Return whether coordinates cannot be longitudes and latitudes."""
    return max(abs(west), abs(east)) > 360.0 or max(abs(south), abs(north)) > 90.0


def in_options(text: str) -> str:
    """Word a message about settings for the options of commands without a configuration."""
    for setting, option in _AS_OPTIONS.items():
        text = text.replace(setting, option)
    return text


def _stated_crs(dataset: Any, file: Input) -> pyproj.CRS | None:
    if not dataset.crs:
        return None
    try:
        crs = pyproj.CRS.from_user_input(dataset.crs)
    except CRSError:
        raise InputError(
            "has a coordinate system that is not understood",
            file=file,
            expected="a known one: terrain.crs with terrain.override_crs",
        ) from None
    # Nameless local systems say nothing about where the raster lies.
    return None if crs.is_engineering else crs


def _check_plane(plane: pyproj.CRS, file: Input, bounds: Bounds) -> None:
    """Refuse what cannot be measured in metres, or cannot be where it says it is."""
    metres = "a projected system in metres"
    wrong = partial(InputError, file=file, field="terrain.crs")
    west, south, east, north = bounds
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    extent = extent_text(*bounds)
    in_degrees = not beyond_degrees(*bounds)
    if plane.is_geographic:
        if not in_degrees:
            raise wrong(
                "coordinates cannot be degrees: the file is probably tagged with the wrong system",
                found=f"{plane.name} with {extent}",
                expected="its true, projected system: terrain.crs with terrain.override_crs",
            )
        to_utm = f"{metres}: rio warp FILE NEW --dst-crs EPSG:{_utm(x, y)}"
        raise wrong("is in degrees", found=str(plane.name), expected=to_utm)
    if not plane.is_projected:
        found = str(plane.name)
        raise wrong("has no projected coordinate system", found=found, expected=metres)
    for axis in plane.axis_info[:2]:
        if abs(axis.unit_conversion_factor - 1.0) > 1e-9:
            raise wrong(
                "coordinates are not in metres",
                found=f"{plane.name} in {axis.unit_name}",
                expected=f"{metres}: rio warp FILE NEW --dst-crs EPSG:...",
            )
    if in_degrees:
        raise wrong(
            "coordinates look like degrees, yet the file is tagged with a system in metres",
            found=f"{plane.name} with {extent}",
            expected=f"{metres}; if it is in degrees: rio edit-info FILE --crs EPSG:4326, then "
            "rio warp FILE NEW --dst-crs EPSG:...",
        )
    _check_place(plane, file, x, y, extent)


def _utm(lon: float, lat: float) -> int:
    zone = min(60, max(1, math.floor((lon + 180.0) / 6.0) + 1))
    return (32600 if lat >= 0.0 else 32700) + zone


def _check_place(plane: pyproj.CRS, file: Input, x: float, y: float, extent: str) -> None:
    """Check that coordinates belong to the system, and that its metres are metres on the ground."""
    wrong = partial(InputError, file=file, field="terrain.crs")
    base = plane.source_crs if plane.is_bound and plane.source_crs is not None else plane
    try:
        proj = pyproj.Proj(base)
        lon, lat = proj(x, y, inverse=True)
        factors = proj.get_factors(lon, lat)
        scale = max(factors.meridional_scale, factors.parallel_scale, key=lambda k: abs(k - 1.0))
    except ProjError:
        lon = lat = scale = math.inf
    if not (math.isfinite(lon) and math.isfinite(lat)):
        raise wrong(
            "coordinates do not belong to its coordinate system",
            found=f"{plane.name} with {extent}",
            expected="coordinates on the Earth; the file is probably tagged with the wrong system",
        )
    area = _area_of_use(base)
    if area is not None:
        beyond = max(area.south - lat, lat - area.north, 0.0)
        width = (area.east - area.west) % 360.0 or 360.0
        past = (lon - area.west) % 360.0
        beyond = max(beyond, min(past - width, 360.0 - past) if past > width else 0.0)
        if beyond > _AREA_MARGIN_DEG:
            notice(
                f"{file}: lies {beyond:.1f} degrees outside the area of use of {plane.name} "
                f"({area.name.rstrip('.')}); the coordinate system may be wrong"
            )
    if abs(scale - 1.0) > _SCALE_ERROR:
        raise wrong(
            "map metres are not metres on the ground",
            found=f"{plane.name} with scale {scale:.3f} at the DEM",
            expected=f"a system true to scale: rio warp FILE NEW --dst-crs EPSG:{_utm(lon, lat)}",
        )
    if abs(scale - 1.0) > _SCALE_WARNING:
        notice(f"{file}: a metre in {plane.name} is {1.0 / scale:.4f} m on the ground at the DEM")


def _area_of_use(crs: pyproj.CRS) -> Any:
    """Return the area of use; files do not carry it, but their codes lead to it."""
    code = crs.to_epsg()
    return crs.area_of_use or (None if code is None else pyproj.CRS.from_epsg(code).area_of_use)


def _height_system(
    vertical: pyproj.CRS | None, configured: str | None, file: Input
) -> tuple[str, float]:
    if vertical is None:
        return configured or "", 1.0
    name = str(vertical.name)
    if configured and configured.lower() not in name.lower():
        notice(
            f"{file}: height system {name!r} of the file is used, not {configured!r} as configured"
        )
    axis = vertical.axis_info[0] if vertical.axis_info else None
    if axis is not None and axis.direction.lower() == "down":
        raise InputError(
            "holds depths, positive downwards", file=file, field="terrain.vertical_datum",
            found=name, expected="heights, positive upwards",
        )  # fmt: skip
    return name, 1.0 if axis is None else float(axis.unit_conversion_factor)
