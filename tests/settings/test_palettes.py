"""Classes of zones and maps differ without colour, and to eyes that do not see all colours."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from sassgis.hazard.levels import (
    hazard_level_style,
    level_change_style,
    uncertain_style,
    zone_style,
)
from sassgis.inputs.presets import preset_names, read_preset
from sassgis.outputs.layers.risk_objects import _RAMP
from sassgis.settings.statistics_table import STATISTICS
from sassgis.settings.styles import Symbol, VectorStyle, class_colours, rgb

#: Steps of L* between classes that are to be told apart without colour; a difference of about 2
#: is just seen side by side, and prints and distances take more.
GREY_STEP = 9.0
#: Distance in CIE Lab of classes to eyes that lack one kind of cones.
COLOUR_STEP = 15.0
#: Machado, Oliveira and Fernandes (2009), severity 1, for linear RGB.
DEFICIENCY = {
    "protan": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deutan": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritan": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
PRESETS = [read_preset(name) for name in preset_names()]


def linear(colour: str) -> NDArray[np.float64]:
    part = np.array(rgb(colour)) / 255.0
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def lab(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIE Lab (D65) of linear RGB."""
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    t = to_xyz @ np.clip(light, 0.0, 1.0) / [0.9505, 1.0, 1.089]
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def grey(colour: str) -> float:
    return float(lab(linear(colour))[0])


def indistinct(first: Symbol, second: Symbol) -> list[str]:
    """To whom two signs look the same."""
    if first.hatch != second.hatch:
        return []
    out = [] if abs(grey(first.colour) - grey(second.colour)) >= GREY_STEP else ["in grey"]
    for name, matrix in DEFICIENCY.items():
        one, two = (lab(np.array(matrix) @ linear(s.colour)) for s in (first, second))
        if np.linalg.norm(one - two) < COLOUR_STEP:
            out.append(name)
    return out


def test_what_looks_the_same_is_found() -> None:
    assert [grey(c) for c in ("#ffffff", "#777777")] == pytest.approx([100.0, 50.0], abs=0.3)
    red, green = Symbol("fill", "#d7262b"), Symbol("fill", "#5d7a00")
    assert "in grey" in indistinct(red, green)
    assert indistinct(red, Symbol("fill", "#d7262b", hatch="diagonal")) == []


STYLES = {
    "changes": level_change_style("change"),
    **{f"levels of {p.name}": hazard_level_style("level", p.levels) for p in PRESETS},
    **{
        f"intensities of {p.name}": zone_style(
            "class", [(c.code, c.label, c.colour, False) for c in p.intensities]
        )
        for p in PRESETS
    },
}


@pytest.mark.parametrize("style", STYLES.values(), ids=STYLES)
def test_classes_of_zones_differ(style: VectorStyle) -> None:
    for first, second in combinations(style.classes, 2):
        same = indistinct(first.symbol, second.symbol)
        assert not same, f"{first.label} and {second.label}: {', '.join(same)}"


@pytest.mark.parametrize("preset", PRESETS, ids=lambda p: p.name)
def test_uncertain_places_are_hatched_as_no_level_is(preset: object) -> None:
    levels = hazard_level_style("level", preset.levels)  # type: ignore[attr-defined]
    assert uncertain_style().symbol.hatch not in {c.symbol.hatch for c in levels.classes}


def test_ramps_fall_in_steps_that_are_seen_in_grey() -> None:
    palettes = [class_colours(row.breaks, row.ramp) for row in STATISTICS if row.breaks]
    palettes += [
        class_colours((0.0, 30.0, 300.0), "YlOrRd"),
        class_colours((0.0, 1e-6, 1e-5, 1e-4, 1e-3), _RAMP),
    ]
    for palette in palettes:
        steps = -np.diff([grey(colour) for colour in palette])
        assert (np.abs(steps) >= GREY_STEP).all() and len(set(np.sign(steps))) == 1, palette
    assert all(a != b for palette in palettes for a, b in pairwise(palette))
