"""Where blocks start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class ReleaseArea:
    """A place from which blocks start."""

    name: str  # unique in the run; random draws hang on it
    geometry: Any  # shapely geometry; polygons, lines or points in the coordinates of the DEM (m)
    scenarios: tuple[str, ...]  # names of the block scenarios that start here
    # Share of it (of its area, length or points) where heights are known: only there blocks start.
    known: float = 1.0
