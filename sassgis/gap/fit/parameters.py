"""Parameters of ground classes that can be calibrated, and which of them are identifiable.

Of contacts, restitution, the speed at which it has halved, friction, what the ground holds back and
a loss that grows with the speed make smooth, monotone functions of normal speed, speed along the
ground and angle of an impact. They are learned from single contacts, each predicted from the state
that was observed before it, and shrunk towards the values of the class. What a class without
contacts is taken to be follows the others half way. Spins have a factor and a scatter besides, the
same for all classes: blocks do not turn in only the plane of their path.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm, qmc
from scipy.stats import t as student

from sassgis.errors import InputError
from sassgis.gap.causes.cause import Range, rounded
from sassgis.gap.constants import (
    AT_LIMIT_SHARE,
    CONTRADICTING_LOSS,
    CONTRADICTING_SHARE,
    CORRELATED,
    LAW_SEARCHED,
    LAW_TRIED,
    LEARNED_CONTACTS,
    LEARNED_ROCKS,
    MOST_CONTACTS,
    NARROWER,
    NEAR_LIMIT,
    OUTERMOST,
    POSTERIOR_SAMPLES,
    SHARE_DIGITS,
    SHOWN_COMBINATIONS,
    SPIN_LOG_SD,
    SPIN_NOISES,
    WEAK_PRIOR,
)
from sassgis.gap.fit.linear_fit import LinearFit, bounded
from sassgis.gap.fit.site_data import (
    impact_scores,
    observed_impacts,
    observed_outcomes,
    simulated_outcomes,
)
from sassgis.gap.forward.released_rocks import HypothesisModel, MeasurementError
from sassgis.gap.observations.case import Case, LearnedContacts
from sassgis.gap.residuals.impact_residuals import ImpactsInFlight
from sassgis.grid import FloatArray
from sassgis.settings.blocks import EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable, RangeRule, ranges_of, with_values
from sassgis.settings.settings import EngineSettings

#: Ranges wide enough for any ground that rocks have been observed on. They are limits of the
#: search, not values of any ground: a result at a limit is a finding.
RANGES: Mapping[str, Range] = {
    "restitution": Range(0.0, 0.9),
    "eta_max": Range(0.1, 1.0),
    "mu_f": Range(0.2, 1.2),
    "mu_0": Range(0.02, 0.9),
    "rolling_threshold": Range(0.02, 2.0, "log"),
}


@dataclass(frozen=True, slots=True)
class ClassParameter:
    """One parameter of one ground class, mapped to a share from 0 to 1 of its range."""

    class_name: str
    name: str
    limits: Range
    configured: float  # value before the calibration
    #: Standard deviation of the prior about the configured value, as a share of the range. Half the
    #: range where nothing is known of how such values vary between sites.
    sd: float = 0.5

    @property
    def label(self) -> str:
        """Class and parameter in one word; only the parameter if it is of no class."""
        return f"{self.class_name}.{self.name}" if self.class_name else self.name

    def value(self, share: FloatArray | float) -> FloatArray:
        """Return values at shares of the range."""
        own, log = self.limits, self.limits.scale == "log"
        low, high = (np.log(own.low), np.log(own.high)) if log else (own.low, own.high)
        at = low + (high - low) * np.asarray(share, np.float64)
        return np.exp(at) if log else at

    @property
    def spread(self) -> float:
        """Standard deviation of the prior in the unit of the parameter, at the configured value."""
        at = self.start + np.array([-0.5, 0.5]) * self.sd
        return float(np.ptp(self.value(at)))

    @property
    def start(self) -> float:
        """Share of the range at which the configured value lies; the nearer limit if outside."""
        return min(max(self.limits.share(self.configured), 0.0), 1.0)


def fitted_names(names: Iterable[str] | None, engines: Iterable[EngineSettings]) -> tuple[str, ...]:
    """Return names of the parameters to calibrate: all that the engine reads, or those asked for.

    InputError if one of them cannot be calibrated.
    """
    settings = [engine.resolved() for engine in engines]
    known = tuple(name for name in RANGES if any(_reads(own, name) for own in settings))
    if names is None:
        return known
    asked = tuple(dict.fromkeys(names))
    for name in asked:
        if name not in known:
            raise InputError(
                "is not a parameter that can be calibrated with these settings of the engine",
                field="parameters",
                found=repr(name),
                expected="some of " + ", ".join(known),
            )
    return asked


def _reads(engine: EngineSettings, name: str) -> bool:
    """Return whether the engine reads a parameter of ground classes in these settings."""
    if name == "restitution":
        return engine.eta_max_rule == "restitution"
    return name != "rolling_threshold" or engine.rolling_threshold is None


def parameters_of(
    table: GroundTable, class_names: Sequence[str], names: Sequence[str], rules: Sequence[RangeRule]
) -> tuple[ClassParameter, ...]:
    """Return the parameters of some classes; ``rules`` give the spread between sites."""
    spread = {(r.class_name, r.parameter): r for r in ranges_of(table, class_names, rules, names)}
    found = []
    for own in class_names:
        ground = table.classes[table.index(own)]
        for name in names:
            one = ClassParameter(own, name, RANGES[name], float(getattr(ground, name)))
            if (between := spread.get((own, name))) is not None:
                # On the scale of the search, so that a factor counts alike up and down.
                low, high = one.limits.share(between.low), one.limits.share(between.high)
                one = replace(one, sd=replace(between, low=low, high=high).sd)
            found.append(one)
    return tuple(found)


def table_with(
    table: GroundTable, parameters: Sequence[ClassParameter], shares: FloatArray
) -> GroundTable:
    """Return a table with parameters at shares of their ranges; not those of other sites."""
    pairs = zip(parameters, shares.tolist(), strict=True)
    return with_values(
        table,
        {
            (p.class_name, p.name): float(p.value(share))
            for p, share in pairs
            if p.class_name in table.names
        },
    )


def prior_shares(parameters: Sequence[ClassParameter], normal: FloatArray) -> FloatArray:
    """Return shares of the ranges of parameters of which the prior is standard normal, (..., d).

    The prior keeps what the observations say nothing about where it was configured, as near as such
    values lie together from site to site; beyond the limits of the search lies the limit itself.
    """
    centre, sd = (np.array([getattr(p, name) for p in parameters]) for name in ("start", "sd"))
    # The last digits of linear algebra depend on where its arrays lie in memory.
    shares = np.round(centre + sd * normal, SHARE_DIGITS)
    return np.asarray(np.clip(shares, 0.0, 1.0), np.float64)


#: Ranges of the parameters of a contact, and how far those of one class lie from site to site
#: (standard deviation, as a share of the range): wide, as other laws are to be met.
_RANGES = {
    "eta_max": (Range(0.0, 1.0), 0.15),
    "mu_f": (Range(0.02, 1.5), 0.17),
    "restitution": (Range(0.0, 1.0), 0.25),
    "restitution_speed_mps": (Range(0.5, 200.0, "log"), 0.13),
    "mu_v": (Range(0.0, 0.05), 0.1),
}


def learned_contacts(case: Case, seed: int) -> LearnedContacts | None:
    """Return contacts as observed, for the law with restitution; None of too few."""
    if case.engine.resolved().eta_max_rule != "restitution":
        return None
    impacts = observed_impacts(case)
    if impacts is None:
        return None
    known: dict[int, FloatArray] = {}
    counts: list[int] = []
    for k in np.unique(impacts.kind).tolist():
        rows = np.flatnonzero(impacts.kind == k)
        if rows.size >= LEARNED_CONTACTS and np.unique(impacts.rock[rows]).size >= LEARNED_ROCKS:
            few = rows[
                np.linspace(0, rows.size - 1, min(rows.size, MOST_CONTACTS)).astype(np.int64)
            ]
            known[k] = _learned(case, impacts.take(few), k, seed)
            counts.append(few.size)
    if not known:
        return None
    others = 0.5 * np.mean(list(known.values()), axis=0)
    classes = enumerate(case.table.classes)
    table = GroundTable(tuple(_with_shift(own, known.get(k, others)) for k, own in classes))
    spin = np.average([shift[-1] for shift in known.values()], weights=counts)
    scale = _spin_scale(float(spin))

    observed = observed_outcomes(impacts)

    def loss(noise: float) -> float:
        error = MeasurementError(spin_scale=scale, spin_noise=noise)
        return _misfit(case, impacts, observed, table, error, seed)

    # Scatter of the spins after a contact that the law with its errors of measurement lacks.
    return LearnedContacts(table, scale, min(SPIN_NOISES, key=loss))


def _misfit(
    case: Case,
    impacts: ImpactsInFlight,
    observed: FloatArray,
    table: GroundTable,
    error: MeasurementError,
    seed: int,
) -> float:
    """Return the mean score of the rocks that have impacts."""
    # The same draws for all values: what differs is no luck.
    model = HypothesisModel(table, EffectSettings(), measurement=error)
    made = simulated_outcomes(case, model, impacts, seed=seed, number=3700)
    scores = impact_scores(impacts, observed, made, case.n_rocks)
    return float(scores[np.unique(impacts.rock)].mean())


def _learned(case: Case, impacts: ImpactsInFlight, kind: int, seed: int) -> FloatArray:
    """Return shifts of the parameters of a class, and of the spins, in usual spreads, (n + 1,)."""
    observed = observed_outcomes(impacts)

    def loss(shift: FloatArray) -> float:
        classes = list(case.table.classes)
        classes[kind] = _with_shift(classes[kind], shift)
        error = MeasurementError(spin_scale=_spin_scale(float(shift[-1])))
        misfit = _misfit(case, impacts, observed, GroundTable(tuple(classes)), error, seed)
        return misfit + 0.5 * float(shift @ shift) / impacts.rock.size

    d = len(_RANGES) + 1
    rng = np.random.default_rng([seed, 37])
    normal = qmc.MultivariateNormalQMC(np.zeros(d), 4.0 * np.eye(d), rng=rng)
    tried = [np.zeros(d), *normal.random(LAW_TRIED)]
    best = min(tried, key=loss)
    simplex = np.vstack([best, best + 0.7 * np.eye(best.size)])
    found = minimize(
        loss, best, method="Nelder-Mead",
        options={"maxfev": LAW_SEARCHED, "initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-4},
    )  # fmt: skip
    return np.asarray(found.x)


def _spin_scale(shift: float) -> float:
    return rounded(math.exp(SPIN_LOG_SD * shift))


def _with_shift(ground: GroundClass, shift: FloatArray) -> GroundClass:
    """Return a class with shifted parameters of the contact, kept within their ranges."""
    values = {}
    for (name, (limits, sd)), own in zip(_RANGES.items(), shift[:-1].tolist(), strict=True):
        one = ClassParameter(ground.name, name, limits, float(getattr(ground, name)))
        share = min(max(limits.share(one.configured) + sd * own, 0.0), 1.0)
        values[name] = rounded(float(one.value(share)))
    return replace(ground, **values)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Misfits:
    """Observed less simulated numbers of a site at the best parameters, in standard errors."""

    whole: FloatArray  # shape (p,)
    without: FloatArray  # shape (n_parts, p); without the rocks of each part
    drawn: FloatArray  # shape (n, p); of rocks that were drawn anew
    units: int  # rocks, or groups of them


@dataclass(frozen=True, slots=True)
class Estimated:
    """Evidence of some rocks on the parameters, by the linear model about the best ones."""

    best: FloatArray  # shape (d,); standard normal before any rock is seen
    precision: FloatArray  # shape (d, d); of the numbers, as if each were independent of the others
    pull: FloatArray  # shape (d,); slope of their logarithmic likelihood at the best
    without: FloatArray  # shape (n_parts, d); the same without the rocks of each part
    #: Covariance of the pull, shape (d, d): with the rocks drawn anew, so that numbers of the same
    #: rocks count for no more than they are.
    scatter: FloatArray

    def estimate(self, prior: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return parameters, shape (d,), and their covariance, with a prior of this precision.

        That of a linear estimate with the weights of independent numbers, which need not be the
        best ones (the sandwich of White 1982, Econometrica 50, 1-25).
        """
        own = prior * np.eye(self.best.size)
        gain = np.linalg.inv(self.precision + own)
        found = self.best + gain @ (self.pull - prior * self.best)
        return np.asarray(found), np.asarray(gain @ (self.scatter + own) @ gain.T)

    def estimate_without(self, part: int) -> FloatArray:
        """Return parameters for the rocks of the other parts, shape (d,)."""
        return replace(self, pull=self.without[part]).estimate()[0]


