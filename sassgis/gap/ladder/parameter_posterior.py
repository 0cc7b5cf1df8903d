"""Which values of the parameters of a hypothesis the observed rocks leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.identifiability import (
    Fitted,
    TradeOff,
    fitted_parameters,
    trade_offs,
)
from sassgis.gap.calibration.parameters import CalibrationRange, ClassParameter
from sassgis.gap.calibration.search import (
    Posterior,
    SiteScores,
    keeping_configured,
    posterior_of,
    surface_of,
)
from sassgis.gap.causes.parameter_draws import ParameterDraws
from sassgis.gap.diagnosis import Range
from sassgis.gap.which.ensemble import BLIND, CalibrationProblem, Ensemble
from sassgis.gap.which.hypotheses import NONE, Draw, draw

#: Samples of which the values of parameters are computed.
_SAMPLES = 200
_SHARES = CalibrationRange(0.0, 1.0, False, "")


@dataclass(frozen=True, slots=True)
class ParameterPosterior:
    """Shares of the ranges of the parameters that the scores of the rocks leave.

    Attributes
    ----------
    names : tuple of str
        Those of ``Draw.parameter_draws`` that every draw of the hypothesis has.
    posterior : Posterior
        Its ``best`` keeps at the configured value what need not leave it.
    fitted : tuple of Fitted
        One for each name.
    trade_offs : tuple of TradeOff
    """

    names: tuple[str, ...]
    posterior: Posterior
    fitted: tuple[Fitted, ...]
    trade_offs: tuple[TradeOff, ...]

    @property
    def best(self) -> dict[str, float]:
        """Best parameter draws."""
        return dict(zip(self.names, np.clip(self.posterior.best, 0.0, 1.0).tolist(), strict=True))

    def intervals(self, problem: CalibrationProblem, chosen: Draw) -> Mapping[str, Range]:
        """95 % intervals of the parameters as they are reported; what is handed over is within."""
        families = () if chosen.effect == NONE else tuple(chosen.effect.split("+"))
        rng = np.random.default_rng([problem.seed, 91])
        step = max(1, len(self.posterior.samples) // _SAMPLES)
        found = [chosen.parameters]
        for shares in self.posterior.samples[::step].tolist():
            given = {**chosen.parameter_draws, **dict(zip(self.names, shares, strict=True))}
            found.append(draw(problem.case, families, ParameterDraws(rng, given)).parameters)
        out = {}
        for name, value in chosen.parameters.items():
            low, high = np.quantile([f[name] for f in found if name in f], [0.025, 0.975])
            out[name] = (min(float(low), value), max(float(high), value))
        return out


def parameter_posterior(
    problem: CalibrationProblem, ensemble: Ensemble, effect: str, fit: int
) -> ParameterPosterior | None:
    """Posterior of the parameters of a hypothesis by the rocks that have a say in a fit.

    The score of a group of rocks counts as one, as rocks of a group are not independent.

    Parameters
    ----------
    problem : CalibrationProblem
    ensemble : Ensemble
        With the effect refined.
    effect : str
    fit : int

    Returns
    -------
    ParameterPosterior or None
        None where nothing is scored or too few groups are left.
    """
    rocks = problem.rocks_of(fit)
    unit = np.unique(problem.case.group[rocks], return_inverse=True)[1]
    n = int(unit.max()) + 1
    if not problem.rows.shape[1] or n < 3:
        return None
    own = ensemble.of(effect) if fit == problem.n_parts else ensemble.of(effect, fit)
    # The blind ones first: they are spread evenly.
    own = own[np.argsort(ensemble.fit[own] != BLIND, kind="stable")]
    draws = [ensemble.tried[i].draw.parameter_draws for i in own.tolist()]
    names = tuple(k for k in draws[0] if "." in k and all(k in other for other in draws))
    points = np.array([[one[k] for k in names] for one in draws])
    scores = np.zeros((n, own.size))
    np.add.at(scores, unit, np.nan_to_num(ensemble.scores[np.ix_(own, rocks)]).T)
    parameters = tuple(
        ClassParameter(k.rpartition(".")[0], k.rpartition(".")[2], _SHARES, 0.5) for k in names
    )
    first = int((ensemble.fit[own] == BLIND).sum())
    surface = surface_of(
        points, [SiteScores(np.arange(len(names)), scores.T)], np.full(len(names), 0.5), first
    )
    posterior = posterior_of(surface, points, problem.seed)
    fitted = fitted_parameters(parameters, posterior)
    identified = np.array([f.identified for f in fitted])
    pairs = trade_offs(parameters, posterior)
    return ParameterPosterior(
        names, keeping_configured(surface, posterior, identified), fitted, pairs
    )
