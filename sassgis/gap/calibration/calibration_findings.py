"""What is wrong with calibrated values: at a limit, against the order of the ground, far away."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sassgis.gap.calibration.identifiability import Fitted
from sassgis.gap.causes.ground_classes import HARD
from sassgis.gap.inference.intervals import Interval

#: Built-in classes from hard to soft: ground on which nothing yields, loose blocks, soil.
HARDNESS = (HARD, ("talus", "debris"), ("overgrown_slope", "forest_soil", "soft_meadow"))
#: What harder ground has no less of (1) or no more of (-1), with its name.
_ORDER = {"restitution": (1, "restitution"), "mu_0": (-1, "rolling friction")}
#: Standard deviations between sites from which on a value is far from the configured one.
_FAR = 2.0


@dataclass(frozen=True, slots=True)
class CalibrationFinding:
    """Something about calibrated values that speaks against them, or for a fault elsewhere."""

    kind: str  # "limit", "order", "far" or "gain"
    parameters: tuple[str, ...]  # labels
    text: str


def findings_of(
    fitted: Sequence[Fitted], gains: Mapping[str, Interval]
) -> tuple[CalibrationFinding, ...]:
    """Values at a limit, against the order of the ground, far from what was configured.

    And sites of which the ``gains`` on rocks left out do not clear zero.
    """
    small = [
        CalibrationFinding("gain", (), f"{site}: {gain_text(gain)}, which does not clear zero.")
        for site, gain in gains.items()
        if not gain.low > 0.0
    ]
    return (*_at_limits(fitted), *_against_order(fitted), *_far(fitted), *small)


def gain_text(gain: Interval) -> str:
    """A gain of score in words."""
    ends = (gain.value, gain.low, gain.high)
    value, low, high = (f"{100.0 * v:.1f}".replace("-", "−") for v in ends)
    return f"on rocks left out the fitted classes gain {value} % ({low} to {high}) of the score"


def _at_limits(fitted: Sequence[Fitted]) -> list[CalibrationFinding]:
    return [
        CalibrationFinding(
            "limit",
            (f.parameter.label,),
            f"{f.parameter.label} is at the {f.limit} limit of the search ({f.value:.3g}): the "
            "model may lack something that acts there.",
        )
        for f in fitted
        if f.limit
    ]


def _against_order(fitted: Sequence[Fitted]) -> list[CalibrationFinding]:
    rank = {name: k for k, names in enumerate(HARDNESS) for name in names}
    found = []
    for one, other in itertools.permutations(fitted, 2):
        names = one.parameter.class_name, other.parameter.class_name
        same = one.parameter.name == other.parameter.name
        if not same or one.parameter.name not in _ORDER or not set(names) <= set(rank):
            continue
        sign, word = _ORDER[one.parameter.name]
        if rank[names[0]] >= rank[names[1]] or sign * (one.value - other.value) >= 0.0:
            continue
        before = sign * (one.parameter.configured - other.parameter.configured) < 0.0
        found.append(
            CalibrationFinding(
                "order",
                (one.parameter.label, other.parameter.label),
                f"{names[0]} is harder than {names[1]} but has {'less' if sign > 0 else 'more'} "
                f"{word} ({one.value:.3g}, {other.value:.3g})"
                + (", as configured." if before else ", unlike as configured."),
            )
        )
    return found


def _far(fitted: Sequence[Fitted]) -> list[CalibrationFinding]:
    found = []
    for f in fitted:
        apart = abs(f.share - f.parameter.start) / f.parameter.sd
        if apart > _FAR:
            found.append(
                CalibrationFinding(
                    "far",
                    (f.parameter.label,),
                    f"{f.parameter.label} {f.value:.3g} lies {apart:.1f} standard deviations "
                    f"between sites from the configured {f.parameter.configured:.3g}: is the "
                    "ground what its class says?",
                )
            )
    return found