def estimated_by(found: LinearFit, sites: Sequence[Misfits]) -> tuple[Estimated, ...]:
    """Return the evidence of each site's rocks; numbers of ``found`` are those of joined sites."""
    out, first = [], 0
    for site in sites:
        rows = slice(first, first := first + site.whole.size)
        slopes, variance = found.slopes[rows], found.variance[rows]
        weight = slopes.T / variance
        whole, without, drawn = (
            bounded(own) @ weight.T for own in (site.whole, site.without, site.drawn)
        )
        scatter = small_sample_factor(site.units) * np.atleast_2d(np.cov(drawn.T))
        estimated = Estimated(found.best, weight @ slopes, whole, without, scatter)
        # Numbers that even the site's parameters leave farther apart than their errors say have
        # larger ones (Birge 1932, Phys. Rev. 40, 207-227).
        apart = bounded(site.whole) - slopes @ (estimated.estimate()[0] - found.best)
        scatter = scatter * max(float(apart @ apart) / max(apart.size, 1), 1.0)
        # What the linear model leaves is not in the rocks.
        scatter = scatter + np.cov((found.left[:, rows] @ weight.T).T)
        out.append(replace(estimated, scatter=scatter))
    return tuple(out)


def together(sites: Sequence[Estimated]) -> Estimated:
    """Combine the rocks of all sites."""
    names = ("precision", "pull", "without", "scatter")
    return Estimated(
        sites[0].best, *(np.sum([getattr(s, n) for s in sites], axis=0) for n in names)
    )


