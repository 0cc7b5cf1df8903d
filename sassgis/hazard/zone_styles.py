"""Ready styles of hazard zones: levels, intensities, changes by barriers, uncertain levels.

Colours and names are those of the preset. Levels are not distinguished only by colour: a level
that the preset calls hatched is drawn as stripes on white.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from sassgis.settings.hazard_rules import HazardLevel
from sassgis.settings.styles import StyleClass, Symbol, VectorStyle

#: Zones let the terrain through, and what is drawn below them.
ZONE_OPACITY = 0.7
_ZONE = Symbol("fill", "#808080", opacity=ZONE_OPACITY, outline="#4d4d4d", outline_mm=0.25)

#: How barriers change the level of a place: label and colour. Green and purple stand apart for
#: all common kinds of colour vision, and are no colours of levels.
LEVEL_CHANGES: Mapping[str, tuple[str, str]] = {
    "lower": ("Lower level", "#7fbf7b"),
    "same": ("Same level", "#f7f7f7"),
    "higher": ("Higher level", "#762a83"),
}


def zone_symbol(colour: str, *, hatched: bool = False) -> Symbol:
    """Return the sign of a zone: filled, or striped on white if hatched."""
    if not hatched:
        return replace(_ZONE, colour=colour)
    return replace(
        _ZONE, colour=colour, hatch="diagonal", hatch_mm=0.9, hatch_step_mm=2.0, ground="#ffffff"
    )


def hazard_level_style(column: str, levels: Sequence[HazardLevel]) -> VectorStyle:
    """Return zones in the colours of their hazard level, the most severe first in the legend.

    ``column`` holds the code of the level; ``levels`` are from low to high.
    """
    return zone_style(column, [(v.code, v.label, v.colour, v.hatched) for v in levels])


def level_change_style(column: str) -> VectorStyle:
    """Return areas by how barriers change their level: the codes of :data:`LEVEL_CHANGES`."""
    changes = LEVEL_CHANGES.items()
    return zone_style(column, [(code, label, colour, False) for code, (label, colour) in changes])


def uncertain_style() -> VectorStyle:
    """Return fine black lines over uncertain places, falling across the stripes of levels."""
    return VectorStyle(
        Symbol(
            "fill", "#000000", opacity=0.8, outline="#000000", outline_mm=0.15, hatch="falling",
            hatch_mm=0.15, hatch_step_mm=1.4,
        )
    )  # fmt: skip


def open_limit_style() -> VectorStyle:
    """Return a broad line in magenta, which no level has, where a zone is open."""
    return VectorStyle(Symbol("line", "#d400aa", size_mm=1.2))


def zone_style(column: str, entries: Sequence[tuple[str, str, str, bool]]) -> VectorStyle:
    """Make a sign per code, the last first; entries: code, label, ``#rrggbb``, hatched."""
    return VectorStyle(
        symbol=_ZONE,
        method="categories",
        column=column,
        classes=tuple(
            StyleClass(label, zone_symbol(colour, hatched=hatched), value=code)
            for code, label, colour, hatched in reversed(entries)
        ),
    )


def opaque(style: VectorStyle) -> VectorStyle:
    """Return the same style, with nothing shining through."""
    return replace(
        style,
        symbol=replace(style.symbol, opacity=1.0),
        classes=tuple(replace(c, symbol=replace(c.symbol, opacity=1.0)) for c in style.classes),
    )
