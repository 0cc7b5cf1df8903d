"""Calibrate ground classes on prepared sites, and estimate their spread between sites.

The spread by random effects: the value of a class at a site is normal about a mean with a standard
deviation between sites, and the calibration of the site has a separate error. The mean has a
flat prior, the standard deviation a half-normal one, with the spread that was assumed before as its
scale: two sites by themselves hardly show it (Gelman 2006; Röver 2020).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.errors import InputError
from sassgis.gap.constants import (
    CLASS_COUNT,
    CLASS_DRAWS,
    CLASS_LIMIT,
    CLASS_LOOKED,
    CLASS_ROUNDS,
    DRAWS_EACH,
    FINAL_COUNT,
    FINAL_NUMBER,
    LAST_ROUND,
    LEAST_VALUE_ERROR,
    MIDDLE_90,
    MISFIT_NUMBER,
    NO_PRIOR,
    SITE_SAMPLES,
    SPREAD_END,
)
from sassgis.gap.fit.distances import Interval
from sassgis.gap.fit.fit_errors import (
    CalibrationFinding,
    QuantityErrors,
    TableScore,
    findings_of,
    gain_text,
    paired_gain,
    quantity_errors,
    table_scores,
)
from sassgis.gap.fit.linear_fit import (
    FitBudget,
    RunTrials,
    Seen,
    SiteSummary,
    Trial,
    fit_linearly,
    joined,
    rocks_drawn_anew,
    summary_of,
)
from sassgis.gap.fit.parameters import (
    ClassParameter,
    Estimated,
    Fitted,
    Misfits,
    Posterior,
    TradeOff,
    as_good,
    classes_alike,
    contradicting,
    estimated_by,
    fitted_parameters,
    identified_combinations,
    parameters_of,
    posterior_of,
    prior_shares,
    table_with,
    together,
    trade_offs,
)
from sassgis.gap.fit.site_data import Prediction, SiteData, added, prediction, scores_of
from sassgis.gap.forward.released_rocks import HypothesisModel, configured_model
from sassgis.gap.observations.case import classes_met
from sassgis.grid import FloatArray
from sassgis.settings.ground import LIMITS, GroundTable, ParameterRange, RangeRule, ranges_of
from sassgis.settings.languages import phrase


@dataclass(frozen=True, slots=True)
class CalibrationTask:
    """All that a process needs to make campaigns."""

    summaries: tuple[SiteSummary, ...]
    parameters: tuple[ClassParameter, ...]
    seed: int

    @property
    def sites(self) -> tuple[SiteData, ...]:
        """The sites themselves."""
        return tuple(own.problem for own in self.summaries)

    @property
    def n_rocks(self) -> int:
        """Rocks of all sites."""
        return sum(site.n_rocks for site in self.sites)

    @property
    def n_parts(self) -> int:
        """Parts of the cross-validation."""
        return max(site.n_parts for site in self.sites)

    @property
    def measured(self) -> int:
        """Rocks of which anything was measured that is compared."""
        return sum(
            int(np.any([np.isfinite(v) for v in site.quantities.values()], axis=0).sum())
            for site in self.sites
        )

    def model(self, site: SiteData, shares: FloatArray | None) -> HypothesisModel:
        """Return a site as configured, with parameters at shares of their ranges, if given."""
        table = site.case.table
        if shares is not None:
            table = table_with(table, self.parameters, shares)
        return configured_model(site.case, table)


def calibration_task(
    sites: Sequence[SiteData],
    class_names: Sequence[str],
    names: Sequence[str],
    rules: Sequence[RangeRule],
    seed: int,
) -> CalibrationTask:
    """Return the parameters to calibrate; ``rules`` give the variation of values between sites."""
    parameters: list[ClassParameter] = []
    for own in class_names:
        table = next(s.case.table for s in sites if own in s.case.table.names)
        parameters += parameters_of(table, [own], names, rules)
    return CalibrationTask(tuple(summary_of(site) for site in sites), tuple(parameters), seed)


def budget_of(task: CalibrationTask, draws: int | None) -> FitBudget:
    """Return draws of each round; default: 4 for each parameter, at least 32."""
    own = draws or max(CLASS_DRAWS, DRAWS_EACH * len(task.parameters))
    return FitBudget(CLASS_ROUNDS, own, CLASS_COUNT, CLASS_LOOKED, CLASS_LIMIT, LAST_ROUND * own)


def run_trial(task: CalibrationTask, trial: Trial) -> Seen:
    """Return numbers of all sites, one after the other, and the mean score of the rocks."""
    shares = prior_shares(task.parameters, trial.at)
    numbers, scores = [], []
    for site in task.summaries:
        model = task.model(site.problem, shares)
        own, rows = site.of_model(model, trial.number, trial.count)
        numbers.append(own)
        scores.append(scores_of(site.problem, model, trial.number, rows))
    return Seen(np.concatenate(numbers), float(np.concatenate(scores).mean()))


@dataclass(frozen=True, slots=True)
class SiteTask:
    """Campaigns of a site at shares of the parameters; without them, of the configured ones."""

    site: int
    shares: FloatArray | None
    number: int


RunSites = Callable[[Sequence[SiteTask]], Sequence[Misfits]]


def run_site(task: CalibrationTask, at: SiteTask) -> Misfits:
    """Return observed less simulated numbers of a site at some parameters."""
    site = task.summaries[at.site]
    problem = site.problem
    parts = np.arange(task.n_parts)[:, None]
    weights = [np.ones((1, problem.n_rocks)), problem.part != parts, rocks_drawn_anew(problem)]
    model = task.model(problem, at.shares)
    off = site.misfits(model, at.number, FINAL_COUNT, np.vstack(weights))
    first = 1 + task.n_parts
    return Misfits(off[0], off[1:first], off[first:], site.units)


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Result of a calibration, and what follows from it."""

    estimated: tuple[Estimated, ...]  # by site
    posterior: Posterior
    fitted: tuple[Fitted, ...]
    draws: int  # parameter sets that were tried


