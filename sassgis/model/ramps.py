"""Colour ramps of maps, and colours as numbers.

The ramps are tables of 256 colours, ``data/ramps.csv``, as matplotlib 3.10 makes them: Blues, BuPu,
RdBu, RdPu, YlGnBu and YlOrRd by ColorBrewer (Brewer 2002), plasma and viridis by Smith and van der
Walt (2015). A name with ``_r`` at its end is the same ramp reversed.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib import resources


@cache
def _ramps() -> Mapping[str, tuple[str, ...]]:
    text = resources.files("sassgis").joinpath("data", "ramps.csv").read_text(encoding="ascii")
    names, *rows = csv.reader(text.splitlines())
    return dict(zip(names, zip(*rows, strict=True), strict=True))


def ramp_colours(ramp: str, count: int) -> list[str]:
    """Colours (``#rrggbb``) evenly along a ramp, from end to end.

    Raises
    ------
    ValueError
        If there is no such ramp.
    """
    ramps = _ramps()
    name = ramp.removesuffix("_r")
    if name not in ramps:
        raise ValueError(f"there is no colour ramp {ramp!r}, only {', '.join(ramps)}")
    colours = ramps[name] if name == ramp else ramps[name][::-1]
    steps = max(count - 1, 1)
    return [colours[min(256 * place // steps, 255)] for place in range(count)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue (0 to 255) of a colour ``#rrggbb``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
