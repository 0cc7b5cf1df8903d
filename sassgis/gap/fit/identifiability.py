"""Identifiability: parameters, classes, trade-offs, sites that contradict."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from sassgis.gap.constants import (
    AT_LIMIT_SHARE,
    CONTRADICTING_LOSS,
    CONTRADICTING_SHARE,
    CORRELATED,
    NARROWER,
    NEAR_LIMIT,
    OUTERMOST,
    POSTERIOR_SAMPLES,
    SHOWN_COMBINATIONS,
    WEAK_PRIOR,
)
from sassgis.gap.fit.linear_fit import LinearFit, bounded
from sassgis.gap.fit.parameters import ClassParameter, prior_shares
from sassgis.grid import FloatArray


@dataclass(frozen=True, slots=True)
class Misfits:
    """Observed less simulated numbers of a site at the best parameters, in standard errors."""

    whole: FloatArray  # shape (p,)
    without: FloatArray  # shape (n_parts, p); without the rocks of each part
    drawn: FloatArray  # shape (n, p); of rocks that were drawn anew
    units: int  # rocks, or groups of them


@dataclass(frozen=True, slots=True)
class Told:
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


def told_by(found: LinearFit, sites: Sequence[Misfits]) -> tuple[Told, ...]:
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
        told = Told(found.best, weight @ slopes, whole, without, scatter)
        # Numbers that even the site's parameters leave farther apart than their errors say have
        # larger ones (Birge 1932, Phys. Rev. 40, 207-227).
        apart = bounded(site.whole) - slopes @ (told.estimate()[0] - found.best)
        scatter = scatter * max(float(apart @ apart) / max(apart.size, 1), 1.0)
        # What the linear model leaves is not in the rocks.
        scatter = scatter + np.cov((found.left[:, rows] @ weight.T).T)
        out.append(replace(told, scatter=scatter))
    return tuple(out)


def together(sites: Sequence[Told]) -> Told:
    """Combine the rocks of all sites."""
    names = ("precision", "pull", "without", "scatter")
    return Told(sites[0].best, *(np.sum([getattr(s, n) for s in sites], axis=0) for n in names))


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


def posterior_of(parameters: Sequence[ClassParameter], told: Told, seed: int) -> Posterior:
    """Sample the posterior, which is normal in parameters of which the prior is standard normal."""
    rng = np.random.default_rng([seed, 7])
    best, covariance = told.estimate()
    samples = rng.multivariate_normal(best, covariance, POSTERIOR_SAMPLES)
    alone = rng.multivariate_normal(*told.estimate(WEAK_PRIOR), POSTERIOR_SAMPLES)
    off = samples - best
    return Posterior(
        best=prior_shares(parameters, best), samples=prior_shares(parameters, samples),
        of_numbers=prior_shares(parameters, alone), covariance=covariance,
        excess=((off @ told.precision) * off).sum(axis=1),
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
    sites: Sequence[Told], common: Sequence[float], own_best: Sequence[float], seed: int
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
