"""Trees as a cause: energy lost at once, on some flights, on a stretch of the way."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sassgis.engine.effects.trees import Trees
from sassgis.gap.causes.cause import (
    Cause,
    CausePart,
    Fit,
    ParameterDraws,
    Range,
    Scores,
    Trace,
    Unseen,
    loss_of_flights,
    part_of,
    reaches_between,
    rounded,
    usual_scatter,
    wrong_on_one,
)
from sassgis.gap.constants import (
    CLEAR_RADII,
    CLEAR_RISE_M,
    COMPARISON_SHIFT,
    FINGERPRINT_ROCKS,
    FREE_REACH,
    LOST_SHARE,
    LOST_SIGMAS,
    MIDDLE_HALF,
    ONE_PLACE_M,
    SEEM_STRUCK,
    SEEM_STRUCK_AT_CONTACTS,
    STRUCK_SHARE,
    STRUCK_SIGMAS,
)
from sassgis.gap.forward.released_rocks import ForestStand, HypothesisModel
from sassgis.gap.observations.case import Case, errors_of
from sassgis.gap.residuals.residual_table import MODEL_FLIGHT, ResidualTable, StepTable
from sassgis.gap.residuals.rock_residuals import per_rock, sureness
from sassgis.grid import FloatArray

FIT = Fit(
    # drag_kgps per kilogram of a middling block (1/s).
    ranges={
        "efficiency": Range(0.05, 3.0, "log"),
        "drag_kgps": Range(0.03, 0.8, "log"),
        "stems_per_ha": Range(60.0, 2500.0, "log"),
        "dbh_cm": Range(10.0, 55.0),
    },
    forms={"stems": 0.45, "full_stems": 0.4, "viscous": 0.15},
    parameters={"stems": ("efficiency",), "full_stems": ("efficiency",), "viscous": ("drag_kgps",)},
)
_ENERGY = "energy_jpkg"


def _length(case: Case) -> float:
    """Return the furthest run-out observed, or the length of the shortest line (m)."""
    ends = case.profiles.s[case.profiles.offset[1:] - 1]
    seen = [
        float(np.nanmax(put.s))
        for name, put in case.projected.items()
        if name in ("deposits", "passages") and np.isfinite(put.s).any()
    ]
    return max(min(max(seen, default=float(ends.min())), float(ends.max())), 5.0)


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    length = _length(case)
    low = draws.uniform("stand.from", 0.0, 0.75 * length)
    stand = ForestStand(
        low,
        rounded(low + draws.uniform("stand.length", 0.15, 1.0) * length),
        draws.within("stand.stems", FIT.ranges["stems_per_ha"]),
        draws.within("stand.dbh", FIT.ranges["dbh_cm"]),
    )
    form, drawn = FIT.drawn("trees", draws)
    if form == "viscous":
        masses = case.mass_kg[np.isfinite(case.mass_kg)]
        middle = float(np.median(masses)) if masses.size else 1000.0
        drawn = {"drag_kgps": rounded(middle * drawn["drag_kgps"])}
    part = part_of(Trees, form, drawn)
    values = {"stand_from_m": stand.s0, "stand_to_m": stand.s1, **drawn}
    if form != "viscous":
        values |= {"stems_per_ha": stand.stems_per_ha, "dbh_cm": stand.dbh_cm}
    return CausePart(form, lambda m: replace(part.change(m), stand=stand), values)


def _in_the_stand(case: Case, models: Sequence[HypothesisModel]) -> tuple[str, ...]:
    """Return reaches with the stand of fitted models."""
    stands = [model.stand for model in models if model.stand is not None]
    if not stands:
        return case.reaches
    low = float(np.median([stand.s0 for stand in stands]))
    high = float(np.median([stand.s1 for stand in stands]))
    return reaches_between(case, low, high)


def _on_few_flights(case: Case, residuals: ResidualTable) -> Scores:
    """Test losses against flights of the base, which unrecorded contacts cut as well."""
    error = errors_of(case).position_m
    rows, loss, usual = loss_of_flights(_above_ground(residuals.steps.of("flight", _ENERGY), error))
    struck, chance = _struck(rows, loss, usual), SEEM_STRUCK_AT_CONTACTS
    with suppress(Unseen):
        base = loss_of_flights(_above_ground(residuals.steps.of(MODEL_FLIGHT, _ENERGY), error))
        chance = max(chance, float(_struck(*base).mean()))
    scores = per_rock(struck.astype(np.float64) - chance, rows.rock, case.n_rocks)
    return Scores(scores, float(struck.mean()))


def _above_ground(rows: StepTable, error_m: float) -> StepTable:
    """Return flights on which what was struck stood above the ground."""
    least = np.maximum(CLEAR_RADII * rows.radius_m, CLEAR_RISE_M)
    return rows.where((rows.clear_m > least + 2.0 * error_m) & (rows.reach < FREE_REACH))


def _struck(rows: StepTable, loss: FloatArray, usual: FloatArray) -> NDArray[np.bool_]:
    """Return whether flights lost so much that something was struck."""
    share = loss / np.maximum(rows.predicted, 1.0)
    middle = float(np.median(usual))
    # Stated errors may be too small: what flights scatter by themselves counts as well.
    scatter = max(usual_scatter(usual), 1.0)
    return (share > STRUCK_SHARE) & (usual - max(middle, 0.0) > STRUCK_SIGMAS * scatter)


def _above_the_ground(case: Case, residuals: ResidualTable) -> Scores:
    """Return the speed lost along a stretch where no impulse of the ground can have taken it."""
    rows = residuals.steps.of("aloft", "speed_mps")
    if len(rows) < 2 * FINGERPRINT_ROCKS or losses_at_one_place(residuals) is not None:
        raise Unseen
    struck = _struck_aloft(rows)
    scores = per_rock(struck.astype(np.float64), rows.rock, case.n_rocks)
    return Scores(scores, float(struck.mean()), np.where(np.isfinite(scores), SEEM_STRUCK, 0.0))


def _struck_aloft(rows: StepTable) -> NDArray[np.bool_]:
    """Return whether paths in time lost so much above the ground that something was struck."""
    lost = 1.0 - rows.observed / rows.predicted
    return (lost > LOST_SHARE) & (-rows.z > LOST_SIGMAS)


def losses_at_one_place(residuals: ResidualTable) -> tuple[int, float] | None:
    """Return how many paths in time lose speed above the ground at one place, and its chainage (m).

    It is a step that the terrain model lacks, or something built, and no trees; None without.
    """
    rows = residuals.steps.of("aloft", "speed_mps")
    place = rows.way_m[_struck_aloft(rows)]
    if place.size < FINGERPRINT_ROCKS or np.ptp(np.quantile(place, MIDDLE_HALF)) >= ONE_PLACE_M:
        return None
    return place.size, float(np.median(place))


def _on_one_reach(case: Case, residuals: ResidualTable) -> Scores:
    """Return reach with the surest loss; on the first one it would be an error of the release."""
    wrong = wrong_on_one(residuals, sign=-1.0)
    lost = [own for place, own in wrong.items() if place != case.reaches[0]]
    surest = max(lost, key=sureness)
    return Scores(surest - COMPARISON_SHIFT, float(np.nanmean(surest - COMPARISON_SHIFT)))


CAUSE = Cause(
    "trees",
    number=4,
    group="along the way",
    phase="flight",
    draw=_draw,
    statistics=(
        Trace("energy lost at once, on few flights", _on_few_flights, ("impacts",), clear=True),
        Trace(
            "speed lost above the ground, where no contact takes it",
            _above_the_ground,
            ("trajectories",),
            clear=True,
        ),
        Trace(
            "speed lost on one reach, right on the others", _on_one_reach, ("passages", "stations")
        ),
    ),
    place=_in_the_stand,
)
