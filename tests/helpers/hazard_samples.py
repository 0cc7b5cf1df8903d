"""Presets, sources and samples that the tests of this folder share."""

from __future__ import annotations

import numpy as np

from sassgis.hazard.levels import hazard_level
from sassgis.hazard.sampling_error import LevelChances, level_chances
from sassgis.settings.hazard_rules import (
    HazardCurves,
    HazardLevel,
    HazardPreset,
    IntensityClass,
    Provenance,
    Source,
    SourceCounts,
)

_HERE = Provenance("made up for the tests", False)
RED, BLUE, YELLOW, RESIDUAL = 3, 2, 1, 0


def swiss() -> HazardPreset:
    """The Swiss matrix, written out apart from the file that ships with the package."""
    return HazardPreset(
        "test",
        "A preset of the tests",
        (
            IntensityClass("low", "low", 0.0, "#00aa00", _HERE),
            IntensityClass("mean", "mean", 30.0, "#aaaa00", _HERE),
            IntensityClass("high", "high", 300.0, "#aa0000", _HERE),
        ),
        (30.0, 100.0, 300.0),
        _HERE,
        (
            HazardLevel("residual_hazard", "residual", "#ffffaa", True, _HERE),
            HazardLevel("slight", "slight", "#ffff00", False, _HERE),
            HazardLevel("mean", "mean", "#0000ff", False, _HERE),
            HazardLevel("substantial", "substantial", "#ff0000", False, _HERE),
        ),
        (
            (BLUE, BLUE, YELLOW, RESIDUAL),
            (RED, BLUE, BLUE, RESIDUAL),
            (RED, RED, RED, RESIDUAL),
        ),
        ((_HERE,) * 4,) * 3,
    )


def curves_of(
    rate: object, variance: object = 0.0, of_a_rock: object = 0.0, energies: object = (0, 30, 300)
) -> HazardCurves:
    """Curves with rates as they are given, one row per place."""
    rates = np.atleast_2d(np.asarray(rate, np.float64))
    n = rates.shape[0]
    return HazardCurves(
        np.arange(n),
        np.asarray(energies, np.float64),
        rates,
        np.array(np.broadcast_to(np.asarray(variance, np.float64), rates.shape)),
        np.array(np.broadcast_to(np.asarray(of_a_rock, np.float64), (n,))),
    )


def chances_of(
    curves: HazardCurves,
    preset: HazardPreset,
    known: np.ndarray | None = None,
    in_part: bool = False,
) -> LevelChances:
    """What another sample would make of the levels of these curves."""
    return level_chances(curves, hazard_level(curves, preset), preset, known, in_part)


def drawn_counts(
    rng: np.random.Generator, source: Source, chance: np.ndarray, places: np.ndarray | None = None
) -> SourceCounts:
    """A sample of rocks.

    ``chance[p, l, e]`` is the probability that a rock of line l comes to place p with at least the
    energy of column e. One rock has one energy: it is in a column if it is in the next one.
    """
    n = source.rocks_per_line
    draw = rng.random((*chance.shape[:2], n))
    per_line = (draw[:, :, :, None] < chance[:, :, None, :]).sum(axis=2)
    return SourceCounts(
        np.arange(chance.shape[0]) if places is None else places,
        per_line.sum(axis=1).astype(np.int64),
        (per_line**2).sum(axis=1).astype(np.int64),
    )
