"""Answer of a diagnosis: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.residuals.discrepancy import Discrepancy

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class GapFinding:
    """One gap between what was observed and what the model predicts, in the quantity's unit."""

    #: Station ("S3"), reach between stations ("S2-S3", "release-S1", "S4-end"), ground class
    #: ("ground:talus") or "all".
    place: str
    phase: str  # release, flight, impact, rolling or stopping
    quantity: str  # with its unit in the name, as in the tables of observations
    gap: float  # observed less predicted, mean over rocks
    unit: str
    ci95: Range  # bootstrap over rocks
    p_adjusted: float  # of the largest |t| over all findings (Westfall and Young 1993)
    q_value: float  # Benjamini and Hochberg (1995), for the map
    rocks: int  # on which it rests
    observed: float  # mean (unit)
    predicted: float
    #: "free run", "reach" (restart from what was observed at its upper end) or "one step".
    test: str
    s0_m: float  # chainages between which the place lies, mean over lines (m)
    s1_m: float
    x: float  # where to put it on the map (m)
    y: float
    #: Single values that it rests on: impacts and flights of the rocks, else one a rock.
    values: int = 0


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer in a word."""

    effect: str  # a family, two joined by "+", "none", "unknown" or "contact_law"
    #: Probability of the answer (0 to 1): of effects that they act, by itself or with others; NaN
    #: where none is given.
    confidence: float
    #: What these data do not separate from it, itself included, most likely first.
    confusion_set: tuple[str, ...]
    #: Where the effect acts, as far as it is identifiable: phase of motion and reaches; "" and ()
    #: where it is not.
    phase: str = ""
    segments: tuple[str, ...] = ()
    reason: str = ""  # in a sentence
    #: Of every cause, of "none", and of "unknown" (no known effect), by fingerprints and gains,
    #: most likely first.
    probabilities: Mapping[str, float] = field(default_factory=dict)
    #: Group of the cause, which is often sure where the cause itself is not: "instruments",
    #: "start", "extra blocks", "along the way", "contact", "sideways"; "" where not even that is.
    group: str = ""
    #: What the base needs: "ground" (calibrated ground is adequate), "contact_law" (the contact
    #: follows another law), "unresolved".
    base: str = "unresolved"
    #: Whether the base leaves no gap that is significant and large beyond the discrepancy of its
    #: law of motion.
    adequate: bool = False
    group_probability: float = math.nan  # of its causes together; NaN without a group
    #: Causes that these data could not show: neither named nor excluded.
    cannot_exclude: tuple[str, ...] = ()

    @property
    def named(self) -> tuple[str, ...]:
        """Causes that are named: none, one or two."""
        nothing = self.effect in ("none", "unknown", "contact_law")
        return () if nothing else tuple(self.effect.split("+"))

    @property
    def ranked(self) -> Mapping[str, float]:
        """Probabilities, most likely first, for display.

        "unknown" has those of the causes that these data cannot show; where the contact follows
        another law, "none" is that law.
        """
        names = dict.fromkeys(self.cannot_exclude, "unknown")
        if self.effect == "contact_law":
            names["none"] = "contact_law"
        found: dict[str, float] = {}
        for name, p in self.probabilities.items():
            shown = names.get(name, name)
            found[shown] = found.get(shown, 0.0) + p
        return dict(sorted(found.items(), key=lambda one: -one[1]))

    @property
    def rivals(self) -> tuple[str, ...]:
        """What these data could show, and do not separate from the answer."""
        own = {*self.effect.split("+"), *self.cannot_exclude}
        return tuple(name for name in self.confusion_set if name not in own)


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """One fingerprint in some observations."""

    effect: str  # a family or "contact_law"
    statistic: str  # what was looked at
    value: float  # its size, in the unit of the statistic; NaN if it cannot be seen
    z: float  # mean over its standard error; below zero: against the effect
    p_adjusted: float  # of the largest over all fingerprints, one-sided
    observable: bool  # whether these data could show it
    rocks: int  # rocks, or groups of rocks, on which it rests


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One explanation that was tried."""

    effect: str  # "none" (calibrated ground), "contact_law", a family, or two joined by "+"
    form: str  # functional form that fits best
    #: Energy score of rocks held out of the calibration, mean over rocks; less is better.
    score: float
    gain: float  # score of the model that it is added to less this one
    ci95: Range  # of the gain, bootstrap over rocks
    probability: float  # of being the cause, among all hypotheses
    #: Calibrated parameters by name, with their unit in the name, and their 95 % intervals.
    parameters: Mapping[str, float] = field(default_factory=dict)
    intervals: Mapping[str, Range] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CauseGain:
    """Part of the gap of the base that a cause closes, were the ground calibrated anew."""

    effect: str
    #: Of the squared distance of what was observed from the base, in all numbers that sum up the
    #: rocks and in their errors.
    share: float
    sureness: float  # standard errors by which it is more than what chance makes of the base
    power: float  # share of its draws that these data would show, by a sureness of 5
    #: Squared distance of what was observed from the base, over that of its campaigns: the same
    #: for all causes of a site.
    excess: float
    #: Parameters of the draw that closes most, as shares of their ranges.
    shares: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """How far the gap shrinks on held-out rocks, S = (D_base − D_effect)/(D_base − D_floor)."""

    effect: str
    value: float | None  # None where it is withheld: D_base is not significantly above the floor
    ci95: Range | None
    distance_base: float  # energy distances, all quantities together
    distance_effect: float
    distance_floor: float
    #: Quantity to {"base", "effect", "floor", "shrinkage"}.
    by_quantity: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    note: str = ""  # why it is withheld, or what limits it


