"""Observed against predicted, rock by rock: what findings are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sassgis.gap.inference.rock_tests import rock_means
from sassgis.model.grid import FloatArray, IntArray

#: Units by the end of the name of a quantity.
_UNITS = {"_mps": "m/s", "_mps2": "m/s²", "_hz": "1/s", "_m": "m", "_deg": "°", "_radps": "rad/s"}


@dataclass(frozen=True, slots=True)
class Residual:
    """One quantity at one place, of all rocks; arrays of shape (n_rocks,)."""

    # As in ``sassgis.gap.diagnosis.GapFinding``.
    place: str
    phase: str
    quantity: str
    test: str
    # NaN for rocks without one.
    observed: FloatArray
    predicted: FloatArray
    # Chainages between which the place lies (m).
    s0_m: float
    s1_m: float
    score: FloatArray | None = None  # tested for a mean of zero; default: observed less predicted
    #: Of the rocks in the means, for quantities measured more closely on some of them.
    weight: FloatArray | None = None
    steps: int = 0  # single values that the means of the rocks are of; 0 for one a rock

    @property
    def gap(self) -> FloatArray:
        """Observed less predicted, shape (n_rocks,)."""
        return self.observed - self.predicted

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        name = self.quantity.removesuffix("_spread")
        return next((u for end, u in _UNITS.items() if name.endswith(end)), "1")

    def tested(self) -> FloatArray:
        """Values whose mean over rocks is zero if there is no gap, shape (n_rocks,)."""
        values = self.gap if self.score is None else self.score
        values = np.where(np.isfinite(self.gap), values, np.nan)
        if self.weight is None:
            return values
        known = np.isfinite(values)
        mean = np.mean(self.weight[known]) if known.any() else 1.0
        return values * self.weight / mean


def per_rock(values: FloatArray, rock: IntArray, n_rocks: int) -> FloatArray:
    """Mean of the rows of each rock, shape (n_rocks,); NaN for rocks without any."""
    result = np.full(n_rocks, np.nan)
    own = rock >= 0
    if own.any():
        means, rocks = rock_means(values[own], rock[own])
        result[rocks] = means[:, 0]
    return result


def rows_per_rock(values: FloatArray, rock: IntArray, n_rocks: int) -> FloatArray:
    """Number of rows of each rock that have a value, shape (n_rocks,).

    It is the weight of a rock in means over single steps: a rock that springs far makes few steps,
    so that the mean over rocks of their own means would count the far ones too much.
    """
    own = (rock >= 0) & np.isfinite(values)
    return np.bincount(rock[own], minlength=n_rocks).astype(np.float64)


def mean_of_draws(draws: FloatArray, least: int = 2) -> FloatArray:
    """Mean over the last axis, missing ones left out; NaN where there are too few."""
    known = np.isfinite(draws)
    count = known.sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known, draws, 0.0).sum(axis=-1) / count
    return np.where(count >= least, mean, np.nan)


def spread(observed: FloatArray, draws: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distance of observations from the middle of what is predicted, and what it should be.

    Parameters
    ----------
    observed : float64, shape (n,)
    draws : float64, shape (n, m)
        Predicted values; NaN where there is none.

    Returns
    -------
    distance, expected : float64, shape (n,)
        From the mean of the draws, of the observation and of the draws themselves.
    score : float64, shape (n,)
        |PIT − ½| less its mean under the model: above zero if the observed scatter more. The PIT,
        the share of draws below the observation, is uniform if the model is right.
    """
    known = np.isfinite(draws)
    count = known.sum(axis=-1).astype(float)
    centre = mean_of_draws(draws, least=3)
    with np.errstate(invalid="ignore", divide="ignore"):
        away = np.where(known, np.abs(draws - centre[:, None]), 0.0).sum(axis=-1) / count
        # A draw pulls the mean towards itself, an observation does not.
        expected = away * np.sqrt((count + 1.0) / (count - 1.0))
        below = (known & (draws < observed[:, None])).sum(axis=-1)
        equal = (known & (draws == observed[:, None])).sum(axis=-1)
        pit = (below + 0.5 * equal + 0.5) / (count + 1.0)
        half = np.floor(count / 2.0)
        # Mean of |(r + ½)/(m + 1) − ½| over the equally likely ranks r = 0 … m.
        usual = (
            np.where(count % 2 == 0, half * (half + 1.0), (half + 1.0) ** 2) / (count + 1.0) ** 2
        )
        score = np.abs(pit - 0.5) - usual
    few = count < 3
    return (
        np.where(few, np.nan, np.abs(observed - centre)),
        np.where(few, np.nan, expected),
        np.where(few | ~np.isfinite(observed), np.nan, score),
    )


def only_above(score: FloatArray) -> FloatArray:
    """Scores of a scatter of which only an upper bound is known: less than that is no gap."""
    known = score[np.isfinite(score)]
    return score if known.size and known.mean() > 0.0 else np.where(np.isfinite(score), 0.0, score)


def beyond(gap: FloatArray, tolerance: float) -> FloatArray:
    """Gaps moved together towards zero by a tolerance: what is tested is how far they exceed it.

    ``gap``: shape (n,), NaN where there is none; ``tolerance``: mean gap that can be an error of
    the comparison itself.
    """
    known = gap[np.isfinite(gap)]
    mean = float(known.mean()) if known.size else 0.0
    left: FloatArray = gap - np.clip(mean, -tolerance, tolerance)
    return left
