"""The look that all figures share, and how a figure becomes a PNG."""

from __future__ import annotations

import functools
import io
import textwrap
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.resources import as_file, files
from os import PathLike
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, PercentFormatter

from sassgis.errors import OutputError
from sassgis.grid import FloatArray
from sassgis.settings.languages import current_language, named, translated
from sassgis.settings.results import power_of_ten, thousands

#: Width of a figure: the text width of an A4 page (in).
WIDTH_IN = 6.7
DPI = 180

SMALL, TEXT, TITLE = 7.0, 8.0, 9.5
#: Width of a letter of DejaVu Sans over the font size, on average; from a line to the next (in).
_LETTER, _LINE_IN = 0.56, 0.137

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
    """Return settings of matplotlib: its defaults, and over them the style sheet of the figures."""
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


def new_figure(
    width_in: float, height_in: float, *, constrained: bool = True, compressed: bool = False
) -> Figure:
    """Make a figure that belongs to nobody but the caller (no pyplot)."""
    layout: Any = "compressed" if compressed else "constrained" if constrained else None
    figure = Figure(figsize=(width_in, height_in), layout=layout)
    FigureCanvasAgg(figure)
    return figure


class Sheet:
    """A figure that lays itself out; its height (in) is that between title and legends."""

    def __init__(
        self, title: str, note: str, height_in: float, *, compressed: bool = False
    ) -> None:
        words, below = wrap(title, WIDTH_IN - 0.2, TITLE), wrap(note, WIDTH_IN - 0.2)
        self._head_in = 0.18 * lines_in(words) + 0.1
        self._foot_in = _LINE_IN * lines_in(below) + 0.12
        self.figure = new_figure(WIDTH_IN, height_in, compressed=compressed)
        if words:
            head(self.figure, words)
        inches = self.figure.dpi_scale_trans
        self.figure.text(
            0.1, 0.07, below, transform=inches, size=SMALL, color=GREY, va="bottom", gid="note"
        )
        self.set_height(height_in)

    def set_height(self, height_in: float) -> None:
        """Make all between title and foot so high (in)."""
        self._height_in = height_in
        whole = self._head_in + height_in + self._foot_in
        self.figure.set_figheight(whole)
        engine = self.figure.get_layout_engine()
        assert engine is not None
        below = self._foot_in / whole
        engine.set(rect=(0.0, below, 1.0, 1.0 - below))  # type: ignore[call-arg]

    def lay_out(self, axes: Sequence[Axes]) -> None:
        """Put all in its place without drawing it; ``axes`` are those of a fixed aspect."""
        engine = self.figure.get_layout_engine()
        assert engine is not None
        engine.execute(self.figure)
        for ax in axes:
            ax.apply_aspect()

    def keep_places(self) -> None:
        """Do not lay the figure out again when it is drawn: that takes half of the time.

        Nothing can be added afterwards.
        """
        self.figure.set_layout_engine("none")

    def legend(self, signs: Sequence[Artist]) -> None:
        """Draw signs with their labels in rows over the note and what stands there."""
        widest = max(text_width_pt(str(sign.get_label())) for sign in signs) / 72.0 + 0.5
        columns = min(len(signs), max(1, int((WIDTH_IN - 0.3) / widest)))
        legend = self.figure.legend(
            handles=signs, ncols=columns, loc="lower left", bbox_to_anchor=(0.12, self._foot_in),
            bbox_transform=self.figure.dpi_scale_trans, borderaxespad=0.0, borderpad=0.0,
            alignment="left", columnspacing=1.6,
        )  # fmt: skip
        legend.set_in_layout(False)
        self._foot_in += 0.165 * -(-len(signs) // columns) + 0.08
        self.set_height(self._height_in)


def head(figure: Figure, title: str) -> None:
    """Write the title of a figure that lays itself out."""
    words = wrap(title, WIDTH_IN - 0.2, TITLE)
    figure.suptitle(words, x=0.015, ha="left", size=TITLE, weight="bold", gid="title")


def halo(width: float = 2.0) -> list[AbstractPathEffect]:
    """Return a white edge around letters that lie over a drawing."""
    return [withStroke(linewidth=width, foreground="white")]


def beside(
    ax: Axes, words: str, at: tuple[float, float], offset_pt: tuple[float, float], **how: Any
) -> None:
    """Write a text so many points next to a place."""
    ax.annotate(words, at, xytext=offset_pt, textcoords="offset points", **({"size": SMALL} | how))


def to_png(figure: Figure) -> bytes:
    """Draw a figure as PNG; the same figure gives the same bytes on every run."""
    translate_texts(figure)
    buffer = io.BytesIO()
    before = figure.dpi
    with house_style():
        figure.set_dpi(DPI)
        # Not savefig, which draws everything twice: at first only to lay it out. Without the
        # metadata matplotlib writes its version into the file. Level 3 takes less than half of the
        # time of the usual 6, for files that are a twentieth larger.
        canvas: Any = FigureCanvasAgg(figure)
        canvas.print_png(buffer, metadata={"Software": None}, pil_kwargs={"compress_level": 3})
        figure.set_dpi(before)
    # The canvas of the figure has no memory for its dots.
    FigureCanvasAgg(figure)
    return buffer.getvalue()


def translate_texts(figure: Figure) -> None:
    """Put the texts of a figure into the language of the caller."""
    if current_language() != "en":
        for text in figure.findobj(Text):
            assert isinstance(text, Text)
            # Named: a figure that is laid out before it is written comes here twice.
            text.set_text(named(translated(text.get_text())))


def save(figure: Figure, path: str | PathLike[str]) -> Path:
    """Write a figure as PNG; an OutputError if the file cannot be written."""
    target = Path(path)
    try:
        target.write_bytes(to_png(figure))
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{target}: the figure cannot be written ({reason})") from error
    return target


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


def thousands_formatter(
    decimals: int = 0, scale: float = 1.0, within: tuple[float, float] = (-np.inf, np.inf)
) -> FuncFormatter:
    """Return tick labels in units of ``scale`` with a thin space between thousands."""
    return FuncFormatter(partial(_thousands_tick, decimals, scale, within))


def _thousands_tick(
    decimals: int, scale: float, within: tuple[float, float], value: float, _: object
) -> str:
    return thousands(value / scale, decimals) if within[0] <= value <= within[1] else ""


def log_ticks(axis: Axis, decades: float) -> None:
    """Set the ticks of a logarithmic axis over so many powers of ten."""
    # Where few are in sight, the steps between them are named too.
    steps = (1.0, 2.0, 5.0) if decades < 2.0 else (1.0,)
    axis.set_major_locator(LogLocator(10.0, subs=steps))
    axis.set_major_formatter(plain_tick)
    axis.set_minor_formatter(NullFormatter())


def plain_tick(value: float, _: object = None) -> str:
    """Return tick label of a logarithmic axis."""
    if value >= 1.0:
        return thousands(value)
    number, _, exponent = f"{value:.3g}".partition("e")
    if not exponent:
        return number
    return power_of_ten(int(exponent)) if number == "1" else times_ten(number, exponent)


def times_ten(number: str, exponent: str) -> str:
    """Return a number times a power of ten, as '1.20 × 10⁻⁵'."""
    return f"{number}\u2009×\u2009{power_of_ten(int(exponent))}"


def ink_on(colour: str, opacity: float = 1.0) -> str:
    """Return the colour of a text that can be read on another, which may let white through."""
    red, green, blue = (1.0 - opacity * (1.0 - c) for c in to_rgb(colour))
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "white"


def nothing_to_show(ax: Axes, text: str = "no data", *, keep_x: bool = False) -> None:
    """Say in the middle of a panel that it is empty on purpose, and take its ticks away."""
    ax.set_yticks([])
    if not keep_x:
        ax.set_xticks([])
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color=GREY, size=TEXT)


