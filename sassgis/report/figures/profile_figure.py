"""The slope in its vertical plane with the paths of blocks (Bozzolo and Pamini 1986, Fig. 13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MultipleLocator

from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.results import ControlLine
from sassgis.report.figures.style import (
    BLUE,
    GREY,
    GROUND_COLOURS,
    INK,
    SMALL,
    TITLE,
    VERMILION,
    WIDTH_IN,
    YELLOW,
    count,
    lines_in,
    new_figure,
    round_step,
    spread,
    styled,
    text_width_pt,
    thousands_formatter,
    wrap,
)

#: A control line with its chainage (m) and the height of the ground there (m).
ProfileControlLine = tuple[ControlLine, float, float]

_HALO = [withStroke(linewidth=1.8, foreground="white")]
_STRIP_PT = 7.0
_LEFT_IN, _RIGHT_IN = 0.62, 0.15


@dataclass(frozen=True, slots=True)
class ProfilePanel:
    """What one panel of a profile figure shows.

    Attributes
    ----------
    s, z : float, shape (n,)
        Chainage and height of the vertices of the slope (m).
    trajectories : (s, z) of float, shape (m,)
        Paths of the centres of mass (m).
    ground : int, shape (n - 1,) or (n,), optional
        Ground class of the segment that starts at each vertex; a last value is unused.
    ground_names : str
        Names of the ground classes by their number.
    control_lines : (ControlLine, chainage, height of the ground)
    stops : float, shape (k,)
        Chainages where blocks ended (m).
    title : str
    """

    s: FloatArray
    z: FloatArray
    trajectories: Sequence[tuple[FloatArray, FloatArray]] = ()
    ground: IntArray | None = None
    ground_names: Sequence[str] = ()
    control_lines: Sequence[ProfileControlLine] = ()
    stops: FloatArray = field(default_factory=lambda: np.empty(0))
    title: str = ""

    def __post_init__(self) -> None:
        s, z = np.asarray(self.s, float), np.asarray(self.z, float)
        if s.ndim != 1 or s.shape != z.shape or s.size < 2:
            raise InputError(
                "a profile needs as many chainages as heights, two at least",
                found=f"shapes {s.shape} and {z.shape}",
            )
        if np.any(np.diff(s) <= 0.0):
            raise InputError("the chainages of a profile must rise")
        if self.ground is not None and len(self.ground) not in (s.size - 1, s.size):
            raise InputError(
                "a profile needs one ground class for each segment",
                found=len(self.ground),
                expected=str(s.size - 1),
            )


@dataclass(frozen=True, slots=True)
class _Frame:
    """Limits of a panel (m) and its drawn size (in)."""

    s0: float
    s1: float
    z0: float
    z1: float
    inches: tuple[float, float]

    @property
    def pt(self) -> float:
        """Metres per typographic point."""
        return (self.s1 - self.s0) / (self.inches[0] * 72.0)


def _limits(panels: Sequence[ProfilePanel]) -> tuple[float, float, float, float]:
    """Chainage and height limits that hold every panel's slope, paths and barriers (m)."""
    s = np.concatenate([np.asarray(p.s, float) for p in panels])
    z = [np.asarray(p.z, float) for p in panels]
    for panel in panels:
        z += [np.asarray(path[1], float) for path in panel.trajectories]
        z.append(
            np.array(
                [ground + control_line.height_m for control_line, _, ground in panel.control_lines]
            )
        )
    heights = np.concatenate(z)
    heights = heights[np.isfinite(heights)]
    return float(s.min()), float(s.max()), float(heights.min()), float(heights.max())


def _frame(panels: Sequence[ProfilePanel], max_height_in: float) -> _Frame:
    """Fit the panels to the page at equal scale of both axes."""
    s0, s1, z0, z1 = _limits(panels)
    span, drop = s1 - s0, max(z1 - z0, 0.05 * (s1 - s0))
    width = WIDTH_IN - _LEFT_IN - _RIGHT_IN
    while True:
        metres = span * 1.04 / width
        # Room in points: under the slope for strip and class names, over it for station names.
        below, above = 34.0 * metres / 72.0, 26.0 * metres / 72.0
        height = (drop + below + above) / metres
        if height <= 1.001 * max_height_in:
            break
        # The room for labels does not shrink with the slope.
        width *= max((max_height_in - 60.0 / 72.0) / (height - 60.0 / 72.0), 0.2)
    return _Frame(
        s0 - 0.02 * span, s1 + 0.02 * span, z0 - below, z0 + drop + above, (width, height)
    )