@dataclass(frozen=True, slots=True)
class Rung:
    """One model of the ladder from the configured one to what chance leaves."""

    rung: str  # "configured", "ground", "contact_law", an effect, two joined by "+", "floor"
    #: Energy distance to the observed rocks, each with a model calibrated without it.
    distance: float
    #: Of the gap of the configured model beyond the floor that is closed; None where that gap may
    #: be chance.
    share: float | None = None
    ci95: Range | None = None  # bootstrap over rocks, or groups of rocks
    over: str = ""  # the simpler rung to which ``gain`` is compared; "" of the first and the last
    gain: float | None = None  # distance of that rung less this one's
    gain_ci95: Range | None = None


@dataclass(frozen=True, slots=True)
class ModelGap:
    """How far a model is off in one statistic of the rocks."""

    place: str  # station, or "stop"
    #: "runout_m", "energy_kj" or, where masses are not known, "speed_mps"; "arrived" (%).
    quantity: str
    #: "median", "90 %" (quantile) or "width" (from the 10 % to the 90 % quantile); of "arrived" the
    #: "mean" over the rocks.
    statistic: str
    unit: str
    observed: float
    predicted: float
    #: Observed less predicted: above zero the model comes less far, is slower or scatters less than
    #: the rocks, which is the unsafe side.
    gap: float
    ci95: Range
    limit: float = 0.0  # from which size on the gap is relevant
    rocks: int = 0  # on which it rests
    side: str = ""  # "unsafe" or "safe" where the interval excludes zero; else ""

    @property
    def key(self) -> tuple[str, str, str]:
        """Name of the quantity and its place."""
        return self.place, self.quantity, self.statistic

    @property
    def counts(self) -> bool:
        """Whether it is distinguished from chance, and relevant."""
        return bool(self.side) and abs(self.gap) >= self.limit

    @property
    def is_far(self) -> bool:
        """Whether it is certain, and twice as large as it must be to count."""
        return bool(self.side) and abs(self.gap) >= 2.0 * self.limit

    @property
    def far_short(self) -> bool:
        """Whether it is so on the unsafe side."""
        return self.side == "unsafe" and self.is_far


@dataclass(frozen=True, slots=True)
class GroundSetting:
    """A parameter of a ground class to set."""

    ground: str
    parameter: str
    before: float
    value: float
    ci95: Range  # of the sets of parameters that the observations do not distinguish from the best
    identified: bool  # whether that is clearly narrower than the range of the search


