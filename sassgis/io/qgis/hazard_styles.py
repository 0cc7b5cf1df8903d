"""Ready styles of hazard zones: levels, intensities, what barriers change, what is undecided.

Colours and names are those of the preset. Levels are not told apart by colour alone: a level that
the preset calls hatched is drawn as stripes on white.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from sassgis.core.hazard import HazardLevel, IntensityClass
from sassgis.core.results import RasterClass
from sassgis.io.qgis.styles import StyleClass, Symbol, VectorStyle

#: Zones let the terrain through, and what is drawn below them.
ZONE_OPACITY = 0.7
_ZONE = Symbol("fill", "#808080", opacity=ZONE_OPACITY, outline="#4d4d4d", outline_mm=0.25)

#: What barriers make of the level of a place: label and colour. Green and purple stand apart for
#: all common kinds of colour vision, and are no colours of levels.
LEVEL_CHANGES: Mapping[str, tuple[str, str]] = {
    "lower": ("Lower level", "#1b7837"),
    "same": ("Same level", "#f7f7f7"),
    "higher": ("Higher level", "#762a83"),
}


def zone_symbol(colour: str, *, hatched: bool = False) -> Symbol:
    """The sign of a zone: filled, or striped on white if hatched."""
    if not hatched:
        return replace(_ZONE, colour=colour)
    return replace(
        _ZONE, colour=colour, hatch="diagonal", hatch_mm=0.9, hatch_step_mm=2.0, ground="#ffffff"
    )


def hazard_level_style(column: str, levels: Sequence[HazardLevel]) -> VectorStyle:
    """Zones in the colours of their hazard level, the most severe first in the legend.

    Parameters
    ----------
    column : str
        Holds the code of the level, as "slight".
    levels : sequence of HazardLevel
        From slight to severe, as ``HazardPreset.levels``.

    Returns
    -------
    VectorStyle
        Hatched levels as stripes on white; a code that is no level is not drawn.
    """
    return _zones(column, [(v.code, v.label, v.colour, v.hatched) for v in levels])


def intensity_style(column: str, classes: Sequence[IntensityClass]) -> VectorStyle:
    """Areas in the colours of their intensity, the strongest first in the legend.

    Parameters
    ----------
    column : str
        Holds the code of the class, as "mean".
    classes : sequence of IntensityClass
        From weak to strong, as ``HazardPreset.intensities``.

    Returns
    -------
    VectorStyle
        The limits (kJ) are in the labels.
    """
    return _zones(
        column,
        [
            (entry.code, label, entry.colour, False)
            for entry, label in zip(classes, intensity_labels(classes), strict=True)
        ],
    )


def intensity_labels(classes: Sequence[IntensityClass]) -> list[str]:
    """Names of the classes with their limits, as "mean (30 – 300 kJ)".

    Parameters
    ----------
    classes : sequence of IntensityClass
        From weak to strong.

    Returns
    -------
    list of str
        In the order given. The lower limit belongs to the class.
    """
    out = []
    for place, entry in enumerate(classes):
        following = classes[place + 1].from_kj if place + 1 < len(classes) else None
        if following is None:
            limits = f"≥ {entry.from_kj:g} kJ"
        elif entry.from_kj == 0.0:
            limits = f"< {following:g} kJ"
        else:
            limits = f"{entry.from_kj:g} – {following:g} kJ"
        out.append(f"{entry.label} ({limits})")
    return out


def level_classes(levels: Sequence[HazardLevel]) -> tuple[RasterClass, ...]:
    """Classes of a raster of levels: 1 is the slightest."""
    return tuple(
        RasterClass(number, level.label, level.colour, level.hatched)
        for number, level in enumerate(levels, start=1)
    )


def intensity_classes(classes: Sequence[IntensityClass]) -> tuple[RasterClass, ...]:
    """Classes of a raster of intensities: 1 is the weakest; limits (kJ) in the labels."""
    return tuple(
        RasterClass(number, label, entry.colour)
        for number, (entry, label) in enumerate(
            zip(classes, intensity_labels(classes), strict=True), start=1
        )
    )


def level_change_style(column: str) -> VectorStyle:
    """Areas by what barriers make of their level.

    Parameters
    ----------
    column : str
        Holds "higher", "same" or "lower" (:data:`LEVEL_CHANGES`).

    Returns
    -------
    VectorStyle
    """
    return _zones(
        column,
        [(code, label, colour, False) for code, (label, colour) in LEVEL_CHANGES.items()],
    )


def undecided_style() -> VectorStyle:
    """Fine black lines over places whose level the sample of rocks does not settle.

    They fall to the right, across the stripes of hatched levels.
    """
    return VectorStyle(
        Symbol(
            "fill", "#000000", opacity=0.8, outline="#000000", outline_mm=0.15, hatch="falling",
            hatch_mm=0.15, hatch_step_mm=1.4,
        )
    )  # fmt: skip


def _zones(column: str, entries: Sequence[tuple[str, str, str, bool]]) -> VectorStyle:
    """One symbol per code, listed from the last."""
    return VectorStyle(
        symbol=_ZONE,
        method="categories",
        column=column,
        classes=tuple(
            StyleClass(label, zone_symbol(colour, hatched=hatched), value=code)
            for code, label, colour, hatched in reversed(entries)
        ),
    )