def runs_of(ground: IntArray) -> list[tuple[int, int, int]]:
    """Stretches of equal ground: (class, first segment, last segment + 1)."""
    classes = np.asarray(ground, np.int64)
    if not classes.size:
        return []
    borders = np.concatenate([[0], np.nonzero(np.diff(classes))[0] + 1, [classes.size]])
    return [(int(classes[a]), int(a), int(b)) for a, b in pairwise(borders)]


def _class_name(panel: ProfilePanel, number: int) -> str:
    known = 0 <= number < len(panel.ground_names)
    return panel.ground_names[number] if known else f"class {number}"


@dataclass(frozen=True, slots=True)
class _GroundName:
    """The name of a ground class written beside the strip: anchor (m), offset (pt), alignment."""

    name: str
    s: float
    z: float
    offset: tuple[float, float]
    align: Literal["left", "center", "right"]


def _ground_runs(panel: ProfilePanel) -> list[tuple[int, int, int]]:
    """Stretches of equal ground of a panel."""
    if panel.ground is None:
        return []
    return runs_of(np.asarray(panel.ground)[: np.size(panel.s) - 1])


def _place_name(
    panel: ProfilePanel, run: tuple[int, int, int], name: str, frame: _Frame
) -> _GroundName | None:
    """Find room for the name of a class below the strip; None where there is none."""
    s, z = np.asarray(panel.s, float), np.asarray(panel.z, float)
    length = s[run[2]] - s[run[1]]
    middle = float((s[run[1]] + s[run[2]]) / 2.0)
    segment = min(int(np.searchsorted(s, middle, side="right")), s.size - 1)
    angle = np.arctan2(z[segment] - z[segment - 1], s[segment] - s[segment - 1])
    text = text_width_pt(name) * frame.pt
    offset = (
        float((_STRIP_PT + 3.0) * np.sin(angle)),
        float(-(_STRIP_PT + 3.0) * np.cos(angle)),
    )
    height = float(np.interp(middle, s, z))
    if abs(angle) < np.radians(12.0):
        room = length >= text
        align: Literal["left", "center", "right"] = "center"
    else:
        # Below a slope that falls to the right there is room to the left, and the reverse.
        align = "right" if angle < 0.0 else "left"
        edge = middle + offset[0] * frame.pt
        inside = edge - text > s[0] if angle < 0.0 else edge + text < s[-1]
        room = bool(inside and length >= 2.0 * SMALL * frame.pt * np.cos(angle))
    return _GroundName(name, middle, height, offset, align) if room else None


def _ground_names(panel: ProfilePanel, frame: _Frame) -> tuple[list[_GroundName], dict[str, str]]:
    """Names that fit beside their longest stretch, and name and colour of those that do not."""
    runs = _ground_runs(panel)
    s = np.asarray(panel.s, float)
    placed: list[_GroundName] = []
    unplaced: dict[str, str] = {}
    for number in sorted({run[0] for run in runs}):
        longest = max((r for r in runs if r[0] == number), key=lambda r: s[r[2]] - s[r[1]])
        name = _class_name(panel, number)
        where = _place_name(panel, longest, name, frame)
        if where is None:
            unplaced[name] = GROUND_COLOURS[number % len(GROUND_COLOURS)]
        else:
            placed.append(where)
    if unplaced:
        # Half the names in the slope and half in a legend would be harder to read than either.
        numbers = sorted({run[0] for run in runs})
        return [], {_class_name(panel, k): GROUND_COLOURS[k % len(GROUND_COLOURS)] for k in numbers}
    return placed, {}


def _draw_ground(ax: Axes, panel: ProfilePanel, frame: _Frame) -> None:
    """Draw the slope and the strip of ground classes below it."""
    s, z = np.asarray(panel.s, float), np.asarray(panel.z, float)
    floor = frame.z0 - (frame.z1 - frame.z0)
    around = np.column_stack(
        [np.concatenate([[s[0]], s, [s[-1]]]), np.concatenate([[floor], z, [floor]])]
    )
    under = Polygon(around, closed=True, fc="#f4f2ef", ec="none", zorder=1)
    ax.add_patch(under)
    # Thick lines, cut at the slope, keep the strip equally thick on steep ground. Round ends below
    # the square ones fill the wedges that open between two stretches in a hollow.
    for ends, zorder in (("round", 1.5), ("butt", 2.0)):
        for number, a, b in _ground_runs(panel):
            (strip,) = ax.plot(
                s[a : b + 1],
                z[a : b + 1],
                color=GROUND_COLOURS[number % len(GROUND_COLOURS)],
                lw=2.0 * _STRIP_PT,
                solid_capstyle=ends,
                solid_joinstyle="round",
                zorder=zorder,
                gid=f"ground-{number}" if ends == "butt" else None,
            )
            strip.set_clip_path(under)
    for label in _ground_names(panel, frame)[0]:
        ax.annotate(
            label.name,
            (label.s, label.z),
            xytext=label.offset,
            textcoords="offset points",
            ha=label.align,
            va="top",
            size=SMALL,
            color=INK,
            style="italic",
            zorder=6,
        )
    ax.plot(s, z, color=INK, lw=1.1, zorder=4, gid="slope", solid_joinstyle="round")


