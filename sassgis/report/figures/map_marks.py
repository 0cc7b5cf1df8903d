"""Marks on maps next to their values: zones, release, fall lines, control lines, objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from sassgis.grid import Bounds, FloatArray
from sassgis.report.figures.style import BLUE, INK, SMALL, beside, halo, text_width_pt
from sassgis.settings.languages import named, phrase, translated
from sassgis.settings.results import RasterClass, thousands
from sassgis.settings.styles import ASSESSED_STYLE, BARRIER_STYLE, EDIT_STYLE

#: Name, kind ("station", or of a barrier) and line on the map, shape (n, 2), of a control line.
MapControlLine = tuple[str, str, FloatArray]

#: Name of an exposed object and its geometry.
MapObject = tuple[str, Any]

#: Names of objects beyond this number hide the map.
MAX_OBJECT_NAMES = 30
#: Fall lines beyond this number hide the layer; an even choice of them is drawn.
MAX_LINES = 120

_OBJECT = "#5a4632"
#: As on the map in QGIS.
_BARRIER = BARRIER_STYLE.symbol.colour
_EDIT = EDIT_STYLE.symbol.outline
_ASSESSED = ASSESSED_STYLE.symbol.outline
#: Maps let a little of the relief through.
LAYER_ALPHA = 0.8
_CONTROL_LINE_LINE = {
    "station": (BLUE, "--", 1.4),
    "wall": (_BARRIER, "-", 2.2),
    "net": (_BARRIER, ":", 2.2),
    "gallery": (_BARRIER, "--", 2.2),
}


@dataclass(frozen=True, slots=True)
class MapName:
    """A name next to a place of a map, so many points from it, and its look."""

    text: str
    at: tuple[float, float]
    gap_pt: float
    look: Mapping[str, Any]
    needed: bool = False


@dataclass(frozen=True, slots=True)
class MapMarks:
    """Marks over the values of a map; coordinates in m, of shape (n, 2)."""

    # Outlines of the release areas; arrays of one or two rows are drawn as points.
    release: Sequence[FloatArray] = ()
    # Fall lines. Of more than MAX_LINES an even choice is drawn, and the map says so.
    lines: Sequence[FloatArray] = ()
    control_lines: Sequence[MapControlLine] = ()
    # From the lowest class, in place of the cells of a map of classes.
    zones: Sequence[tuple[Any, RasterClass]] = ()
    edits: Sequence[FloatArray] = ()  # outlines of what was edited by hand
    assessed: Sequence[FloatArray] = ()  # outlines of what was assessed completely
    objects: Sequence[MapObject] = ()
    names: Sequence[MapName] = ()  # of what is drawn otherwise

    def draw(self, ax: Axes, box: Bounds) -> None:
        """Draw all of it on a map but the names."""
        draw_zones(ax, self.zones)
        dashes = {"linewidths": 1.6, "linestyles": "--", "zorder": 4.5}
        _outlines(ax, self.assessed, _ASSESSED, **dashes, gid="assessed")
        _outlines(ax, self.edits, _EDIT, **dashes, gid="edits")
        draw_control_lines(ax, self.control_lines)
        draw_objects(ax, self.objects, box)
        if self.lines:
            draw_lines(ax, [self.lines[i] for i in even_choice(len(self.lines), MAX_LINES)])
        draw_release(ax, self.release)

    def write_names(self, ax: Axes, box: Bounds, points_per_metre: float) -> None:
        """Write the names of what is drawn, at the scale at which it is drawn."""
        names = list(self.names)
        for name, kind, xy in self.control_lines:
            seen = shapely.get_coordinates(shapely.clip_by_rect(shapely.linestrings(xy), *box))
            if seen.size:
                names.append(line_name(name, seen, color=_CONTROL_LINE_LINE[kind][0]))
        if len(self.objects) <= MAX_OBJECT_NAMES:
            names += object_names(self.objects, box)
        _write_names(ax, names, box, points_per_metre)

    def key(self, box: Bounds) -> str:
        """Say in words what the marks on a map are."""
        kinds = {kind for _, kind, _ in self.control_lines}
        dimensions = {int(shapely.get_dimensions(geometry)) for _, geometry in self.objects}
        parts = {
            "black outline or triangle: release area": all_points(self.release).size,
            "thin black lines: fall lines": self.lines,
            "black dashes: assessed area": any(
                shapely.LinearRing(ring).intersects(shapely.box(*box)) for ring in self.assessed
            ),
            "pink dashes: edited by hand": self.edits,
            "blue dashes: station": "station" in kinds,
            "green line: wall": "wall" in kinds,
            "green dots: net": "net" in kinds,
            "green dashes: gallery": "gallery" in kinds,
            "brown: buildings and people": dimensions - {1},
            "white with a brown edge: roads and lines": 1 in dimensions,
        }
        text = "; ".join(translated(part) for part, there in parts.items() if there)
        return f"{text[:1].upper()}{text[1:]}." if text else ""

    def left_out(self) -> str:
        """Say what is not drawn of many fall lines."""
        if len(self.lines) <= MAX_LINES:
            return ""
        return phrase("{} fall lines of {} are drawn.", MAX_LINES, thousands(len(self.lines)))


def even_choice(n: int, most: int) -> list[int]:
    """Return positions of at most ``most`` of n things, evenly spread."""
    return list(np.unique(np.linspace(0, n - 1, min(n, most)).astype(int)))


def all_points(arrays: Sequence[FloatArray]) -> FloatArray:
    """Return all coordinates of several arrays of shape (n, 2), one below the other."""
    parts = [np.asarray(a, float).reshape(-1, 2) for a in arrays]
    return np.concatenate(parts) if parts else np.empty((0, 2))


def _outlines(ax: Axes, rings: Sequence[FloatArray], colour: str, **how: Any) -> None:
    ax.add_collection(
        PolyCollection(rings, closed=True, facecolors="none", edgecolors=colour, **how)
    )


def fill_of(entry: RasterClass) -> str:
    """Return the colour of a class: hatched ones are striped on white."""
    return "white" if entry.hatched else entry.colour


def draw_areas(ax: Axes, polygons: Sequence[Any], **how: Any) -> None:
    """Draw polygons with their holes as one shape."""
    rings = [ring for polygon in polygons for ring in shapely.get_rings(polygon)]
    if rings:
        paths = (Path(shapely.get_coordinates(ring), closed=True) for ring in rings)
        # Not add_patch, which looks for the limits of every curve: a map has limits of its own.
        ax.add_artist(PathPatch(Path.make_compound_path(*paths), **({"zorder": 2} | how)))


def draw_zones(ax: Axes, zones: Sequence[tuple[Any, RasterClass]]) -> None:
    """Draw zones in the colours of their classes, with thin dark outlines."""
    for polygon, entry in zones:
        hatch: dict[str, Any] = {"hatch": "////", "ec": entry.colour} if entry.hatched else {}
        look = {"fc": fill_of(entry), "lw": 0.0, "alpha": LAYER_ALPHA, **hatch}
        draw_areas(ax, [polygon], gid="zone", **look)
        draw_areas(ax, [polygon], fc="none", ec=INK, lw=0.6, zorder=4)


def draw_release(ax: Axes, areas: Sequence[FloatArray]) -> None:
    """Draw release areas as outlines and release points as small triangles."""
    rings = [np.asarray(a, float) for a in areas if len(a) >= 3]
    loose = all_points([a for a in areas if len(a) < 3])
    if rings:
        _outlines(ax, rings, "white", linewidths=2.4, zorder=6)
        _outlines(ax, rings, INK, linewidths=1.0, zorder=7, gid="release-areas")
    if loose.size:
        draw_points(ax, loose, "^", 3.5, fill=INK, edge="white", width=0.4, zorder=7,
                    gid="release-points")  # fmt: skip


def draw_points(
    ax: Axes, xy: FloatArray, mark: str, size: float, fill: str, edge: str, width: float, **how: Any
) -> None:
    """Draw points as filled marks with an edge."""
    ax.plot(*xy.T, mark, ms=size, mfc=fill, mec=edge, mew=width, **how)


def draw_objects(ax: Axes, objects: Sequence[MapObject], box: Bounds) -> None:
    """Draw exposed objects: areas and points filled, roads and lines pale with a dark edge."""
    for _, geometry in objects:
        for part in shapely.get_parts(shapely.clip_by_rect(geometry, *box)):
            xy = shapely.get_coordinates(part)
            if isinstance(part, shapely.Polygon):
                ax.fill(xy[:, 0], xy[:, 1], fc=_OBJECT, ec="white", lw=0.5, zorder=6)
            elif isinstance(part, shapely.Point):
                draw_points(
                    ax=ax,
                    xy=xy,
                    mark="D",
                    size=3.5,
                    fill=_OBJECT,
                    edge="white",
                    width=0.4,
                    zorder=6,
                )
            else:
                ax.plot(*xy.T, color=_OBJECT, lw=2.4, zorder=5.5)
                ax.plot(*xy.T, color="white", lw=1.2, zorder=5.6)


def object_names(objects: Sequence[MapObject], box: Bounds) -> list[MapName]:
    """Return the names of exposed objects, at the longest part of each that is seen."""
    names = []
    for name, geometry in objects:
        seen = shapely.get_parts(shapely.clip_by_rect(geometry, *box))
        if not seen.size or seen[0].is_empty:
            continue
        longest = max(seen, key=lambda part: part.length)
        line = shapely.get_dimensions(longest) == 1
        at = longest.interpolate(0.3, normalized=True) if line else longest.centroid
        look = {"size": SMALL - 1.0, "color": _OBJECT, "zorder": 21, "gid": "object"}
        names.append(MapName(name, (at.x, at.y), 4.0, look))
    return names


def _write_names(ax: Axes, names: Sequence[MapName], box: Bounds, points_per_metre: float) -> None:
    """Write names where they overlap no earlier one; without room only if they are needed."""
    taken: list[Bounds] = []
    width, height = ((box[k + 2] - box[k]) * points_per_metre for k in (0, 1))
    for name in names:
        wide = text_width_pt(name.text, name.look.get("size", SMALL))
        high, gap = 1.3 * name.look.get("size", SMALL), name.gap_pt
        x, y = ((name.at[k] - box[k]) * points_per_metre for k in (0, 1))
        right = (x + gap, y - high / 2.0), (gap, 0.0), "left", "center"
        left = (x - gap - wide, y - high / 2.0), (-gap, 0.0), "right", "center"
        above = (x - wide / 2.0, y + gap), (0.0, gap), "center", "bottom"
        below = (x - wide / 2.0, y - gap - high), (0.0, -gap), "center", "top"
        sides = [right, left] if x <= width / 2.0 else [left, right]
        rooms = {(*s[0], s[0][0] + wide, s[0][1] + high): s[1:] for s in (*sides, above, below)}
        within = [r for r in rooms if min(r) >= 0.0 and r[2] <= width and r[3] <= height]
        free = [
            (x0, y0, x1, y1)
            for x0, y0, x1, y1 in within
            if not any(x0 < t[2] and t[0] < x1 and y0 < t[3] and t[1] < y1 for t in taken)
        ]
        for room in (free or (within or [*rooms]) * name.needed)[:1]:
            offset, ha, va = rooms[room]
            look = {"path_effects": halo(), "clip_on": True, "annotation_clip": True, **name.look}
            beside(ax, named(name.text), name.at, offset, ha=ha, va=va, **look)
            taken.append(room)


def draw_lines(
    ax: Axes, lines: Sequence[FloatArray], width: float = 0.4, alpha: float = 0.45
) -> None:
    """Draw fall lines."""
    ax.add_collection(
        LineCollection(lines, colors=INK, linewidths=width, alpha=alpha, zorder=5, gid="fall-lines")
    )


def draw_control_lines(ax: Axes, control_lines: Sequence[MapControlLine]) -> None:
    """Draw stations and barriers."""
    for name, kind, xy in control_lines:
        colour, dashes, width = _CONTROL_LINE_LINE[kind]
        ax.plot(*xy.T, "-", color="white", lw=width + 1.6, zorder=8)
        ax.plot(*xy.T, ls=dashes, color=colour, lw=width, zorder=9, gid=f"control_line-{name}")


def line_name(name: str, xy: FloatArray, **look: Any) -> MapName:
    """Return the name of a line across a map, next to its easternmost vertex."""
    x, y = xy[np.argmax(xy[:, 0])]
    look = {"weight": "bold", "zorder": 22, **look}
    return MapName(name, (float(x), float(y)), 3.0, look, needed=True)
