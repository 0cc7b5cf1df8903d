"""What the observations identify: parameters, classes, trade-offs, sites that contradict."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.parameters import ClassParameter, Prior
from sassgis.gap.calibration.search import (
    Posterior,
    ScoreSurface,
    bootstrap_excess,
    minimum_without,
)
from sassgis.model.grid import FloatArray

#: A parameter is identified if its interval is narrower than this share of that of the prior.
_NARROWER = 0.7
#: A limit is met where this share of the posterior lies in the outermost part of the range.
_AT_LIMIT, _OUTERMOST = 0.25, 0.05
#: A value this near to a limit lies there, however little is known of it.
_LAST = 0.005
#: Correlations of the posterior from here on are stated as trade-offs.
_CORRELATED = 0.4
#: Combinations that are shown.
_SHOWN = 6
#: Sites contradict each other if the common parameters cost them more than chance would in this
#: share of samples of their rocks, and at least this share of their score.
_CHANCE, _WORSE = 0.99, 0.02


@dataclass(frozen=True, slots=True)
class Fitted:
    """A calibrated parameter.

    Attributes
    ----------
    parameter : ClassParameter
    share : float
        Place of the value in the range, from 0 to 1.
    value : float
    low, high : float
        95 % interval.
    identified : bool
        Whether the interval is clearly narrower than that of the prior.
    narrowed : float
        Width of the interval over that of the prior, on the scale of the search.
    limit : str
        "low" or "high" where values at the limit of the range fit best, else "".
    """

    parameter: ClassParameter
    share: float
    value: float
    low: float
    high: float
    identified: bool
    narrowed: float
    limit: str


def fitted_parameters(
    parameters: Sequence[ClassParameter], posterior: Posterior
) -> tuple[Fitted, ...]:
    """Values, intervals, and what the observations identify."""
    found = []
    d = len(parameters)
    before = Prior.of(parameters).quantiles(np.repeat([[0.025], [0.975]], d, axis=1))
    for k, parameter in enumerate(parameters):
        own = posterior.samples[:, k]
        low, high = np.quantile(own, [0.025, 0.975])
        narrowed = float((high - low) / (before[1, k] - before[0, k]))
        identified = narrowed < _NARROWER
        share = float(posterior.best[k])
        limit = ""
        for name, end in (("low", 0.0), ("high", 1.0)):
            # What was configured there has not gone there.
            went = abs(parameter.start - end) > _OUTERMOST
            lies = identified and np.mean(np.abs(own - end) < _OUTERMOST) > _AT_LIMIT
            if went and (lies or abs(share - end) < _LAST):
                limit = name
        value = float(parameter.value(share))
        ends = parameter.value(np.array([low, high]))
        # The best value lies within its interval, also where the interval ends at a limit.
        least, most = min(float(ends[0]), value), max(float(ends[1]), value)
        found.append(Fitted(parameter, share, value, least, most, identified, narrowed, limit))
    return tuple(found)


def identified_combinations(parameters: Sequence[ClassParameter], posterior: Posterior) -> int:
    """Number of combinations of the parameters that the observations identify.

    Where two parameters can make up for each other, neither is identified by itself, yet a
    combination of both is: a direction in which the posterior is clearly narrower than the prior.
    """
    scaled = posterior.samples / Prior.of(parameters).spread
    spread = np.atleast_2d(np.cov(scaled.T))
    return int((np.sqrt(np.linalg.eigvalsh(spread)) < _NARROWER).sum())


@dataclass(frozen=True, slots=True)
class TradeOff:
    """Two parameters that can make up for each other.

    Attributes
    ----------
    one, other : str
    correlation : float
        Of the posterior; above 0: more of both does as well.
    """

    one: str
    other: str
    correlation: float


def trade_offs(parameters: Sequence[ClassParameter], posterior: Posterior) -> tuple[TradeOff, ...]:
    """Pairs of parameters that make up for each other, the strongest first."""
    if len(parameters) < 2:
        return ()
    r = np.asarray(np.corrcoef(posterior.samples.T))
    found = [
        TradeOff(parameters[i].label, parameters[j].label, float(r[i, j]))
        for i, j in itertools.combinations(range(len(parameters)), 2)
        if abs(r[i, j]) >= _CORRELATED
    ]
    return tuple(sorted(found, key=lambda t: -abs(t.correlation)))


def as_good(surface: ScoreSurface, posterior: Posterior) -> FloatArray:
    """Combinations that fit as well as the best, as far apart as possible, shape (n, d)."""
    excess = surface.total.value(posterior.samples)
    good = posterior.samples[excess <= np.quantile(excess, 0.5)]
    chosen = [posterior.best]
    for _ in range(_SHOWN):
        apart = np.min([((good - c) ** 2).sum(axis=1) for c in chosen], axis=0)
        chosen.append(good[int(np.argmax(apart))])
    return np.array(chosen[1:])


def classes_alike(
    parameters: Sequence[ClassParameter], posterior: Posterior
) -> tuple[tuple[str, str], ...]:
    """Pairs of classes that the observations cannot tell apart.

    Two classes are told apart if the 95 % interval of the difference of one of their parameters,
    corrected for the number of parameters, does not contain zero. The interval is that of the
    scores without the prior, which sets classes apart that no rock has told apart.
    """
    names = list(dict.fromkeys(p.class_name for p in parameters))
    alike = []
    for one, other in itertools.combinations(names, 2):
        pairs = [
            (i, j)
            for (i, p), (j, q) in itertools.product(enumerate(parameters), repeat=2)
            if (p.class_name, q.class_name) == (one, other) and p.name == q.name
        ]
        tail = 0.025 / len(pairs)
        differ = False
        for i, j in pairs:
            apart = posterior.of_scores[:, i] - posterior.of_scores[:, j]
            low, high = np.quantile(apart, [tail, 1.0 - tail])
            differ = differ or bool(low > 0.0 or high < 0.0)
        if not differ:
            alike.append((one, other))
    return tuple(alike)


@dataclass(frozen=True, slots=True)
class SiteFit:
    """How well the common parameters fit one site.

    Attributes
    ----------
    name : str
    score : float
        Mean score of its rocks at the common parameters (emulated).
    own_score : float
        The same at the best parameters for this site.
    own : float64, shape (d,)
        These, as shares of the ranges.
    """

    name: str
    score: float
    own_score: float
    own: FloatArray


def site_fits(
    names: Sequence[str], surface: ScoreSurface, posterior: Posterior, seed: int
) -> tuple[tuple[SiteFit, ...], bool]:
    """Common and own parameters of each site, and whether the sites contradict each other.

    They do if the common parameters are worse for them, taken together, than chance explains.
    """
    found = []
    chance = np.zeros(1)
    worse = total_score = 0.0
    for k, (name, n) in enumerate(zip(names, surface.sizes, strict=True)):
        weights = [np.full(m, float(i == k)) for i, m in enumerate(surface.sizes)]
        own = minimum_without(surface, posterior, weights)
        total = surface.weighted(weights)
        common, least = (float(total.value(u[None])[0]) for u in (posterior.best, own))
        found.append(SiteFit(name, common / n, least / n, own))
        if len(names) > 1:
            alone = ScoreSurface((surface.columns[k],), (surface.emulators[k],), surface.prior)
            chance = chance + bootstrap_excess(alone, own, np.random.default_rng([seed, 9, k]))
        worse += common - least
        total_score += least
    contradict = worse > max(float(np.quantile(chance, _CHANCE)), _WORSE * total_score)
    return tuple(found), bool(contradict) and len(names) > 1
