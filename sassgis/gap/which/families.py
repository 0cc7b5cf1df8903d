"""Families of effects that a diagnosis knows, and the phase of motion in which each acts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

Family = Literal[
    "lateral_deflection",
    "fragmentation",
    "soft_ground",
    "entrainment",
    "trees",
    "air_drag",
    "roughness",
    "rock_shape",
    "release_error",
    "measurement_error",
]
FAMILIES: tuple[Family, ...] = get_args(Family)
#: Families that are part of the motion; the others are errors of the observation.
PHYSICAL: tuple[Family, ...] = FAMILIES[:8]

#: Phase of motion in which each family acts.
PHASES: Mapping[str, str] = {
    "lateral_deflection": "impact",
    "fragmentation": "impact",
    "soft_ground": "impact",
    "entrainment": "impact",
    "trees": "flight",
    "air_drag": "flight",
    "roughness": "impact",
    "rock_shape": "impact",
    "release_error": "release",
    "measurement_error": "observation",
}
