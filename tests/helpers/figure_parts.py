"""What is in a figure."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
from matplotlib.text import Text


def find(figure: Figure, gid: str) -> list[Any]:
    """All artists of a figure with a mark."""
    return list(figure.findobj(lambda artist: artist.get_gid() == gid))


def axes_of(figure: Figure, label: str) -> list[Any]:
    """Axes of a figure with a label."""
    return [ax for ax in figure.axes if ax.get_label() == label]


def texts(figure: Figure) -> str:
    """All words that a figure shows, line breaks as spaces."""
    figure.canvas.draw()
    shown = [t for t in figure.findobj(Text) if isinstance(t, Text) and t.get_visible()]
    found = " | ".join(" ".join(t.get_text().split()) for t in shown if t.get_text())
    # What a formatter of matplotlib writes as mathematics would be shown as it stands.
    assert "\\mathdefault" not in found, found
    return found
