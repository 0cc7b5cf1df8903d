"""A calibration of ground classes from prepared sites to its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.calibrator import (
    Budget,
    Calibrated,
    NumberedDraw,
    RunDraws,
    Space,
    calibrate_on,
)
from sassgis.gap.calibration.fit_errors import QuantityErrors, quantity_errors
from sassgis.gap.calibration.identifiability import (
    Fitted,
    SiteFit,
    TradeOff,
    as_good,
    classes_alike,
    identified_combinations,
    site_fits,
    trade_offs,
)
from sassgis.gap.calibration.parameters import (
    ClassParameter,
    classes_met,
    parameters_of,
    table_with,
)
from sassgis.gap.calibration.problem import CalibrationProblem, compared_replicas, scores_of
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, configured_model
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable

#: Campaigns made with one set of parameters: the scatter of each rock is known from them.
COUNT = 16
#: Repetitions in which new draws are placed where the best parameters may lie.
_REPETITIONS = 6
#: Campaigns from which the errors are taken.
FINAL_COUNT = 60
#: Numbers of the campaigns for the errors begin here.
_FINAL = 100_000


@dataclass(frozen=True, slots=True)
class CalibrationTask:
    """All that a process needs to make campaigns."""

    sites: tuple[CalibrationProblem, ...]
    parameters: tuple[ClassParameter, ...]
    seed: int

    @property
    def n_rocks(self) -> int:
        """Rocks of all sites."""
        return sum(site.n_rocks for site in self.sites)

    @property
    def measured(self) -> int:
        """Rocks of which anything was measured that is compared."""
        return sum(
            int(np.any([np.isfinite(v) for v in site.quantities.values()], axis=0).sum())
            for site in self.sites
        )

    def model(self, site: CalibrationProblem, shares: FloatArray) -> HypothesisModel:
        """A site as configured, with parameters at shares of their ranges."""
        return configured_model(site.case, table_with(site.case.table, self.parameters, shares))


def calibration_task(
    sites: Sequence[CalibrationProblem], class_names: Sequence[str], names: Sequence[str], seed: int
) -> CalibrationTask:
    """The parameters of some classes at some sites."""
    parameters: list[ClassParameter] = []
    for own in class_names:
        table = next(s.case.table for s in sites if own in s.case.table.names)
        parameters += parameters_of(table, [own], names)
    return CalibrationTask(tuple(sites), tuple(parameters), seed)


def budget_of(task: CalibrationTask, first: int | None) -> Budget:
    """Draws of the first design (default: 32 for each parameter, at least 96), and after it."""
    own = first or max(96, 32 * len(task.parameters))
    return Budget(own, _REPETITIONS, max(16, own // 3))


def score_draw(task: CalibrationTask, draw: NumberedDraw) -> FloatArray:
    """Score of each rock of all sites, site after site."""
    number, shares = draw
    return np.concatenate(
        [scores_of(site, task.model(site, shares), number, COUNT) for site in task.sites]
    )


def search(task: CalibrationTask, run: RunDraws, first: int | None = None) -> Calibrated:
    """Calibrate the classes of all sites together."""
    met = [classes_met(site.case) for site in task.sites]
    columns = tuple(np.flatnonzero([p.class_name in own for p in task.parameters]) for own in met)
    space = Space(task.parameters, columns, np.ones(len(task.parameters), np.bool_))
    return calibrate_on(task.sites, space, run, budget_of(task, first))


@dataclass(frozen=True, slots=True)
class FinalTask:
    """Campaigns for the errors of a site; without shares of the parameters: as configured."""

    site: int
    shares: FloatArray | None
    number: int


def final_replicas(task: CalibrationTask, final: FinalTask) -> dict[str, FloatArray]:
    """Replicas of the rocks of a site."""
    site = task.sites[final.site]
    model = configured_model(site.case) if final.shares is None else task.model(site, final.shares)
    return compared_replicas(site, model, final.number, FINAL_COUNT)


RunFinals = Callable[[Sequence[FinalTask]], Sequence[Mapping[str, FloatArray]]]


def held_out(
    task: CalibrationTask, found: Calibrated, run: RunFinals
) -> list[dict[str, FloatArray]]:
    """Replicas of each rock with parameters chosen on the rocks of the other parts, by site."""
    parts = range(max(site.n_parts for site in task.sites))
    tasks = []
    for part in parts:
        shares = found.without(task.sites, part)
        tasks += [FinalTask(k, shares, _FINAL + 10 + part) for k in range(len(task.sites))]
    made = list(run(tasks))
    merged = []
    for k, site in enumerate(task.sites):
        own = made[k :: len(task.sites)]
        of_part = np.arange(len(parts))[:, None, None] == site.part
        merged.append(
            {
                name: np.where(of_part, np.stack([one[name] for one in own]), 0.0).sum(axis=0)
                for name in own[0]
            }
        )
    return merged


@dataclass(frozen=True, slots=True)
class SiteResult:
    """One site of a calibration.

    Attributes
    ----------
    name : str
    rocks : int
    tables : mapping of table to rows
    errors : tuple of QuantityErrors
    fit : SiteFit
    own : mapping
        Parameters that fit this site best, by label.
    replicas : mapping of model to mapping of quantity to float64, shape (count, n_rocks)
        "before", "after", "left out".
    observed : mapping of quantity to float64, shape (n_rocks,)
    """

    name: str
    rocks: int
    tables: Mapping[str, int]
    errors: tuple[QuantityErrors, ...]
    fit: SiteFit
    own: Mapping[str, float]
    replicas: Mapping[str, Mapping[str, FloatArray]]
    observed: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True)
class SiteCalibration:
    """What a calibration found.

    Attributes
    ----------
    fitted : tuple of Fitted
    combinations : int
        Combinations of parameters that are identified.
    trade_offs : tuple of TradeOff
    as_good : tuple of mapping
        Other combinations that fit as well, by label.
    alike : tuple of (str, str)
        Pairs of classes that cannot be told apart.
    sites : tuple of SiteResult
    contradict : bool
        Whether no common parameters fit the sites.
    draws : int
        Parameter sets that were tried.
    seed : int
    """

    fitted: tuple[Fitted, ...]
    combinations: int
    trade_offs: tuple[TradeOff, ...]
    as_good: tuple[Mapping[str, float], ...]
    alike: tuple[tuple[str, str], ...]
    sites: tuple[SiteResult, ...]
    contradict: bool
    draws: int
    seed: int

    @property
    def rocks(self) -> int:
        """Rocks of all sites."""
        return sum(site.rocks for site in self.sites)

    def table(self, configured: GroundTable) -> GroundTable:
        """A table with the calibrated values."""
        return table_with(
            configured,
            [f.parameter for f in self.fitted],
            np.array([f.share for f in self.fitted]),
        )


def result_of(task: CalibrationTask, found: Calibrated, run: RunFinals) -> SiteCalibration:
    """What the search says, and how well it fits rocks left out."""
    posterior, surface = found.posterior, found.surface
    parameters = task.parameters
    finals = []
    for k in range(len(task.sites)):
        finals += [FinalTask(k, None, _FINAL), FinalTask(k, posterior.best, _FINAL + 1)]
    made = list(run(finals))
    left_out = held_out(task, found, run)
    fits, contradict = site_fits([s.name for s in task.sites], surface, posterior, task.seed)
    sites = []
    for k, (site, fit) in enumerate(zip(task.sites, fits, strict=True)):
        models = {"before": made[2 * k], "after": made[2 * k + 1], "left out": left_out[k]}
        sites.append(
            SiteResult(
                site.name,
                site.n_rocks,
                {n: len(t) for n, t in site.case.observations.tables.items() if len(t)},
                quantity_errors(site, models, task.seed),
                fit,
                _by_label(parameters, fit.own),
                models,
                site.quantities,
            )
        )
    return SiteCalibration(
        found.fitted,
        identified_combinations(parameters, posterior),
        trade_offs(parameters, posterior),
        tuple(_by_label(parameters, u) for u in as_good(surface, posterior)),
        classes_alike(parameters, posterior),
        tuple(sites),
        contradict,
        len(found.points),
        task.seed,
    )


def _by_label(parameters: Sequence[ClassParameter], shares: FloatArray) -> dict[str, float]:
    return {
        p.label: float(p.value(share)) for p, share in zip(parameters, shares.tolist(), strict=True)
    }
