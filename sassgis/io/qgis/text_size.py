"""How much room a text needs: measured with DejaVu Sans, which matplotlib brings along.

It is wider than the Arial of the map sheets, and what most systems without Arial have in its place:
what fits with it fits.
"""

from __future__ import annotations

import functools

from sassgis.model.process import not_found

with not_found("matplotlibrc"):
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
    face = _face(bold)
    if not face.get_char_index(ord(letter)):
        return 1.0  # of another font, as wide as high
    return float(face.load_char(ord(letter)).linearHoriAdvance) / 65536.0 / _MEASURED_AT


def text_width(text: str, points: float, *, bold: bool = False) -> float:
    """Width of a line of text (mm)."""
    return sum(_advance(letter, bold) for letter in text) * points * MM_PER_POINT


def breakable(text: str, width_mm: float, points: float, *, bold: bool = False) -> str:
    """A text whose words all fit a line, and whose numbers stay with their per cent.

    QGIS breaks lines between words only; a longer word, such as a path, is broken here.
    """
    letters: list[str] = []
    used, begins = 0.0, True
    for letter in text.replace(" %", "\u00a0%"):
        width = _advance(letter, bold)
        ends = letter in " \n"
        if not (begins or ends) and (used + width) * points * MM_PER_POINT > width_mm:
            letters.append("\n")
            used = 0.0
        letters.append(letter)
        used, begins = (0.0 if ends else used + width), ends
    return "".join(letters)


def wrapped(text: str, width_mm: float, points: float, *, bold: bool = False) -> list[str]:
    """Break a text into lines that fit."""
    lines = []
    space = text_width(" ", points, bold=bold)
    for paragraph in breakable(text, width_mm, points, bold=bold).splitlines() or [""]:
        first, *words = paragraph.split(" ")
        line, used = [first], text_width(first, points, bold=bold)
        for word in words:
            width = text_width(word, points, bold=bold)
            if used + space + width > width_mm:
                lines.append(" ".join(line))
                line, used = [word], width
            else:
                line.append(word)
                used += space + width
        lines.append(" ".join(line))
    return lines


def text_height(lines: int, points: float) -> float:
    """Height of some lines of text (mm)."""
    return lines * points * MM_PER_POINT * _LINE
