"""Maps of how a result answers to the ranges of the ground classes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sassgis.hazard.sensitivity import SensitivityMaps
from sassgis.model.ground_ranges import ParameterRange
from sassgis.model.hazard import HazardPreset
from sassgis.model.results import Band, RasterClass, RasterLayer

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
    base = (
        f"{samples} simulations with values that fill the ranges of all ground classes; the same "
        "blocks in each."
    )

    def band(name: str, what: str, unit: str, values: NDArray[np.generic]) -> Band:
        out = np.full(shape[0] * shape[1], np.nan, np.float32)
        out[maps.cells] = values
        return Band(name, what, unit, out.reshape(shape))

    def level(name: str, what: str, codes: NDArray[np.int64]) -> Band:
        return band(name, what, "class", np.where(codes > 0, codes, np.nan))

    layers = []
    if preset is not None:
        layers += [
            RasterLayer(
                "level_could_be",
                "Level could be",
                f"Highest level in any of {base} The ends of each range alone count as well.",
                (
                    level("highest", "Highest level within the ranges", maps.level_highest),
                    level("base", "Level with the values of the classes", maps.level),
                    level("lowest", "Lowest level within the ranges", maps.level_lowest),
                ),
                (),
                "",
                tuple(
                    RasterClass(k, c.label, c.colour, c.hatched)
                    for k, c in enumerate(preset.levels, start=1)
                ),
            ),
            RasterLayer(
                "level_higher",
                "Level could be higher: share of the simulations",
                f"Share with a higher level than with the values of the classes. {base}",
                (
                    band("higher", "Share with a higher level", "1", maps.higher),
                    band("lower", "Share with a lower level", "1", maps.lower),
                ),
                (0.0, 0.05, 0.1, 0.25, 0.5, 0.75),
                "YlOrRd",
            ),
        ]
    low, middle, high = maps.energy_ratio
    return (
        *layers,
        RasterLayer(
            "reach_share",
            "Reached: share of the simulations",
            f"Share in which any block reaches the cell. {base}",
            (
                band("share", "Share in which blocks reach the cell", "1", maps.reached),
                band("base", "Reached with the values of the classes", "1", maps.reached_base),
            ),
            (0.0, 0.05, 0.1, 0.25, 0.5, 0.75),
            "YlGnBu",
        ),
        RasterLayer(
            "energy_ratio",
            "Energy (95 %), ratio to that of the classes",
            "Quantiles 90, 50 and 10 % of the ratio; nothing where 20 blocks arrive in less than "
            f"half of them. {base}",
            (
                band("q90", "Ratio, 90 % quantile", "1", high),
                band("q50", "Ratio, median", "1", middle),
                band("q10", "Ratio, 10 % quantile", "1", low),
            ),
            (0.5, 0.8, 1.25, 2.0, 4.0),
            "RdBu_r",
        ),
        RasterLayer(
            "strongest_parameter",
            "Parameter with the strongest effect on the energy",
            "Whose range alone changes the 95 % quantile of the energy most. Nothing where none "
            "does more than another seed, or where fewer than 20 blocks arrive.",
            (level("strongest", "Position in tables/ranges.csv", maps.strongest),),
            (),
            "",
            _parameter_classes(maps.strongest, ranges),
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
