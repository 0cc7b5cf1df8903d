"""The answer: from odds, scores and shrinkage to a cause, its confidence and what is confused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.core.grid import FloatArray
from sassgis.gap.case import Case
from sassgis.gap.choose import Odds, Thresholds
from sassgis.gap.contenders import NONE, Draw
from sassgis.gap.diagnosis import Finding, Verdict
from sassgis.gap.families import PHASES
from sassgis.gap.where import locate

UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for and against an answer.

    Attributes
    ----------
    odds : Odds
    best : str
        Most probable effect, or a pair.
    closes_at_most : float or None
        Upper limit of the shrinkage by the best effect, on rocks left out; None where it is
        withheld.
    """

    odds: Odds
    best: str
    closes_at_most: float | None


def probabilities(odds: Odds) -> dict[str, float]:
    """Probability of each contender, most probable first."""
    order = np.argsort(-odds.probability, kind="stable")
    return {odds.effects[k]: float(odds.probability[k]) for k in order.tolist()}


def against_base(odds: Odds, thresholds: Thresholds) -> tuple[bool, float]:
    """Whether the evidence against the base is more than chance, and the level it must exceed."""
    level = float(np.quantile(odds.evidence_of_base, thresholds.null_quantile))
    level = max(level, thresholds.null_margin)
    return odds.evidence > level, level


def best_effect(odds: Odds) -> str:
    """The most probable family."""
    return next(name for name in probabilities(odds) if name != NONE)


def decide(evidence: Evidence, thresholds: Thresholds) -> tuple[str, float, str]:
    """Answer, confidence and reason.

    Parameters
    ----------
    evidence : Evidence
    thresholds : Thresholds

    Returns
    -------
    effect : str
        "none", "unknown", a family or a pair.
    confidence : float
    reason : str
    """
    odds = evidence.odds
    shares = probabilities(odds)
    exceeds, level = against_base(odds, thresholds)
    if not exceeds:
        return (
            NONE,
            max(shares[NONE], 1.0 - thresholds.null_quantile),
            f"the evidence against the calibrated base model ({odds.evidence:.1f}, logarithm of "
            f"odds) is within what chance makes of it ({level:.1f})",
        )
    best = max(shares.get(name, 0.0) for name in evidence.best.split("+"))
    confidence = best / max(1.0 - shares[NONE], 1e-9) if best < 1.0 else 1.0
    most = evidence.closes_at_most
    weak = most is not None and most < thresholds.least_shrinkage
    if weak:
        return (
            UNKNOWN,
            0.5,
            f"the most probable effect ({evidence.best.replace('_', ' ')}) surely closes none of "
            "the gap on rocks left out",
        )
    if confidence < thresholds.least_confidence:
        return UNKNOWN, 1.0 - confidence, "no effect is probable enough to be named"
    return evidence.best, confidence, "it explains the observed rocks better than the others"


def confusion_set(effect: str, odds: Odds, thresholds: Thresholds) -> tuple[str, ...]:
    """What cannot be told from the answer: together the probability that is asked for.

    The answer comes first.
    """
    held, total = [*effect.split("+")] if effect != UNKNOWN else [UNKNOWN], 0.0
    shares = probabilities(odds)
    for name, share in shares.items():
        if total >= thresholds.confusion_mass:
            break
        total += share
        if name not in held:
            held.append(name)
    return tuple(held)


def place_of(
    effect: str,
    case: Case,
    fitted: Sequence[Draw],
    findings: Sequence[Finding],
) -> tuple[str, tuple[str, ...]]:
    """Phase of motion and legs in which an effect acts.

    Parameters
    ----------
    effect : str
        The answer.
    case : Case
    fitted : sequence of Draw
        Calibrated draws of the effect.
    findings : sequence of Finding
        Where the gap lies, for effects without a place of their own.
    """
    if effect == NONE:
        return "", ()
    if effect == UNKNOWN:
        return locate(findings)
    family = effect.split("+")[0]
    phase = PHASES[family]
    if family == "release_error":
        return phase, case.legs[:1]
    if family == "trees":
        stands = [d.model.stand for d in fitted if d.model.stand is not None]
        if stands:
            low = float(np.median([s.s0 for s in stands]))
            high = float(np.median([s.s1 for s in stands]))
            return phase, legs_between(case, low, high)
    if family in ("soft_ground", "entrainment", "roughness") and fitted:
        classes = _classes_of(family, fitted)
        if classes:
            return phase, legs_on(case, classes)
    return phase, case.legs


