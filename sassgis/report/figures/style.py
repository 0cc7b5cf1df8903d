"""The look that all figures share, and how a figure becomes a PNG."""

from __future__ import annotations

import functools
import io
import textwrap
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import as_file, files
from os import PathLike
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter
from scipy.optimize import isotonic_regression

from sassgis.model.errors import OutputError
from sassgis.model.grid import FloatArray
from sassgis.model.labels import power_of_ten, thousands
from sassgis.model.languages import current_language, named, translated

#: Width of a figure: the text width of an A4 page (in).
WIDTH_IN = 6.7
DPI = 180

SMALL, TEXT, TITLE = 7.0, 8.0, 9.5
#: Width of a letter of DejaVu Sans over the font size, on average.
_LETTER, _LETTER_BOLD = 0.56, 0.63

# Okabe and Ito (2008), colours distinguishable with all common kinds of colour vision.
INK = "#1a1a1a"
GREY = "#6b6b6b"
LIGHT = "#d9d9d9"
BLUE = "#0072B2"
SKY = "#56B4E9"
ORANGE = "#E69F00"
GREEN = "#009E73"
YELLOW = "#F0E442"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"

#: Less observed than predicted (or before) is blue, more vermilion.
GAP_COLOURS = LinearSegmentedColormap.from_list(
    "gap", [BLUE, "#9ecae1", "#f2f2f2", "#f5b38c", VERMILION]
)

#: Fill colours for kinds of ground, in the order of the table; they repeat after the last.
GROUND_COLOURS = (
    "#8c8c8c", "#E6C27A", "#7FBF9B", "#A6D3EE", "#E0A3C2", "#C98A5B", "#5B8FB9", "#EDE79B",
)  # fmt: skip

# matplotlib reads its defaults from one table per process; the lock keeps threads apart.
_LOCK = threading.RLock()


@functools.cache
def _settings() -> dict[Any, Any]:
    """Settings of matplotlib: its defaults, and over them the style sheet of the figures."""
    with as_file(files("sassgis.data").joinpath("figures.mplstyle")) as sheet:
        own = mpl.rc_params_from_file(sheet, use_default_template=False)
    # Not the backend: setting that would load pyplot.
    both = dict(mpl.rcParamsDefault) | dict(own)
    return {key: value for key, value in both.items() if not key.startswith("backend")}


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the style of the figures, whatever the user's matplotlibrc says; also a decorator."""
    with _LOCK, mpl.rc_context():
        mpl.rcParams.update(_settings())
        yield


