"""What each cause closes of the gap that the base leaves, once the ground is calibrated anew.

The base and every cause release the rocks again; each campaign is summed up by the same numbers
(``site_summary``). In the directions that the ground cannot follow, by the linear model of the
base, what is observed less the base is compared with what the draws of a cause change. Chance is
seen from campaigns of the base itself (parametric bootstrap), and whether these data could show a
cause from campaigns with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sassgis.gap.calibration.linear_fit import LinearFit
from sassgis.gap.calibration.site_summary import SiteSummary
from sassgis.gap.causes.all_causes import CAUSES
from sassgis.gap.causes.cause import SHOWS
from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.diagnosis import CauseGain
from sassgis.gap.ladder.hypothesis_fit import (
    FittedHypothesis,
    HypothesisDraw,
    RunTasks,
    families_of,
)
from sassgis.gap.which.hypotheses import draw
from sassgis.model.grid import FloatArray

#: Campaigns of the base in each of some parts, draws of each cause, and campaigns of a draw.
BASE, _PARTS, DRAWS, EACH = 10, 4, 20, 2
#: Number of the first draw of a cause, and of the base.
_NUMBER = 4100
#: Share of the scatter of the numbers about their mean that is taken to be their own: the
#: covariances of many numbers are not known from few campaigns.
_OWN = 0.5
#: Directions in which a cause changes what is seen, at most.
_DIRECTIONS = 4
#: A draw counts for up to this many times its change: its strength is not that of nature.
_MOST = 1.5


def see_each(summary: SiteSummary, task: HypothesisDraw) -> FloatArray:
    """Numbers of the single campaigns of a draw, shape (count, p)."""
    model = task.of(summary.problem.case).model
    return summary.of_each(model, task.number, task.count)


def cause_gains(
    summary: SiteSummary, base: FittedHypothesis, families: Sequence[str], run: RunTasks
) -> dict[str, CauseGain]:
    """Gains of causes beyond a calibrated base; empty where nothing is compared."""
    if base.found is None:
        return {}
    tasks = [HypothesisDraw(base.effect, base.shares, _NUMBER + k, BASE) for k in range(_PARTS)]
    for family in families:
        tasks += _draws(summary, base, family)
    made = list(run(see_each, tasks))
    campaigns = np.concatenate(made[:_PARTS])
    mean, onto = _directions(summary, base.found, campaigns)
    if not onto.shape[1]:
        return {}

    def seen(numbers: FloatArray) -> FloatArray:
        """Numbers less those of the base, shape (n, p) to (n, q)."""
        scaled = summary.in_errors(numbers) - mean
        # What is not there is as in the base, and nothing counts more than it can by chance.
        return np.clip(np.nan_to_num(scaled), -12.0, 12.0) @ onto

    observed, chance = seen(summary.observed[None])[0], seen(campaigns)
    # A base that leaves more than chance does everywhere leaves it to any cause.
    excess = max(float(observed @ observed) / float(np.mean((chance**2).sum(axis=1))), 1.0)
    found = {}
    for k, family in enumerate(families):
        rows = slice(_PARTS + k * DRAWS, _PARTS + (k + 1) * DRAWS)
        drawn = np.array([seen(one) for one in made[rows]])
        found[family] = _gain_of(family, observed, chance, drawn, excess, tasks[rows])
    return found


def _draws(summary: SiteSummary, base: FittedHypothesis, family: str) -> list[HypothesisDraw]:
    """The base with draws of a cause."""
    effect = "+".join(sorted({*families_of(base.effect), family}))
    tasks, cause = [], CAUSES[family].number
    for k in range(DRAWS):
        rng = np.random.default_rng([summary.problem.seed, 61, cause, k])
        made = draw(summary.problem.case, families_of(effect), ParameterDraws(rng, base.shares))
        number = _NUMBER + _PARTS + cause * DRAWS + k
        tasks.append(HypothesisDraw(effect, made.parameter_draws, number, EACH))
    return tasks


def _directions(
    summary: SiteSummary, found: LinearFit, base: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean numbers of the base, shape (p,), and to units of chance where no ground follows, (p, q).

    ``base``: numbers of its campaigns, shape (n, p).
    """
    scaled = summary.in_errors(base)
    known = np.isfinite(scaled)
    mean = np.where(known, scaled, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    off = np.where(known, scaled - mean, 0.0)
    # Observed numbers scatter as those of the base, or as the observed rocks themselves.
    covariance = off.T @ off / len(off)
    own = np.maximum(np.diag(covariance), 0.5)
    covariance = (1.0 - _OWN) * covariance + _OWN * np.diag(own)
    covariance[np.diag_indices_from(covariance)] = own
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    slopes = white @ found.slopes
    d = slopes.shape[1]
    basis, _ = np.linalg.qr(np.vstack([slopes, np.eye(d)]), mode="complete")
    return mean, white.T @ basis[: len(slopes), d:]


def _gain_of(
    family: str,
    observed: FloatArray,
    chance: FloatArray,
    draws: FloatArray,
    excess: float,
    tasks: Sequence[HypothesisDraw],
) -> CauseGain:
    """``draws``: shape (DRAWS, EACH, q)."""
    change = _cleaned(draws.mean(axis=1))
    gains = _closed(observed[None], change)[0]
    best = int(np.argmax(gains))
    usual = _closed(chance, change).max(axis=1)
    middle, most = np.quantile(usual, (0.5, 0.95))
    spread = max(float(most - middle), 1.0)
    sureness = (float(gains[best]) / excess - float(middle)) / spread
    found = [
        _closed(own, np.delete(change, k, axis=0)).max(axis=1) / excess > middle + SHOWS * spread
        for k, own in enumerate(draws)
    ]
    share = float(gains[best] / max(float(observed @ observed), 1e-9))
    return CauseGain(family, share, sureness, float(np.mean(found)), excess, tasks[best].shares)


def _cleaned(change: FloatArray) -> FloatArray:
    """Changes in the few directions in which they are more than the chance of two campaigns."""
    n, q = change.shape
    _, size, directions = np.linalg.svd(change, full_matrices=False)
    # Largest singular value of n vectors of chance alone (Marchenko and Pastur 1967).
    edge = (np.sqrt(n) + np.sqrt(q)) / np.sqrt(EACH)
    kept = directions[:_DIRECTIONS][size[:_DIRECTIONS] > edge]
    return np.asarray(change @ kept.T @ kept)


def _closed(seen: FloatArray, change: FloatArray) -> FloatArray:
    """What draws close of the squared distance of some numbers, shape (n, n_draws)."""
    size = np.maximum((change**2).sum(axis=1), 1e-9)
    along = seen @ change.T
    times = np.clip(along / size, 0.0, _MOST)
    return np.asarray(times * (2.0 * along - times * size))
