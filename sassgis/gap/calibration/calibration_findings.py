"""What is wrong with calibrated values: at a limit, against the order of the ground, far away."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sassgis.gap.calibration.identifiability import Fitted
from sassgis.gap.causes.ground_classes import HARD
from sassgis.gap.inference.intervals import Interval
from sassgis.model.languages import phrase

#: Built-in classes from hard to soft: ground on which nothing yields, loose blocks, soil.
HARDNESS = (HARD, ("talus", "debris"), ("overgrown_slope", "forest_soil", "soft_meadow"))
#: What harder ground has no less of (1) or no more of (-1), and what is said where it has.
_ORDER = {
    "restitution": (1, "{} is harder than {} but has less restitution ({}, {})"),
    "mu_0": (-1, "{} is harder than {} but has more rolling friction ({}, {})"),
}
#: Values at a limit of the search.
_AT_LIMIT = {
    "low": "{} is at the low limit of the search ({}): the model may lack something that acts "
    "there.",
    "high": "{} is at the high limit of the search ({}): the model may lack something that acts "
    "there.",
}
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
    text = "{}: {}, which does not clear zero."
    small = [
        CalibrationFinding("gain", (), phrase(text, site, gain_text(gain)))
        for site, gain in gains.items()
        if not gain.low > 0.0
    ]
    return (*_at_limits(fitted), *_against_order(fitted), *_far(fitted), *small)


def gain_text(gain: Interval) -> str:
    """A gain of score in words."""
    ends = (gain.value, gain.low, gain.high)
    text = "on rocks left out the fitted classes gain {} % ({} to {}) of the score"
    return phrase(text, *(f"{100.0 * v:.1f}".replace("-", "−") for v in ends))


def _at_limits(fitted: Sequence[Fitted]) -> list[CalibrationFinding]:
    return [
        CalibrationFinding(
            "limit",
            (f.parameter.label,),
            phrase(_AT_LIMIT[f.limit], f.parameter.label, f"{f.value:.3g}"),
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
        sign, text = _ORDER[one.parameter.name]
        if rank[names[0]] >= rank[names[1]] or sign * (one.value - other.value) >= 0.0:
            continue
        before = sign * (one.parameter.configured - other.parameter.configured) < 0.0
        said = phrase(text, *names, f"{one.value:.3g}", f"{other.value:.3g}")
        said = phrase("{}, as configured." if before else "{}, unlike as configured.", said)
        labels = one.parameter.label, other.parameter.label
        found.append(CalibrationFinding("order", labels, said))
    return found


def _far(fitted: Sequence[Fitted]) -> list[CalibrationFinding]:
    found = []
    text = (
        "{} {} lies {} standard deviations between sites from the configured {}: is the ground "
        "what its class says?"
    )
    for f in fitted:
        apart = abs(f.share - f.parameter.start) / f.parameter.sd
        if apart > _FAR:
            label, configured = f.parameter.label, f"{f.parameter.configured:.3g}"
            said = phrase(text, label, f"{f.value:.3g}", f"{apart:.1f}", configured)
            found.append(CalibrationFinding("far", (label,), said))
    return found
