"""The law of the contact as the recorded contacts have it, class by class.

Restitution, the speed at which it has halved, friction, what the ground holds back and a loss that
grows with the speed make smooth, monotone functions of normal speed, speed along the ground and
angle of an impact. They are learned from single contacts, each predicted from the state that was
observed before it, and shrunk towards the values of the class. What a class without contacts is
taken to be follows the others half way. Spins have a factor and a scatter besides, the same for all
classes: blocks do not turn in the plane of their path alone.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from sassgis.gap.calibration.impact_scores import (
    impact_scores,
    observed_impacts,
    observed_outcomes,
    simulated_outcomes,
)
from sassgis.gap.calibration.parameters import ClassParameter
from sassgis.gap.causes.parameter_draws import Range, rounded
from sassgis.gap.observations.case import Case, LearnedContacts
from sassgis.gap.replicas.hypothesis_model import HypothesisModel, MeasurementError
from sassgis.gap.residuals.one_step import ImpactsInFlight
from sassgis.model.effects import EffectSettings
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundClass, GroundTable

#: Ranges of the parameters of a contact, and how far those of one class lie from site to site
#: (standard deviation, as a share of the range): wide, as other laws are to be met.
_RANGES = {
    "eta_max": (Range(0.0, 1.0), 0.15),
    "mu_f": (Range(0.02, 1.5), 0.17),
    "restitution": (Range(0.0, 1.0), 0.25),
    "restitution_speed_mps": (Range(0.5, 200.0, "log"), 0.13),
    "mu_v": (Range(0.0, 0.05), 0.1),
}
#: Standard deviation of the logarithm of the factor of the spins.
_SPIN_SD = 0.2
#: Relative scatters of the spins that are tried.
_SPIN_NOISES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8)
#: Contacts and rocks from which on a class is learned, and contacts of it that are used at most.
_FEWEST, _FEWEST_ROCKS, _MOST = 20, 5, 250
#: Values that are tried first, of twice the usual spread, and evaluations of the search after it.
_TRIED, _SEARCHED = 32, 90


def learned_contacts(case: Case, seed: int) -> LearnedContacts | None:
    """Contacts as observed; None where too few were recorded.

    Only the law of impact with restitution has these parameters.
    """
    if case.engine.resolved().eta_max_rule != "restitution":
        return None
    impacts = observed_impacts(case)
    if impacts is None:
        return None
    known: dict[int, FloatArray] = {}
    counts: list[int] = []
    for k in np.unique(impacts.kind).tolist():
        rows = np.flatnonzero(impacts.kind == k)
        if rows.size >= _FEWEST and np.unique(impacts.rock[rows]).size >= _FEWEST_ROCKS:
            few = rows[np.linspace(0, rows.size - 1, min(rows.size, _MOST)).astype(np.int64)]
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
    return LearnedContacts(table, scale, min(_SPIN_NOISES, key=loss))


def _misfit(
    case: Case,
    impacts: ImpactsInFlight,
    observed: FloatArray,
    table: GroundTable,
    error: MeasurementError,
    seed: int,
) -> float:
    """Mean score of the rocks that have impacts."""
    # The same draws for all values: what differs is no luck.
    model = HypothesisModel(table, EffectSettings(), measurement=error)
    made = simulated_outcomes(case, model, impacts, seed=seed, number=3700)
    scores = impact_scores(impacts, observed, made, case.n_rocks)
    return float(scores[np.unique(impacts.rock)].mean())


def _learned(case: Case, impacts: ImpactsInFlight, kind: int, seed: int) -> FloatArray:
    """Shift of the parameters of a class from the configured ones, and of the spins.

    In usual spreads, shape (n + 1,).
    """
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
    tried = [np.zeros(d), *normal.random(_TRIED)]
    best = min(tried, key=loss)
    simplex = np.vstack([best, best + 0.7 * np.eye(best.size)])
    found = minimize(
        loss, best, method="Nelder-Mead",
        options={"maxfev": _SEARCHED, "initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-4},
    )  # fmt: skip
    return np.asarray(found.x)


def _spin_scale(shift: float) -> float:
    return rounded(math.exp(_SPIN_SD * shift))


def _with_shift(ground: GroundClass, shift: FloatArray) -> GroundClass:
    """A class with shifted parameters of the contact, kept within their ranges."""
    values = {}
    for (name, (limits, sd)), own in zip(_RANGES.items(), shift[:-1].tolist(), strict=True):
        one = ClassParameter(ground.name, name, limits, float(getattr(ground, name)))
        share = min(max(one.share(one.configured) + sd * own, 0.0), 1.0)
        values[name] = rounded(float(one.value(share)))
    return replace(ground, **values)  # type: ignore[arg-type]
