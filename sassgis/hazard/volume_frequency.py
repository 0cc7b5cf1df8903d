"""How often blocks of which volume are released: a power law fitted to observed volumes.

The frequency of blocks larger than V falls as V^-b from the volume on from which the list is
complete (Hungr, Evans and Hazzard 1999, Canadian Geotechnical Journal 36, 224-238; Dussauge,
Grasso and Helmstetter 2003, Journal of Geophysical Research 108, 2286), up to a largest volume if
one is stated (truncated Pareto distribution: Aban, Meerschaert and Panorska 2006, Journal of the
American Statistical Association 101, 270-277). Fit by maximum likelihood and test of the fit by
simulation follow Clauset, Shalizi and Newman (2009), SIAM Review 51, 661-703. None of them was
checked against the source; what is computed is derived here.

With x = ln(V/V0), V0 the volume of completeness and X = ln(largest/V0), x has the density
b exp(-b x)/(1 - exp(-b X)).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.special import lambertw

from sassgis.errors import InputError
from sassgis.grid import FloatArray

#: Largest drop of the log-likelihood below its maximum: half of the 95 % quantile of chi-square
#: with one degree of freedom.
_ALLOWED = 0.5 * 3.841459
#: Range in which exponents are searched.
_EXPONENTS = (1e-3, 50.0)
_LEAST_BLOCKS = 5
#: Below it another volume of completeness has too few blocks to be compared.
_LEAST_COMPARED = 20
_SIMULATIONS = 499

Likelihood = Callable[[float], float]


@dataclass(frozen=True, slots=True)
class BlockSurvey:
    """Volumes of blocks, as a list or counted by class."""

    # Shape (n,); limits of the volume (m3): equal where it was measured, high infinite in an open
    # class.
    low: FloatArray
    high: FloatArray
    count: FloatArray  # shape (n,); blocks of each

    @property
    def is_list(self) -> bool:
        """Return whether each volume was measured."""
        return bool(np.array_equal(self.low, self.high))

    @property
    def blocks(self) -> int:
        """Return the number of all blocks."""
        return int(self.count.sum())

    def complete(self, volume: float) -> BlockSurvey:
        """Return blocks of this volume (m3) and above; InputError if a class lies on both sides."""
        cut = (self.low < volume) & (volume < self.high)
        if cut.any():
            raise InputError(
                "lies within a class of the survey",
                field="completeness volume",
                found=f"{volume:g} m3",
                expected=f"a limit of a class, as {self.low[cut][0]:g} or {self.high[cut][0]:g}",
            )
        kept = self.low >= volume
        return BlockSurvey(self.low[kept], self.high[kept], self.count[kept])


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with the limits of its 95 % interval."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True)
class PowerLaw:
    """A power law of volumes as it was fitted."""

    survey: BlockSurvey  # the blocks from ``complete_from`` on
    # Volumes between which it holds (m3); up_to may be infinite.
    complete_from: float
    up_to: float
    exponent: Estimate  # b, with the interval of the likelihood ratio

    @property
    def span(self) -> float:
        """Return the logarithm of the largest over the smallest volume."""
        return math.log(self.up_to / self.complete_from)

    def share(self, low: float, high: float, b: FloatArray | float) -> FloatArray:
        """Return share of the blocks with volumes between two limits (m3), for given exponents."""
        x, y = (math.log(v / self.complete_from) for v in (low, high))
        part = np.exp(-np.multiply(b, x)) * -np.expm1(-np.multiply(b, y - x))
        return np.asarray(part / -np.expm1(-np.multiply(b, self.span)))

    def frequency(self, low: float, high: float, rate: float, counted: bool) -> Estimate:
        """Return annual frequency of blocks between two volumes (m3), with its likelihood interval.

        ``rate`` is that of all blocks of the law; if ``counted`` it is the count of the survey over
        years, else it is taken as exact.
        """
        b = np.geomspace(self.exponent.lower, self.exponent.upper, 401)
        likely = _likelihood(self.survey, self.complete_from, self.span)
        missed = likely(self.exponent.value) - np.array([likely(one) for one in b])
        left = np.maximum(_ALLOWED - missed, 0.0)
        share = self.share(low, high, b)
        # Of a Poisson count n the rate u times its estimate falls short by n (u - 1 - ln u).
        about = np.maximum(-np.exp(-1.0 - left / self.survey.blocks), -math.exp(-1.0) + 1e-15)
        least, most = (-lambertw(about, k).real if counted else 1.0 for k in (0, -1))
        best = float(self.share(low, high, self.exponent.value))
        lower, upper = float((least * share).min()), float((most * share).max())
        return Estimate(rate * best, rate * lower, rate * upper)


def fit_power_law(survey: BlockSurvey, complete_from: float, up_to: float = math.inf) -> PowerLaw:
    """Fit a power law to the blocks of a survey by maximum likelihood.

    ``complete_from`` is the volume from which on no block was missed, ``up_to`` the largest that is
    possible (m3). Raises InputError if there are too few blocks, one is larger than possible, or no
    power law fits.
    """
    if not 0.0 < complete_from < up_to:
        raise InputError(
            "is not below the largest volume",
            field="completeness volume",
            found=f"{complete_from:g} and {up_to:g} m3",
            expected="two volumes (m3), the smaller first",
        )
    used = survey.complete(complete_from)
    if used.blocks < _LEAST_BLOCKS:
        raise InputError(
            f"too few blocks from {complete_from:g} m3 on",
            found=str(used.blocks),
            expected=f"{_LEAST_BLOCKS} or more",
        )
    # An open class says that there may be larger blocks, not that there are.
    largest = np.where(used.high < math.inf, used.high, used.low).max()
    if largest > up_to:
        raise InputError(
            "the survey has larger blocks than are stated to be possible",
            found=f"{largest:g} m3",
            expected=f"{up_to:g} m3 at most",
        )
    used = replace(used, high=np.minimum(used.high, up_to))
    span = math.log(up_to / complete_from)
    likely = _likelihood(used, complete_from, span)
    value = _most_likely(likely)
    if not 1.01 * _EXPONENTS[0] < value < _EXPONENTS[1] / 1.01:
        raise InputError(
            f"no power law fits: volumes do not spread, or do not fall off, between "
            f"{complete_from:g} and {up_to:g} m3",
            found=f"exponent at {value:.3g}",
            expected=f"one within {_EXPONENTS[0]:g} and {_EXPONENTS[1]:g}",
        )

    def missed(b: float) -> float:
        return likely(value) - likely(b) - _ALLOWED

    lower, upper = (
        brentq(missed, *sorted((end, value))) if missed(end) > 0.0 else end for end in _EXPONENTS
    )
    return PowerLaw(used, complete_from, up_to, Estimate(value, lower, upper))


def higher_thresholds(law: PowerLaw) -> Iterator[PowerLaw]:
    """Yield the same fit from larger volumes on, as long as blocks remain: up to three."""
    low = np.unique(law.survey.low)
    steps = law.complete_from * 2.0 ** np.arange(1, 4) if law.survey.is_list else low[1:4]
    for volume in steps:
        if law.survey.complete(volume).blocks >= _LEAST_COMPARED:
            try:
                yield fit_power_law(law.survey, float(volume), law.up_to)
            except InputError:
                return


def fit_test(law: PowerLaw) -> tuple[float, float]:
    """Compute the largest distance of observed and fitted shares, and how likely a larger one is.

    The distance is that of Kolmogorov and Smirnov, of classes at their limits; p is the share of
    samples of the law, each fitted anew, that lie farther from their fit.
    """
    draws = np.random.default_rng(1)
    n, b, own = law.survey.blocks, law.exponent.value, _distance(law)
    farther = 0
    for _ in range(_SIMULATIONS):
        if law.survey.is_list:
            u = draws.random(n)
            x = -np.log1p(u * np.expm1(-b * law.span)) / b
            volume = law.complete_from * np.exp(x)
            sample = BlockSurvey(volume, volume, np.ones(n))
        else:
            share = [float(law.share(lo, hi, b)) for lo, hi in _classes(law)]
            count = draws.multinomial(n, np.array(share) / sum(share)).astype(float)
            low, high = np.array(_classes(law)).T
            sample = BlockSurvey(low, high, count)
        likely = _likelihood(sample, law.complete_from, law.span)
        fitted = Estimate(_most_likely(likely), math.nan, math.nan)
        farther += _distance(replace(law, survey=sample, exponent=fitted)) >= own
    return own, (farther + 1) / (_SIMULATIONS + 1)


def _classes(law: PowerLaw) -> list[tuple[float, float]]:
    """Return classes of a survey without gaps, from the volume of completeness to the largest."""
    edges = sorted({law.complete_from, law.up_to, *law.survey.low, *law.survey.high})
    return list(itertools.pairwise(edges))


def _distance(law: PowerLaw) -> float:
    survey, b = law.survey, law.exponent.value
    order = np.argsort(survey.high)
    reached = np.cumsum(survey.count[order]) / survey.count.sum()
    below = np.array([float(law.share(law.complete_from, v, b)) for v in survey.high[order]])
    before = np.concatenate([[0.0], reached[:-1]])
    ends = np.abs(reached - below).max()
    return float(max(ends, np.abs(below - before).max()) if survey.is_list else ends)


def _likelihood(survey: BlockSurvey, complete_from: float, span: float) -> Likelihood:
    """Return the log-likelihood of a survey as a function of the exponent, up to a constant."""
    x = np.log(survey.low / complete_from)
    width = np.log(survey.high / survey.low)
    measured = width == 0.0
    n, n_measured = survey.count.sum(), survey.count[measured].sum()
    total = float(survey.count @ x)
    width, count = width[~measured], survey.count[~measured]

    def of(b: float) -> float:
        in_classes = float(count @ np.log(-np.expm1(-b * width)))
        truncated = n * math.log(-math.expm1(-b * span))
        return float(n_measured * math.log(b) - b * total + in_classes - truncated)

    return of


def _most_likely(likely: Likelihood) -> float:
    found = minimize_scalar(
        lambda log_b: -likely(math.exp(log_b)),
        bounds=tuple(map(math.log, _EXPONENTS)),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return math.exp(found.x)
