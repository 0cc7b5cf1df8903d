"""Maps, areas and tables of changes: other ground classes, another result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sassgis.files.vector_layer import VectorLayer, described_layer
from sassgis.grid import Grid
from sassgis.hazard.assess import raster
from sassgis.hazard.levels import LEVEL_CHANGES
from sassgis.hazard.zoning.coverage import Coverage
from sassgis.inputs.dem import affine_of
from sassgis.outputs.frames import same, table_of
from sassgis.outputs.layers.maps import described_band, described_raster, level_classes, on_grid
from sassgis.outputs.layers.run_vectors import cell_outlines, footprints
from sassgis.outputs.layers.zones import change_table, changes, level_changes
from sassgis.settings.ground import ParameterRange, RangeRule
from sassgis.settings.hazard_rules import HazardPreset
from sassgis.settings.languages import phrase
from sassgis.settings.results import RasterClass, RasterLayer, rounded
from sassgis.settings.statistics_table import STATISTICS
from sassgis.settings.styles import FOOTPRINT_STYLE, categorised_style
from sassgis.studies import result_change
from sassgis.studies.stored_result import StoredResult
from sassgis.studies.variants import HIGH, LOW, Answers, CellMaps, RangeEffect, SpreadBand

#: Breaks and ramp of the maps of a sensitivity that have no classes.
_SHARES = (0.0, 0.05, 0.1, 0.25, 0.5, 0.75)
_LOOKS: dict[str, tuple[tuple[float, ...], str]] = {
    "level_higher": (_SHARES, "YlOrRd"),
    "reach_share": (_SHARES, "YlGnBu"),
    "energy_ratio": ((0.5, 0.8, 1.25, 2.0, 4.0), "RdBu_r"),
}
#: Colours for the parameters, as distinct as so many can be (P. Tol, 2021, "muted").
_COLOURS = (
    "#332288", "#88ccee", "#44aa99", "#117733", "#999933", "#ddcc77", "#cc6677", "#882255",
    "#aa4499", "#6699cc", "#661100", "#dddddd",
)  # fmt: skip
#: Label and colour of what blocks reach in some and in most draws, the larger first.
_REACHED = {
    "high": ("reached in a tenth of the draws", "#fdcc8a"),
    "low": ("reached in nine tenths of the draws", "#d7301f"),
}


def sensitivity_layers(
    maps: CellMaps,
    ranges: Sequence[ParameterRange],
    samples: int,
    shape: tuple[int, int],
    preset: HazardPreset | None,
) -> tuple[RasterLayer, ...]:
    """Return all maps; those of levels only with a preset."""
    text = (
        "{} simulations with values that fill the ranges of all ground classes; the same blocks "
        "in each."
    )
    cells, all_bands = maps
    classes = {
        "level_could_be": () if preset is None else level_classes(preset),
        "strongest_parameter": _parameter_classes(
            all_bands["strongest_parameter"]["strongest"], ranges
        ),
    }
    layers = []
    for key, bands in all_bands.items():
        if preset is None and key.startswith("level"):
            continue
        shown = [
            # No level and no parameter are 0.
            described_band(
                key,
                n,
                on_grid(np.where(v > 0, v, np.nan) if key in classes else v, cells, shape),
            )
            for n, v in bands.items()
        ]
        look = (*_LOOKS.get(key, ((), "")), classes.get(key, ()))
        layers.append(described_raster(key, shown, *look, base=phrase(text, samples)))
    return tuple(layers)


def _parameter_classes(
    strongest: NDArray[np.int64], ranges: Sequence[ParameterRange]
) -> tuple[RasterClass, ...]:
    """Return ranges that occur, in separate colours from the most frequent; the rest in one."""
    count = np.bincount(strongest, minlength=len(ranges) + 1)[1:]
    order = [int(i) for i in np.argsort(-count, kind="stable") if count[i] or i == 0]
    colour = {k: _COLOURS[min(n, len(_COLOURS) - 1)] for n, k in enumerate(order)}
    return tuple(RasterClass(k + 1, ranges[k].label, colour[k]) for k in sorted(order))


def spread_layers(
    maps: CellMaps, draws: int, grid: Grid, preset: HazardPreset | None, ref_width_m: float
) -> tuple[RasterLayer, ...]:
    """Return limits of the bands of hazard level (width in m), with a preset, and of reach."""
    cells, bands = maps
    reach = next(row for row in STATISTICS if row.stem == "reach_probability")
    looks: dict[str, tuple[float, dict[str, Any]]] = {
        "ground_reach": (grid.cell_size, {"breaks": reach.breaks, "ramp": reach.ramp})
    }
    if preset is not None:
        looks = {"ground_level": (ref_width_m, {"classes": level_classes(preset)})} | looks
    layers = []
    for key, (width, look) in looks.items():
        for name, share in (("high", HIGH), ("low", LOW)):
            percent = f"{100 * share:g}"
            words: dict[str, Any] = {"percent": percent, "draws": draws, "width": f"{width:.4g}"}
            values = bands[key][name]
            # No block and no level are no 0, as on the maps of the run itself.
            own = np.where(values > 0, values.astype(float), np.nan)
            band = described_band(key, "value", on_grid(own, cells, grid.shape), **words)
            layers.append(described_raster(key, [band], stem=f"{key}_q{percent}", **look, **words))
    return tuple(layers)


def spread_vectors(
    maps: CellMaps, draws: int, grid: Grid, preset: HazardPreset | None
) -> tuple[VectorLayer, ...]:
    """Return areas that blocks reach in some and in most draws, and parts where levels change."""
    layers = []
    cells, bands = maps
    level, low, high = (bands["ground_level"][name] for name in ("base", "low", "high"))
    for key, other, which in (("higher", high, high > level), ("lower", low, low < level)):
        if preset is not None:
            pieces = _pieces(cells[which], level[which], other[which], grid)
            codes = [own.code for own in preset.levels]
            layer = level_changes(pieces, codes, grid.crs, f"level_changes.ground_{key}")
            layers.append(replace(layer, name=f"ground_level_{key}"))
    labels, outlines = [], []
    for name, (label, _) in _REACHED.items():
        reach = bands["ground_reach"][name]
        reach = on_grid(np.where(reach > 0, reach, np.nan), cells, grid.shape)
        own = footprints(reach, grid, [0.0])
        if own:
            labels.append(label)
            outlines.append(own[0.0])
    areas = np.array([outline.area for outline in outlines], float)
    colours: dict[str | int, tuple[str, str]] = {look[0]: look for look in _REACHED.values()}
    style = categorised_style(FOOTPRINT_STYLE.symbol, "label", colours)
    columns = {"label": labels, "area_m2": areas}
    reached = described_layer("ground_reached", columns, outlines, grid.crs, style, draws=draws)
    return (*layers, reached)


def _pieces(
    cells: NDArray[Any], before: NDArray[Any], after: NDArray[Any], grid: Grid
) -> gpd.GeoDataFrame:
    """Return patches of cells with the same two levels, as :func:`level_changes` takes them."""
    most = int(max(before.max(initial=0), after.max(initial=0))) + 1
    numbers = raster(grid, cells, 1 + before * most + after).astype(np.int32)
    outlines = cell_outlines(numbers, affine_of(grid))
    found = [(shape, *divmod(number - 1, most)) for shape, number in outlines]
    return gpd.GeoDataFrame(
        {"before": [b for _, b, _ in found], "after": [a for _, _, a in found]},
        geometry=[shape for shape, _, _ in found],
    )


def range_table(ranges: Sequence[ParameterRange]) -> pd.DataFrame:
    """Return the ranges with their sources."""
    names = ("parameter", "value", "low", "high", "sd", "source", "verified", "sites", "rocks")
    columns = {"class": "class_name", **same(*names)}
    table = table_of(ranges, columns, {"low": 6, "high": 6, "sd": 6})
    table.insert(0, "number", range(1, len(ranges) + 1))
    return table


def rule_table(rules: Sequence[RangeRule]) -> pd.DataFrame:
    """Return ranges as ``--ranges`` and ``[ground] ranges`` take them."""
    names = ("parameter", "kind", "low", "high", "source", "verified", "sites", "rocks")
    return table_of(rules, {"class": "class_name", **same(*names)}, {"low": 6, "high": 6})


def effect_table(effects: Sequence[RangeEffect]) -> pd.DataFrame:
    """Return a row for each parameter and measure."""
    columns = {
        "class": "range.class_name", "parameter": "range.parameter",
        **same("measure", "unit", "base"), "at_low": "low", "at_high": "high",
        "another_seed": "chance", "beyond_chance": "beyond_chance",
        "rank_correlation": "correlation",
    }  # fmt: skip
    digits = dict.fromkeys(("base", "at_low", "at_high", "another_seed"), 5)
    return table_of(effects, columns, {**digits, "rank_correlation": 3})


def band_table(bands: Sequence[SpreadBand]) -> pd.DataFrame:
    """Return a row for each measure, with the values of the classes and over the draws."""
    columns = {**same("measure", "unit", "base"), "q10": "low", "q50": "middle", "q90": "high"}
    return table_of(bands, columns, dict.fromkeys(("base", "q10", "q50", "q90"), 5))


def answer_table(table: Answers, ranges: Sequence[ParameterRange]) -> pd.DataFrame:
    """Return a row for each simulation: the values of its parameters, and its measures."""
    columns: dict[str, list[object]] = {"simulation": [v.name for v in table.variants]}
    for r in ranges:
        key = (r.class_name, r.parameter)
        columns[r.label] = [rounded(v.values.get(key, r.value), 5) for v in table.variants]
    for (measure, unit), values in zip(table.units.items(), table.values.T, strict=True):
        name = measure if unit == "1" else f"{measure} ({unit})"
        columns[name] = [rounded(float(value), 5) for value in values]
    return pd.DataFrame(columns)


#: Limits of the legend: as much below as above zero.
_BREAKS = {
    "reach_probability": (-0.3, -0.1, -0.03, -0.01, 0.01, 0.03, 0.1, 0.3),
    "energy": (-300.0, -100.0, -30.0, -10.0, 10.0, 30.0, 100.0, 300.0),
    "passing_height": (-3.0, -1.0, -0.3, -0.1, 0.1, 0.3, 1.0, 3.0),
}


def change_layers(before: StoredResult, after: StoredResult) -> tuple[RasterLayer, ...]:
    """Map the change on the same cells, each map with bands of the value before and after."""
    layers = []
    for stem, band, title, unit in result_change.compared_maps(before, after):
        old, new = (r.band(stem, band) for r in (before, after))
        values = {"change": result_change.difference(old, new), "before": old, "after": new}
        width = (
            f" Width {before.grid.cell_size:.4g} m (one cell)."
            if stem == result_change.REACH.stem
            else ""
        )
        words: dict[str, Any] = {
            "title": title,
            "what": f"{title[0].lower()}{title[1:]}",
            "unit": unit,
            "in_unit": f" ({unit})" if unit != "1" else "",
            "width": width,
        }
        bands = [described_band("change", name, own, **words) for name, own in values.items()]
        look = (_BREAKS[stem], "RdBu_r")
        layers.append(described_raster("change", bands, *look, stem=f"{stem}_change", **words))
    return tuple(layers)


def level_change_layer(before: StoredResult, after: StoredResult) -> RasterLayer:
    """Map where the hazard level is higher or lower, with bands of the level before and after."""
    key = "hazard_level_change"
    old, new = (r.band(*result_change.LEVEL[:2]) for r in (before, after))
    values = {
        "change": 2.0 + np.sign(result_change.difference(old, new)),
        "before": old,
        "after": new,
    }
    bands = [described_band(key, name, own) for name, own in values.items()]
    kinds = [RasterClass(i, *LEVEL_CHANGES[c]) for i, c in enumerate(LEVEL_CHANGES, start=1)]
    levels = "; ".join(f"{c.value} {c.label}" for c in after.maps[result_change.LEVEL.stem].classes)
    return described_raster(key, bands, classes=kinds, levels=levels)


def zone_changes(
    before: StoredResult, after: StoredResult
) -> tuple[VectorLayer, pd.DataFrame] | None:
    """Return parts of the zones by change of level, and their areas; None without zones."""
    if before.zones is None or after.zones is None:
        return None
    both = changes(_one_class_each(before.zones), _one_class_each(after.zones))
    labels = [
        c.label for c in sorted(after.maps[result_change.LEVEL.stem].classes, key=lambda c: c.value)
    ]
    # Of the level that neither result has a zone of, the label.
    codes = [
        two if two != label else one
        for label, one, two in zip(labels, before.level_codes, after.level_codes, strict=True)
    ]
    layer = level_changes(both, codes, after.grid.crs, "level_changes.compared")
    return layer, change_table(both, labels, "level_before")


def _one_class_each(zones: Coverage) -> Coverage:
    """Return zones of a class as one: only borders between levels are to cut the other zones."""
    frame = gpd.GeoDataFrame({"k": zones.classes}, geometry=list(zones.polygons)).dissolve("k")
    return Coverage(frame.geometry.to_numpy(), frame.index.to_numpy(np.int64))


def change_rows_table(rows: Sequence[result_change.ChangeRow]) -> pd.DataFrame:
    """Return every number before and after, a row each."""
    columns = same("part", "name", "quantity", "unit", "before", "after", "change")
    return table_of(rows, columns, dict.fromkeys(("before", "after", "change"), 6))


def difference_table(differences: Sequence[result_change.SettingChange]) -> pd.DataFrame:
    """List in what program, settings, inputs and libraries differ, a row each."""
    return table_of(differences, same("kind", "name", "before", "after"), {})
