"""Search of the parameters: designs, the posterior of a score, minima of resampled rocks.

The score of a proper scoring rule takes the place of a likelihood, which a simulation of rocks does
not have: the posterior is proportional to prior × exp(−w × sum of the scores) (Bissiri, Holmes and
Walker 2016, J. R. Stat. Soc. B 78, 1103-1130). Its sharpness w is chosen so that the excess of the
score over its minimum is that which drawing the rocks anew makes (compare Syring and Martin 2019,
Biometrika 106, 479-486). It is sampled by emcee (Foreman-Mackey et al. 2013, PASP 125, 306)
from emulators of the scores.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import emcee
import numpy as np
from scipy.optimize import minimize
from scipy.stats import norm, qmc
from scipy.stats import t as student

from sassgis.gap.calibration.emulator import Emulator, WeightedSum, fit
from sassgis.gap.calibration.parameters import Prior
from sassgis.model.grid import FloatArray, IntArray

#: Samples of rocks drawn anew.
_BOOTSTRAP, _FEW = 60, 20
#: Attempts at the sharpness, each from the one before.
_ROUNDS = 4
#: Steps of each walker, of which the first half is thrown away, and of the rest every so many kept.
_STEPS, _THIN = 300, 10
_STEPS_OF_DESIGN = 100
#: The first design is spread like the prior with this many times its standard deviation: values of
#: unusual ground are tried as well.
_BEYOND_PRIOR = 2.5
#: Sharpness of the two posteriors, wider than the one looked for, that new draws come from, over
#: that of a single identified parameter.
_WIDER = (0.5, 0.1)


def first_design(prior: Prior, draws: int, seed: int) -> FloatArray:
    """Shares of the ranges, spread evenly over a wider prior (Sobol sequence), shape (draws, d)."""
    size, d = int(np.ceil(np.log2(max(draws, 2)))), prior.centre.size
    made = qmc.Sobol(d, rng=np.random.default_rng([seed, 3])).random_base2(size)
    return prior.wider(_BEYOND_PRIOR).quantiles(made[:draws])


@dataclass(frozen=True, slots=True)
class SiteScores:
    """Scores of the rocks of one site at all draws.

    Attributes
    ----------
    columns : int64
        Parameters that act at the site.
    scores : float64, shape (n_draws, n_rocks)
    """

    columns: IntArray
    scores: FloatArray


@dataclass(frozen=True, slots=True)
class ScoreSurface:
    """Emulated scores of all sites.

    Attributes
    ----------
    columns : tuple of int64
    emulators : tuple of Emulator
    prior : Prior
    """

    columns: tuple[IntArray, ...]
    emulators: tuple[Emulator, ...]
    prior: Prior

    @property
    def sizes(self) -> tuple[int, ...]:
        """Rocks of each site."""
        return tuple(e.centre.size for e in self.emulators)

    @property
    def informative(self) -> int:
        """Rocks whose score depends on the parameters."""
        return sum(int(np.any(e.weights != 0.0, axis=0).sum()) for e in self.emulators)

    def weighted(
        self, rock_weights: Sequence[FloatArray], rng: np.random.Generator | None = None
    ) -> Total:
        """The weighted sum over all rocks; with ``rng`` as other campaigns might have given it."""
        pairs = zip(self.emulators, rock_weights, strict=True)
        return Total(self.columns, tuple(e.weighted(w, rng) for e, w in pairs))

    @property
    def total(self) -> Total:
        """The sum over all rocks."""
        return self.weighted([np.ones(n) for n in self.sizes])


@dataclass(frozen=True, slots=True)
class Total:
    """A weighted sum over the rocks of all sites."""

    columns: tuple[IntArray, ...]
    sums: tuple[WeightedSum, ...]

    def value(self, shares: FloatArray) -> FloatArray:
        """Sum at some points, shape (m,)."""
        value = np.zeros(len(shares))
        for columns, own in zip(self.columns, self.sums, strict=True):
            value += own.value(shares[:, columns])
        return value

    def minimum(
        self,
        beginnings: FloatArray,
        prior: Prior | None = None,
        sharpness: float = 1.0,
    ) -> tuple[FloatArray, float]:
        """Lowest point reached from some beginnings, and the sum there.

        A ``prior`` is weighed against ``sharpness`` times the sum.
        """
        bounds = [(0.0, 1.0)] * beginnings.shape[1]

        def both(u: FloatArray) -> tuple[float, FloatArray]:
            slope = np.zeros(u.size)
            for columns, own in zip(self.columns, self.sums, strict=True):
                slope[columns] += own.gradient(u[columns])
            value = float(self.value(u[None])[0])
            if prior is not None:
                pull = (u - prior.centre) / prior.sd**2 / sharpness
                value += 0.5 * float((u - prior.centre) @ pull)
                slope = slope + pull
            return value, slope

        found = [minimize(both, u, jac=True, method="L-BFGS-B", bounds=bounds) for u in beginnings]
        best = min(found, key=lambda f: float(f.fun))
        return best.x, float(self.value(best.x[None])[0])


def surface_of(
    points: FloatArray, sites: Sequence[SiteScores], prior: Prior, first: int
) -> ScoreSurface:
    """Emulate the scores of all sites; ``first`` draws are those of the first design."""
    return ScoreSurface(
        tuple(s.columns for s in sites),
        tuple(fit(points[:, s.columns], s.scores, first) for s in sites),
        prior,
    )


@dataclass(frozen=True, slots=True)
class Posterior:
    """Samples of the parameters that the scores leave.

    Attributes
    ----------
    samples, of_scores : float64, shape (n, d)
        With the prior, and by the scores with next to none.
    best : float64, shape (d,)
        Highest density.
    sharpness : float
    excess : float
        By how much the sum of the scores exceeds its minimum at the best of other rocks, median
        over samples of rocks.
    """

    samples: FloatArray
    of_scores: FloatArray
    best: FloatArray
    sharpness: float
    excess: float


def posterior_of(surface: ScoreSurface, points: FloatArray, seed: int) -> Posterior:
    """Sample the posterior, with the sharpness that drawing the rocks anew asks for."""
    rng = np.random.default_rng([seed, 7])
    total = surface.total
    order = np.argsort(total.value(points), kind="stable")
    bottom, least = total.minimum(points[order[:4]])
    sharpness = 1.0 / max(float(bootstrap_excess(surface, bottom, rng, _FEW).mean()), 1e-9)
    beginnings = np.vstack([bottom, points[order]])
    # The prior has next to no part in the sharpness: a sharper score would make up for it. Where
    # nothing was tried the emulators know nothing: the samples stay where the first design lies.
    broad = surface.prior.wider(_BEYOND_PRIOR)
    for _ in range(_ROUNDS):
        of_scores = _sample(total, broad, sharpness, beginnings, rng)
        over = total.value(of_scores) - least
        anew = _bests_of_other_rocks(surface, broad, sharpness, bottom, rng)
        # Some rocks drawn anew find a false minimum where little was tried: the median does not.
        excess = float(np.median(total.value(anew) - least))
        found = _sharpness(over, sharpness, excess)
        done = abs(np.log(found / sharpness)) < 0.15
        sharpness = found
        if done:
            break
    prior = surface.prior
    best, _ = total.minimum(np.vstack([bottom, prior.centre, points[order[:4]]]), prior, sharpness)
    samples = _sample(total, prior, sharpness, np.vstack([best, beginnings]), rng)
    return Posterior(samples, of_scores, best, sharpness, excess)


def _bests_of_other_rocks(
    surface: ScoreSurface,
    prior: Prior,
    sharpness: float,
    bottom: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Best parameters for rocks, campaigns and centres of the prior drawn anew, shape (n, d).

    Where the rocks say nothing these scatter as the prior does, as samples of a posterior do: what
    is left of the difference between both is what the rocks say (the posterior bootstrap of Lyddon,
    Walker and Holmes 2018, NeurIPS 31).
    """
    factor = np.sqrt(small_sample_factor(surface.informative))
    found = []
    for _ in range(_BOOTSTRAP):
        weights = [
            1.0 + factor * (rng.multinomial(n, np.full(n, 1.0 / n)) - 1.0) for n in surface.sizes
        ]
        centre = prior.quantiles(rng.random(bottom.size))
        own = surface.weighted(weights, rng)
        best, _ = own.minimum(bottom[None], replace(prior, centre=centre), sharpness)
        found.append(best)
    return np.array(found)


