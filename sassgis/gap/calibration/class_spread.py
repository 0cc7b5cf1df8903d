"""What calibrations of several sites say of a class: its mean, and its spread between sites.

Random effects: the value of a class at a site is normal about a mean with a standard deviation
between sites, and the calibration of the site has an error of its own. The mean has a flat prior,
the standard deviation a half-normal one, with the spread that was assumed before as its scale: two
sites alone hardly tell it (Gelman 2006; Röver 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sassgis.gap.calibration.class_calibration import Calibrated, CalibrationTask
from sassgis.gap.calibration.parameters import Prior, classes_met
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.model.ground import LIMITS
from sassgis.model.ground_ranges import ParameterRange, RangeRule, ranges_of

#: Nodes and weights of the quadrature over the standard deviation between sites, and its end in
#: prior scales.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(100)
_END = 6.0
#: Precision of the prior where the rocks of a site speak alone, and samples of what they leave.
_NO_PRIOR, _SAMPLES = 1e-3, 2000
#: Least error, as a share of the range: a value that is always at a limit is not known exactly.
_LEAST_ERROR = 0.02
#: Half of the middle 90 % of a normal distribution, in standard deviations.
_MIDDLE = 1.645


@dataclass(frozen=True, slots=True)
class SiteValue:
    """A parameter of a class as the rocks of one site alone tell it."""

    site: str
    class_name: str  # or another name of the description that sites share
    parameter: str
    value: float
    error: float  # standard error
    rocks: int


@dataclass(frozen=True, slots=True)
class BetweenSites:
    """Mean and spread of a parameter between sites."""

    mean: float  # of the sites there might be
    mean_error: float  # its standard error
    sd: float  # standard deviation between sites, posterior mean
    predictive_sd: float  # standard deviation of the value at a site that is not known yet


def between_sites(values: FloatArray, errors: FloatArray, scale: float) -> BetweenSites:
    """Posterior of mean and spread by quadrature.

    Parameters
    ----------
    values, errors : float64, shape (n_sites,)
    scale : float
        Of the half-normal prior of the standard deviation between sites.

    Raises
    ------
    InputError
        No values, or an error or a scale that is not above 0.
    """
    if not values.size or not (errors > 0.0).all() or not scale > 0.0:
        raise InputError(
            "the spread between sites cannot be told",
            found=f"{values.size} values, errors {errors.tolist()}, scale {scale:g}",
            expected="one value or more; errors and scale above 0",
        )
    # Denser towards 0, where a spread below the errors is told.
    root = 0.5 * (_NODES + 1.0)
    tau = _END * scale * root**2
    weight = 1.0 / (errors**2 + tau[:, None] ** 2)
    variance = 1.0 / weight.sum(axis=1)
    mean = variance * (weight * values).sum(axis=1)
    misfit = (weight * (values - mean[:, None]) ** 2).sum(axis=1)
    log_density = 0.5 * (
        np.log(weight).sum(axis=1) + np.log(variance) - misfit - (tau / scale) ** 2
    )
    density = _WEIGHTS * root * np.exp(log_density - log_density.max())
    density /= density.sum()
    centre = float(density @ mean)
    of_mean = float(density @ (variance + (mean - centre) ** 2))
    return BetweenSites(
        centre, of_mean**0.5, float(density @ tau), (of_mean + float(density @ tau**2)) ** 0.5
    )


def class_spread(
    found: Sequence[SiteValue], known: Sequence[ParameterRange]
) -> tuple[RangeRule, ...]:
    """Rows of a table of ranges: the middle 90 % of what a new site may have.

    ``known``: what was assumed before; parameters without such a range are left out.
    """
    rules = []
    for before in known:
        own = [
            v for v in found
            if (v.class_name, v.parameter) == (before.class_name, before.parameter)
        ]  # fmt: skip
        if not own:
            continue
        told = between_sites(
            np.array([v.value for v in own]), np.array([v.error for v in own]), before.sd
        )
        room = _MIDDLE * told.predictive_sd
        low, high = np.clip([told.mean - room, told.mean + room], *LIMITS[before.parameter])
        source = (
            f"Random effects over {', '.join(v.site for v in own)}: mean {told.mean:.3g} (standard "
            f"error {told.mean_error:.2g}), standard deviation between sites {told.sd:.2g} "
            f"(before: {before.sd:.2g})."
        )
        rules.append(
            RangeRule(
                before.class_name, before.parameter, "value", float(low), float(high), source,
                sites=len(own), rocks=sum(v.rocks for v in own),
            )
        )  # fmt: skip
    return tuple(rules)


def spread_of_sites(
    task: CalibrationTask, found: Calibrated, rules: Sequence[RangeRule]
) -> tuple[RangeRule, ...]:
    """What class_spread says of the calibrated classes; ``rules`` are those from before."""
    tables = {name: site.case.table for site in task.sites for name in site.case.table.names}
    known = [
        own
        for p in task.parameters
        for own in ranges_of(tables[p.class_name], [p.class_name], rules, [p.name])
    ]
    return class_spread(site_values(task, found), known)


def site_values(task: CalibrationTask, found: Calibrated) -> tuple[SiteValue, ...]:
    """Values that the rocks of each site alone leave, and their standard errors.

    What the rocks do not tell scatters over its range.
    """
    prior, out = Prior.of(task.parameters), []
    for k, (site, told) in enumerate(zip(task.sites, found.told, strict=True)):
        rng = np.random.default_rng([task.seed, 11, k])
        shares = prior.shares(rng.multivariate_normal(*told.estimate(_NO_PRIOR), _SAMPLES))
        met = classes_met(site.case)
        for j, p in enumerate(task.parameters):
            if p.class_name in met:
                values = p.value(shares[:, j])
                error = max(float(values.std()), _LEAST_ERROR * (p.limits.high - p.limits.low))
                value = float(values.mean())
                out.append(SiteValue(site.name, p.class_name, p.name, value, error, site.n_rocks))
    return tuple(out)
