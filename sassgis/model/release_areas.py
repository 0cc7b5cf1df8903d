"""Where blocks start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class ReleaseArea:
    """A place from which blocks start.

    Attributes
    ----------
    name : str
        Unique in the run; random draws hang on it.
    geometry : shapely geometry
        Polygons, lines or points in the coordinates of the DEM (m).
    scenarios : tuple of str
        Names of the block scenarios that start here.
    """

    name: str
    geometry: Any
    scenarios: tuple[str, ...]