def search(
    task: CalibrationTask, run: RunTrials, run_sites: RunSites, draws: int | None = None
) -> Calibrated:
    """Calibrate the classes of all sites together.

    Only the prior keeps parameters near their configured values: rocks left out are predicted with
    parameters that were chosen in the same way.
    """
    budget = budget_of(task, draws)
    fit = fit_linearly(joined(task.summaries), np.zeros(len(task.parameters)), run, budget)
    best, sites = prior_shares(task.parameters, fit.best), range(len(task.sites))
    estimated = estimated_by(fit, run_sites([SiteTask(k, best, MISFIT_NUMBER) for k in sites]))
    posterior = posterior_of(task.parameters, together(estimated), task.seed)
    fitted = fitted_parameters(task.parameters, posterior)
    return Calibrated(estimated, posterior, fitted, budget.tried)


def final_prediction(task: CalibrationTask, final: SiteTask) -> Prediction:
    """Predict the rocks of a site."""
    site = task.sites[final.site]
    return prediction(site, task.model(site, final.shares), final.number, FINAL_COUNT)


RunFinals = Callable[[Sequence[SiteTask]], Sequence[Prediction]]


def held_out(task: CalibrationTask, found: Calibrated, run: RunFinals) -> list[Prediction]:
    """Predict each rock with parameters chosen on the rocks of the other parts, by site."""
    whole = together(found.estimated)
    tasks = []
    for part in range(task.n_parts):
        shares = prior_shares(task.parameters, whole.estimate_without(part))
        tasks += [SiteTask(k, shares, FINAL_NUMBER + 10 + part) for k in range(len(task.sites))]
    made = list(run(tasks))
    merged = []
    for k, site in enumerate(task.sites):
        own, rocks = made[k :: len(task.sites)], np.arange(site.n_rocks)
        replicas, scores = (
            {n: np.stack([v[n] for v in values])[site.part, ..., rocks].T for n in values[0]}
            for values in ([p.replicas for p in own], [p.scores for p in own])
        )
        merged.append(Prediction(replicas, scores))
    return merged


@dataclass(frozen=True, slots=True)
class SiteResult:
    """One site of a calibration."""

    name: str
    rocks: int
    tables: Mapping[str, int]  # rows
    errors: tuple[QuantityErrors, ...]
    scores: tuple[TableScore, ...]
    gain: Interval  # of the score, on rocks left out, as a share of the score before
    score: float  # mean of the rocks at the common parameters
    own_score: float  # at those that fit this site best
    own: Mapping[str, float]  # parameters that fit this site best, by label
    #: Of the models "before", "after", "left out" each quantity, shape (count, n_rocks).
    replicas: Mapping[str, Mapping[str, FloatArray]]
    observed: Mapping[str, FloatArray]  # each quantity, shape (n_rocks,)


