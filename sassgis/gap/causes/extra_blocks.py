"""Causes that leave extra blocks: fragmentation and entrainment, known by the masses that lie.

Rocks and blocks are ranked by mass, whatever they are called. Where rocks broke the blocks of their
ranks are too light, and what they lack lies in blocks beyond the number of rocks. Where blocks were
entrained there is more mass than came down. The null is that of only the errors of the masses.
Missing rocks may have broken or have left: unless blocks next to the others make up
for them, both are possible. Pieces that bear the name of their rock show that it broke.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from sassgis.engine.effects.entrainment import Entrainment
from sassgis.engine.effects.fragmentation import Fragmentation
from sassgis.gap.causes.cause import (
    Cause,
    CausePart,
    Fit,
    ParameterDraws,
    Range,
    Scores,
    Scoring,
    Trace,
    Unseen,
    loose_classes,
    on_its_classes,
    part_of,
    rounded,
    usual_scatter,
)
from sassgis.gap.constants import (
    CHIP_SHARE,
    COMPENSATED_SHARE,
    FEW_LOST_SHARE,
    FINGERPRINT_ROCKS,
    KNOWN_ROCKS,
    LEAST_MASS_ERROR,
    LEAST_MASS_SHARE,
    MASS_DRAWS,
    MISNAMED_CHANCE,
)
from sassgis.gap.observations.case import Case, errors_of
from sassgis.gap.observations.observed import deposit_masses_kg
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.grid import FloatArray


def _mass_scores(which: int) -> Scoring:
    """Score the budget: 0, missing and lying in fragments; 1, in addition."""

    def scores(case: Case, residuals: ResidualTable) -> Scores:
        blocks, rocks = deposit_masses_kg(case.observations), case.mass_kg
        if not blocks.size or not np.isfinite(rocks).all() or not np.isfinite(blocks).all():
            raise Unseen
        blocks = blocks[blocks > CHIP_SHARE * np.median(rocks)]
        left, error = _gone(case), _scatter(case)
        unexplained = _unexplained(case, left)
        many_lost = _has_nameless(case) and unexplained.mean() > FEW_LOST_SHARE
        either = many_lost or (which == 1 and _may_be_either(case))
        # What lies next to the others may be in addition as well as theirs. Where it may be either,
        # neither is surer than the other.
        of_rocks = {1: rocks[~(left | unexplained)], 0: rocks[~left]}
        found = [_score(k, of_rocks[k], blocks, error) for k in of_rocks if either or k == which]
        return max(found, key=lambda one: float(one.values[0]))

    return scores


def _scatter(case: Case) -> float:
    """Return the relative scatter of the mass of whole rocks that lie, as seen or as stated."""
    seen = case.observations
    owner, lying = seen.rock_of("deposits"), deposit_masses_kg(seen)
    largest = np.zeros(case.n_rocks)
    own = owner >= 0
    np.maximum.at(largest, owner[own], lying[own])
    whole = largest > 0.5 * case.mass_kg
    if whole.sum() < KNOWN_ROCKS:
        return math.sqrt(2.0) * max(errors_of(case).mass_rel, LEAST_MASS_ERROR)
    return max(usual_scatter(np.log(largest[whole] / case.mass_kg[whole])), LEAST_MASS_ERROR)


def _score(which: int, rocks: FloatArray, blocks: FloatArray, error: float) -> Scores:
    """Return the budget of some rocks and blocks against what the scatter of masses makes of it."""
    if rocks.size < FINGERPRINT_ROCKS:
        raise Unseen
    rng = np.random.default_rng(1986)
    drawn = rocks * np.exp(error * rng.standard_normal((MASS_DRAWS, rocks.size)))
    if which == 0:
        # The smallest blocks may be what others have left there.
        others = np.sort(blocks)[: max(blocks.size - rocks.size, 0)]
        null = np.array([mass_budget(rocks, np.append(one, others))[0] for one in drawn])
    else:
        null = drawn.sum(axis=1) / rocks.sum() - 1.0
    value = mass_budget(rocks, blocks)[which]
    z = np.clip((value - null.mean()) / max(null.std(), LEAST_MASS_SHARE), -12.0, 12.0)
    return Scores(np.array([z]), value)


def _may_be_either(case: Case) -> bool:
    """Return whether nameless blocks may be fragments of the few missing rocks."""
    seen = case.observations
    lost = float(_not_found(case).mean())
    few_lost = 0.0 < lost <= FEW_LOST_SHARE
    return few_lost and _has_nameless(case) and not seen.is_piece("deposits").any()


def _has_nameless(case: Case) -> bool:
    """Return whether a block lies that bears no name of a rock."""
    return bool((case.observations.rock_of("deposits") < 0).any())


def _not_found(case: Case) -> NDArray[np.bool_]:
    """Return rocks of which nothing lies under their name."""
    return ~np.isin(np.arange(case.n_rocks), case.observations.rock_of("deposits"))


def _gone(case: Case) -> NDArray[np.bool_]:
    """Return rocks that passed the last station whole and do not lie: they left the survey."""
    gone = np.zeros(case.n_rocks, bool)
    seen = case.observations
    if not case.station_names or not len(seen.passages):
        return gone
    tolerance = 3.0 * math.sqrt(2.0) * max(errors_of(case).mass_rel, LEAST_MASS_ERROR)
    last = seen.passages.station == case.station_names[-1]
    rock, mass = seen.rock_of("passages")[last], seen.passages.mass_kg[last]
    with np.errstate(invalid="ignore", divide="ignore"):
        same = np.abs(np.log(mass / case.mass_kg[np.maximum(rock, 0)])) < tolerance
    gone[rock[(rock >= 0) & (same | ~np.isfinite(mass))]] = True
    # Of one that broke below the station its fragments lie.
    owner, lying = seen.rock_of("deposits"), deposit_masses_kg(seen)
    own = owner >= 0
    found = np.bincount(owner[own], lying[own], minlength=case.n_rocks)
    gone &= found < 0.5 * case.mass_kg
    # Nor has one left for which a block without a name lies.
    nameless = np.sort(lying[~own]).tolist()
    for rock in np.flatnonzero(gone)[np.argsort(-case.mass_kg[gone])]:
        if nameless and nameless[-1] >= 0.5 * case.mass_kg[rock]:
            nameless.pop()
            gone[rock] = False
    return gone


def _unexplained(case: Case, left: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return missing rocks that are not known to have left and have no fragments."""
    seen = case.observations
    owner = seen.rock_of("deposits")
    lost = _not_found(case) & ~left
    nameless = deposit_masses_kg(seen)[owner < 0].sum()
    compensated = nameless >= COMPENSATED_SHARE * case.mass_kg[lost].sum()
    return np.asarray(lost & ~(compensated | seen.is_piece("deposits").any()), np.bool_)


