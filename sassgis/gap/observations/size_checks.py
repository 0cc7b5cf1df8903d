"""Whether sizes and masses can be true."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sassgis.gap.observations.allowances import MASS_ERROR_REL, SIGMAS, stated_or
from sassgis.gap.observations.observation_finding import ObservationFinding
from sassgis.gap.observations.observed import DENSITY_KGM3, Observations
from sassgis.gap.observations.rules import RULES, some_of
from sassgis.model.grid import Grid

#: Densities that rocks have (kg/m³).
_LIGHTEST_KGM3, _HEAVIEST_KGM3 = 900.0, 5000.0
#: An ellipsoid fills from half of the box of its axes; rocks lie between. Full axes give 8 times.
_FULL_AXES = 4.0
#: What axes, or the mass, look like in another unit: ellipsoids of so many times the volume.
_UNITS = {"centimetres": 1e6, "millimetres": 1e9}
_TONNES = 1e3
#: Factor within which such a number is taken for that unit.
_NEAR = 4.0


def check_sizes(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Axes, volumes, masses and densities against each other."""
    rocks = obs.rocks
    axes = 4.0 / 3.0 * math.pi * rocks.semi_axis_a_m * rocks.semi_axis_b_m * rocks.semi_axis_c_m
    density = np.where(np.isfinite(rocks.density_kgm3), rocks.density_kgm3, DENSITY_KGM3)
    volume = np.where(np.isfinite(rocks.volume_m3), rocks.volume_m3, rocks.mass_kg / density)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = axes / volume
    known = np.isfinite(ratio)
    full = known & (ratio > _FULL_AXES)
    middle = float(np.median(ratio[known])) if known.any() else 1.0
    if middle > _FULL_AXES:
        found = f"ellipsoids of {middle:,.0f} times the volume of the rocks"
        # Also of full axes in that unit.
        unit = next((u for u, f in _UNITS.items() if f / _NEAR < middle < 8.0 * _NEAR * f), "")
        tonnes = _TONNES / _NEAR < middle < _NEAR * _TONNES
        by_mass = ~np.isfinite(rocks.volume_m3[known]).any()
        fault = "tonnes" if tonnes and by_mass else "unit of axes" if unit else "full axes"
        yield from RULES[fault].at(obs, "rocks", known, found, unit=unit)
    elif full.any():
        found = f"an ellipsoid of {ratio[full].max():.1f} times the volume of the rock"
        yield from RULES["large axes"].at(obs, "rocks", full, found)
    if (small := known & (ratio < 1.0 / _FULL_AXES)).any():
        found = f"an ellipsoid of {ratio[small].min():.2g} times the volume of the rock"
        yield from RULES["small axes"].at(obs, "rocks", small, found)
    for name, table in obs.tables.items():
        numbers = table.numbers
        if not {"mass_kg", "volume_m3"} <= numbers.keys():
            continue
        with np.errstate(invalid="ignore", divide="ignore"):
            own = numbers["mass_kg"] / numbers["volume_m3"]
        odd = np.isfinite(own) & ((own < _LIGHTEST_KGM3) | (own > _HEAVIEST_KGM3))
        middle = float(np.median(own[odd])) if odd.any() else math.nan
        # In kg/m³ of a rock: between, where tonnes were meant; above, grams or litres.
        unit = "tonnes" if 0.9 <= middle <= 5.0 else "grams or litres" if middle > 1e5 else ""
        rule = RULES["unit of mass" if unit else "mass and volume"]
        yield from rule.at(obs, name, odd, f"{middle:.3g} kg/m³", unit=unit)
    density = rocks.density_kgm3
    odd = np.isfinite(density) & ((density < _LIGHTEST_KGM3) | (density > _HEAVIEST_KGM3))
    middle = float(np.median(density[odd])) if odd.any() else math.nan
    problem = "look like g/cm³" if middle < 6.0 else "not the density of a rock"
    yield from RULES["density"].at(obs, "rocks", odd, f"{middle:.4g}", problem=problem)


def check_pieces(obs: Observations, grid: Grid | None) -> Iterator[ObservationFinding]:
    """Pieces cannot weigh more than their rock."""
    rocks, deposits = obs.rocks, obs.deposits
    if not len(rocks) or not len(deposits):
        return
    owner = obs.rock_of("deposits")
    place = {name: i for i, name in enumerate(rocks.rock_id.tolist())}
    # Both were weighed.
    error = stated_or(obs.metadata.mass_error_rel, MASS_ERROR_REL)
    room = 1.0 + SIGMAS * math.sqrt(2.0) * error
    for column, unit in (("mass_kg", "kg"), ("volume_m3", "m³")):
        values = deposits.numbers[column]
        heavy: dict[str, tuple[float, float]] = {}
        rows = np.zeros(len(deposits), bool)
        for i, name in enumerate(obs.rock_names):
            own = (owner == i) & np.isfinite(values)
            lying, whole = float(values[own].sum()), float(rocks.numbers[column][place[name]])
            if own.any() and lying > room * whole:
                heavy[name] = lying, whole
                rows |= own
        if heavy:
            # Scales are wrong for many at once: that is one thing to say.
            worst = max(heavy, key=lambda name: heavy[name][0] / heavy[name][1])
            found, most = heavy[worst]
            of = f" of {worst}" if len(heavy) > 1 else ""
            yield from RULES["heavy pieces"].at(
                obs, "deposits", rows, f"{found:.4g} {unit}{of}", column,
                name=some_of(list(heavy), str), most=f"{room * most:.4g} {unit}",
            )  # fmt: skip
