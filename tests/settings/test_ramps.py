"""Colours of the ramps."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb

from sassgis.settings.styles import ramp_colours, rgb

RAMPS = ("Blues", "BuPu", "RdBu", "RdPu", "YlGnBu", "YlOrRd", "plasma", "viridis")


@pytest.mark.parametrize("ramp", [*RAMPS, *(f"{name}_r" for name in RAMPS)])
def test_ramps_are_those_of_matplotlib(ramp: str) -> None:
    colours = matplotlib.colormaps[ramp]
    for count in (1, 2, 3, 5, 6, 7, 11, 100, 256):
        places = np.linspace(0.0, 1.0, count)
        assert ramp_colours(ramp, count) == [to_hex(colours(float(place))) for place in places]


def test_no_such_ramp() -> None:
    with pytest.raises(ValueError, match="no colour ramp 'nosuch', only Blues"):
        ramp_colours("nosuch", 3)


@pytest.mark.parametrize("colour", ["#000000", "#ffffff", "#d7262B", "#4a86d8"])
def test_colours_as_numbers(colour: str) -> None:
    assert rgb(colour) == tuple(round(255 * part) for part in to_rgb(colour))
