"""The answer: from probabilities and shrinkage to a cause, its confidence and what is confused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.diagnosis import GapFinding, Verdict
from sassgis.gap.observations.case import Case
from sassgis.gap.where.findings import locate
from sassgis.gap.which.classifier import PAIR, UNKNOWN, cautious
from sassgis.gap.which.families import PHASES
from sassgis.gap.which.hypotheses import NONE, Draw
from sassgis.model.grid import FloatArray


@dataclass(frozen=True, slots=True)
class Thresholds:
    """What was chosen on worlds of development and is frozen for all that is reported.

    Attributes
    ----------
    none_share : float
        From this probability of the calibrated base on, no effect is named.
    least_confidence : float
        A cause that is less probable is not named: "unknown".
    least_shrinkage : float
        Where the upper limit of its shrinkage is below, the effect does not explain the gap:
        "unknown".
    confusion_mass : float
        Probability that a confusion set holds.
    """

    none_share: float = 0.3
    least_confidence: float = 0.3
    least_shrinkage: float = 0.0
    confusion_mass: float = 0.95


def best_cause(shares: Mapping[str, float]) -> str:
    """The most probable cause apart from the base: a family, two joined by "+", or "unknown".

    Parameters
    ----------
    shares : mapping
        Probability of each cause, most probable first.
    """
    first = next(name for name in shares if name != NONE)
    return pair_of(shares) if first == PAIR else first


def best_families(shares: Mapping[str, float]) -> list[str]:
    """Families, most probable first."""
    return [name for name in shares if name not in (NONE, UNKNOWN, PAIR)]


def pair_of(shares: Mapping[str, float]) -> str:
    """The two most probable families."""
    return "+".join(sorted(best_families(shares)[:2]))


def probability_of(cause: str, shares: Mapping[str, float]) -> float:
    """Probability of a cause."""
    return shares.get(PAIR if "+" in cause else cause, 0.0)


def decide(
    shares: Mapping[str, float], closes_at_most: float | None, thresholds: Thresholds
) -> tuple[str, float, str]:
    """Answer, its probability and reason.

    Parameters
    ----------
    shares : mapping
        Probability of each cause, most probable first.
    closes_at_most : float or None
        Upper limit of the shrinkage by the best cause, on held-out rocks; None where it is
        withheld.
    thresholds : Thresholds

    Returns
    -------
    effect : str
        "none", "unknown", a family or a pair.
    probability : float
    reason : str
    """
    none = shares.get(NONE, 0.0)
    if none >= thresholds.none_share:
        return (
            NONE,
            none,
            "the calibrated base model shows the same, as far as chance and its own discrepancies "
            f"allow a distinction (probability {none:.2f})",
        )
    best = best_cause(shares)
    probability = probability_of(best, shares)
    if best == UNKNOWN:
        return UNKNOWN, probability, "the gap looks like that of none of the known effects"
    if closes_at_most is not None and closes_at_most < thresholds.least_shrinkage:
        return (
            UNKNOWN,
            probability + shares.get(UNKNOWN, 0.0),
            f"the most probable effect ({best.replace('_', ' ')}) certainly closes none "
            "of the gap on held-out rocks",
        )
    if probability < thresholds.least_confidence:
        return UNKNOWN, shares.get(UNKNOWN, 0.0), "no effect is probable enough to be named"
    return best, probability, "its signature is that of the observed rocks"


def confusion_set(
    effect: str, shares: Mapping[str, float], thresholds: Thresholds
) -> tuple[str, ...]:
    """What cannot be distinguished from the answer: together the probability that is asked for.

    The answer comes first. Pairs have no place of their own: their families have.
    """
    held = effect.split("+")
    single = {name: share for name, share in shares.items() if name != PAIR}
    whole = sum(single.values())
    total = 0.0
    for name, share in single.items():
        if total >= thresholds.confusion_mass * whole:
            break
        total += share
        if name not in held:
            held.append(name)
    return tuple(held)


def place_of(
    effect: str,
    case: Case,
    fitted: Sequence[Draw],
    findings: Sequence[GapFinding],
) -> tuple[str, tuple[str, ...]]:
    """Phase of motion and reaches in which an effect acts.

    Parameters
    ----------
    effect : str
        The answer.
    case : Case
    fitted : sequence of Draw
        Calibrated draws of the effect.
    findings : sequence of GapFinding
        Where the gap lies, for effects without a place of their own.
    """
    if effect == NONE:
        return "", ()
    if effect == UNKNOWN:
        return locate(findings)
    family = effect.split("+")[0]
    phase = PHASES[family]
    if family == "release_error":
        return phase, case.reaches[:1]
    if family == "trees":
        stands = [d.model.stand for d in fitted if d.model.stand is not None]
        if stands:
            low = float(np.median([s.s0 for s in stands]))
            high = float(np.median([s.s1 for s in stands]))
            return phase, reaches_between(case, low, high)
    if family in ("soft_ground", "entrainment", "roughness") and fitted:
        classes = _classes_of(family, fitted)
        if classes:
            return phase, reaches_on(case, classes)
    return phase, case.reaches


def _classes_of(family: str, fitted: Sequence[Draw]) -> tuple[str, ...]:
    """Ground classes that most of the fitted draws have the effect on."""
    counts: dict[str, int] = {}
    for draw in fitted:
        for name in getattr(draw.model.effects.named(family), "classes", ()):
            counts[name] = counts.get(name, 0) + 1
    return tuple(name for name, n in counts.items() if 2 * n > len(fitted))


def _reach_bounds(case: Case) -> FloatArray:
    """Chainages of the ends of the reaches, median over the rocks (m), shape (n_reaches + 1,)."""
    inner = np.nanmedian(case.station_s, axis=0) if case.station_names else np.empty(0)
    return np.concatenate([[-np.inf], inner, [np.inf]])


def reaches_between(case: Case, low: float, high: float) -> tuple[str, ...]:
    """Reaches that a stretch of chainage touches."""
    edges = _reach_bounds(case)
    return tuple(
        name
        for name, start, end in zip(case.reaches, edges[:-1], edges[1:], strict=True)
        if low < end and high > start
    )


def reaches_on(case: Case, classes: Sequence[str]) -> tuple[str, ...]:
    """Reaches in which the profiles cross any of some ground classes."""
    wanted = [k for k, name in enumerate(case.table.names) if name in classes]
    found: list[str] = []
    source = case.profiles
    for line in np.unique(case.line).tolist():
        own = slice(int(source.offset[line]), int(source.offset[line + 1]) - 1)
        ends = source.s[own.start + 1 : own.stop + 1]
        for low, high, ground in zip(source.s[own], ends, source.ground[own], strict=True):
            if int(ground) in wanted and high > 0.0:
                found.extend(reaches_between(case, float(low), float(high)))
    return tuple(name for name in case.reaches if name in set(found))


def verdict_of(
    shares: Mapping[str, float],
    closes_at_most: float | None,
    thresholds: Thresholds,
    case: Case,
    fitted: Sequence[Draw],
    findings: Sequence[GapFinding],
    confidence_calibration: float = 0.0,
) -> Verdict:
    """Put the answer together; parameters as for ``decide`` and ``place_of``.

    ``confidence_calibration`` lowers the stated confidence, as ``classifier.cautious`` has it.
    """
    effect, probability, reason = decide(shares, closes_at_most, thresholds)
    confidence = float(cautious(probability, confidence_calibration))
    phase, segments = place_of(effect, case, fitted, findings)
    return Verdict(
        effect,
        float(min(max(confidence, 0.0), 0.99)),
        confusion_set(effect, shares, thresholds),
        phase,
        segments,
        reason,
        dict(shares),
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
        ("rocks", "release_speed_mps", "the speed and the place at which each rock is released"),
    ),
    "measurement_error": (
        ("trajectories", "t_s", "paths of free flights: they must give g = 9.81 m/s²"),
    ),
}


def measure_next(case: Case, confused: Sequence[str]) -> tuple[str, ...]:
    """What further measurement would separate confused effects, from what each shows itself by.

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
                out.append(f"To separate {name.replace('_', ' ')} from the others: {how}.")
                break
    if len(named) > 1 and not out:
        out.append(
            f"More rocks: with {case.n_rocks} the measured quantities leave "
            f"{', '.join(n.replace('_', ' ') for n in named)} close to each other."
        )
    return tuple(out)
