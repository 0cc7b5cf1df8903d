"""How much room a text needs: measured with DejaVu Sans, which matplotlib brings along.

It is wider than the Arial of the map sheets, and what most systems without Arial have in its place:
what fits with it fits.
"""

from __future__ import annotations

import functools

from matplotlib.font_manager import FontProperties, findfont
from matplotlib.ft2font import FT2Font

MM_PER_POINT = 25.4 / 72.0
#: From one line of text to the next, in type sizes.
_LINE = 1.22
_MEASURED_AT = 100.0


@functools.cache
def _face(bold: bool) -> FT2Font:
    wanted = FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    face = FT2Font(findfont(wanted))
    face.set_size(_MEASURED_AT, 72.0)
    return face


@functools.cache
def _advance(letter: str, bold: bool) -> float:
    """Width of a letter in type sizes."""
    return float(_face(bold).load_char(ord(letter)).linearHoriAdvance) / 65536.0 / _MEASURED_AT


def text_width(text: str, points: float, *, bold: bool = False) -> float:
    """Width of a line of text (mm)."""
    return sum(_advance(letter, bold) for letter in text) * points * MM_PER_POINT


def breakable(text: str, width_mm: float, points: float, *, bold: bool = False) -> str:
    """A text whose words all fit a line, and whose numbers stay with their per cent.

    QGIS breaks lines between words only; a longer word, such as a path, is broken here.
    """
    words = []
    for word in text.replace(" %", "\u00a0%").split(" "):
        rest = word
        while text_width(rest, points, bold=bold) > width_mm and len(rest) > 1:
            cut = len(rest) - 1
            while cut > 1 and text_width(rest[:cut], points, bold=bold) > width_mm:
                cut -= 1
            words.append(rest[:cut] + "\n")
            rest = rest[cut:]
        words.append(rest + " ")
    return "".join(words)[:-1]


def wrapped(text: str, width_mm: float, points: float, *, bold: bool = False) -> list[str]:
    """Break a text into lines that fit."""
    lines = []
    for paragraph in breakable(text, width_mm, points, bold=bold).splitlines() or [""]:
        line, *words = paragraph.split(" ")
        for word in words:
            longer = f"{line} {word}"
            if text_width(longer, points, bold=bold) > width_mm:
                lines.append(line)
                line = word
            else:
                line = longer
        lines.append(line)
    return lines


def text_height(lines: int, points: float) -> float:
    """Height of some lines of text (mm)."""
    return lines * points * MM_PER_POINT * _LINE
