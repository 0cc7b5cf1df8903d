"""Parameters of ground classes that can be calibrated, their ranges, and tables made of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sassgis.gap.causes.parameter_draws import Range
from sassgis.gap.observations.case import Case
from sassgis.model.errors import InputError
from sassgis.model.grid import FloatArray
from sassgis.model.ground import GroundTable
from sassgis.model.ground_ranges import RangeRule, ranges_of, with_values
from sassgis.model.settings import EngineSettings

#: Digits of shares of ranges.
_SHARE_DIGITS = 9
#: Ground further down than this many times the furthest observed run-out is not calibrated.
_BEYOND = 1.5
#: Share of the length of the fall lines below which a class is not calibrated.
_LEAST_SHARE = 0.02
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
        """Class and parameter in one word; the parameter alone if it is of no class."""
        return f"{self.class_name}.{self.name}" if self.class_name else self.name

    def value(self, share: FloatArray | float) -> FloatArray:
        """Values at shares of the range."""
        own, log = self.limits, self.limits.scale == "log"
        low, high = (np.log(own.low), np.log(own.high)) if log else (own.low, own.high)
        at = low + (high - low) * np.asarray(share, np.float64)
        return np.exp(at) if log else at

    def share(self, value: float) -> float:
        """Share of the range at which a value lies; above 1 beyond it."""
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
    """Names of the parameters to calibrate: all that the engine reads, or those asked for.

    Raises
    ------
    InputError
        If one of them cannot be calibrated.
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


def classes_met(case: Case) -> tuple[str, ...]:
    """Classes on the fall lines of the rocks, as far down as rocks can have come."""
    stops = case.projected["deposits"].s if "deposits" in case.projected else np.empty(0)
    known = np.concatenate([case.station_s.ravel(), stops])
    known = known[np.isfinite(known)]
    length = np.zeros(len(case.table.classes))
    if "impacts" in case.projected:
        rock, s = case.observations.rock_of("impacts"), case.projected["impacts"].s
        own = (rock >= 0) & np.isfinite(s)
        kind, _ = case.ground_at(rock[own], s[own])
        np.add.at(length, kind[kind >= 0], 1.0)
    # Impacts alone say nothing of ground without any.
    limit = _BEYOND * float(known.max()) if known.size else 0.0
    for line in np.unique(case.line).tolist():
        first, last = (int(v) for v in case.profiles.offset[line : line + 2])
        ends_s = np.clip(case.profiles.s[first:last], 0.0, limit)
        np.add.at(length, case.profiles.ground[first : last - 1], np.diff(ends_s))
    return tuple(
        c.name
        for c, own in zip(case.table.classes, length.tolist(), strict=True)
        if own > _LEAST_SHARE * length.sum()
    )


def _reads(engine: EngineSettings, name: str) -> bool:
    """Whether the engine reads a parameter of ground classes in these settings."""
    if name == "restitution":
        return engine.eta_max_rule == "restitution"
    return name != "rolling_threshold" or engine.rolling_threshold is None


def parameters_of(
    table: GroundTable, class_names: Sequence[str], names: Sequence[str], rules: Sequence[RangeRule]
) -> tuple[ClassParameter, ...]:
    """The parameters of some classes, class by class; ``rules`` give the spread between sites."""
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
    """A table with the calibrated parameters at shares of their ranges.

    Classes that the table does not have are passed over: they are of another site.
    """
    pairs = zip(parameters, shares.tolist(), strict=True)
    return with_values(
        table,
        {
            (p.class_name, p.name): float(p.value(share))
            for p, share in pairs
            if p.class_name in table.names
        },
    )


@dataclass(frozen=True, slots=True)
class Prior:
    """Normal about the configured values; beyond the limits of the search lies the limit itself.

    It keeps what the observations say nothing about where it was configured, as near as such values
    lie together from site to site.
    """

    centre: FloatArray  # shape (d,), as the standard deviation; shares of the ranges
    sd: FloatArray

    @staticmethod
    def of(parameters: Sequence[ClassParameter]) -> Prior:
        """The prior of some parameters."""
        return Prior(np.array([p.start for p in parameters]), np.array([p.sd for p in parameters]))

    def shares(self, normal: FloatArray) -> FloatArray:
        """Shares of parameters of which the prior is standard normal, shape (..., d)."""
        # The last digits of linear algebra depend on where its arrays lie in memory.
        shares = np.round(self.centre + self.sd * normal, _SHARE_DIGITS)
        return np.asarray(np.clip(shares, 0.0, 1.0), np.float64)
