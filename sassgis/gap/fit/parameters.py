"""Parameters of ground classes that can be calibrated, and the law of recorded contacts.

Of contacts, restitution, the speed at which it has halved, friction, what the ground holds back and
a loss that grows with the speed make smooth, monotone functions of normal speed, speed along the
ground and angle of an impact. They are learned from single contacts, each predicted from the state
that was observed before it, and shrunk towards the values of the class. What a class without
contacts is taken to be follows the others half way. Spins have a factor and a scatter besides, the
same for all classes: blocks do not turn in only the plane of their path.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from sassgis.errors import InputError
from sassgis.gap.causes.cause import Range, rounded
from sassgis.gap.constants import (
    LAW_SEARCHED,
    LAW_TRIED,
    LEARNED_CONTACTS,
    LEARNED_ROCKS,
    MOST_CONTACTS,
    SHARE_DIGITS,
    SPIN_LOG_SD,
    SPIN_NOISES,
)
from sassgis.gap.fit.site_data import (
    impact_scores,
    observed_impacts,
    observed_outcomes,
    simulated_outcomes,
)
from sassgis.gap.forward.hypothesis_model import HypothesisModel, MeasurementError
from sassgis.gap.observations.case import Case, LearnedContacts
from sassgis.gap.residuals.impact_residuals import ImpactsInFlight
from sassgis.grid import FloatArray
from sassgis.settings.effects import EffectSettings
from sassgis.settings.ground import GroundClass, GroundTable
from sassgis.settings.ground_ranges import RangeRule, ranges_of, with_values
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

    def share(self, value: float) -> float:
        """Return the share of the range at which a value lies; above 1 beyond it."""
        own = self.limits
        if own.scale == "log":
            return float(np.log(max(value, own.low) / own.low) / np.log(own.high / own.low))
        return (value - own.low) / (own.high - own.low)

    @property
    def spread(self) -> float:
        """Standard deviation of the prior in the unit of the parameter, at the configured value."""
        at = self.start + np.array([-0.5, 0.5]) * self.sd
        return float(np.ptp(self.value(at)))

    @property
    def start(self) -> float:
        """Share of the range at which the configured value lies; the nearer limit if outside."""
        return min(max(self.share(self.configured), 0.0), 1.0)


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
                low, high = one.share(between.low), one.share(between.high)
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
        share = min(max(one.share(one.configured) + sd * own, 0.0), 1.0)
        values[name] = rounded(float(one.value(share)))
    return replace(ground, **values)  # type: ignore[arg-type]