def spread(positions: Sequence[float] | FloatArray, widths: float | FloatArray) -> FloatArray:
    """Shift labels of some width along an axis, as little as possible, so that none overlap."""
    wanted = np.asarray(positions, float)
    if not wanted.size:
        return wanted
    order = np.argsort(wanted, kind="stable")
    room = np.broadcast_to(np.asarray(widths, float), wanted.shape)[order]
    packed = np.append(0.0, np.cumsum((room[:-1] + room[1:]) / 2.0))
    if not np.any(np.diff(wanted[order] - packed) < 0.0):
        return wanted.copy()
    # Takes long to load, and labels seldom overlap.
    from scipy.optimize import isotonic_regression

    out = np.empty_like(wanted)
    # Less the tightest packing, the middles need only not to fall.
    out[order] = packed + isotonic_regression(wanted[order] - packed).x
    return out


def text_width_pt(text: str, size: float = SMALL) -> float:
    """Return room that a line of text takes (points), a little on the safe side."""
    return 0.64 * size * len(text) + 4.0


def percent_formatter(whole: float = 100.0) -> PercentFormatter:
    """Return tick labels in per cent of a whole, with a thin space before the sign."""
    return PercentFormatter(whole, decimals=0, symbol="\u2009%")


def round_step(span: float, target: int) -> float:
    """Give the 1-2-5 step that cuts a span into about ``target`` parts."""
    if not (np.isfinite(span) and span > 0.0):
        return 1.0
    raw = span / max(target, 1)
    power = 10.0 ** np.floor(np.log10(raw))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(np.log(m * power / raw))) * power)
