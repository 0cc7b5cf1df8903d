"""Maps of how a result changes within the ranges of the ground classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.sensitivity import SensitivityMaps
from sassgis.io.write.layers.maps import Place, described_band, described_raster, level_classes
from sassgis.model.ground_ranges import ParameterRange
from sassgis.model.hazard import HazardPreset
from sassgis.model.languages import phrase
from sassgis.model.results import RasterClass, RasterLayer

#: Colours for the parameters, told apart as well as so many can be (P. Tol, 2021, "muted").
_COLOURS = (
    "#332288", "#88ccee", "#44aa99", "#117733", "#999933", "#ddcc77", "#cc6677", "#882255",
    "#aa4499", "#6699cc", "#661100", "#dddddd",
)  # fmt: skip


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
