"""Soft ground as a cause: rebound lost with the normal speed, on only one ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sassgis.engine.effects.soft_ground import SoftGround
from sassgis.gap.causes.cause import (
    HARD,
    Cause,
    CausePart,
    Fit,
    ParameterDraws,
    Range,
    Scores,
    Trace,
    Unseen,
    contact_gaps,
    on_its_classes,
    over_scatter,
    part_of,
    reach_gaps,
    sizes,
    soft_first,
)
from sassgis.gap.constants import (
    FINGERPRINT_ROCKS,
    GROUND_BOUNDS,
    GROUND_WIDTHS,
    IMPACT_DRAWS,
    SOFT_LOSS,
)
from sassgis.gap.forward.released_rocks import configured_model
from sassgis.gap.observations.case import Case
from sassgis.gap.residuals.impact_residuals import all_impacts_in_flight, rebound_draws
from sassgis.gap.residuals.residual_table import ResidualTable
from sassgis.gap.residuals.rock_residuals import mean_of_draws, per_rock, sureness
from sassgis.settings.ground import GroundClass, GroundTable

FIT = Fit(
    ranges={
        "reference_speed_mps": Range(0.4, 12.0, "log"),
        "depth_scale": Range(1.0, 80.0, "log"),
        "drag_coefficient": Range(0.5, 6.0, "log"),
        "friction": Range(0.05, 0.6),
    },
    forms={"velocity_scaled": 1.0, "scar": 1.0, "slip": 1.0},
    parameters={
        "velocity_scaled": ("reference_speed_mps",),
        "scar": ("depth_scale", "drag_coefficient"),
        "slip": ("friction",),
    },
)


def _draw(case: Case, draws: ParameterDraws) -> CausePart:
    form, values = FIT.drawn("soft_ground", draws)
    softest = soft_first(case)
    soft = softest[: 1 + int(draws.share("soft_classes") * len(softest))]
    return part_of(SoftGround, form, values, classes=tuple(soft))


def _on_one_ground(case: Case, residuals: ResidualTable) -> Scores:
    """Return the yielding ground on which the loss is surest."""
    rows, z = contact_gaps(residuals, "normal_speed_mps")
    lost = []
    for k in np.unique(rows.ground).tolist():
        on = rows.ground == k
        if k < 0 or case.table.names[k] in HARD or on.sum() < 3 * FINGERPRINT_ROCKS or on.all():
            continue
        fast = np.log(np.maximum(rows.vn_mps, 0.2))
        score = -(z - float(np.mean(z[~on]))) * np.exp(fast - fast[on].mean())
        own = np.where(on, rows.rock, -1)
        values = per_rock(np.where(on, score, np.nan), own, case.n_rocks) - 0.3
        lost.append(Scores(values, float(score[on].mean())))
    if not lost:
        raise Unseen
    return max(lost, key=lambda one: sureness(one.values))


def _beyond_usual(case: Case, residuals: ResidualTable) -> Scores:
    """Return what contacts on one yielding ground lose beyond all usual values of its class.

    Less what those on other ground lose beyond theirs: another law of the contact does that on all.
    The ground must do it in its upper and its lower part, or it is a patch of other ground.
    """
    seen = all_impacts_in_flight(case, residuals.run.axes_m, IMPACT_DRAWS)
    if seen is None:
        raise Unseen
    model = configured_model(case)
    lossy = replace(model, table=GroundTable(tuple(map(_least_rebound, model.table.classes))))
    draws = rebound_draws(case, lossy, seen, np.random.default_rng([residuals.run.seed, 37]))
    before = seen.impacts.vt_in_mps**2 + seen.impacts.vn_in_mps**2
    kept = (seen.impacts.vt_out_mps**2 + seen.impacts.vn_out_mps**2) / before
    usual = mean_of_draws((draws[..., :2] ** 2).sum(axis=2)) / before
    lost = np.clip(usual - kept, -1.0, 1.0) - SOFT_LOSS
    known, found = np.isfinite(lost), []
    for k in np.unique(seen.kind).tolist():
        on = (seen.kind == k) & known
        others = (seen.kind != k) & known
        if case.table.names[k] in HARD or min(on.sum(), others.sum()) < 3 * FINGERPRINT_ROCKS:
            continue
        beyond = lost - max(float(lost[others].mean()), 0.0)
        middle = float(np.median(seen.s[on]))
        parts = [
            per_rock(beyond, np.where(on & half, seen.rock, -1), case.n_rocks)
            for half in (seen.s <= middle, seen.s > middle)
        ]
        values = min(parts, key=sureness)
        found.append(Scores(values, float(beyond[on].mean() + SOFT_LOSS)))
    if not found:
        raise Unseen
    return max(found, key=lambda one: sureness(one.values))


def _least_rebound(ground: GroundClass) -> GroundClass:
    """Return a class with the usual values at which contacts lose most."""
    changed = {
        name: max(getattr(ground, name) - GROUND_WIDTHS[name], GROUND_BOUNDS[name][0])
        for name in ("eta_max", "restitution")
    }
    return replace(ground, **changed)


def _large_stop_early(case: Case, residuals: ResidualTable) -> Scores:
    foot = reach_gaps(residuals, "runout_m")
    late = mean_of_draws(over_scatter(foot, 1.0), least=1)
    late = (late - np.nanmean(late)) * sizes(residuals)
    return Scores(-late, float(-np.nanmean(late)))


CAUSE = Cause(
    "soft_ground",
    number=2,
    group="contact",
    phase="impact",
    draw=_draw,
    statistics=(
        Trace(
            "energy lost at contacts beyond all usual values, on one yielding ground alone",
            _beyond_usual,
            ("impacts",),
            clear=True,
        ),
        Trace(
            "rebound lost with the normal speed, on one ground alone", _on_one_ground, ("impacts",)
        ),
        Trace(
            "large rocks stop early at the foot",
            _large_stop_early,
            ("passages", "stations", "deposits"),
        ),
    ),
    place=on_its_classes("soft_ground"),
)