def _draw_control_lines(
    ax: Axes, control_lines: Sequence[ProfileControlLine], frame: _Frame
) -> None:
    """Draw stations over the full height, walls and nets at their true height."""
    stations = [(g, s, z) for g, s, z in control_lines if g.kind == "station"]
    wanted = [s for _, s, _ in stations]
    room = np.array(
        [text_width_pt(control_line.name) * frame.pt for control_line, _, _ in stations]
    )
    placed = spread(wanted, room)
    for (control_line, s, z), label in zip(stations, placed, strict=True):
        ax.plot(
            [s, s],
            [z, frame.z1 - 13.0 * frame.pt],
            color=BLUE,
            lw=0.8,
            ls=(0, (4, 2)),
            zorder=3,
            gid=f"control_line-{control_line.name}",
        )
        ax.annotate(
            control_line.name,
            (float(s), frame.z1 - 13.0 * frame.pt),
            xytext=(float((label - s) / frame.pt), 2.0),
            textcoords="offset points",
            ha="center",
            va="bottom",
            size=SMALL,
            color=BLUE,
            weight="bold",
            zorder=9,
        )
    for control_line, s, z in control_lines:
        if control_line.kind == "station":
            continue
        top = z + control_line.height_m
        ax.plot(
            [s, s],
            [z, top],
            color=VERMILION,
            lw=2.4,
            ls="-" if control_line.kind == "wall" else (0, (0.6, 0.35)),
            solid_capstyle="butt",
            dash_capstyle="butt",
            zorder=8,
            gid=f"control_line-{control_line.name}",
        )
        ax.annotate(
            f"{control_line.name} ({control_line.kind}, {control_line.height_m:g} m)",
            (float(s), float(top)),
            xytext=(3.0, 3.0),
            textcoords="offset points",
            size=SMALL,
            color=VERMILION,
            weight="bold",
            path_effects=_HALO,
            ha="left",
            va="bottom",
            zorder=9,
        )


def _draw_panel(ax: Axes, panel: ProfilePanel, frame: _Frame) -> None:
    """Draw one panel."""
    _draw_ground(ax, panel, frame)
    paths = [
        np.column_stack([np.asarray(s, float), np.asarray(z, float)])
        for s, z in panel.trajectories
        if len(s)
    ]
    ax.add_collection(
        LineCollection(paths, colors=INK, linewidths=0.35, alpha=0.6, zorder=5, gid="trajectories"),
        autolim=False,
    )
    stops = np.asarray(panel.stops, float)
    stops = stops[np.isfinite(stops)]
    if stops.size:
        ax.plot(
            stops,
            np.interp(stops, panel.s, panel.z),
            "o",
            ms=3.4,
            mfc=YELLOW,
            mec=INK,
            mew=0.4,
            ls="none",
            zorder=7,
            gid="stops",
        )
    _draw_control_lines(ax, panel.control_lines, frame)
    ax.set_xlim(frame.s0, frame.s1)
    ax.set_ylim(frame.z0, frame.z1)
    ax.set_aspect("equal")
    across = round_step(frame.s1 - frame.s0, max(3, round(1.4 * frame.inches[0])))
    upward = round_step(frame.z1 - frame.z0, max(3, round(1.6 * frame.inches[1])))
    ax.xaxis.set_major_locator(MultipleLocator(across))
    ax.yaxis.set_major_locator(MultipleLocator(upward))
    ax.xaxis.set_major_formatter(thousands_formatter())
    ax.yaxis.set_major_formatter(thousands_formatter())
    ax.set_ylabel("height (m)")