@dataclass(frozen=True, slots=True)
class SiteCalibration:
    """Result of a calibration at sites."""

    fitted: tuple[Fitted, ...]
    combinations: int  # of parameters that are identified
    trade_offs: tuple[TradeOff, ...]
    as_good: tuple[Mapping[str, float], ...]  # other combinations that fit as well, by label
    alike: tuple[tuple[str, str], ...]  # pairs of classes that cannot be distinguished
    sites: tuple[SiteResult, ...]
    contradict: bool  # whether no common parameters fit the sites
    #: Of the score over all sites, on rocks left out, as a share of the score before.
    gain: Interval
    findings: tuple[CalibrationFinding, ...]
    draws: int  # parameter sets that were tried
    seed: int

    @property
    def rocks(self) -> int:
        """Rocks of all sites."""
        return sum(site.rocks for site in self.sites)

    @property
    def recommended(self) -> bool:
        """Whether to run the calibrated classes: their gain clears zero, no site loses as much."""
        return self.gain.low > 0.0 and not any(s.gain.high < 0.0 for s in self.sites)

    @property
    def recommendation(self) -> str:
        """Which ground to run and why, in one line."""
        of_gain = gain_text(self.gain)
        worse = ", ".join(s.name for s in self.sites if s.gain.high < 0.0)
        if self.recommended:
            return phrase("Run the fitted classes: {}.", of_gain)
        if not np.isfinite(self.gain.value):
            return (
                "Keep the configured ground. There are too few rocks for a test on held-out rocks."
            )
        if worse:
            text = "Keep the configured ground. {}; they are worse at {}."
            return phrase(text, of_gain, worse)
        return phrase("Keep the configured ground. The gain may be chance: {}.", of_gain)

    def table(self, configured: GroundTable) -> GroundTable:
        """Return a table with the calibrated values."""
        shares = np.array([f.share for f in self.fitted])
        return table_with(configured, [f.parameter for f in self.fitted], shares)


def result_of(task: CalibrationTask, found: Calibrated, run: RunFinals) -> SiteCalibration:
    """Return the result of the search, and how well it fits rocks left out."""
    posterior, parameters = found.posterior, task.parameters
    own = [prior_shares(parameters, estimated.estimate()[0]) for estimated in found.estimated]
    finals = []
    for k, best in enumerate(own):
        finals += [
            SiteTask(k, None, FINAL_NUMBER),
            SiteTask(k, posterior.best, FINAL_NUMBER + 1),
            SiteTask(k, best, FINAL_NUMBER + 1),
        ]
    # What fits the only site best is what fits all.
    made = list(run(finals if len(own) > 1 else finals[:2]))
    made += made[1:] if len(own) == 1 else []
    left_out = held_out(task, found, run)
    sites, pairs = [], []
    for k, site in enumerate(task.sites):
        models = {"before": made[3 * k], "after": made[3 * k + 1], "left out": left_out[k]}
        scores = [float(_of_units(site, one).mean()) for one in made[3 * k + 1 : 3 * k + 3]]
        replicas = {name: model.replicas for name, model in models.items()}
        pairs.append((_of_units(site, models["before"]), _of_units(site, models["left out"])))
        sites.append(
            SiteResult(
                name=site.name, rocks=site.n_rocks,
                tables={n: len(t) for n, t in site.case.observations.tables.items() if len(t)},
                errors=quantity_errors(site, replicas, task.seed),
                scores=table_scores(site, {name: model.scores for name, model in models.items()}),
                gain=paired_gain(*pairs[-1]), score=scores[0], own_score=scores[1],
                own=_by_label(parameters, own[k]), replicas=replicas, observed=site.quantities,
            )
        )  # fmt: skip
    before, left = (np.concatenate(own) for own in zip(*pairs, strict=True))
    common, own_best = [s.score for s in sites], [s.own_score for s in sites]
    return SiteCalibration(
        fitted=found.fitted, combinations=identified_combinations(posterior.covariance),
        trade_offs=trade_offs([p.label for p in parameters], posterior.covariance),
        as_good=tuple(_by_label(parameters, u) for u in as_good(posterior)),
        alike=classes_alike(parameters, posterior), sites=tuple(sites),
        contradict=contradicting(found.estimated, common, own_best, task.seed),
        gain=paired_gain(before, left),
        findings=findings_of(found.fitted, {s.name: s.gain for s in sites}), draws=found.draws,
        seed=task.seed,
    )  # fmt: skip


def _of_units(site: SiteData, predicted: Prediction) -> FloatArray:
    """Return the score of each unit, added over the tables."""
    return site.per_unit(added(predicted.scores))


def _by_label(parameters: Sequence[ClassParameter], shares: FloatArray) -> dict[str, float]:
    return {
        p.label: float(p.value(share)) for p, share in zip(parameters, shares.tolist(), strict=True)
    }


#: Nodes and weights of the quadrature over the standard deviation between sites, and its end in
#: prior scales.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(100)


