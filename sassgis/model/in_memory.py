"""Inputs that a caller holds in memory, where a configuration names files."""

from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Literal


@dataclass(frozen=True, slots=True)
class InMemory:
    """A raster, a vector layer or a table in place of a file."""

    name: str  # what messages and reports call it
    kind: Literal["raster", "layer", "table"]
    digest: str  # SHA-256 of its content: equal inputs are equal settings
    # What its reader takes: the bytes of a GeoTIFF, a GeoDataFrame, or the text of a CSV table.
    data: Any = field(compare=False, repr=False)

    #: As of a path, for what only asks for a name.
    suffix = ""

    def __str__(self) -> str:
        return self.name

    @property
    def stem(self) -> str:
        """Its name, as that of a file without suffix."""
        return self.name

    def is_dir(self) -> bool:
        """It is no folder."""
        return False


#: What a setting may name.
Input = Path | InMemory
#: What a caller may give for it.
AnyInput = str | PathLike[str] | InMemory


def named(given: AnyInput) -> Input:
    """A path, or what is in memory as it is."""
    return given if isinstance(given, InMemory) else Path(given)