def small_sample_factor(n: int) -> float:
    """By how much few rocks drawn anew scatter too little, as a ratio of variances.

    Rocks that are drawn anew scatter by (n − 1)/n of the variance of a mean, and an interval from n
    of them needs Student's instead of the normal quantile.
    """
    wider = student.ppf(0.975, n - 1) / norm.ppf(0.975)
    return float(wider**2 * n / (n - 1))


def _sharpness(over: FloatArray, sampled_at: float, wanted: float) -> float:
    """Sharpness at which the median excess is the one wanted, by weights of the samples."""
    over = np.sort(over)

    def middle(factor: float) -> float:
        below = np.cumsum(np.exp(-(factor - 1.0) * sampled_at * (over - over[0])))
        return float(over[np.searchsorted(below, 0.5 * below[-1])])

    low, high = 0.2, 5.0
    if middle(high) > wanted:
        return high * sampled_at
    if middle(low) < wanted:
        return low * sampled_at
    for _ in range(40):
        tried = np.sqrt(low * high)
        low, high = (tried, high) if middle(tried) > wanted else (low, tried)
    return float(np.sqrt(low * high)) * sampled_at


def bootstrap_excess(
    surface: ScoreSurface, bottom: FloatArray, rng: np.random.Generator, draws: int = _BOOTSTRAP
) -> FloatArray:
    """How much worse than the best for rocks drawn anew the best for all rocks is, for each draw.

    Rocks are drawn anew within their sites, and so is the noise of the simulated campaigns.
    """
    found, broad = np.empty(draws), surface.prior.wider(_BEYOND_PRIOR)
    for k in range(draws):
        weights = [rng.multinomial(n, np.full(n, 1.0 / n)).astype(float) for n in surface.sizes]
        own = surface.weighted(weights, rng)
        elsewhere = broad.quantiles(rng.random((1, bottom.size)))
        _, least = own.minimum(np.vstack([bottom, elsewhere]))
        found[k] = float(own.value(bottom[None])[0]) - least
    return np.maximum(found, 0.0)


