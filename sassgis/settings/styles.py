"""How layers look in QGIS: one description, used in every place that QGIS reads.

``raster_style`` and ``vector_style`` make XML of it (of QGIS 3.22; later versions read it) for the
``.qml`` next to a raster, the ``layer_styles`` table of the GeoPackage and the project.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import Literal

from sassgis.settings.languages import phrase, translated
from sassgis.settings.results import RasterClass, thousands
from sassgis.settings.statistics_table import built_in_rows

#: A RasterLayer of heights with this name as its ramp is shown as shaded relief.
HILLSHADE = "hillshade"
#: One with this name is shown as it is in its file, as a base map.
PICTURE = "picture"
#: Maps over the shaded relief let a little of it through.
RASTER_OPACITY = 0.85

SymbolKind = Literal["marker", "line", "fill"]
Hatch = Literal["", "diagonal", "horizontal", "falling"]


@dataclass(frozen=True, slots=True)
class FieldInfo:
    """Meaning of a column."""

    alias: str  # name shown to the reader, without the unit
    unit: str = ""  # empty for none
    description: str = ""
    choices: tuple[str, ...] = ()  # the texts that may stand in it; empty for any
    default: str = ""  # expression of QGIS that gives a new feature its value
    # Limits of a number, both included.
    low: float | None = None
    high: float | None = None
    needed: bool = False  # whether a feature must have a value
    unique: bool = False  # whether no two features may have the same

    @property
    def label(self) -> str:
        """Alias with its unit, as the attribute table and the form show it."""
        if not self.unit:
            return self.alias
        return phrase("{} ({})", phrase(self.alias), phrase(self.unit))


@dataclass(frozen=True, slots=True)
class Symbol:
    """A drawn sign: a marker, a line or a filled area."""

    kind: SymbolKind  # {"marker", "line", "fill"}
    colour: str  # ``#rrggbb`` of the marker, line or filling
    opacity: float = 1.0  # of the filling or line, 0 to 1; outlines are opaque
    size_mm: float = 2.0  # diameter of a marker or width of a line
    outline: str = ""  # ``#rrggbb``; empty for none. Markers and fills only.
    outline_mm: float = 0.2
    # Of a marker: QGIS's name ("circle", "square", "triangle", "diamond", "star", ...).
    shape: str = "circle"
    dash: Literal["solid", "dash", "dot"] = "solid"  # of a line or an outline
    # {"", "diagonal", "horizontal", "falling"}; hatch lines in place of the solid filling: rising
    # to the right, level, falling.
    hatch: Hatch = ""
    # Width of the hatch lines, and from one to the next.
    hatch_mm: float = 0.3
    hatch_step_mm: float = 2.0
    ground: str = ""  # ``#rrggbb`` between the hatch lines, as opaque as they; empty for nothing


@dataclass(frozen=True, slots=True)
class StyleClass:
    """One entry of a legend."""

    label: str
    symbol: Symbol
    value: str | int | None = None  # of a category; None is for all other values
    # Of a range: lower <= value < upper.
    lower: float = -math.inf
    upper: float = math.inf


@dataclass(frozen=True, slots=True)
class VectorStyle:
    """How the features of a layer are drawn."""

    symbol: Symbol  # used as it is by a simple style; gives the kind of geometry in every style
    method: Literal["simple", "categories", "ranges"] = "simple"
    column: str = ""  # whose values choose the class
    classes: tuple[StyleClass, ...] = field(default=())  # ranges ascending
    label_column: str = ""  # whose text is written next to the feature; empty for none
    # Denominator of the smallest scale at which the layer is drawn; 0: at all.
    smallest_scale: float = 0.0

    def __post_init__(self) -> None:
        if (self.method == "simple") != (not self.classes):
            raise ValueError("classes are for the methods 'categories' and 'ranges', and needed")
        if self.classes and not self.column:
            raise ValueError("classes need the column that chooses them")
        if any(entry.symbol.kind != self.symbol.kind for entry in self.classes):
            raise ValueError("all symbols of a style are of one kind")

    def showing(self, values: Collection[object]) -> VectorStyle:
        """Return the style with the classes of some values only; of none that has a class, all."""
        shown = tuple(entry for entry in self.classes if entry.value in values)
        return replace(self, classes=shown or self.classes)


def class_limits(breaks: Sequence[float]) -> list[tuple[float, float]]:
    """Return the lower and upper limits of the classes that ascending ``breaks`` make.

    A limit belongs to the class above: lower <= value < upper. The first class is open below, the
    last above. A first break of zero opens no class below itself, as nothing that is mapped is
    negative. ValueError if the breaks do not ascend or there are none.
    """
    if not breaks or any(not low < high for low, high in pairwise(breaks)):
        raise ValueError(f"class limits must ascend: {tuple(breaks)}")
    edges = [*breaks, math.inf] if breaks[0] == 0 else [-math.inf, *breaks, math.inf]
    return list(pairwise(float(edge) for edge in edges))


def class_labels(breaks: Sequence[float], unit: str) -> list[str]:
    """Return legend texts of the classes of :func:`class_limits`, with the unit."""
    return [_range_label(low, high, unit) for low, high in class_limits(breaks)]


def class_colours(breaks: Sequence[float], ramp: str) -> list[str]:
    """Return colours (``#rrggbb``) of the classes of :func:`class_limits`.

    They are spread over the ramp from end to end, the class below the first break included even
    where zero as the first break leaves it out: so the palest end of a ramp can be avoided.
    ValueError as of that function and of :func:`ramp_colours`.
    """
    return ramp_colours(ramp, len(breaks) + 1)[-len(class_limits(breaks)) :]


def class_tint(entry: RasterClass) -> str:
    """Return colour (``#rrggbb``) of a class on a raster, where no lines can be drawn.

    That of a hatch is half white, as it looks from afar.
    """
    if not entry.hatched:
        return entry.colour.lower()
    return "#" + "".join(f"{round((255 + part) / 2):02x}" for part in rgb(entry.colour))


def class_name(entry: RasterClass) -> str:
    """Return legend text of a class on a raster; it says where a pale tint represents a hatch."""
    return translated(phrase("{} (pale)", phrase(entry.label))) if entry.hatched else entry.label


def with_unit(text: str, unit: str) -> str:
    """Return a text with its unit, if it has one."""
    return phrase("{} {}", text, phrase(unit)) if unit and unit != "1" else text


def _range_label(low: float, high: float, unit: str) -> str:
    first, last = (f"{x:g}" if abs(x) < 1000.0 else thousands(x) for x in (low, high))
    if math.isinf(low):
        return with_unit(f"< {last}", unit)
    if math.isinf(high):
        return with_unit(f"≥ {first}", unit)
    return with_unit(f"{first} – {last}", unit)


def zero_is_nothing(unit: str) -> bool:
    """Return whether a value of 0 in this unit stays clear on the map.

    A passing height of 0 m is a block that rolls; a count, probability or energy of 0 is no block.
    """
    return unit != "m"


def categorised_style(
    symbol: Symbol,
    column: str,
    entries: Mapping[str | int, tuple[str, str]],
    smallest_scale: float = 0.0,
) -> VectorStyle:
    """Return one colour per value: the symbol in that of its entry (label, ``#rrggbb``)."""
    return VectorStyle(
        symbol=symbol, method="categories", column=column,
        classes=tuple(
            StyleClass(label, replace(symbol, colour=colour), value=value)
            for value, (label, colour) in entries.items()
        ),
        smallest_scale=smallest_scale,
    )  # fmt: skip


RELEASE_AREA_STYLE = VectorStyle(
    # No filling: it would tint the zones under it.
    Symbol("fill", "#6a3d9a", opacity=0.0, outline="#4a1486", outline_mm=0.5),
    label_column="name",
)
#: Single points and lines would run into one another on smaller scales.
SINGLE_SCALE = 25_000.0
#: Over zones, whose colours and outlines stay to be seen.
EDIT_STYLE = VectorStyle(
    Symbol("fill", "#d01c8b", opacity=0.0, outline="#d01c8b", outline_mm=0.7, dash="dash")
)
#: The perimeter of what was assessed completely.
ASSESSED_STYLE = VectorStyle(
    Symbol("fill", "#222222", opacity=0.0, outline="#222222", outline_mm=0.6, dash="dash")
)
#: Where a zone is open: a broad line in magenta, which no level has.
OPEN_LIMIT_STYLE = VectorStyle(Symbol("line", "#d400aa", size_mm=1.2))
#: Where blocks came at all: thinner than any limit of a zone.
REACHED_STYLE = VectorStyle(
    Symbol("fill", "#404040", opacity=0.0, outline="#404040", outline_mm=0.15, dash="dot")
)
#: An envelope, and no zone either.
ENERGY_LINE_STYLE = VectorStyle(
    Symbol("fill", "#e66100", opacity=0.0, outline="#e66100", outline_mm=0.5, dash="dash")
)
RELEASE_POINT_STYLE = VectorStyle(
    Symbol("marker", "#6a3d9a", size_mm=1.6, outline="#ffffff", outline_mm=0.15, shape="triangle"),
    smallest_scale=SINGLE_SCALE,
)
FALL_LINE_STYLE = VectorStyle(
    Symbol("line", "#404040", opacity=0.7, size_mm=0.2), smallest_scale=SINGLE_SCALE
)
STOP_STYLE = VectorStyle(
    Symbol("marker", "#1a1a1a", opacity=0.8, size_mm=1.2, outline="#ffffff", outline_mm=0.1),
    smallest_scale=SINGLE_SCALE,
)
STATION_STYLE = VectorStyle(
    Symbol("line", "#08519c", size_mm=0.5, dash="dash"), label_column="name"
)
_WALL = Symbol("line", "#00441b", size_mm=1.2)
BARRIER_STYLE = VectorStyle(
    _WALL, "categories", "kind",
    (
        StyleClass("wall", _WALL, value="wall"),
        StyleClass("net", replace(_WALL, dash="dot"), value="net"),
        StyleClass("gallery", replace(_WALL, dash="dash"), value="gallery"),
    ),
    label_column="name",
)  # fmt: skip
FOOTPRINT_STYLE = VectorStyle(
    Symbol("fill", "#e31a1c", opacity=0.4, outline="#b10026", outline_mm=0.1)
)


# Tables of 256 colours as matplotlib 3.10 makes them: Blues, BuPu, RdBu, RdPu, YlGnBu and YlOrRd by
# ColorBrewer (Brewer 2002), plasma and viridis by Smith and van der Walt (2015). A name with ``_r``
# at its end is the same ramp reversed. YlOrRdBk is YlOrRd with a fifth more, towards black.
@cache
def _ramps() -> Mapping[str, tuple[str, ...]]:
    rows = list(built_in_rows("ramps"))
    return {name: tuple(row[name] for row in rows) for name in rows[0]}


def ramp_colours(ramp: str, count: int) -> list[str]:
    """Return colours (``#rrggbb``) evenly along a ramp; ValueError if there is no such ramp."""
    ramps = _ramps()
    name = ramp.removesuffix("_r")
    if name not in ramps:
        raise ValueError(f"there is no colour ramp {ramp!r}, only {', '.join(ramps)}")
    colours = ramps[name] if name == ramp else ramps[name][::-1]
    steps = max(count - 1, 1)
    return [colours[min(256 * place // steps, 255)] for place in range(count)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue (0 to 255) of a colour ``#rrggbb``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
