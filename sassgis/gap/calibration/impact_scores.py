"""Scores of single impacts: observed states before them, and what the model makes of these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sassgis.gap.inference.distances import energy_scores
from sassgis.gap.inference.rock_tests import rock_means
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.hypothesis_model import HypothesisModel
from sassgis.gap.residuals.one_step import (
    ImpactsInFlight,
    impacts_in_flight,
    rebound_draws,
    usable_impacts,
)
from sassgis.model.grid import FloatArray

#: Orientations and slopes drawn for each impact, and impacts that are compared at most: more of
#: them cost as much as the runs and say next to nothing more.
DRAWS, MOST = 12, 400
#: What is compared of an impact: speeds along and off the ground, surface speed and energy after,
#: over the speed and the energy before.
QUANTITIES = ("impact:along", "impact:normal", "impact:turning", "impact:energy")


def observed_impacts(case: Case) -> ImpactsInFlight | None:
    """Impacts after flights of rocks of known size; None if none was observed."""
    if not len(case.observations.impacts):
        return None
    axes = case.semi_axes_m[:, None]
    rows = np.flatnonzero(usable_impacts(case, axes))
    found = impacts_in_flight(case, axes, rows, DRAWS) if rows.size else None
    if found is None or found.rock.size <= MOST:
        return found
    return found.take(np.linspace(0, found.rock.size - 1, MOST).astype(np.int64))


def observed_outcomes(impacts: ImpactsInFlight) -> FloatArray:
    """Speeds after over the speed before, shape (n, 3); NaN where no spin was measured."""
    after = np.column_stack(
        [impacts.impacts.vt_out_mps, impacts.impacts.vn_out_mps, impacts.impacts.omega_out_radps]
    )
    return _relative(impacts, after[:, None])[:, 0]


def simulated_outcomes(
    case: Case, model: HypothesisModel, impacts: ImpactsInFlight, *, seed: int, number: int
) -> FloatArray:
    """The same in a model, shape (n, DRAWS, 3); a rock that would roll on keeps its speed."""
    turns = model.measurement.spin_scale
    rng = np.random.default_rng([seed, number, 87])
    start = replace(impacts, spin=np.where(impacts.has_spin, impacts.spin / turns, impacts.spin))
    after = rebound_draws(case, model, start, rng)
    along = np.maximum(impacts.impacts.vt_in_mps, 0.0)
    rolls = np.column_stack([along, np.zeros(along.size), along / impacts.radius])
    made = np.where(np.isfinite(after), after, rolls[:, None])
    made[..., 2] *= turns
    return _relative(impacts, made)


def _relative(impacts: ImpactsInFlight, after: FloatArray) -> FloatArray:
    before = np.hypot(impacts.impacts.vt_in_mps, impacts.impacts.vn_in_mps)
    unit = np.column_stack([before, before, before / impacts.radius])
    return np.asarray(after / unit[:, None])


def impact_scores(
    impacts: ImpactsInFlight, observed: FloatArray, simulated: FloatArray, n_rocks: int
) -> FloatArray:
    """Energy score of the impacts of each rock, mean over them, shape (n_rocks,); 0 without any.

    It is over the root of the number of quantities, as those of other tables are. The unit of each
    quantity is its scatter among the observed impacts.
    """
    spread = np.nanstd(observed, axis=0, ddof=1) if len(observed) > 1 else np.zeros(3)
    unit = np.where(spread > 1e-9, spread, 1.0)
    scores = energy_scores(observed / unit, np.swapaxes(simulated / unit, 0, 1))
    scores /= np.sqrt(observed.shape[1])
    return _per_rock(scores[:, None], impacts, n_rocks)[:, 0]


def impact_quantities(
    impacts: ImpactsInFlight, outcomes: FloatArray, n_rocks: int
) -> Mapping[str, FloatArray]:
    """Means over the impacts of each rock, shape (n_rocks, draws) each; NaN without any.

    ``outcomes``: shape (n, draws, 3).
    """
    own = (impacts.inertia / impacts.radius**2)[:, None]
    before = np.hypot(impacts.impacts.vt_in_mps, impacts.impacts.vn_in_mps)
    turning = own[:, 0] * (impacts.radius * impacts.spin / before) ** 2
    energy = outcomes[..., 0] ** 2 + outcomes[..., 1] ** 2 + own * outcomes[..., 2] ** 2
    kept = np.where(impacts.has_spin[:, None], energy / (1.0 + turning[:, None]), np.nan)
    each = (*np.moveaxis(outcomes, 2, 0), kept)
    return {
        name: _per_rock(values, impacts, n_rocks, np.nan)
        for name, values in zip(QUANTITIES, each, strict=True)
    }


def _per_rock(
    values: FloatArray, impacts: ImpactsInFlight, n_rocks: int, missing: float = 0.0
) -> FloatArray:
    means, rocks = rock_means(values, impacts.rock)
    found = np.full((n_rocks, values.shape[1]), missing)
    found[rocks] = means
    return found