def _classes_of(family: str, fitted: Sequence[Draw]) -> tuple[str, ...]:
    """Ground classes that most of the fitted draws have the effect on."""
    counts: dict[str, int] = {}
    for draw in fitted:
        for name in getattr(getattr(draw.model.effects, family), "classes", ()):
            counts[name] = counts.get(name, 0) + 1
    return tuple(name for name, n in counts.items() if 2 * n > len(fitted))


def leg_edges(case: Case) -> FloatArray:
    """Chainages of the ends of the legs, median over the rocks (m), shape (n_legs + 1,)."""
    inner = np.nanmedian(case.station_s, axis=0) if case.station_names else np.empty(0)
    return np.concatenate([[-np.inf], inner, [np.inf]])


def legs_between(case: Case, low: float, high: float) -> tuple[str, ...]:
    """Legs that a stretch of chainage touches."""
    edges = leg_edges(case)
    return tuple(
        name
        for name, start, end in zip(case.legs, edges[:-1], edges[1:], strict=True)
        if low < end and high > start
    )


def legs_on(case: Case, classes: Sequence[str]) -> tuple[str, ...]:
    """Legs in which the profiles cross any of some ground classes."""
    wanted = [k for k, name in enumerate(case.table.names) if name in classes]
    found: list[str] = []
    source = case.profiles
    for line in np.unique(case.line).tolist():
        own = slice(int(source.offset[line]), int(source.offset[line + 1]) - 1)
        ends = source.s[own.start + 1 : own.stop + 1]
        for low, high, ground in zip(source.s[own], ends, source.ground[own], strict=True):
            if int(ground) in wanted and high > 0.0:
                found.extend(legs_between(case, float(low), float(high)))
    return tuple(name for name in case.legs if name in set(found))


def verdict_of(
    evidence: Evidence,
    thresholds: Thresholds,
    case: Case,
    fitted: Sequence[Draw],
    findings: Sequence[Finding],
) -> Verdict:
    """Put the answer together."""
    effect, confidence, reason = decide(evidence, thresholds)
    phase, segments = place_of(effect, case, fitted, findings)
    return Verdict(
        effect,
        float(min(max(confidence, 0.0), 0.99)),
        confusion_set(effect, evidence.odds, thresholds),
        phase,
        segments,
        reason,
    )


#: What shows each family most directly: table, column, and in words how it is measured.
_SHOWN_BY: Mapping[str, tuple[tuple[str, str, str], ...]] = {
    "lateral_deflection": (
        ("passages", "x", "where rocks pass the stations, across the slope"),
        ("impacts", "turn_deg", "the change of direction at impacts, filmed from above"),
    ),
    "fragmentation": (
        ("deposits", "mass_kg", "the masses of all blocks that lie, by the rock they broke from"),
        ("passages", "mass_kg", "the sizes of the blocks that pass the stations"),
    ),
    "entrainment": (("deposits", "mass_kg", "all blocks that lie, also those of no known rock"),),
    "soft_ground": (
        ("impacts", "vn_out_mps", "velocities before and after impacts, and the depth of scars"),
    ),
    "trees": (
        (
            "trajectories",
            "speed_mps",
            "paths in time through the stand, and stems that are hit",
        ),
        ("impacts", "vt_in_mps", "velocities at impacts, so that losses between them show"),
    ),
    "air_drag": (("trajectories", "t_s", "paths of long flights in time"),),
    "roughness": (
        ("impacts", "vn_out_mps", "velocities before and after impacts of rocks of several sizes"),
    ),
    "rock_shape": (
        ("rocks", "semi_axis_c_m", "all three axes of the rocks"),
        ("impacts", "omega_out_radps", "spin before and after impacts"),
    ),
    "release_error": (
        ("rocks", "release_speed_mps", "the speed and the place at which each rock is let go"),
    ),
    "measurement_error": (
        ("trajectories", "t_s", "paths of free flights: they must give g = 9.81 m/s²"),
    ),
}


def measure_next(case: Case, confused: Sequence[str]) -> tuple[str, ...]:
    """What further measurement would tell confused effects apart, from what each shows itself by.

    Parameters
    ----------
    case : Case
    confused : sequence of str
        The confusion set.
    """
    present = case.observations.present
    named = [name for name in confused if name in _SHOWN_BY]
    out = []
    for name in named if len(confused) > 1 else []:
        for table, column, how in _SHOWN_BY[name]:
            if column not in present.get(table, frozenset()):
                out.append(f"To tell {name.replace('_', ' ')} from the others: {how}.")
                break
    if len(named) > 1 and not out:
        out.append(
            f"More rocks: with {case.n_rocks} the measured quantities leave "
            f"{', '.join(n.replace('_', ' ') for n in named)} close to each other."
        )
    return tuple(out)
