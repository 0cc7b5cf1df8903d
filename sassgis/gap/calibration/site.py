"""A site of a calibration: its rocks, what was measured of them, and their scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.impact_scores import (
    impact_quantities,
    impact_scores,
    observed_impacts,
    observed_outcomes,
    simulated_outcomes,
)
from sassgis.gap.observations.campaign import observed_campaign
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.campaigns import campaigns
from sassgis.gap.replicas.hypothesis_model import configured_model
from sassgis.gap.replicas.rock_lines import RockLines, rock_lines_of
from sassgis.gap.residuals.one_step import ImpactsInFlight
from sassgis.gap.which.ensemble import Scale, rock_scores, scale_of
from sassgis.gap.which.features import rock_quantities
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable

#: Campaigns made with one set of parameters: the scatter of each rock is known from them.
COUNT = 16
#: Ground further down than this many times the furthest observed run-out is not calibrated.
_BEYOND = 1.5
#: Share of the length of the fall lines below which a class is not calibrated.
_LEAST_SHARE = 0.02


@dataclass(frozen=True, slots=True)
class CalibrationSite:
    """A site made ready for many campaigns.

    Attributes
    ----------
    name : str
    case : Case
    rock_lines : RockLines
    scale : Scale
        Quantities that are scored, with the scatter of the observed as their unit.
    quantities : mapping
        Of the observed rocks.
    rows : float64, shape (n_rocks, 2 k)
        The same, standardised.
    impacts : ImpactsInFlight or None
    outcomes : float64, shape (n_impacts, 3)
        What was observed after them.
    classes : tuple of str
        Ground classes that the rocks meet.
    """

    name: str
    case: Case
    rock_lines: RockLines
    scale: Scale
    quantities: Mapping[str, FloatArray]
    rows: FloatArray
    impacts: ImpactsInFlight | None
    outcomes: FloatArray
    classes: tuple[str, ...]

    @property
    def n_rocks(self) -> int:
        """Rocks of the site."""
        return self.case.n_rocks


def site_of(name: str, case: Case, file: str = "") -> CalibrationSite:
    """Prepare a case; ``file`` is for messages.

    Raises
    ------
    InputError
        If nothing was measured that a simulation could be compared with.
    """
    quantities = rock_quantities(case, observed_campaign(case))
    scale = scale_of(case, quantities)
    impacts = observed_impacts(case)
    if not scale.names and impacts is None:
        rows = {name: len(table) for name, table in case.observations.tables.items() if len(table)}
        raise InputError(
            "nothing to calibrate on",
            file=file or None,
            field="deposits, passages, impacts",
            found=", ".join(f"{n} {name}" for name, n in rows.items()) or "no rows",
            expected="stops, passages at stations, of 5 rocks or more, or impacts",
        )
    scored = {name: quantities[name] for name in scale.names}
    outcomes = np.empty((0, 3))
    if impacts is not None:
        outcomes = observed_outcomes(impacts)
        seen_after = impact_quantities(impacts, outcomes[:, None], case.n_rocks)
        scored |= {k: v[:, 0] for k, v in seen_after.items() if np.isfinite(v).any()}
    return CalibrationSite(
        name, case, rock_lines_of(case), scale, scored, scale.rows(quantities), impacts, outcomes,
        _classes(case, quantities, impacts),
    )  # fmt: skip


def _classes(
    case: Case, quantities: Mapping[str, FloatArray], impacts: ImpactsInFlight | None
) -> tuple[str, ...]:
    """Classes on the fall lines of the rocks, as far down as rocks can have come."""
    s = quantities.get("stop:runout", np.empty(0))
    reached = [float(np.nanmax(s))] if np.isfinite(s).any() else []
    reached += [float(np.nanmax(case.station_s))] if np.isfinite(case.station_s).any() else []
    length = np.zeros(len(case.table.classes))
    if impacts is not None:
        np.add.at(length, impacts.kind, 1.0)
    # Impacts alone say nothing of ground without any.
    limit = _BEYOND * max(reached, default=0.0)
    for line in np.unique(case.line).tolist():
        first, last = (int(v) for v in case.profiles.offset[line : line + 2])
        ends = np.clip(case.profiles.s[first:last], 0.0, limit)
        np.add.at(length, case.profiles.ground[first : last - 1], np.diff(ends))
    return tuple(
        c.name
        for c, own in zip(case.table.classes, length.tolist(), strict=True)
        if own > _LEAST_SHARE * length.sum()
    )


def replicas(
    site: CalibrationSite, table: GroundTable, *, count: int, seed: int, number: int
) -> dict[str, FloatArray]:
    """Compared quantities of ``count`` campaigns, each of shape (count or draws, n_rocks)."""
    made = _released(site, table, count, seed, number)
    if site.impacts is not None:
        outcomes = simulated_outcomes(site.case, table, site.impacts, seed=seed, number=number)
        found = impact_quantities(site.impacts, outcomes, site.n_rocks)
        made |= {name: v.T for name, v in found.items() if name in site.quantities}
    return made


def _released(
    site: CalibrationSite, table: GroundTable, count: int, seed: int, number: int
) -> dict[str, FloatArray]:
    if not site.scale.names:
        return {}
    made = campaigns(
        site.case, site.rock_lines, configured_model(site.case, table),
        count=count, seed=seed, number=number, impacts=False,
    )  # fmt: skip
    each = [rock_quantities(site.case, one) for one in made]
    return {name: np.stack([one[name] for one in each]) for name in site.scale.names}


def scores(
    site: CalibrationSite, table: GroundTable, *, seed: int, number: int, count: int = COUNT
) -> FloatArray:
    """Energy score of each observed rock with a class table, shape (n_rocks,).

    That of its stop and its passages, and that of its impacts, one by one, are added.
    """
    total = np.zeros(site.n_rocks)
    made = _released(site, table, count, seed, number)
    if made:
        rows = [site.scale.rows({name: v[k] for name, v in made.items()}) for k in range(count)]
        total += rock_scores(site.rows, np.stack(rows))
    if site.impacts is not None:
        outcomes = simulated_outcomes(site.case, table, site.impacts, seed=seed, number=number)
        total += impact_scores(site.impacts, site.outcomes, outcomes, site.n_rocks)
    return total
