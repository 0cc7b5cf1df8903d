"""Families that a diagnosis tries: effects of the registry, and errors of the observation."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from sassgis.engine.effects.registry import EFFECTS, Calibration

#: Families of the diagnosis that are no effects: name to place in the order and phase.
_ERRORS = {"release_error": (8, "release"), "measurement_error": (9, "observation")}

_PLACES: dict[str, tuple[int, str]] = {
    row.name: (row.calibration.order, row.calibration.phase)
    for row in EFFECTS.values()
    if row.calibration is not None
} | _ERRORS

#: All families; their order fixes the random draws of each.
FAMILIES: tuple[str, ...] = tuple(sorted(_PLACES, key=lambda name: _PLACES[name][0]))

#: Phase of motion in which each family shows.
PHASES: Mapping[str, str] = MappingProxyType({name: _PLACES[name][1] for name in FAMILIES})


def calibration_of(family: str) -> Calibration:
    """How an effect is fitted; KeyError for what is not fitted."""
    found = EFFECTS[family].calibration
    if found is None:
        raise KeyError(family)
    return found
