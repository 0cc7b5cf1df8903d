"""Maps and areas of what may change within the ranges of the ground classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import geopandas as gpd
import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.assess import raster
from sassgis.hazard.ground_spread import HIGH, LOW, SpreadMaps
from sassgis.hazard.sensitivity import SensitivityMaps
from sassgis.io.vector_layer import VectorLayer, described_layer
from sassgis.io.write.layers.maps import Place, described_band, described_raster, level_classes
from sassgis.io.write.layers.run_vectors import cell_outlines, footprints
from sassgis.io.write.layers.zones import level_changes
from sassgis.model.grid import Grid, IntArray
from sassgis.model.ground_ranges import ParameterRange
from sassgis.model.hazard import HazardPreset
from sassgis.model.languages import phrase
from sassgis.model.results import RasterClass, RasterLayer
from sassgis.model.statistics_table import STATISTICS
from sassgis.model.styles import FOOTPRINT_STYLE, categorised_style

#: Colours for the parameters, told apart as well as so many can be (P. Tol, 2021, "muted").
_COLOURS = (
    "#332288", "#88ccee", "#44aa99", "#117733", "#999933", "#ddcc77", "#cc6677", "#882255",
    "#aa4499", "#6699cc", "#661100", "#dddddd",
)  # fmt: skip
#: Label and colour of what blocks reach in some and in most draws, the larger first.
_REACHED = (
    ("reached in a tenth of the draws", "#fdcc8a"),
    ("reached in nine tenths of the draws", "#d7301f"),
)


def sensitivity_layers(
    maps: SensitivityMaps,
    ranges: Sequence[ParameterRange],
    samples: int,
    shape: tuple[int, int],
    preset: HazardPreset | None,
) -> tuple[RasterLayer, ...]:
    """All maps; those of levels only with a preset."""
    text = (
        "{} simulations with values that fill the ranges of all ground classes; the same blocks "
        "in each."
    )
    base = phrase(text, samples)
    place = Place(maps.cells, shape)

    def layer(
        key: str,
        values: Mapping[str, NDArray[Any]],
        breaks: tuple[float, ...] = (),
        ramp: str = "",
        classes: Sequence[RasterClass] = (),
    ) -> RasterLayer:
        bands = [
            # No level and no parameter are 0.
            described_band(key, n, place.map_of(np.where(v > 0, v, np.nan) if classes else v))
            for n, v in values.items()
        ]
        return described_raster(key, bands, breaks, ramp, classes, base=base)

    shares = (0.0, 0.05, 0.1, 0.25, 0.5, 0.75)
    low, middle, high = maps.energy_ratio
    levels = {"highest": maps.level_highest, "base": maps.level, "lowest": maps.level_lowest}
    layers = []
    if preset is not None:
        higher = {"higher": maps.higher, "lower": maps.lower}
        layers.append(layer("level_could_be", levels, classes=level_classes(preset)))
        layers.append(layer("level_higher", higher, shares, "YlOrRd"))
    return (
        *layers,
        layer("reach_share", {"share": maps.reached, "base": maps.reached_base}, shares, "YlGnBu"),
        layer(
            "energy_ratio",
            {"q90": high, "q50": middle, "q10": low},
            (0.5, 0.8, 1.25, 2.0, 4.0),
            "RdBu_r",
        ),
        layer(
            "strongest_parameter",
            {"strongest": maps.strongest},
            classes=_parameter_classes(maps.strongest, ranges),
        ),
    )


def _parameter_classes(
    strongest: NDArray[np.int64], ranges: Sequence[ParameterRange]
) -> tuple[RasterClass, ...]:
    """The ranges that occur, in colours of their own from the most frequent; the rest in one."""
    count = np.bincount(strongest, minlength=len(ranges) + 1)[1:]
    order = [int(i) for i in np.argsort(-count, kind="stable") if count[i] or i == 0]
    colour = {k: _COLOURS[min(n, len(_COLOURS) - 1)] for n, k in enumerate(order)}
    return tuple(RasterClass(k + 1, ranges[k].label, colour[k]) for k in sorted(order))


def spread_layers(
    maps: SpreadMaps, draws: int, grid: Grid, preset: HazardPreset | None, ref_width_m: float
) -> tuple[RasterLayer, ...]:
    """Limits of the bands of the hazard level, with a preset, and of the reach probability.

    The reference width (m) is that of the hazard level.
    """
    place = Place(maps.cells, grid.shape)

    def layer(key: str, share: float, values: NDArray[Any], **look: Any) -> RasterLayer:
        width = ref_width_m if key == "ground_level" else grid.cell_size
        words: dict[str, Any] = {
            "percent": f"{100 * share:g}",
            "draws": draws,
            "width": f"{width:.4g}",
        }
        # No block and no level are no 0, as on the maps of the run itself.
        own = place.map_of(np.where(values > 0, values.astype(float), np.nan))
        band = described_band(key, "value", own, **words)
        stem = f"{key}_q{100 * share:g}"
        return described_raster(key, [band], stem=stem, **words, **look)

    layers = []
    if preset is not None:
        classes = level_classes(preset)
        layers = [
            layer("ground_level", HIGH, maps.level_high, classes=classes),
            layer("ground_level", LOW, maps.level_low, classes=classes),
        ]
    look = next(row for row in STATISTICS if row.stem == "reach_probability")
    for share, values in ((HIGH, maps.reach_high), (LOW, maps.reach_low)):
        layers.append(layer("ground_reach", share, values, breaks=look.breaks, ramp=look.ramp))
    return tuple(layers)


def spread_vectors(
    maps: SpreadMaps, draws: int, grid: Grid, preset: HazardPreset | None
) -> tuple[VectorLayer, ...]:
    """Areas that blocks reach in some and in most draws, and pieces where levels change."""
    layers = []
    if preset is not None:
        codes = [level.code for level in preset.levels]
        for key, other, which in (
            ("higher", maps.level_high, maps.level_high > maps.level),
            ("lower", maps.level_low, maps.level_low < maps.level),
        ):
            pieces = _pieces(maps.cells[which], maps.level[which], other[which], grid)
            layer = level_changes(pieces, codes, grid.crs, f"level_changes.ground_{key}")
            layers.append(replace(layer, name=f"ground_level_{key}"))
    place = Place(maps.cells, grid.shape)
    rows = [
        (label, own[0.0])
        for (label, _), reach in zip(_REACHED, (maps.reach_high, maps.reach_low), strict=True)
        if (own := footprints(place.map_of(np.where(reach > 0, reach, np.nan)), grid, [0.0]))
    ]
    columns = {
        "label": [label for label, _ in rows],
        "area_m2": np.array([outline.area for _, outline in rows], float),
    }
    colours: dict[str | int, tuple[str, str]] = {
        label: (label, colour) for label, colour in _REACHED
    }
    style = categorised_style(FOOTPRINT_STYLE.symbol, "label", colours)
    outlines = [outline for _, outline in rows]
    return (
        *layers,
        described_layer("ground_reached", columns, outlines, grid.crs, style, draws=draws),
    )


def _pieces(cells: IntArray, before: IntArray, after: IntArray, grid: Grid) -> gpd.GeoDataFrame:
    """Patches of cells with the same two levels, as :func:`level_changes` takes them."""
    most = int(max(before.max(initial=0), after.max(initial=0))) + 1
    numbers = raster(grid, cells, 1 + before * most + after).astype(np.int32)
    found = [(shape, *divmod(number - 1, most)) for shape, number in cell_outlines(numbers, grid)]
    return gpd.GeoDataFrame(
        {"before": [b for _, b, _ in found], "after": [a for _, _, a in found]},
        geometry=[shape for shape, _, _ in found],
    )