def _sample(
    total: Total,
    prior: Prior,
    sharpness: float,
    beginnings: FloatArray,
    rng: np.random.Generator,
    steps: int = _STEPS,
) -> FloatArray:
    d = beginnings.shape[1]
    # Many walkers and few steps: a step of all of them at once costs little more than one of few.
    walkers = max(96, 8 * d)

    def log_density(shares: FloatArray) -> FloatArray:
        return prior.log_density(shares) - sharpness * total.value(np.clip(shares, 0.0, 1.0))

    place = beginnings[np.arange(walkers) % min(len(beginnings), walkers)]
    place = np.clip(place + 0.02 * rng.standard_normal(place.shape), 0.001, 0.999)
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(walkers, d, log_density, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(int(rng.integers(2**31))).get_state()
    sampler.run_mcmc(place, steps)
    kept: FloatArray = sampler.get_chain(discard=steps // 2, thin=_THIN, flat=True)
    return kept


def next_design(surface: ScoreSurface, points: FloatArray, draws: int, seed: int) -> FloatArray:
    """New draws where the best parameters may lie, from a wider posterior, shape (draws, d)."""
    rng = np.random.default_rng([seed, 5, len(points)])
    total = surface.total
    order = np.argsort(total.value(points), kind="stable")
    bottom, _ = total.minimum(points[order[:4]])
    wanted = float(np.mean(bootstrap_excess(surface, bottom, rng, _FEW)))
    beginnings = np.vstack([bottom, points[order]])
    chosen = [bottom[None]]
    for sharpness, part in zip(_WIDER, np.array_split(np.arange(draws - 1), 2), strict=True):
        own = sharpness / max(wanted, 1e-9)
        samples = _sample(total, surface.prior, own, beginnings, rng, _STEPS_OF_DESIGN)
        chosen.append(samples[rng.choice(len(samples), part.size, replace=False)])
    return np.vstack(chosen)


def minimum_without(
    surface: ScoreSurface, posterior: Posterior, weights: Sequence[FloatArray]
) -> FloatArray:
    """Best parameters for weighted rocks: a weight of 0 leaves a rock out."""
    own = surface.weighted(weights)
    beginnings = np.vstack([posterior.best, posterior.samples[:: len(posterior.samples) // 3][:3]])
    found, _ = own.minimum(beginnings, surface.prior, posterior.sharpness)
    return found
