"""The slope in its vertical plane with the paths of blocks (Bozzolo and Pamini 1986, Fig. 13)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MultipleLocator
from matplotlib.transforms import Bbox

from sassgis.grid import FloatArray, IntArray
from sassgis.report.figures import style
from sassgis.report.figures.map_marks import draw_points, even_choice
from sassgis.settings.languages import counted, joined, phrase
from sassgis.settings.results import ControlLine, thousands

#: A control line with its chainage (m) and the height of the ground there (m).
ProfileControlLine = tuple[ControlLine, float, float]

#: Paths beyond this number would be a black mass: bands represent them. Paths that make a band.
MAX_PATHS, _ENOUGH = 30, 10
_STRIP_PT = 7.0


@dataclass(frozen=True, slots=True)
class ProfilePanel:
    """Contents of one panel of a profile figure."""

    s: FloatArray  # chainage and height of the vertices of the slope (m), shape (n,)
    z: FloatArray
    # Chainages and heights of the centres of mass (m), shape (m,) of each path.
    trajectories: Sequence[tuple[FloatArray, FloatArray]] = ()
    # Class of the segment that starts at each vertex, shape (n - 1,) or (n,); a last is unused.
    ground: IntArray | None = None
    ground_names: Sequence[str] = ()
    control_lines: Sequence[ProfileControlLine] = ()
    # Chainages where blocks ended (m).
    stops: FloatArray = field(default_factory=lambda: np.empty(0))
    title: str = ""

    def ground_runs(self) -> list[tuple[int, int, int]]:
        """Return stretches of equal ground."""
        return [] if self.ground is None else runs_of(self.ground[: self.s.size - 1])

    def known_stops(self) -> FloatArray:
        """Return stops that have a chainage."""
        stops = np.asarray(self.stops, float)
        return np.asarray(stops[np.isfinite(stops)])

    def caption(self) -> str:
        """Say how many blocks are drawn."""
        n, stops = len(self.trajectories), self.known_stops().size
        paths = ("{} path of the centre of mass", "{} paths of the centre of mass")
        dots = ("yellow dots: where {} block stopped", "yellow dots: where {} blocks stopped")
        parts = [counted(k, *texts, thousands(k)) for texts, k in ((paths, n), (dots, stops)) if k]
        if n > MAX_PATHS:
            text = "{} of them as lines; bands: 50 % and 90 % of the paths"
            parts.insert(1, phrase(text, MAX_PATHS))
        return joined("; ", parts)

    def bands(self) -> tuple[FloatArray, FloatArray]:
        """Return chainages and the 5, 25, 75 and 95 % heights of the paths (m), (n,) and (4, n)."""
        s = np.linspace(self.s[0], self.s[-1], 400)
        rows = [np.interp(s, *path, np.nan, np.nan) for path in self.trajectories if len(path[0])]
        z = np.array(rows)
        known = np.isfinite(z).sum(axis=0) >= _ENOUGH
        heights = np.full((4, s.size), np.nan)
        heights[:, known] = np.nanquantile(z[:, known], (0.05, 0.25, 0.75, 0.95), axis=0)
        return s, heights


def runs_of(ground: IntArray) -> list[tuple[int, int, int]]:
    """Return stretches of equal ground: (class, first segment, last segment + 1)."""
    classes = np.asarray(ground, np.int64)
    if not classes.size:
        return []
    borders = np.concatenate([[0], np.nonzero(np.diff(classes))[0] + 1, [classes.size]])
    return [(int(classes[a]), int(a), int(b)) for a, b in pairwise(borders)]


def _frame(panels: Sequence[ProfilePanel], max_height_in: float) -> tuple[Bbox, float]:
    """Return limits (m) that hold all panels, and metres per typographic point of both axes."""
    s = np.concatenate([p.s for p in panels])
    z = [p.z for p in panels]
    for panel in panels:
        z += [np.asarray(path[1], float) for path in panel.trajectories]
        z.append(np.array([ground + line.height_m for line, _, ground in panel.control_lines]))
    heights = np.concatenate(z)
    s0, s1 = float(s.min()), float(s.max())
    z0, z1 = float(np.nanmin(heights)), float(np.nanmax(heights))
    span, drop = s1 - s0, max(z1 - z0, 0.05 * (s1 - s0))
    width = style.WIDTH_IN - 0.75
    while True:
        metres = span * 1.04 / width
        # Room in points: under the slope for strip and class names, over it for station names.
        below, above = 34.0 * metres / 72.0, 26.0 * metres / 72.0
        height = (drop + below + above) / metres
        if height <= 1.001 * max_height_in:
            break
        # The room for labels does not shrink with the slope.
        width *= max((max_height_in - 60.0 / 72.0) / (height - 60.0 / 72.0), 0.2)
    ends = z0 - below, z0 + drop + above
    return Bbox([[s0 - 0.02 * span, ends[0]], [s1 + 0.02 * span, ends[1]]]), metres / 72.0


def _draw_ground(ax: Axes, panel: ProfilePanel, floor: float) -> None:
    """Draw the slope and the strip of ground classes below it."""
    s, z = panel.s, panel.z
    around = np.column_stack([[s[0], *s, s[-1]], [floor, *z, floor]])
    under = Polygon(around, closed=True, fc="#f4f2ef", ec="none", zorder=1)
    ax.add_patch(under)
    # Thick lines, cut at the slope, keep the strip equally thick on steep ground. Round ends below
    # the square ones fill the wedges that open between two stretches in a hollow.
    for ends, zorder in (("round", 1.5), ("butt", 2.0)):
        for number, a, b in panel.ground_runs():
            (strip,) = ax.plot(
                s[a : b + 1],
                z[a : b + 1],
                color=style.GROUND_COLOURS[number % len(style.GROUND_COLOURS)],
                lw=2.0 * _STRIP_PT,
                solid_capstyle=ends,
                solid_joinstyle="round",
                zorder=zorder,
                gid=f"ground-{number}" if ends == "butt" else None,
            )
            strip.set_clip_path(under)
    ax.plot(s, z, color=style.INK, lw=1.1, zorder=4, gid="slope", solid_joinstyle="round")


def _draw_control_lines(ax: Axes, panel: ProfilePanel, highest: float, pt: float) -> None:
    """Draw stations over the full height, barriers at their true height."""
    stations = [(line, s, z) for line, s, z in panel.control_lines if line.kind == "station"]
    room = np.array([style.text_width_pt(line.name) * pt for line, _, _ in stations])
    top = highest - 13.0 * pt
    bold: dict[str, Any] = {"weight": "bold", "va": "bottom", "zorder": 9}
    placed = style.spread([s for _, s, _ in stations], room)
    for (line, s, z), label in zip(stations, placed, strict=True):
        ax.plot(
            [s, s], [z, top], color=style.BLUE, lw=0.8, ls=(0, (4, 2)), zorder=3,
            gid=f"control_line-{line.name}",
        )  # fmt: skip
        offset = (float((label - s) / pt), 2.0)
        style.beside(ax, line.name, (float(s), top), offset, color=style.BLUE, ha="center", **bold)
    for line, s, z in panel.control_lines:
        if line.kind == "station":
            continue
        dashes = (0, (0.6, 0.35)) if line.kind == "net" else "-"
        along, up = [s, s], [z, z + line.height_m]
        if line.kind == "gallery":
            along.append(s + line.width_m)
            up.append(up[1] - line.width_m * math.tan(math.radians(line.roof_slope_deg)))
        ax.plot(
            along, up, color=style.VERMILION, lw=2.4, ls=dashes, zorder=8,
            solid_capstyle="butt", dash_capstyle="butt", gid=f"control_line-{line.name}",
        )  # fmt: skip
        words = line.described
        at = (float(s), float(z + line.height_m))
        style.beside(
            ax, words, at, (3.0, 3.0), color=style.VERMILION, path_effects=style.halo(1.8), **bold
        )


def _draw_panel(ax: Axes, panel: ProfilePanel, frame: Bbox, pt: float) -> None:
    _draw_ground(ax, panel, frame.y0 - frame.height)
    paths = [np.column_stack(path) for path in panel.trajectories if len(path[0])]
    if len(paths) > MAX_PATHS:
        s, (low, lower, upper, high) = panel.bands()
        ax.fill_between(s, low, high, color=style.SKY, alpha=0.3, lw=0, zorder=4.5, gid="band")
        ax.fill_between(s, lower, upper, color=style.SKY, alpha=0.6, lw=0, zorder=4.6, gid="band")
        paths = [paths[i] for i in even_choice(len(paths), MAX_PATHS)]
    ax.add_collection(
        LineCollection(
            paths, colors=style.INK, linewidths=0.35, alpha=0.6, zorder=5, gid="trajectories"
        ),
        autolim=False,
    )
    stops = panel.known_stops()
    if stops.size:
        dots = np.column_stack([stops, np.interp(stops, panel.s, panel.z)])
        draw_points(
            ax=ax,
            xy=dots,
            mark="o",
            size=3.4,
            fill=style.YELLOW,
            edge=style.INK,
            width=0.4,
            zorder=7,
            gid="stops",
        )
    _draw_control_lines(ax, panel, frame.y1, pt)
    ax.set(xlim=frame.intervalx, ylim=frame.intervaly, aspect="equal")
    ax.set_ylabel("height (m)")
    for axis, span, per_in in ((ax.xaxis, frame.width, 1.4), (ax.yaxis, frame.height, 1.6)):
        step = style.round_step(span, max(3, round(per_in * span / (72.0 * pt))))
        axis.set_major_locator(MultipleLocator(step))
        axis.set_major_formatter(style.thousands_formatter())


@style.house_style()
def profile_figure(panels: Sequence[ProfilePanel]) -> Figure:
    """Stack profiles at one scale on one page, such as a slope before and after measures."""
    # One A4 page holds all panels with their headings, gaps and the foot.
    frame, pt = _frame(panels, max((9.3 - 0.75) / len(panels) - 0.8, 1.4))
    width, height = (side / (72.0 * pt) for side in (frame.width, frame.height))
    height = len(panels) * (height + 0.5) + 0.3
    # Of narrow panels in the middle of the page headings may go on to its right edge.
    room = max(width, 0.5 * (style.WIDTH_IN + width) - 0.4)
    sheet = style.Sheet("", "", height)
    axes = sheet.figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    grounds: dict[str, str] = {}
    for i, (ax, panel) in enumerate(zip(axes, panels, strict=True)):
        _draw_panel(ax, panel, frame, pt)
        letter = f"{'abcdefghij'[i % 10]}  " if len(panels) > 1 else ""
        caption = style.wrap(panel.caption(), room)
        pad = 5.0 + 9.0 * style.lines_in(caption)
        ax.set_title(
            style.wrap(f"{letter}{panel.title}", room, style.TITLE),
            size=style.TITLE,
            pad=pad,
        )
        style.beside(
            ax, caption, (0.0, 1.0), (0.0, 3.0), xycoords="axes fraction", color=style.GREY
        )
        for k in dict.fromkeys(run[0] for run in panel.ground_runs()):
            name = dict(enumerate(panel.ground_names)).get(k, phrase("class {}", k))
            grounds[name] = style.GROUND_COLOURS[k % len(style.GROUND_COLOURS)]
    axes[-1].set_xlabel("chainage (m)")
    if grounds:
        sheet.legend([Patch(fc=colour, label=name) for name, colour in grounds.items()])
    return sheet.figure
