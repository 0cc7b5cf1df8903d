"""Coordinate systems: read from text, named for people, compared."""

from __future__ import annotations

import re
import warnings

import pyproj
from pyproj.exceptions import CRSError

from sassgis.errors import InputError


def parse_crs(text: str, *, file: object = None, field: str = "") -> pyproj.CRS:
    """Return a coordinate system from a code or well-known text; InputError if not understood."""
    try:
        return pyproj.CRS.from_user_input(text)
    except CRSError:
        raise InputError(
            "is no coordinate system", file=file, field=field or None,
            found=repr(text if len(text) < 60 else text[:57] + "..."),
            expected="a code such as EPSG:2056",
        ) from None  # fmt: skip


def crs_name(wkt: str) -> str:
    """Return the name of a coordinate system for people, with its code where it has one."""
    if not wkt:
        return "local coordinates"
    crs = pyproj.CRS.from_wkt(wkt)
    authority = crs.to_authority(min_confidence=90)
    return f"{crs.name} ({':'.join(authority)})" if authority else str(crs.name)


def crs_parts(crs: pyproj.CRS) -> tuple[pyproj.CRS, pyproj.CRS | None]:
    """Return the horizontal and vertical part of a coordinate system."""
    if crs.is_compound:
        return crs.sub_crs_list[0], crs.sub_crs_list[1]
    return crs, None


def same_crs(one: pyproj.CRS, other: pyproj.CRS) -> bool:
    """Return whether two coordinate systems put points in the same place, however spelled."""
    if one.equals(other, ignore_axis_order=True):
        return True
    codes = (one.to_epsg(), other.to_epsg())
    if None not in codes:
        return codes[0] == codes[1]
    # Files written by other programs leave codes and names of the projection out.
    return _fingerprint(one) == _fingerprint(other)


def _fingerprint(crs: pyproj.CRS) -> tuple[object, ...]:
    """Return the projection with its numbers, and the datum."""
    base = crs.source_crs if crs.is_bound and crs.source_crs is not None else crs
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what PROJ strings lose, the datum adds
        projection = sorted((k, str(v)) for k, v in base.to_dict().items())
    datum = "" if base.datum is None else str(base.datum.name).lower()
    return (*projection, re.sub(r"^d_|ensemble|[^a-z0-9]", "", datum))
