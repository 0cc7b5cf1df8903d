"""What an expert sets by hand on a map of hazard zones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from sassgis.model.declared import Example, File, Section, Text, checked

#: Code of places without a level.
NO_LEVEL = "not_in_danger"
#: How an edit bears on what was computed: it replaces it, or the level is no lower, or no higher.
EditLimit = Literal["", "at_least", "at_most"]
LIMIT_TEXT: Mapping[str, str] = {"": "", "at_least": "at least", "at_most": "at most"}


@checked(frozen=True, slots=True)
class EditSettings(Section):
    """What experts have set by hand, kept through every run (docs/zones.md)."""

    file: Annotated[
        File | None,
        "polygons (any vector file) with level, author, date, reason; may be empty; --edits "
        "replaces it",
        Example("edits.gpkg"),
    ] = None
    layer: Annotated[Text | None, "layer of the file, if it has several", Example("edits")] = None


@dataclass(frozen=True, slots=True)
class Edit:
    """A level of a place, or a limit of it, that an expert has set."""

    geometry: Any  # shapely geometry; polygons, in the coordinates of the terrain model
    level: int  # position among the levels of the preset, plus 1; 0 for none
    # Whether the level holds, or only where the computed one is lower, or higher.
    limit: EditLimit
    author: str
    date: str  # as 2026-01-31
    reason: str
    # What was computed there when the edit was made, as ``level_shares`` has it; empty if nobody
    # noted it.
    computed: str = ""

    @property
    def words(self) -> str:
        """Who edited, when and why."""
        return f"{self.author}, {self.date}: {self.reason}"
