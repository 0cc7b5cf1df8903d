"""Prepare a site for many campaigns: its rocks, the quantities compared, and their scores.

A campaign releases all observed rocks once. Its result is one row per rock, from which
it is scored against the rock that was observed, its stop, passages and contacts apart; each
observed impact is scored by what the model makes of the state before it. The scores of a rock are
added. A score is over the root of the number of its quantities, so that the tables count alike:
many stations or many impacts do not outweigh a stop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sassgis.gap.constants import MOST_IMPACTS, OUTCOME_DRAWS, SCORED_ROCKS, SPEED_OVER_S
from sassgis.gap.fit.distances import energy_scores, folds_of
from sassgis.gap.forward.observation_operator import campaigns, rock_quantities
from sassgis.gap.forward.released_rocks import HypothesisModel
from sassgis.gap.forward.rock_lines import RockLines, rock_lines_of
from sassgis.gap.observations.case import Campaign, Case, errors_of, observed_campaign
from sassgis.gap.residuals.impact_residuals import (
    ImpactsInFlight,
    all_impacts_in_flight,
    rebound_draws,
)
from sassgis.gap.residuals.rock_residuals import rock_means
from sassgis.grid import FloatArray, IntArray

#: What is compared of an impact: speeds along and off the ground, surface speed and energy after,
#: over the speed and the energy before.
QUANTITIES = ("impact:along", "impact:normal", "impact:turning", "impact:energy")


def observed_impacts(case: Case) -> ImpactsInFlight | None:
    """Return impacts after flights of rocks of known size; None if none was observed."""
    found = all_impacts_in_flight(case, case.semi_axes_m[:, None], OUTCOME_DRAWS)
    if found is None or found.rock.size <= MOST_IMPACTS:
        return found
    return found.take(np.linspace(0, found.rock.size - 1, MOST_IMPACTS).astype(np.int64))


def observed_outcomes(impacts: ImpactsInFlight) -> FloatArray:
    """Return speeds after over the speed before, shape (n, 3); NaN where no spin was measured."""
    after = np.column_stack(
        [impacts.impacts.vt_out_mps, impacts.impacts.vn_out_mps, impacts.impacts.omega_out_radps]
    )
    return _relative(impacts, after[:, None])[:, 0]


def simulated_outcomes(
    case: Case, model: HypothesisModel, impacts: ImpactsInFlight, *, seed: int, number: int
) -> FloatArray:
    """Return same in a model, shape (n, DRAWS, 3); a rock that would roll on keeps its speed."""
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
    """Return the mean energy score of the impacts of each rock, (n_rocks,); 0 for rocks without.

    The unit of each quantity is its scatter among the observed impacts; scores are over the root of
    the number of quantities, as those of other tables are.
    """
    spread = np.nanstd(observed, axis=0, ddof=1) if len(observed) > 1 else np.zeros(3)
    unit = np.where(spread > 1e-9, spread, 1.0)
    scores = energy_scores(observed / unit, np.swapaxes(simulated / unit, 0, 1))
    scores /= np.sqrt(observed.shape[1])
    return _per_rock(scores[:, None], impacts, n_rocks)[:, 0]


def impact_quantities(
    impacts: ImpactsInFlight, outcomes: FloatArray, n_rocks: int
) -> Mapping[str, FloatArray]:
    """Return means over impacts of each rock, (n_rocks, draws) each, of outcomes (n, draws, 3)."""
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


#: Tables whose quantities stand in the row of a rock, by the first letter of these.
_TABLES = {"deposits": "s", "passages": "S", "contacts": "c"}
_IN_ROWS = frozenset(_TABLES)


@dataclass(frozen=True, slots=True)
class Scale:
    """How quantities of a rock become a row whose distances count."""

    names: tuple[str, ...]  # of the quantities, as in ``rock_quantities``
    centre: FloatArray  # shape (k,), as the scale
    scale: FloatArray
    n_rocks: int = 0  # rows where nothing is scored at all

    def rows(self, quantities: Mapping[str, FloatArray]) -> FloatArray:
        """Return standardised values (0 without) and flags of absence, (n_rocks, 2 k)."""
        if not self.names:
            return np.zeros((self.n_rocks, 0))
        values = np.column_stack([_scored(name, quantities[name]) for name in self.names])
        z = (values - self.centre) / self.scale
        absent = ~np.isfinite(z)
        return np.hstack([np.where(absent, 0.0, z), absent.astype(float)])


@dataclass(frozen=True, slots=True)
class SiteData:
    """A site made ready for many campaigns."""

    name: str
    case: Case
    rock_lines: RockLines
    scale: Scale
    observed: Campaign
    #: Of the observed rocks, shape (n_rocks,): those of the scale, and of impacts.
    quantities: Mapping[str, FloatArray]
    rows: FloatArray  # shape (n_rocks, 2 k); the former, standardised
    impacts: ImpactsInFlight | None
    outcomes: FloatArray  # shape (n_impacts, 3); what was observed after them
    seed: int
    part: IntArray  # shape (n_rocks,); part of the cross-validation that each rock belongs to
    unit: IntArray  # shape (n_rocks,); those of a block, day or source, whose scores count as one
    #: Shape (n_rocks, 2 k). Stops of rocks of which no block is known to lie anywhere: not found,
    #: or not separate from others; and what was not measured of a block that lies, or has passed a
    #: station. They count as not measured, in replicas too.
    unseen: NDArray[np.bool_]
    sideways: bool = True  # whether offsets from fall lines and turns count

    @property
    def n_rocks(self) -> int:
        """Rocks of the site."""
        return self.case.n_rocks

    @property
    def n_parts(self) -> int:
        """Parts of the cross-validation."""
        return int(self.part.max()) + 1

    @property
    def turned(self) -> bool:
        """Whether turns at impacts count: measured, of rocks that may leave their fall lines."""
        rows = self.observed.impacts
        return (
            self.sideways
            and self.case.terrain is not None
            and rows is not None
            and bool(np.isfinite(rows.turn_deg).any())
        )

    @property
    def scored(self) -> bool:
        """Whether anything was measured that a simulation can be scored against."""
        return bool(self.scale.names) or self.impacts is not None

    @property
    def units(self) -> int:
        """Number of rocks, or of groups of them."""
        return int(self.unit.max()) + 1

    def per_unit(self, scores: FloatArray) -> FloatArray:
        """Return sums of scores of rocks over their units, shape (..., n_units)."""
        sums = np.zeros((self.units, *scores.shape[:-1]))
        np.add.at(sums, self.unit, np.moveaxis(np.nan_to_num(scores), -1, 0))
        return np.moveaxis(sums, 0, -1)


def site_data_of(
    case: Case,
    seed: int,
    name: str = "",
    simulated: HypothesisModel | None = None,
    number: int = 0,
    sideways: bool = True,
) -> SiteData:
    """Prepare a case.

    ``simulated``: what this model makes of the
    rocks, in its campaign of this number, represents what was observed: a synthetic site with all
    that goes with the real one. ``sideways``: False where neither tilt nor drift of paths is
    calibrated: wrong offsets would be compensated by the ground, which then stops rocks before they
    have gone astray.
    """
    rock_lines = rock_lines_of(case)
    observed = observed_campaign(case)
    if simulated is not None:
        observed = campaigns(
            case, rock_lines, simulated, count=1, seed=seed, number=number, tables=_IN_ROWS
        )[0]
    quantities = rock_quantities(case, observed)
    scale = scale_of(case, quantities)
    unseen = np.zeros((case.n_rocks, 0), np.bool_)
    if scale.names:
        unseen = np.column_stack([_unseen(name, quantities) for name in scale.names])
    compared = {name: quantities[name] for name in scale.names}
    impacts, outcomes = observed_impacts(case), np.empty((0, 3))
    if impacts is not None:
        outcomes = observed_outcomes(impacts)
        if simulated is not None:
            made = simulated_outcomes(case, simulated, impacts, seed=seed, number=number)
            # What was not measured of an impact is not known of the simulated one either.
            outcomes = np.where(np.isfinite(outcomes), made[:, 0], np.nan)
        seen_after = impact_quantities(impacts, outcomes[:, None], case.n_rocks)
        compared |= {k: v[:, 0] for k, v in seen_after.items() if np.isfinite(v).any()}
    return SiteData(
        name=name, case=case, rock_lines=rock_lines, scale=scale, observed=observed,
        quantities=compared, rows=scale.rows(quantities), impacts=impacts, outcomes=outcomes,
        seed=seed, part=folds_of(case.group, seed), unit=case.unit,
        unseen=np.hstack([unseen, unseen]), sideways=sideways,
    )  # fmt: skip


def _unseen(name: str, quantities: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
    """Return rocks of which a quantity was not measured, though it may have been there."""
    place = name.partition(":")[0]
    missing = ~np.isfinite(quantities[name])
    if place == "stop":
        return np.asarray(missing | (quantities["stop:blocks"] == 0.0), np.bool_)
    if place == "contacts":
        return missing
    return np.asarray(missing & (quantities[f"{place}:passed"] > 0.0), np.bool_)


def scale_of(case: Case, quantities: Mapping[str, FloatArray]) -> Scale:
    """Return quantities to be scored, with the scatter of the observed as their unit."""
    errors = errors_of(case)
    floors = {
        "runout": 2.0 * errors.stop_m,
        "aside": 2.0 * errors.position_m,
        "speed": errors.speed_rel,
        "rotation": 0.1,
        "height": 2.0 * errors.height_m,
        "blocks": 0.3,
        # Of rocks with contacts; places that are apart by their errors.
        "contacts": 1.0,
        "fastest_second": math.sqrt(2.0) * errors.position_m / SPEED_OVER_S,
        "between_contacts": 0.02,
        "hop_length_90": math.sqrt(2.0) * errors.position_m,
        "hop_height_90": 0.05,
        "rim_ratio": 0.05,
    }
    names, centre, scale = [], [], []
    for name, values in quantities.items():
        place, _, what = name.partition(":")
        if what not in floors or not (place in ("stop", "contacts") or place.startswith("S")):
            continue
        if what == "aside" and case.terrain is None:
            # Blocks cannot leave their fall lines.
            continue
        known = _scored(name, values)
        known = known[np.isfinite(known)]
        if known.size < SCORED_ROCKS:
            continue
        names.append(name)
        centre.append(float(known.mean()))
        floor = floors["runout"] if (place, what) == ("stop", "aside") else floors[what]
        scale.append(max(float(known.std(ddof=1)), floor))
    return Scale(tuple(names), np.array(centre), np.array(scale), case.n_rocks)


def _scored(name: str, values: FloatArray) -> FloatArray:
    """Return numbers of blocks count by their logarithm."""
    return np.log(np.maximum(values, 0.5)) if name.endswith(":blocks") else values


# ---------------------------------------------------------------------------------------------
# Replicas


def replicas(
    problem: SiteData, model: HypothesisModel, number: int, count: int
) -> list[Mapping[str, FloatArray]]:
    """Return quantities of the rocks in ``count`` campaigns of a model, of this ``number``."""
    made = campaigns(
        problem.case, problem.rock_lines, model,
        count=count, seed=problem.seed, number=number, tables=_IN_ROWS,
    )  # fmt: skip
    return [rock_quantities(problem.case, sample) for sample in made]


def model_rows(problem: SiteData, model: HypothesisModel, number: int, count: int) -> FloatArray:
    """Return rows per rock of campaigns of a model, shape (count, n_rocks, 2 k)."""
    if not problem.scale.names:
        return np.zeros((count, problem.n_rocks, 0))
    return rows_of(problem, replicas(problem, model, number, count))


def rows_of(problem: SiteData, samples: Sequence[Mapping[str, FloatArray]]) -> FloatArray:
    """Return rows per rock of other campaigns of the same rocks, shape (n, n_rocks, 2 k)."""
    rows = np.stack([problem.scale.rows(sample) for sample in samples])
    return np.where(problem.unseen, problem.rows, rows)


@dataclass(frozen=True, slots=True)
class Prediction:
    """Prediction of the observed rocks by a model."""

    #: Everything that is compared, by quantity, shape (count or draws, n_rocks).
    replicas: Mapping[str, FloatArray]
    scores: Mapping[str, FloatArray]  # by table, shape (n_rocks,)


def prediction(problem: SiteData, model: HypothesisModel, number: int, count: int) -> Prediction:
    """Predict the rocks in ``count`` campaigns of a model; ``number`` distinguishes them."""
    made: dict[str, FloatArray] = {}
    rows, outcomes = None, outcomes_of(problem, model, number)
    if problem.scale.names:
        each = replicas(problem, model, number, count)
        rows = rows_of(problem, each)
        made = {name: np.stack([one[name] for one in each]) for name in problem.scale.names}
    if problem.impacts is not None and outcomes is not None:
        found = impact_quantities(problem.impacts, outcomes, problem.n_rocks)
        made |= {name: v.T for name, v in found.items() if name in problem.quantities}
    return Prediction(made, _table_scores(problem, rows, outcomes))


def scores_of(
    problem: SiteData, model: HypothesisModel, number: int, rows: FloatArray
) -> FloatArray:
    """Add up the energy scores of each rock over the tables, (n_rocks,), from model_rows."""
    return added(_table_scores(problem, rows, outcomes_of(problem, model, number)))


def added(scores: Mapping[str, FloatArray]) -> FloatArray:
    """Return scores of all tables together; a table that says nothing of a rock adds nothing."""
    return np.asarray(np.sum([np.nan_to_num(s) for s in scores.values()], axis=0))


def _table_scores(
    problem: SiteData, rows: FloatArray | None, outcomes: FloatArray | None
) -> dict[str, FloatArray]:
    """Return energy score of each rock by table, over the root of the number of quantities."""
    scores = {}
    for table, letter in _TABLES.items():
        own = np.array(
            [
                name.startswith(letter) and (problem.sideways or not name.endswith(":aside"))
                for name in problem.scale.names
            ],
            np.bool_,
        )
        if rows is not None and own.any():
            both = np.concatenate([own, own])
            apart = energy_scores(problem.rows[:, both], rows[..., both])
            scores[table] = apart / np.sqrt(own.sum())
    if problem.impacts is not None and outcomes is not None:
        scores["impacts"] = impact_scores(
            problem.impacts, problem.outcomes, outcomes, problem.n_rocks
        )
    return scores


def outcomes_of(problem: SiteData, model: HypothesisModel, number: int) -> FloatArray | None:
    """Compute a model's outcomes of observed impacts, shape (n_impacts, DRAWS, 3); None without."""
    if problem.impacts is None:
        return None
    return simulated_outcomes(
        problem.case, model, problem.impacts, seed=problem.seed, number=number
    )