@dataclass(frozen=True, slots=True)
class Advice:
    """Recommended settings, and what follows from them."""

    #: Worst gap of the configured model, on the unsafe side if there is one; None where neither
    #: stops nor speeds were observed.
    configured: ModelGap | None = None
    #: Classes whose calibration ran into the limits of its range, so that it was widened.
    wrong_ground: tuple[str, ...] = ()
    ground_range: float = 1.0  # factor on the ranges of the calibration in the end
    settings: tuple[GroundSetting, ...] = ()
    #: Parameters that move together in sets that fit alike: one, other, correlation.
    trade_offs: tuple[tuple[str, str, float], ...] = ()
    compared: tuple[ModelGap, ...] = ()  # all gaps of the configured model
    left: tuple[ModelGap, ...] = ()  # those of the one that is handed over, on rocks left out
    #: Rung that is handed over: the last one whose gain over the simpler one clears zero.
    recommended: str = "ground"
    #: By what it falls short all the same, for certain and by twice what counts: it is then handed
    #: over as the nearest, but no model is recommended.
    short: ModelGap | None = None
    why: str = ""  # in a sentence

    @property
    def consequences(self) -> list[dict[str, Any]]:
        """Changes of the rocks by the recommended model, as in ``diagnosis.json``."""
        after = {g.key: g.predicted for g in self.left}
        return [
            {
                "place": g.place,
                "quantity": f"{g.quantity} ({g.statistic})",
                "unit": g.unit,
                "before": g.predicted,
                "after": after.get(g.key),
            }
            for g in self.compared
        ]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Distributions of one quantity for a figure: values, of models those of replicates."""

    place: str
    quantity: str
    unit: str
    observed: tuple[float, ...]
    base: tuple[float, ...]
    effect: tuple[float, ...] = ()  # empty if none is named
    configured: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All that a diagnosis states."""

    verdict: Verdict
    where: tuple[GapFinding, ...]  # of the calibrated base, most certain first
    which: tuple[Hypothesis, ...]  # most probable first
    shrinkage: Shrinkage
    rocks: int
    tables: Mapping[str, int]  # rows used
    not_identifiable: tuple[str, ...]
    measure_next: tuple[str, ...]  # what would separate the confused effects
    comparisons: tuple[Comparison, ...]
    base: HypothesisModel  # the calibrated base
    effect: HypothesisModel  # the model that is handed over
    settings_hash: str
    seed: int
    warnings: tuple[str, ...] = ()  # what to check in the configuration or the observations
    fingerprints: tuple[Fingerprint, ...] = ()  # the surest first; those that cannot be seen last
    gains: tuple[CauseGain, ...] = ()  # the surest first
    ladder: tuple[Rung, ...] = ()
    advice: Advice = Advice()
    first_sentence: str = ""
    where_configured: tuple[GapFinding, ...] = ()  # of the configured model
    not_testable: str = ""  # causes that these data cannot show, and what would show them
    #: Discrepancy of the law of motion of the base; empty where it leaves no large gap without.
    law: tuple[Discrepancy, ...] = ()


def as_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the diagnosis in the layout of ``diagnosis.json``; missing numbers become None."""
    records = ("where", "where_configured", "which", "fingerprints", "gains", "ladder", "law")
    plain: dict[str, Any] = without_nan(
        {
            "first_sentence": diagnosis.first_sentence,
            "verdict": asdict(diagnosis.verdict),
            **{name: [asdict(own) for own in getattr(diagnosis, name)] for name in records},
            "advice": asdict(diagnosis.advice) | {"consequences": diagnosis.advice.consequences},
            "shrinkage": asdict(diagnosis.shrinkage),
            "data": {
                "rocks": diagnosis.rocks,
                "tables": diagnosis.tables,
                "cannot_tell": diagnosis.not_identifiable,
                "measure_next": diagnosis.measure_next,
                "not_testable": diagnosis.not_testable,
                "warnings": diagnosis.warnings,
            },
            "settings_hash": diagnosis.settings_hash,
            "seed": diagnosis.seed,
        }
    )
    return plain


def without_nan(value: Any) -> Any:
    """Return plain values with None in place of NaN."""
    if isinstance(value, Mapping):
        return {str(k): without_nan(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [without_nan(v) for v in value]
    if isinstance(value, float) and math.isnan(value):
        return None
    return value
