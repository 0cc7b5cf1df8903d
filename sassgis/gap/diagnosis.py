"""What a diagnosis answers: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from sassgis.gap.replicas.hypothesis_model import HypothesisModel

Range = tuple[float, float]
#: Share of the draws of a cause that must show, for what it closes to speak for it.
LEAST_POWER = 0.05


@dataclass(frozen=True, slots=True)
class GapFinding:
    """One gap between what was observed and what the model predicts, in the unit of the quantity.

    Attributes
    ----------
    place : str
        Station ("S3"), reach between stations ("S2-S3", "release-S1", "S4-end"), ground class
        ("ground:talus") or "all".
    phase : str
        release, flight, impact, rolling or stopping.
    quantity : str
        With its unit in the name, as in the tables of observations.
    gap : float
        Observed less predicted, mean over rocks.
    ci95 : (low, high)
        Bootstrap over rocks.
    p_adjusted : float
        Of the largest |t| over all findings (Westfall and Young 1993).
    q_value : float
        Benjamini and Hochberg (1995), for the map.
    rocks : int
        On which it rests.
    observed, predicted : float
        Means (unit).
    test : str
        "free run", "reach" (restart from what was observed at its upper end) or "one step".
    s0_m, s1_m : float
        Chainages between which the place lies, mean over lines (m).
    x, y : float
        Where to put it on the map (m).
    values : int
        Single values that it rests on: impacts and flights of the rocks, else one a rock.
    """

    place: str
    phase: str
    quantity: str
    gap: float
    unit: str
    ci95: Range
    p_adjusted: float
    q_value: float
    rocks: int
    observed: float
    predicted: float
    test: str
    s0_m: float
    s1_m: float
    x: float
    y: float
    values: int = 0


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer in a word.

    Attributes
    ----------
    effect : str
        A family, two joined by "+", "none" or "unknown".
    confidence : float
        Probability of the answer (0 to 1): of effects that they act, alone or beside others; NaN
        where none is given.
    confusion_set : tuple of str
        What these data do not identify from it, itself included; groups where they do not tell
        families of one apart.
    phase, segments
        Where the effect acts, as far as it is identifiable: phase of motion and reaches; "" and ()
        where it is not.
    reason : str
        In a sentence.
    probabilities : mapping
        Of every cause that these data could show, of "none", and of "unknown" (an effect that they
        cannot show, or no known one), by fingerprints and gains, most likely first.
    group : str
        Group of the cause, which is often sure where the cause itself is not: "instruments",
        "start", "extra blocks", "along the way", "contact", "sideways"; "" where not even that is.
    base : str
        What the base needs: "ground" (calibrated ground is adequate), "contact_law" (the contact
        follows another law), "unresolved".
    group_probability : float
        Of its causes together; NaN without a group.
    cannot_exclude : tuple of str
        Causes that these data could not show: neither named nor excluded; counted as "unknown" in
        the probabilities.
    """

    effect: str
    confidence: float
    confusion_set: tuple[str, ...]
    phase: str = ""
    segments: tuple[str, ...] = ()
    reason: str = ""
    probabilities: Mapping[str, float] = field(default_factory=dict)
    group: str = ""
    base: str = "unresolved"
    group_probability: float = math.nan
    cannot_exclude: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """One fingerprint in some observations.

    Attributes
    ----------
    effect : str
        A family or "contact_law".
    statistic : str
        What was looked at.
    value : float
        Its size, in the unit of the statistic; NaN if it cannot be seen.
    z : float
        Mean over its standard error; below zero: against the effect.
    p_adjusted : float
        Of the largest over all fingerprints, one-sided.
    observable : bool
        Whether these data could show it.
    rocks : int
        Rocks, or groups of rocks, on which it rests.
    """

    effect: str
    statistic: str
    value: float
    z: float
    p_adjusted: float
    observable: bool
    rocks: int


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One explanation that was tried.

    Attributes
    ----------
    effect : str
        "none" (the base model, calibrated), a family, two joined by "+", or "unknown" (a flexible
        correction of the base model).
    form : str
        Functional form that fits best.
    score : float
        Energy score of rocks held out of the calibration, mean over rocks; less is better.
    gain : float
        Score of the calibrated base less this one.
    ci95 : (low, high)
        Of the gain, bootstrap over rocks.
    probability : float
        Of being the cause, among all hypotheses.
    parameters : mapping
        Calibrated parameters by name, with their unit in the name.
    intervals : mapping
        95 % intervals of the parameters.
    """

    effect: str
    form: str
    score: float
    gain: float
    ci95: Range
    probability: float
    parameters: Mapping[str, float] = field(default_factory=dict)
    intervals: Mapping[str, Range] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CauseGain:
    """What a cause closes of the gap that the base leaves, were the ground calibrated anew.

    Attributes
    ----------
    share : float
        Of the squared distance of what was observed from the base, in all numbers that sum up the
        rocks and in their errors.
    sureness : float
        Standard errors by which it is more than what chance makes of the base.
    power : float
        Share of its draws that these data would show, by a sureness of 5.
    excess : float
        Squared distance of what was observed from the base, over that of its own campaigns: the
        same for all causes of a site.
    shares : mapping
        Parameters of the draw that closes most, as shares of their ranges.
    """

    effect: str
    share: float
    sureness: float
    power: float
    excess: float
    shares: Mapping[str, float] = field(default_factory=dict)

    @property
    def credible(self) -> bool:
        """Whether the cause could make a gain at all here: else something else makes it."""
        return self.power >= LEAST_POWER


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """How far the gap shrinks on held-out rocks, S = (D_base − D_effect)/(D_base − D_floor).

    Attributes
    ----------
    value : float or None
        None where it is withheld: D_base is not significantly above the floor.
    ci95 : (low, high) or None
    distance_base, distance_effect, distance_floor : float
        Energy distances, all quantities together.
    by_quantity : mapping of quantity to {"base", "effect", "floor", "shrinkage"}
    note : str
        Why it is withheld, or what limits it.
    """

    effect: str
    value: float | None
    ci95: Range | None
    distance_base: float
    distance_effect: float
    distance_floor: float
    by_quantity: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    note: str = ""


@dataclass(frozen=True, slots=True)
class Rung:
    """One model of the ladder from the configured one to what chance leaves.

    Attributes
    ----------
    rung : str
        "configured", "ground", "contact_law", an effect, two joined by "+", "floor".
    distance : float
        Energy distance to the observed rocks, each with a model calibrated without it.
    share : float or None
        Of the gap of the configured model beyond the floor that is closed; None where that gap may
        be chance.
    ci95 : (low, high) or None
        Bootstrap over rocks, or groups of rocks.
    over : str
        The simpler rung to which ``gain`` is compared; "" of the first and the last.
    gain : float or None
        Distance of that rung less this one's.
    gain_ci95 : (low, high) or None
    """

    rung: str
    distance: float
    share: float | None = None
    ci95: Range | None = None
    over: str = ""
    gain: float | None = None
    gain_ci95: Range | None = None


@dataclass(frozen=True, slots=True)
class ModelGap:
    """How far a model is off in one statistic of the rocks.

    Attributes
    ----------
    place : str
        Station, or "stop".
    quantity : str
        "runout_m", "energy_kj" or, where masses are not known, "speed_mps"; "arrived" (%).
    statistic : str
        "median", "90 %" (quantile) or "width" (from the 10 % to the 90 % quantile); of "arrived"
        the "mean" over the rocks.
    gap : float
        Observed less predicted: above zero the model comes less far, is slower or scatters less
        than the rocks, which is the unsafe side.
    ci95 : (low, high)
    limit : float
        From which size on the gap is relevant.
    rocks : int
        On which it rests.
    side : str
        "unsafe" or "safe" where the interval excludes zero; else "".
    """

    place: str
    quantity: str
    statistic: str
    unit: str
    observed: float
    predicted: float
    gap: float
    ci95: Range
    limit: float = 0.0
    rocks: int = 0
    side: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        """What it is of."""
        return self.place, self.quantity, self.statistic

    @property
    def counts(self) -> bool:
        """Whether it is distinguished from chance, and relevant."""
        return bool(self.side) and abs(self.gap) >= self.limit

    @property
    def far_short(self) -> bool:
        """Whether it is certain, on the unsafe side, and twice as large as it must be to count."""
        return self.side == "unsafe" and self.gap >= 2.0 * self.limit


@dataclass(frozen=True, slots=True)
class GroundSetting:
    """A parameter of a ground class to set.

    Attributes
    ----------
    ci95 : (low, high)
        Of the sets of parameters that the observations do not tell from the best.
    identified : bool
        Whether that is clearly narrower than the range of the search.
    """

    ground: str
    parameter: str
    before: float
    value: float
    ci95: Range
    identified: bool


@dataclass(frozen=True, slots=True)
class Advice:
    """What to set, and what follows from it.

    Attributes
    ----------
    configured : ModelGap or None
        Worst gap of the configured model, on the unsafe side if there is one; None where neither
        stops nor speeds were observed.
    wrong_ground : tuple of str
        Classes whose calibration ran into the limits of its range, so that it was widened.
    ground_range : float
        Factor on the ranges of the calibration in the end.
    trade_offs : tuple of (one, other, correlation)
        Parameters that move together in sets that fit alike.
    compared, left : tuple of ModelGap
        All gaps of the configured model, and of the one that is handed over on rocks left out.
    recommended : str
        Rung that is handed over: the last one whose gain over the simpler one clears zero.
    short : ModelGap or None
        By what it falls short all the same, for certain and by twice what counts: it is then handed
        over as the nearest, but no model is recommended.
    why : str
        In a sentence.
    """

    configured: ModelGap | None = None
    wrong_ground: tuple[str, ...] = ()
    ground_range: float = 1.0
    settings: tuple[GroundSetting, ...] = ()
    trade_offs: tuple[tuple[str, str, float], ...] = ()
    compared: tuple[ModelGap, ...] = ()
    left: tuple[ModelGap, ...] = ()
    recommended: str = "ground"
    short: ModelGap | None = None
    why: str = ""

    @property
    def consequences(self) -> list[dict[str, Any]]:
        """What the recommended model changes of the rocks, as in ``diagnosis.json``."""
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
    """Distributions of one quantity for a figure: observed, base and effect.

    Attributes
    ----------
    observed, base, effect : tuple of float
        Values; of the models, of replicates of the same rocks. ``effect`` is empty if none is
        named.
    """

    place: str
    quantity: str
    unit: str
    observed: tuple[float, ...]
    base: tuple[float, ...]
    effect: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All that a diagnosis states.

    Attributes
    ----------
    where : tuple of GapFinding
        Most certain first.
    which : tuple of Hypothesis
        Most probable first.
    tables : mapping of table to number of rows used
    measure_next : tuple of str
        What further measurement would separate the confused effects.
    base, effect : HypothesisModel
        The calibrated base, and the model that is handed over.
    warnings : tuple of str
        What in the configuration or the observations deserves a look.
    fingerprints : tuple of Fingerprint
        The surest first; those that cannot be seen last.
    gains : tuple of CauseGain
        The surest first.
    """

    verdict: Verdict
    where: tuple[GapFinding, ...]
    which: tuple[Hypothesis, ...]
    shrinkage: Shrinkage
    rocks: int
    tables: Mapping[str, int]
    not_identifiable: tuple[str, ...]
    measure_next: tuple[str, ...]
    comparisons: tuple[Comparison, ...]
    base: HypothesisModel
    effect: HypothesisModel
    settings_hash: str
    seed: int
    warnings: tuple[str, ...] = ()
    fingerprints: tuple[Fingerprint, ...] = ()
    gains: tuple[CauseGain, ...] = ()
    ladder: tuple[Rung, ...] = ()
    advice: Advice = Advice()
    first_sentence: str = ""