@dataclass(frozen=True, slots=True)
class SiteValue:
    """A parameter of a class as the rocks of one single site identify it."""

    site: str
    class_name: str  # or another name of the description that sites share
    parameter: str
    value: float
    error: float  # standard error
    rocks: int


@dataclass(frozen=True, slots=True)
class BetweenSites:
    """Mean and spread of a parameter between sites."""

    mean: float  # of the sites there might be
    mean_error: float  # its standard error
    sd: float  # standard deviation between sites, posterior mean
    predictive_sd: float  # standard deviation of the value at a site that is not known yet


def between_sites(values: FloatArray, errors: FloatArray, scale: float) -> BetweenSites:
    """Return the posterior of mean and spread of sites, by quadrature.

    ``scale``: of the half-normal prior of the standard deviation between sites. InputError without
    values, or if an error or the scale is not above 0.
    """
    if not values.size or not (errors > 0.0).all() or not scale > 0.0:
        raise InputError(
            "the spread between sites cannot be estimated",
            found=f"{values.size} values, errors {errors.tolist()}, scale {scale:g}",
            expected="one value or more; errors and scale above 0",
        )
    # Denser towards 0, where a spread below the errors is reported.
    root = 0.5 * (_NODES + 1.0)
    tau = SPREAD_END * scale * root**2
    weight = 1.0 / (errors**2 + tau[:, None] ** 2)
    variance = 1.0 / weight.sum(axis=1)
    mean = variance * (weight * values).sum(axis=1)
    misfit = (weight * (values - mean[:, None]) ** 2).sum(axis=1)
    log_density = 0.5 * (
        np.log(weight).sum(axis=1) + np.log(variance) - misfit - (tau / scale) ** 2
    )
    density = _WEIGHTS * root * np.exp(log_density - log_density.max())
    density /= density.sum()
    centre = float(density @ mean)
    of_mean = float(density @ (variance + (mean - centre) ** 2))
    return BetweenSites(
        centre, of_mean**0.5, float(density @ tau), (of_mean + float(density @ tau**2)) ** 0.5
    )


def class_spread(
    found: Sequence[SiteValue], known: Sequence[ParameterRange]
) -> tuple[RangeRule, ...]:
    """Return ranges of the middle 90 % of a new site; ``known``: those from before, of the same."""
    rules = []
    for before in known:
        own = [
            v for v in found
            if (v.class_name, v.parameter) == (before.class_name, before.parameter)
        ]  # fmt: skip
        if not own:
            continue
        sites = between_sites(
            np.array([v.value for v in own]), np.array([v.error for v in own]), before.sd
        )
        room = MIDDLE_90 * sites.predictive_sd
        low, high = np.clip([sites.mean - room, sites.mean + room], *LIMITS[before.parameter])
        source = (
            f"Random effects over {', '.join(v.site for v in own)}: mean {sites.mean:.3g} "
            f"(standard error {sites.mean_error:.2g}), standard deviation between sites "
            f"{sites.sd:.2g} (before: {before.sd:.2g})."
        )
        rules.append(
            RangeRule(
                before.class_name, before.parameter, "value", float(low), float(high), source,
                sites=len(own), rocks=sum(v.rocks for v in own),
            )
        )  # fmt: skip
    return tuple(rules)


def spread_of_sites(
    task: CalibrationTask, found: Calibrated, rules: Sequence[RangeRule]
) -> tuple[RangeRule, ...]:
    """Return class_spread of the calibrated classes; ``rules`` are those from before."""
    tables = {name: site.case.table for site in task.sites for name in site.case.table.names}
    known = [
        own
        for p in task.parameters
        for own in ranges_of(tables[p.class_name], [p.class_name], rules, [p.name])
    ]
    return class_spread(site_values(task, found), known)


def site_values(task: CalibrationTask, found: Calibrated) -> tuple[SiteValue, ...]:
    """Return values that the rocks of each single site leave, and their standard errors."""
    out = []
    for k, (site, estimated) in enumerate(zip(task.sites, found.estimated, strict=True)):
        rng = np.random.default_rng([task.seed, 11, k])
        drawn = rng.multivariate_normal(*estimated.estimate(NO_PRIOR), SITE_SAMPLES)
        shares = prior_shares(task.parameters, drawn)
        met = classes_met(site.case)
        for j, p in enumerate(task.parameters):
            if p.class_name in met:
                values = p.value(shares[:, j])
                error = max(float(values.std()), LEAST_VALUE_ERROR * (p.limits.high - p.limits.low))
                value = float(values.mean())
                out.append(SiteValue(site.name, p.class_name, p.name, value, error, site.n_rocks))
    return tuple(out)
