from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.text import Text

from sassgis.model.grid import Grid


@pytest.fixture
def find() -> Callable[[Figure, str], list[Artist]]:
    """All artists of a figure with a mark."""

    def search(figure: Figure, gid: str) -> list[Artist]:
        return list(figure.findobj(lambda artist: artist.get_gid() == gid))

    return search


@pytest.fixture
def texts() -> Callable[[Figure], str]:
    """All words that a figure shows, line breaks as spaces."""

    def read(figure: Figure) -> str:
        figure.canvas.draw()
        shown = [t for t in figure.findobj(Text) if isinstance(t, Text) and t.get_visible()]
        return " | ".join(" ".join(t.get_text().split()) for t in shown if t.get_text())

    return read


@pytest.fixture
def valley() -> Grid:
    """A side that falls to the south by 1 in 2, with a gap in the north-east."""
    y, _ = np.mgrid[0:40, 0:60] * 5.0
    z = 1000.0 - 0.5 * y
    z[:6, -8:] = np.nan
    return Grid(z, 2_700_000.0, 1_150_000.0, 5.0)