def small_sample_factor(n: int) -> float:
    """Return by how much few rocks drawn anew scatter too little, as a ratio of variances.

    They scatter by (n − 1)/n of the variance of a mean, and an interval from n of them needs
    Student's instead of the normal quantile.
    """
    n = max(n, 2)
    wider = student.ppf(0.975, n - 1) / norm.ppf(0.975)
    return float(wider**2 * n / (n - 1))


@dataclass(frozen=True, slots=True)
class Posterior:
    """Parameters that the observations leave."""

    best: FloatArray  # shape (d,); as shares of the ranges
    samples: FloatArray  # shape (n, d); the same with the prior
    of_numbers: FloatArray  # shape (n, d); by the observations with next to no prior
    covariance: FloatArray  # shape (d, d); of parameters of which the prior is standard normal
    excess: FloatArray  # shape (n,); twice the logarithmic likelihood that samples lack to the best


def posterior_of(
    parameters: Sequence[ClassParameter], estimated: Estimated, seed: int
) -> Posterior:
    """Sample the posterior, which is normal in parameters of which the prior is standard normal."""
    rng = np.random.default_rng([seed, 7])
    best, covariance = estimated.estimate()
    samples = rng.multivariate_normal(best, covariance, POSTERIOR_SAMPLES)
    alone = rng.multivariate_normal(*estimated.estimate(WEAK_PRIOR), POSTERIOR_SAMPLES)
    off = samples - best
    return Posterior(
        best=prior_shares(parameters, best), samples=prior_shares(parameters, samples),
        of_numbers=prior_shares(parameters, alone), covariance=covariance,
        excess=((off @ estimated.precision) * off).sum(axis=1),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Fitted:
    """A calibrated parameter."""

    parameter: ClassParameter
    share: float  # place of the value in the range, from 0 to 1
    value: float
    low: float  # ends of the 95 % interval
    high: float
    identified: bool  # whether the interval is clearly narrower than that of the prior
    narrowed: float  # width of the interval over that of the prior, on the scale of the search
    limit: str  # "low" or "high" where values at the limit of the range fit best, else ""


def fitted_parameters(
    parameters: Sequence[ClassParameter], posterior: Posterior
) -> tuple[Fitted, ...]:
    """Return values, intervals, and what the observations identify."""
    found = []
    usual = norm.ppf([[0.025], [0.975]]) * np.ones(len(parameters))
    before = prior_shares(parameters, usual)
    for k, parameter in enumerate(parameters):
        own = posterior.samples[:, k]
        low, high = np.quantile(own, [0.025, 0.975])
        narrowed = float((high - low) / (before[1, k] - before[0, k]))
        identified = narrowed < NARROWER
        share = float(posterior.best[k])
        limit = ""
        for name, end in (("low", 0.0), ("high", 1.0)):
            # What was configured there has not gone there.
            went = abs(parameter.start - end) > OUTERMOST
            lies = identified and np.mean(np.abs(own - end) < OUTERMOST) > AT_LIMIT_SHARE
            if went and (lies or abs(share - end) < NEAR_LIMIT):
                limit = name
        value = float(parameter.value(share))
        ends = parameter.value(np.array([low, high]))
        # The best value lies within its interval, also where the interval ends at a limit.
        least, most = min(float(ends[0]), value), max(float(ends[1]), value)
        found.append(Fitted(
            parameter=parameter, share=share, value=value, low=least, high=most,
            identified=identified, narrowed=narrowed, limit=limit,
        ))  # fmt: skip
    return tuple(found)


def identified_combinations(covariance: FloatArray) -> int:
    """Return the number of combinations of the parameters that the observations identify.

    Directions in which the posterior, shape (d, d), is clearly narrower than the standard normal
    prior: of two parameters that make up for each other neither is identified by itself.
    """
    return int((np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0)) < NARROWER).sum())