def _caption(panel: ProfilePanel) -> str:
    """Say how many blocks are drawn."""
    stops = np.asarray(panel.stops, float)
    n_stops = int(np.count_nonzero(np.isfinite(stops)))
    parts = [
        f"{count(len(panel.trajectories), 'path')} of the centre of mass"
        if len(panel.trajectories)
        else "",
        f"yellow dots: where {count(n_stops, 'block')} ended" if n_stops else "",
    ]
    return "; ".join(part for part in parts if part)


def _figure(panels: Sequence[ProfilePanel], letters: bool) -> Figure:
    """Stack panels of the same scale and limits on one page."""
    # One A4 page holds all panels with their headings, gaps and the foot.
    frame = _frame(panels, max((9.3 - 0.75) / len(panels) - 0.7, 1.6))
    panel_w, panel_h = frame.inches
    titles = [
        wrap(f"{'abcdefghij'[i % 10]}  {p.title}" if letters else p.title, panel_w, TITLE)
        for i, p in enumerate(panels)
    ]
    heads = [
        0.1 + 0.17 * lines_in(t) + (0.15 if _caption(p) else 0.0)
        for t, p in zip(titles, panels, strict=True)
    ]
    foot = 0.48
    unnamed: dict[str, str] = {}
    for panel in panels:
        unnamed |= _ground_names(panel, frame)[1]
    rows = -(-len(unnamed) // 5)
    columns = -(-len(unnamed) // max(rows, 1))
    legend_h = 0.1 + 0.16 * rows if unnamed else 0.0
    height = sum(heads) + len(panels) * panel_h + (len(panels) - 1) * 0.28 + foot + legend_h
    figure = new_figure(WIDTH_IN, height, constrained=False)
    left = _LEFT_IN + (WIDTH_IN - _LEFT_IN - _RIGHT_IN - panel_w) / 2.0
    y = height
    for i, (panel, title, head) in enumerate(zip(panels, titles, heads, strict=True)):
        y -= head + panel_h
        ax = figure.add_axes(
            (left / WIDTH_IN, y / height, panel_w / WIDTH_IN, panel_h / height),
            label=f"profile-{i}",
        )
        _draw_panel(ax, panel, frame)
        ax.set_title("")
        figure.text(
            left / WIDTH_IN,
            (y + panel_h + head - 0.08) / height,
            title,
            size=TITLE,
            weight="bold",
            va="top",
            gid="title",
        )
        figure.text(
            left / WIDTH_IN,
            (y + panel_h + 0.02) / height,
            _caption(panel),
            size=SMALL,
            color=GREY,
            va="bottom",
            gid="caption",
        )
        if i == len(panels) - 1:
            ax.set_xlabel("chainage (m)")
        else:
            ax.tick_params(labelbottom=False)
        y -= 0.28
    if unnamed:
        figure.legend(
            handles=[Patch(fc=colour, ec="none", label=name) for name, colour in unnamed.items()],
            loc="lower center",
            ncols=columns,
            title_fontsize=SMALL,
            handlelength=1.4,
            columnspacing=1.4,
        )
    return figure


@styled
def profile_figure(
    s: FloatArray,
    z: FloatArray,
    trajectories: Sequence[tuple[FloatArray, FloatArray]],
    *,
    ground: IntArray | None = None,
    ground_names: Sequence[str] = (),
    control_lines: Sequence[ProfileControlLine] = (),
    stops: FloatArray | None = None,
    title: str = "",
) -> Figure:
    """Draw a slope with the paths of blocks, at equal scale of both axes.

    Parameters
    ----------
    s, z : float, shape (n,)
        Chainage and height of the vertices of the slope (m).
    trajectories : (s, z) of float, shape (m,)
        Paths of the centres of mass (m).
    ground : int, shape (n - 1,) or (n,), optional
        Ground class of the segment that starts at each vertex.
    ground_names : str
        Names of the ground classes by their number.
    control_lines : (ControlLine, chainage, height of the ground)
        Stations are drawn as dashed lines, walls and nets at their true height.
    stops : float, shape (k,), optional
        Chainages where blocks ended (m).
    title : str

    Raises
    ------
    InputError
        The arrays do not belong together.
    """
    panel = ProfilePanel(
        s,
        z,
        trajectories,
        ground,
        ground_names,
        control_lines,
        np.empty(0) if stops is None else stops,
        title,
    )
    return _figure([panel], letters=False)


@styled
def profile_comparison_figure(panels: Sequence[ProfilePanel]) -> Figure:
    """Stack profiles at one scale, such as a slope before and after measures.

    Raises
    ------
    InputError
        There is no panel.
    """
    if not panels:
        raise InputError("a comparison of profiles needs at least one panel", found=0)
    return _figure(panels, letters=True)