def new_figure(width_in: float, height_in: float, *, constrained: bool = True) -> Figure:
    """Make a figure that belongs to nobody but the caller (no pyplot)."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained" if constrained else None)
    FigureCanvasAgg(figure)
    return figure


class Page:
    """A figure whose parts are placed in inches from its lower left corner.

    Maps and profiles have axes of equal scale, which leave gaps in automatic layouts.
    """

    def __init__(self, height: float) -> None:
        self.height = height
        self.figure = new_figure(WIDTH_IN, height, constrained=False)

    def axes(self, x: float, y: float, width: float, height: float, label: str = "") -> Axes:
        """Axes with their lower left corner at x, y."""
        return self.figure.add_axes(
            (x / WIDTH_IN, y / self.height, width / WIDTH_IN, height / self.height), label=label
        )

    def text(self, x: float, y: float, words: str, **how: Any) -> None:
        """Write a text at x, y."""
        self.figure.text(x / WIDTH_IN, y / self.height, words, **how)

    def title(self, x: float, words: str, below_top: float = 0.1) -> None:
        """Write the title, its upper left corner so far below the top."""
        y = self.height - below_top
        self.text(x, y, words, size=TITLE, weight="bold", va="top", gid="title")

    def note(self, x: float, y: float, words: str, va: str = "top") -> None:
        """Write the note below the figure."""
        self.text(x, y, words, size=SMALL, color=GREY, va=va, gid="note")

    def around(self, title: str, note: str, room: float = WIDTH_IN) -> None:
        """Write the title at the top and the note at the foot, the note within a width."""
        self.title(0.1, wrap(title, WIDTH_IN, TITLE), 0.08)
        self.note(0.1, 0.07, wrap(note, room - 0.2), "bottom")


def note_height(note: str, room: float = WIDTH_IN) -> float:
    """Height that a note at the foot takes (in)."""
    return 0.14 * lines_in(wrap(note, room - 0.2)) + 0.12 if note else 0.1


def head(figure: Figure, title: str) -> None:
    """Write the title of a figure that lays itself out."""
    figure.suptitle(wrap(title, WIDTH_IN, TITLE), x=0.01, ha="left", size=TITLE, weight="bold")


def halo(width: float = 2.0) -> list[AbstractPathEffect]:
    """A white edge around letters that lie over a drawing."""
    return [withStroke(linewidth=width, foreground="white")]


def beside(
    ax: Axes, words: str, at: tuple[float, float], offset_pt: tuple[float, float], **how: Any
) -> None:
    """Write a text so many points beside a place."""
    ax.annotate(words, at, xytext=offset_pt, textcoords="offset points", **({"size": SMALL} | how))


def to_png(figure: Figure) -> bytes:
    """Draw a figure as PNG; the same figure gives the same bytes on every run."""
    if current_language() != "en":
        for text in figure.findobj(Text):
            assert isinstance(text, Text)
            text.set_text(translated(text.get_text()))
    buffer = io.BytesIO()
    with house_style():
        # Without this matplotlib writes its version into the file.
        figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def save(figure: Figure, path: str | PathLike[str]) -> Path:
    """Write a figure as PNG; an OutputError if the file cannot be written."""
    target = Path(path)
    try:
        target.write_bytes(to_png(figure))
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{target}: the figure cannot be written ({reason})") from error
    return target


def text_width(text: str, size: float = SMALL, *, bold: bool = False) -> float:
    """About the width of a line of text at a font size (inches)."""
    return len(translated(text)) * (_LETTER_BOLD if bold else _LETTER) * size / 72.0


def wrap(text: str, width_in: float, size: float = SMALL) -> str:
    """Break a text into lines that fit a width at a font size (points)."""
    text = translated(text)
    letters = max(12, int(width_in * 72.0 / (_LETTER * size)))
    lines = (line for part in text.splitlines() for line in textwrap.wrap(part, letters) or [""])
    # Translated; it stays so when the figure is written.
    return named("\n".join(lines))


def lines_in(text: str) -> int:
    """Count the lines of a text; 0 if there is none."""
    return text.count("\n") + 1 if text else 0


def thousands_formatter(decimals: int = 0) -> FuncFormatter:
    """Tick labels with a thin space between thousands."""
    return FuncFormatter(lambda value, _: thousands(value, decimals))


def log_ticks(axis: Axis, decades: float) -> None:
    """Ticks of a logarithmic axis over so many powers of ten."""
    # Where few are in sight, the steps between them are named too.
    steps = (1.0, 2.0, 5.0) if decades < 2.0 else (1.0,)
    axis.set_major_locator(LogLocator(10.0, subs=steps))
    axis.set_major_formatter(plain_tick)
    axis.set_minor_formatter(NullFormatter())


def plain_tick(value: float, _: object = None) -> str:
    """Tick label of a logarithmic axis."""
    if value >= 1.0:
        return thousands(value)
    tens = np.log10(value) if value > 0.0 else np.nan
    is_power = value < 0.01 and np.isclose(tens, np.round(tens))
    return power_of_ten(round(tens)) if is_power else f"{value:.3g}"


def count(n: int, noun: str) -> str:
    """Write '1 block', '1 200 blocks'."""
    return f"{thousands(n)} {noun if n == 1 else noun + 's'}"


def nothing_to_show(ax: Axes, text: str = "no data", *, keep_x: bool = False) -> None:
    """Say in the middle of a panel that it is empty on purpose, and take its ticks away."""
    ax.set_yticks([])
    if not keep_x:
        ax.set_xticks([])
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color=GREY, size=TEXT)


def spread(positions: Sequence[float] | FloatArray, widths: float | FloatArray) -> FloatArray:
    """Shift labels along one axis, as little as possible, so that they do not overlap.

    Parameters
    ----------
    positions : float, shape (n,)
        Where the middles of the labels want to stand; their order along the axis is kept.
    widths : float or float, shape (n,)
        Room that each label takes, same unit.
    """
    wanted = np.asarray(positions, float)
    if not wanted.size:
        return wanted
    order = np.argsort(wanted, kind="stable")
    room = np.broadcast_to(np.asarray(widths, float), wanted.shape)[order]
    packed = np.append(0.0, np.cumsum((room[:-1] + room[1:]) / 2.0))
    out = np.empty_like(wanted)
    # Less the tightest packing, the middles need only not to fall.
    out[order] = packed + isotonic_regression(wanted[order] - packed).x
    return out


def text_width_pt(text: str, size: float = SMALL) -> float:
    """Room that a line of text takes (points), a little on the safe side."""
    return 0.64 * size * len(text) + 4.0


def percent_formatter(whole: float = 100.0) -> PercentFormatter:
    """Tick labels in per cent of a whole, with a thin space before the sign."""
    return PercentFormatter(whole, decimals=0, symbol="\u2009%")


def round_step(span: float, target: int) -> float:
    """Give the 1-2-5 step that cuts a span into about ``target`` parts."""
    if not (np.isfinite(span) and span > 0.0):
        return 1.0
    raw = span / max(target, 1)
    power = 10.0 ** np.floor(np.log10(raw))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(np.log(m * power / raw))) * power)