@dataclass(frozen=True, slots=True)
class TradeOff:
    """Two parameters that can make up for each other."""

    one: str
    other: str
    correlation: float  # of the posterior; above 0: more of both does as well


def trade_offs(labels: Sequence[str], covariance: FloatArray) -> tuple[TradeOff, ...]:
    """Return pairs of parameters that make up for each other, the strongest first."""
    sd = np.sqrt(np.diag(covariance))
    r = covariance / np.outer(sd, sd)
    pairs = [
        TradeOff(labels[i], labels[j], float(r[i, j]))
        for i, j in itertools.combinations(range(sd.size), 2)
        if abs(r[i, j]) >= CORRELATED
    ]
    return tuple(sorted(pairs, key=lambda t: -abs(t.correlation)))


def as_good(posterior: Posterior) -> FloatArray:
    """Return combinations that fit as well as the best, as far apart as possible, shape (n, d)."""
    good = posterior.samples[posterior.excess <= np.quantile(posterior.excess, 0.5)]
    chosen = [posterior.best]
    for _ in range(SHOWN_COMBINATIONS):
        apart = np.min([((good - c) ** 2).sum(axis=1) for c in chosen], axis=0)
        chosen.append(good[int(np.argmax(apart))])
    return np.array(chosen[1:])


def classes_alike(
    parameters: Sequence[ClassParameter], posterior: Posterior
) -> tuple[tuple[str, str], ...]:
    """Return pairs of classes that the observations cannot distinguish.

    The 95 % interval of the difference of one of their parameters, corrected for their number, with
    next to no prior, contains zero for each.
    """
    names = list(dict.fromkeys(p.class_name for p in parameters))
    alike = []
    for one, other in itertools.combinations(names, 2):
        pairs = [
            (i, j)
            for (i, p), (j, q) in itertools.product(enumerate(parameters), repeat=2)
            if (p.class_name, q.class_name) == (one, other) and p.name == q.name
        ]
        tail, numbers = 0.025 / len(pairs), posterior.of_numbers
        limits = [np.quantile(numbers[:, i] - numbers[:, j], [tail, 1.0 - tail]) for i, j in pairs]
        if not any(low > 0.0 or high < 0.0 for low, high in limits):
            alike.append((one, other))
    return tuple(alike)