def mass_budget(rocks: FloatArray, blocks: FloatArray) -> tuple[float, float]:
    """Return shares of the released mass: missing and in fragments, additional; masses in kg."""
    if blocks.size <= rocks.size:
        return 0.0, 0.0
    n, total = rocks.size, float(rocks.sum())
    released, lying = np.sort(rocks)[::-1], np.sort(blocks)[::-1]
    lacking = float(np.maximum(released - lying[:n], 0.0).sum())
    more = float(blocks.sum()) - total
    # Of missing rocks the ranks lack as much as all blocks together. Five chips of a
    # kilogram are no fragments of them.
    broken = max(lacking - max(-more, 0.0), min(lacking, float(lying[n:].sum())))
    return broken / total, more / total


_FRAGMENTATION = Fit(
    ranges={
        "energy_jkg": Range(12.0, 800.0, "log"),
        "loss": Range(0.0, 0.5),
        "pieces": Range(2, 9),
        "shape": Range(0.0, 3.0),
        "survival_rate": Range(0.0, 0.8),
        "fractal_dimension": Range(1.8, 2.8),
    },
    forms={"threshold": 0.35, "fractal": 0.65},
    parameters={
        "threshold": ("energy_jkg", "loss", "pieces"),
        "fractal": ("energy_jkg", "loss", "shape", "survival_rate", "fractal_dimension"),
    },
)


def _broken(case: Case, draws: ParameterDraws) -> CausePart:
    form, values = _FRAGMENTATION.drawn("fragmentation", draws)
    if "pieces" in values:
        values["pieces"] = int(values["pieces"])
    # Smaller fragments are not looked for in the field, and there would be very many of them.
    smallest = rounded(0.03 * 4.0 / 3.0 * math.pi * float(np.median(case.radius_m)) ** 3)
    return part_of(Fragmentation, form, values, smallest_m3=smallest)


def _named_pieces(case: Case, residuals: ResidualTable) -> Scores:
    """Return rocks of which blocks lie that bear their name as fragments (R7.2 of R7).

    Those with a block or more, or with several, which is surer of few rocks: each of these blocks
    would have to be misnamed.
    """
    seen = case.observations
    if not len(seen.deposits):
        raise Unseen
    owner = seen.rock_of("deposits")[seen.is_piece("deposits")]
    pieces = np.bincount(owner[owner >= 0], minlength=case.n_rocks)

    def by_chance(least: int) -> float:
        hits = int((pieces >= least).sum())
        return float(stats.binom.sf(hits - 1, case.n_rocks, MISNAMED_CHANCE**least))

    least = min((1, 2), key=by_chance)
    broken = (pieces >= least).astype(np.float64)
    chance = np.full(case.n_rocks, MISNAMED_CHANCE**least)
    return Scores(broken, float((pieces > 0).mean()), chance)


FRAGMENTATION = Cause(
    "fragmentation",
    number=1,
    group="extra blocks",
    phase="impact",
    draw=_broken,
    closes=False,
    statistics=(
        Trace(
            "rocks of which pieces lie under their name", _named_pieces, ("deposits",), clear=True
        ),
        Trace(
            "mass of whole rocks that is missing, and lies in pieces",
            _mass_scores(0),
            ("rocks", "deposits"),
            clear=True,
        ),
    ),
)

_ENTRAINMENT = Fit(
    ranges={
        "number": Range(0.003, 0.8, "log"),
        "size_ratio": Range(0.2, 0.9),
        "share": Range(0.03, 0.6, "log"),
        "energy_kj": Range(2.0, 60.0, "log"),
    },
    forms={"poisson": 1.0, "energy": 1.0},
    parameters={"poisson": ("number", "size_ratio", "share")},
)


def _entrained(case: Case, draws: ParameterDraws) -> CausePart:
    form, values = _ENTRAINMENT.drawn("entrainment", draws)
    classes = loose_classes(case, draws)
    return part_of(Entrainment, form, values, classes=classes)


ENTRAINMENT = Cause(
    "entrainment",
    number=3,
    group="extra blocks",
    phase="impact",
    draw=_entrained,
    closes=False,
    statistics=(
        Trace(
            "mass that lies beyond what was released",
            _mass_scores(1),
            ("rocks", "deposits"),
            clear=True,
        ),
    ),
    place=on_its_classes("entrainment"),
)