def as_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """The diagnosis as plain values, in the layout of ``diagnosis.json``.

    Missing numbers (NaN) become None.
    """
    plain: dict[str, Any] = without_nan(
        {
            "first_sentence": diagnosis.first_sentence,
            "verdict": asdict(diagnosis.verdict),
            "where": [asdict(f) for f in diagnosis.where],
            "which": [asdict(c) for c in diagnosis.which],
            "fingerprints": [asdict(f) for f in diagnosis.fingerprints],
            "gains": [asdict(g) for g in diagnosis.gains],
            "ladder": [asdict(r) for r in diagnosis.ladder],
            "advice": {
                **asdict(diagnosis.advice),
                "consequences": diagnosis.advice.consequences,
            },
            "shrinkage": asdict(diagnosis.shrinkage),
            "data": {
                "rocks": diagnosis.rocks,
                "tables": dict(diagnosis.tables),
                "cannot_tell": list(diagnosis.not_identifiable),
                "measure_next": list(diagnosis.measure_next),
                "warnings": list(diagnosis.warnings),
            },
            "settings_hash": diagnosis.settings_hash,
            "seed": diagnosis.seed,
        }
    )
    return plain


def without_nan(value: Any) -> Any:
    """Plain values with None in place of NaN."""
    if isinstance(value, Mapping):
        return {str(k): without_nan(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [without_nan(v) for v in value]
    if isinstance(value, float) and math.isnan(value):
        return None
    return value
