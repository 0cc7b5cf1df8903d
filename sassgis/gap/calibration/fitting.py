"""A calibration from prepared sites to its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.fit_errors import QuantityErrors, quantity_errors
from sassgis.gap.calibration.identifiability import (
    Fitted,
    SiteFit,
    TradeOff,
    as_good,
    classes_alike,
    fitted_parameters,
    identified_combinations,
    site_fits,
    trade_offs,
)
from sassgis.gap.calibration.parameters import ClassParameter, parameters_of, table_with
from sassgis.gap.calibration.search import (
    Posterior,
    ScoreSurface,
    SiteScores,
    first_design,
    keeping_configured,
    minimum_without,
    next_design,
    posterior_of,
    surface_of,
)
from sassgis.gap.calibration.site import COUNT, CalibrationSite, replicas, scores
from sassgis.gap.inference.folds import folds_of
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.ground import GroundTable

#: Repetitions in which new draws are placed where the best parameters may lie.
REPETITIONS = 6
#: Campaigns from which the errors are taken.
FINAL_COUNT = 60
#: Numbers of the campaigns for the errors begin here.
_FINAL = 100_000


@dataclass(frozen=True, slots=True)
class CalibrationTask:
    """All that a process needs to make campaigns.

    Attributes
    ----------
    sites : tuple of CalibrationSite
    parameters : tuple of ClassParameter
    seed : int
    """

    sites: tuple[CalibrationSite, ...]
    parameters: tuple[ClassParameter, ...]
    seed: int

    @property
    def starts(self) -> FloatArray:
        """Configured values as shares of the ranges."""
        return np.array([p.start for p in self.parameters])

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


#: Number of a draw and its parameters as shares of their ranges.
NumberedDraw = tuple[int, FloatArray]
#: Scores of all rocks, site after site, of draws in their order.
RunDraws = Callable[[Sequence[NumberedDraw]], Sequence[FloatArray]]


def calibration_task(
    sites: Sequence[CalibrationSite], class_names: Sequence[str], names: Sequence[str], seed: int
) -> CalibrationTask:
    """The parameters of some classes at some sites."""
    parameters: list[ClassParameter] = []
    for own in class_names:
        table = next(s.case.table for s in sites if own in s.case.table.names)
        parameters += parameters_of(table, [own], names)
    return CalibrationTask(tuple(sites), tuple(parameters), seed)


def draws_of(task: CalibrationTask, first: int | None) -> tuple[int, int]:
    """Draws of the first design and of each repetition."""
    d = len(task.parameters)
    return (first or max(96, 32 * d)), max(16, (first or max(96, 32 * d)) // 3)


def score_draw(task: CalibrationTask, draw: NumberedDraw) -> FloatArray:
    """Score of each rock of all sites, site after site."""
    number, shares = draw
    return np.concatenate(
        [
            scores(
                site, table_with(site.case.table, task.parameters, shares), seed=task.seed,
                number=number,
            )
            for site in task.sites
        ]
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Search:
    """What was tried, and what follows from it."""

    points: FloatArray
    surface: ScoreSurface
    posterior: Posterior


def search(task: CalibrationTask, run: RunDraws, first: int | None = None) -> Search:
    """Try parameters, more and more of them where the best may lie."""
    draws, more = draws_of(task, first)
    points = first_design(len(task.parameters), draws, task.seed)
    scored = _scored(run, points, 0)
    surface = _surface(task, points, scored, draws)
    for _ in range(REPETITIONS):
        new = next_design(surface, points, more, task.seed)
        scored = np.vstack([scored, _scored(run, new, len(points))])
        points = np.vstack([points, new])
        surface = _surface(task, points, scored, draws)
    posterior = posterior_of(surface, points, task.seed)
    identified = np.array([f.identified for f in fitted_parameters(task.parameters, posterior)])
    return Search(points, surface, keeping_configured(surface, posterior, identified))


def _scored(run: RunDraws, points: FloatArray, before: int) -> FloatArray:
    return np.stack(run([(1 + before + k, share) for k, share in enumerate(points)]))


def _surface(
    task: CalibrationTask, points: FloatArray, scored: FloatArray, first: int
) -> ScoreSurface:
    borders = np.cumsum([site.n_rocks for site in task.sites])[:-1]
    parts = np.split(scored, borders, axis=1)
    sites = [SiteScores(_columns(task, s), own) for s, own in zip(task.sites, parts, strict=True)]
    return surface_of(points, sites, task.starts, first)


def _columns(task: CalibrationTask, site: CalibrationSite) -> IntArray:
    """Parameters that act at a site: those of the classes that its rocks meet."""
    return np.flatnonzero([p.class_name in site.classes for p in task.parameters])


@dataclass(frozen=True, slots=True)
class FinalTask:
    """Campaigns for the errors: a site, a table, a number."""

    site: int
    table: GroundTable
    number: int


def final_replicas(task: CalibrationTask, final: FinalTask) -> dict[str, FloatArray]:
    """Replicas of the rocks of a site with a table."""
    return replicas(
        task.sites[final.site], final.table, count=FINAL_COUNT, seed=task.seed,
        number=final.number,
    )  # fmt: skip


RunFinals = Callable[[Sequence[FinalTask]], Sequence[Mapping[str, FloatArray]]]


def held_out(task: CalibrationTask, found: Search, run: RunFinals) -> list[dict[str, FloatArray]]:
    """Replicas of each rock with parameters chosen on the rocks of the other parts, by site."""
    folds = [folds_of(site.n_rocks, task.seed + k) for k, site in enumerate(task.sites)]
    parts = sorted({int(p) for fold in folds for p in fold})
    tasks = []
    for part in parts:
        weights = [(fold != part).astype(np.float64) for fold in folds]
        shares = minimum_without(found.surface, found.posterior, weights)
        tasks += [
            FinalTask(k, table_with(site.case.table, task.parameters, shares), _FINAL + 10 + part)
            for k, site in enumerate(task.sites)
        ]
    made = list(run(tasks))
    merged = []
    for k, fold in enumerate(folds):
        own = made[k :: len(folds)]
        merged.append(
            {
                name: np.where(
                    np.arange(len(parts))[:, None, None] == fold,
                    np.stack([one[name] for one in own]),
                    0.0,
                ).sum(axis=0)
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


def result_of(task: CalibrationTask, found: Search, run: RunFinals) -> SiteCalibration:
    """What the search says, and how well it fits rocks left out."""
    posterior, surface = found.posterior, found.surface
    parameters = task.parameters
    finals = []
    for k, site in enumerate(task.sites):
        best = table_with(site.case.table, parameters, posterior.best)
        finals += [FinalTask(k, site.case.table, _FINAL), FinalTask(k, best, _FINAL + 1)]
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
        fitted_parameters(parameters, posterior),
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


def rocks_simulated(task: CalibrationTask, draws: int) -> int:
    """Rocks that are simulated for some draws."""
    return COUNT * task.n_rocks * draws
