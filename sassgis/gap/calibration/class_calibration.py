"""A calibration of ground classes from prepared sites to its result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.calibration_findings import CalibrationFinding, findings_of, gain_text
from sassgis.gap.calibration.fit_errors import (
    QuantityErrors,
    TableScore,
    paired_gain,
    quantity_errors,
    table_scores,
)
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
from sassgis.gap.calibration.parameters import (
    ClassParameter,
    Prior,
    classes_met,
    parameters_of,
    table_with,
)
from sassgis.gap.calibration.problem import (
    CalibrationProblem,
    Prediction,
    added,
    prediction,
    scores_of,
)
from sassgis.gap.calibration.search import (
    Posterior,
    ScoreSurface,
    SiteScores,
    first_design,
    minimum_without,
    next_design,
    posterior_of,
    surface_of,
)
from sassgis.gap.inference.intervals import Interval
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, configured_model
from sassgis.model.grid import FloatArray, IntArray
from sassgis.model.ground import GroundTable
from sassgis.model.ground_ranges import RangeRule
from sassgis.model.languages import phrase

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
    sites: Sequence[CalibrationProblem],
    class_names: Sequence[str],
    names: Sequence[str],
    rules: Sequence[RangeRule],
    seed: int,
) -> CalibrationTask:
    """The parameters of some classes at some sites; ``rules`` say how values vary between sites."""
    parameters: list[ClassParameter] = []
    for own in class_names:
        table = next(s.case.table for s in sites if own in s.case.table.names)
        parameters += parameters_of(table, [own], names, rules)
    return CalibrationTask(tuple(sites), tuple(parameters), seed)


@dataclass(frozen=True, slots=True)
class Budget:
    """Draws of the first design, repetitions after it, and draws of each of them."""

    first: int
    repetitions: int
    more: int

    @property
    def draws(self) -> int:
        """Draws in all."""
        return self.first + self.repetitions * self.more


def budget_of(task: CalibrationTask, first: int | None) -> Budget:
    """Draws of the first design (default: 32 for each parameter, at least 96), and after it."""
    own = first or max(96, 32 * len(task.parameters))
    return Budget(own, _REPETITIONS, max(16, own // 3))


#: Number of a draw and its parameters as shares of their ranges.
NumberedDraw = tuple[int, FloatArray]
#: Scores of all rocks, site after site, of draws in their order.
RunDraws = Callable[[Sequence[NumberedDraw]], Sequence[FloatArray]]


def score_draw(task: CalibrationTask, draw: NumberedDraw) -> FloatArray:
    """Score of each rock of all sites, site after site."""
    number, shares = draw
    return np.concatenate(
        [scores_of(site, task.model(site, shares), number, COUNT) for site in task.sites]
    )


@dataclass(frozen=True, slots=True)
class Calibrated:
    """What was tried, and what follows from it.

    Attributes
    ----------
    points : float64, shape (n_draws, d)
    surface : ScoreSurface
    posterior : Posterior
    fitted : tuple of Fitted
    """

    points: FloatArray
    surface: ScoreSurface
    posterior: Posterior
    fitted: tuple[Fitted, ...]

    def without(self, problems: Sequence[CalibrationProblem], part: int) -> FloatArray:
        """Best parameters for the rocks of the other parts; where draws lie is that of all."""
        weights = [(p.unit_parts() != part).astype(np.float64) for p in problems]
        return minimum_without(self.surface, self.posterior, weights)


def search(task: CalibrationTask, run: RunDraws, first: int | None = None) -> Calibrated:
    """Calibrate the classes of all sites together: more and more draws where the best may lie.

    The prior alone keeps parameters near their configured values: rocks left out are predicted with
    parameters that were chosen in the same way.
    """
    budget, prior = budget_of(task, first), Prior.of(task.parameters)
    points = first_design(prior, budget.first, task.seed)
    scores = np.stack(run([(1 + k, share) for k, share in enumerate(points)]))
    surface = _surface(task, prior, points, scores, budget.first)
    for _ in range(budget.repetitions):
        new = next_design(surface, points, budget.more, task.seed)
        scored = run([(1 + len(points) + k, share) for k, share in enumerate(new)])
        scores, points = np.vstack([scores, *scored]), np.vstack([points, new])
        surface = _surface(task, prior, points, scores, budget.first)
    posterior = posterior_of(surface, points, task.seed)
    return Calibrated(points, surface, posterior, fitted_parameters(task.parameters, posterior))


def _surface(
    task: CalibrationTask, prior: Prior, points: FloatArray, scores: FloatArray, first: int
) -> ScoreSurface:
    borders = np.cumsum([site.n_rocks for site in task.sites])[:-1]
    parts = np.split(scores, borders, axis=1)
    sites = []
    for site, own in zip(task.sites, parts, strict=True):
        met = classes_met(site.case)
        columns = np.flatnonzero([p.class_name in met for p in task.parameters])
        sites.append(SiteScores(columns, site.per_unit(own)))
    return surface_of(points, sites, prior, first)


@dataclass(frozen=True, slots=True)
class FinalTask:
    """Campaigns for the errors of a site; without shares of the parameters: as configured."""

    site: int
    shares: FloatArray | None
    number: int


def final_prediction(task: CalibrationTask, final: FinalTask) -> Prediction:
    """Prediction of the rocks of a site."""
    site = task.sites[final.site]
    model = configured_model(site.case) if final.shares is None else task.model(site, final.shares)
    return prediction(site, model, final.number, FINAL_COUNT)


RunFinals = Callable[[Sequence[FinalTask]], Sequence[Prediction]]


def held_out(task: CalibrationTask, found: Calibrated, run: RunFinals) -> list[Prediction]:
    """Prediction of each rock with parameters chosen on the rocks of the other parts, by site."""
    parts = range(max(site.n_parts for site in task.sites))
    tasks = []
    for part in parts:
        shares = found.without(task.sites, part)
        tasks += [FinalTask(k, shares, _FINAL + 10 + part) for k in range(len(task.sites))]
    made = list(run(tasks))
    merged = []
    for k, site in enumerate(task.sites):
        own = made[k :: len(task.sites)]

        def of_part(
            values: Sequence[Mapping[str, FloatArray]], part: IntArray = site.part
        ) -> dict[str, FloatArray]:
            rocks = np.arange(part.size)
            return {n: np.stack([v[n] for v in values])[part, ..., rocks].T for n in values[0]}

        merged.append(
            Prediction(of_part([p.replicas for p in own]), of_part([p.scores for p in own]))
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
    scores : tuple of TableScore
    gain : Interval
        Of the score, on rocks left out, as a share of the score before.
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
    scores: tuple[TableScore, ...]
    gain: Interval
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
    gain : Interval
        Of the score over all sites, on rocks left out, as a share of the score before.
    findings : tuple of CalibrationFinding
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
    gain: Interval
    findings: tuple[CalibrationFinding, ...]
    draws: int
    seed: int

    @property
    def rocks(self) -> int:
        """Rocks of all sites."""
        return sum(site.rocks for site in self.sites)

    @property
    def recommended(self) -> bool:
        """Whether the calibrated classes are to be run: their gain on rocks left out clears zero.

        At no site may they be worse by as much.
        """
        return self.gain.low > 0.0 and not any(s.gain.high < 0.0 for s in self.sites)

    @property
    def recommendation(self) -> str:
        """Which ground to run and why, in one line."""
        of_gain = gain_text(self.gain)
        worse = ", ".join(s.name for s in self.sites if s.gain.high < 0.0)
        if self.recommended:
            return phrase("Run the fitted classes: {}.", of_gain)
        if not np.isfinite(self.gain.value):
            return "The configured ground stays: too few rocks to predict any that were left out."
        if worse:
            text = "The configured ground stays: {}; they are worse at {}."
            return phrase(text, of_gain, worse)
        return phrase("The configured ground stays: {}, which does not clear zero.", of_gain)

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
    sites, pairs = [], []
    for k, (site, fit) in enumerate(zip(task.sites, fits, strict=True)):
        models = {"before": made[2 * k], "after": made[2 * k + 1], "left out": left_out[k]}
        replicas = {name: model.replicas for name, model in models.items()}
        pairs.append((_of_units(site, models["before"]), _of_units(site, models["left out"])))
        sites.append(
            SiteResult(
                site.name,
                site.n_rocks,
                {n: len(t) for n, t in site.case.observations.tables.items() if len(t)},
                quantity_errors(site, replicas, task.seed),
                table_scores(site, {name: model.scores for name, model in models.items()}),
                paired_gain(*pairs[-1]),
                fit,
                _by_label(parameters, fit.own),
                replicas,
                site.quantities,
            )
        )
    before, left = (np.concatenate(own) for own in zip(*pairs, strict=True))
    return SiteCalibration(
        found.fitted,
        identified_combinations(parameters, posterior),
        trade_offs(parameters, posterior),
        tuple(_by_label(parameters, u) for u in as_good(surface, posterior)),
        classes_alike(parameters, posterior),
        tuple(sites),
        contradict,
        paired_gain(before, left),
        findings_of(found.fitted, {s.name: s.gain for s in sites}),
        len(found.points),
        task.seed,
    )


def _of_units(site: CalibrationProblem, predicted: Prediction) -> FloatArray:
    """Score of each unit, added over the tables."""
    return site.per_unit(added(predicted.scores))


def _by_label(parameters: Sequence[ClassParameter], shares: FloatArray) -> dict[str, float]:
    return {
        p.label: float(p.value(share)) for p, share in zip(parameters, shares.tolist(), strict=True)
    }
