"""Hazard zones on axes of matplotlib, in the colours of their levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from sassgis.grid import Grid
from sassgis.report.figures.relief import hillshade
from sassgis.settings.hazard_rules import HazardLevel
from sassgis.settings.languages import translated

if TYPE_CHECKING:
    import geopandas as gpd


def draw_zones(
    zones: gpd.GeoDataFrame, levels: Sequence[HazardLevel], grid: Grid, ax: Axes | None = None
) -> Axes:
    """Draw zones over the relief of the terrain, the lowest level first, with a legend."""
    if ax is None:
        # Only where a notebook or a window shows it.
        import matplotlib.pyplot as plt

        _, ax = plt.subplots(layout="constrained")
    west, south, east, north = grid.bounds
    shade = hillshade(grid)
    ax.imshow(shade, cmap="gray", extent=(west, east, south, north), alpha=0.5, vmin=0.0, vmax=1.0)
    signs = []
    for level in levels:
        # A hatched level is striped on white, as on maps.
        look: dict[str, Any] = {
            "facecolor": "white" if level.hatched else level.colour,
            "edgecolor": level.colour if level.hatched else "#4d4d4d",
            "hatch": "////" if level.hatched else None, "linewidth": 0.5, "alpha": 0.85,
        }  # fmt: skip
        own = zones[zones["hazard_level"] == level.code]
        if len(own):
            own.plot(ax=ax, label=level.code, **look)
            signs.append(Patch(label=translated(level.label), **look))
    ax.legend(handles=signs[::-1], title=translated("Hazard level"))
    ax.set(xlim=(west, east), ylim=(south, north), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    ax.ticklabel_format(useOffset=False, style="plain")
    return ax