def contradicting(
    sites: Sequence[Estimated], common: Sequence[float], own_best: Sequence[float], seed: int
) -> bool:
    """Return whether the common parameters are worse for sites than chance explains, and by much.

    ``common``, ``own_best``: mean scores of the rocks of each site at the common parameters, and at
    its best ones. Compared with chance is by how much separate parameters would fit the numbers
    better; chance draws the pulls of the sites anew about none.
    """
    worse = sum(one - other for one, other in zip(common, own_best, strict=True))
    if len(sites) < 2 or worse <= CONTRADICTING_LOSS * sum(own_best):
        return False
    own = [site.precision + WEAK_PRIOR * np.eye(site.best.size) for site in sites]

    def bettered(pulls: Sequence[FloatArray]) -> FloatArray:
        """Return twice the logarithmic likelihood, from pulls of shape (n, d) by site."""
        alone = np.sum([_squared(a, x) for a, x in zip(own, pulls, strict=True)], axis=0)
        return np.asarray(alone - _squared(np.sum(own, axis=0), np.sum(pulls, axis=0)))

    rng = np.random.default_rng([seed, 9])
    zero = np.zeros(sites[0].best.size)
    chance = bettered([rng.multivariate_normal(zero, s.scatter, POSTERIOR_SAMPLES) for s in sites])
    return bool(
        bettered([s.pull[None] for s in sites])[0] > np.quantile(chance, CONTRADICTING_SHARE)
    )


def _squared(precision: FloatArray, pulls: FloatArray) -> FloatArray:
    return np.asarray((pulls * np.linalg.solve(precision, pulls.T).T).sum(axis=1))
