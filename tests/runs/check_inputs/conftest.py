"""The fixtures that write input files."""

from __future__ import annotations

from helpers.input_files import make_dem, make_layer

__all__ = ["make_dem", "make_layer"]
