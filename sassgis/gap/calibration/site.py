"""A site of a calibration: its rocks, what was measured of them, and their scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sassgis.engine.simulate_paths import PathTerrain
from sassgis.gap.calibration.impact_scores import (
    impact_quantities,
    impact_scores,
    observed_impacts,
    observed_outcomes,
    simulated_outcomes,
)
from sassgis.gap.calibration.observed_release import Released, observed, released
from sassgis.gap.observations.case import Case
from sassgis.gap.replicas.rock_lines import RockLines, rock_lines_of
from sassgis.gap.residuals.one_step import ImpactsInFlight
from sassgis.gap.which.ensemble import Scale, rock_scores, scale_of
from sassgis.gap.which.features import rock_quantities
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable
from sassgis.terrain.flatten import chainage_to_xy

#: Campaigns made with one set of parameters: the scatter of each rock is known from them.
COUNT = 16
#: Ground further down than this many times the furthest observed run-out is not calibrated.
_BEYOND = 1.5
#: Share of the length of the fall lines below which a class is not calibrated.
_LEAST_SHARE = 0.02


@dataclass(frozen=True, slots=True)
class Axes:
    """Place of release of each rock, and the direction in which its fall line leaves it.

    Attributes
    ----------
    x, y : float64, shape (n_rocks,)
    east, north : float64, shape (n_rocks,)
        Unit vector from the release to where the line is at the median of the observed run-outs.
    """

    x: FloatArray
    y: FloatArray
    east: FloatArray
    north: FloatArray

    def run_out(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Plan distance from the release (m)."""
        return np.hypot(x - self.x, y - self.y)

    def lateral(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Distance from the direction of the line (m), positive to the right looking downhill."""
        return (x - self.x) * self.north - (y - self.y) * self.east


@dataclass(frozen=True, slots=True)
class CalibrationSite:
    """A site made ready for many campaigns.

    Attributes
    ----------
    name : str
    case : Case
    rock_lines : RockLines
    terrain : PathTerrain or None
        What paths are followed on; None: rocks keep to their fall lines.
    axes : Axes
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
    terrain: PathTerrain | None
    axes: Axes
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


def site_of(
    name: str, case: Case, terrain: PathTerrain | None = None, file: str = ""
) -> CalibrationSite:
    """Prepare a case; with a terrain paths are followed, ``file`` is for messages.

    Raises
    ------
    InputError
        If nothing was measured that a simulation could be compared with.
    """
    seen = observed(case)
    axes = _axes(case, seen)
    quantities = _quantities(case, axes, seen)
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
        name, case, rock_lines_of(case), terrain, axes, scale, scored, scale.rows(quantities),
        impacts, outcomes, _classes(case, axes, seen, impacts),
    )  # fmt: skip


def _axes(case: Case, seen: Released) -> Axes:
    traces = case.traces
    first = traces.offset[case.line]
    x, y = traces.x[first], traces.y[first]
    far = np.hypot(seen.x - x, seen.y - y)
    known = far[np.isfinite(far)]
    ends = traces.s[traces.offset[case.line + 1] - 1]
    s = np.minimum(np.median(known) if known.size else np.inf, ends)
    to_x, to_y = chainage_to_xy(traces, case.line, s)
    size = np.maximum(np.hypot(to_x - x, to_y - y), 1e-9)
    return Axes(x, y, (to_x - x) / size, (to_y - y) / size)


def _quantities(case: Case, axes: Axes, seen: Released) -> dict[str, FloatArray]:
    found = rock_quantities(case, replace(seen.campaign, deposits=None, impacts=None))
    # Where on a station a rock passes is not kept of followed paths.
    found = {name: values for name, values in found.items() if not name.endswith(":aside")}
    if np.isfinite(seen.x).any():
        found["stop:runout"] = axes.run_out(seen.x, seen.y)
        found["stop:aside"] = axes.lateral(seen.x, seen.y)
    return found


def _classes(
    case: Case, axes: Axes, seen: Released, impacts: ImpactsInFlight | None
) -> tuple[str, ...]:
    """Classes on the fall lines of the rocks, as far down as rocks can have come."""
    s = axes.run_out(seen.x, seen.y)
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
    made = released(
        site.case, site.rock_lines, site.terrain, table, count=count, seed=seed, number=number
    )
    each = [_quantities(site.case, site.axes, one) for one in made]
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
