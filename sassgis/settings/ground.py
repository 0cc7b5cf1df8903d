"""Ground classes of Bozzolo and Pamini (1986) and later ones, and ranges of their parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sassgis.errors import InputError
from sassgis.settings.settings import EngineSettings

#: How far values may be trusted, the most first, and how maps, report and warnings call that.
Trust = Literal["paper", "fitted", "estimate"]
TRUST_TEXT: Mapping[Trust, str] = {
    "paper": "from a paper, what it leaves open chosen within its ranges",
    "fitted": "fitted to field sites",
    "estimate": "estimate",
}
#: What the built-in classes are, from the hardest to the softest.
CLASS_MEANINGS: Mapping[str, str] = {
    "asphalt": "paved road",
    "rock": "bare rock",
    "talus": "coarse blocks below a cliff",
    "debris": "scree and small fragments, gullies",
    "overgrown_slope": "soil with grass and shrubs",
    "forest_soil": "soil under trees (trees themselves: effects.trees)",
    "soft_meadow": "alpine meadow on deep soil",
}
#: Between which each number among the attributes of GroundClass must lie.
LIMITS = {
    "eta_max": (0.0, 1.0),
    "dp_min": (0.0, 1.0),
    "dp_max": (0.0, 1.0),
    "mu_f": (0.0, 10.0),
    "mu_0": (0.0, 10.0),
    "k": (0.0, 10.0),
    "d_star_m": (0.0, 100.0),
    "restitution": (0.0, 1.0),
    "restitution_speed_mps": (0.1, 1e6),
    "rolling_threshold": (0.0, 10.0),
    "mu_v": (0.0, 1.0),
}
#: Parameters of a ground class.
PARAMETERS = tuple(LIMITS)
_ROW_DTYPE = np.dtype([(name, np.float64) for name in PARAMETERS])


@dataclass(frozen=True, slots=True)
class GroundClass:
    """One kind of ground.

    Attributes
    ----------
    eta_max : float
        Readings "1986": largest share of the kinetic energy kept in an impact, 0 to 1 (equation 7).
        Else 1 − η_max is the impulse against the way over the normal impulse: impact.held_back.
    dp_min, dp_max : float
        Limits of the relative slope variation Δp/p met at an impact (Table 1).
    mu_f : float
        Sliding friction (equation 1).
    mu_0, k, d_star_m : float
        Rolling friction μ_r = μ_0 + k d*/d (equation 2); d*: diameter of the ground's blocks (m).
    restitution : float
        Coefficient of restitution e of the contact, 0 to 1, at a low speed.
    restitution_speed_mps : float
        Normal speed v of the contact at which it has halved: e/(1 + (v_n/v)²) (m/s). Default
        9.144, Pfeiffer and Bowen (1989) as coded in PlatRock (Common/BounceModels.py).
    rolling_threshold : float
        A block lands softly and rolls where v_n²/(2 g cos β) is below this share of its radius.
    mu_v : float
        The ground also resists with μ_v v²/(g d) times the normal force, d the diameter of the
        block: engine.resistance. 0: it does not.
    source : str
        Where the values come from.
    trust : {"paper", "fitted", "estimate"}
        Whether every value was read in the source that is named, was fitted to observed blocks of
        one site, or neither.
    """

    name: str
    _: KW_ONLY
    eta_max: float
    dp_min: float
    dp_max: float
    mu_f: float
    mu_0: float
    k: float
    d_star_m: float
    restitution: float = 0.0
    restitution_speed_mps: float = 9.144
    rolling_threshold: float = 0.1
    mu_v: float = 0.0
    source: str = ""
    trust: Trust = "estimate"

    def __post_init__(self) -> None:
        """Raise InputError where a value is outside what the model can take."""
        wrong = partial(InputError, f"ground class {self.name!r} cannot be used")
        for field, (low, high) in LIMITS.items():
            value = getattr(self, field)
            if not (np.isfinite(value) and low <= value <= high):
                expected = f"a number from {low:g} to {high:g}"
                raise wrong(field=field, found=value, expected=expected)
        if self.dp_min > self.dp_max:
            found = f"dp_min {self.dp_min:g} above dp_max {self.dp_max:g}"
            raise wrong(field="dp_min", found=found, expected="dp_min <= dp_max")


@dataclass(frozen=True, slots=True)
class GroundTable:
    """The ground classes of a run; a class is referred to by its position here."""

    classes: tuple[GroundClass, ...]

    def __post_init__(self) -> None:
        names = [c.name for c in self.classes]
        if not names:
            raise InputError("no ground class is defined", expected="at least one")
        doubled = sorted({n for n in names if names.count(n) > 1})
        if doubled:
            raise InputError("ground classes are defined twice", found=", ".join(doubled))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.classes)

    def index(self, name: str) -> int:
        """Return the position of a class; InputError if there is none of that name."""
        try:
            return self.names.index(name)
        except ValueError:
            raise InputError(
                "unknown ground class", found=repr(name), expected="one of " + ", ".join(self.names)
            ) from None

    def with_rolling_threshold(self, threshold: float | None) -> GroundTable:
        """Return the same classes with one rolling threshold, if there is one for all."""
        if threshold is None:
            return self
        return GroundTable(tuple(replace(c, rolling_threshold=threshold) for c in self.classes))

    def rows(self) -> NDArray[np.void]:
        """Return the parameters as a structured array, a field for each; shape (n_classes,)."""
        rows = np.zeros(len(self.classes), _ROW_DTYPE)
        for name in PARAMETERS:
            rows[name] = [getattr(c, name) for c in self.classes]
        return rows


#: What represents every class without a separate range.
EVERY_CLASS = "*"
#: dp_min goes with dp_max: they are the limits of one spread.
RANGED = tuple(p for p in PARAMETERS if p != "dp_min")


@dataclass(frozen=True, slots=True)
class RangeRule:
    """How the range of a parameter follows from its value."""

    class_name: str  # EVERY_CLASS for classes without a separate rule
    parameter: str  # one of RANGED
    # What ``low`` and ``high`` are: the limits themselves, or added to the value of the class, or
    # multiplied with it.
    kind: Literal["value", "offset", "factor"]
    low: float
    high: float
    source: str = ""
    verified: bool = False  # whether the range was read in the source
    sites: int = 0  # sites that stand behind the range; 0: an assumption
    rocks: int = 0  # rocks observed at them
    # Parameters of a class that have the same word here go up and down together, one with a minus
    # before it against them; without a word each by itself.
    together: str = ""

    def __post_init__(self) -> None:
        """Raise InputError where the limits are reversed."""
        if self.low > self.high:
            problem = f"range of {self.class_name} {self.parameter} is reversed"
            found = f"{self.low:g} above {self.high:g}"
            raise InputError(problem, field="low", found=found, expected="low <= high")

    def limits(self, value: float) -> tuple[float, float]:
        """Return the limits for a value, which always lies within them."""
        low, high = self.low, self.high
        if self.kind == "offset":
            low, high = value + low, value + high
        elif self.kind == "factor":
            low, high = value * low, value * high
        return min(low, value), max(high, value)


@dataclass(frozen=True, slots=True)
class ParameterRange:
    """The range of one parameter of one class."""

    class_name: str
    parameter: str
    value: float
    low: float
    high: float
    source: str
    verified: bool
    sites: int = 0  # this and the following as in RangeRule
    rocks: int = 0
    together: str = ""

    @property
    def label(self) -> str:
        """Class and parameter."""
        return f"{self.class_name}: {self.parameter}"

    @property
    def sd(self) -> float:
        """Standard deviation between sites: 90 % of a normal distribution lie within 3.29 of it."""
        return (self.high - self.low) / 3.29


def ranges_of(
    table: GroundTable,
    classes: Sequence[str],
    rules: Sequence[RangeRule],
    parameters: Sequence[str] = RANGED,
) -> tuple[ParameterRange, ...]:
    """Return ranges of some parameters of some classes; those without width are left out.

    A rule of the class goes before one of EVERY_CLASS, a later rule before an earlier one.
    """
    by_key = {(r.class_name, r.parameter): r for r in rules}
    out = []
    for name in classes:
        own = table.classes[table.index(name)]
        for parameter in parameters:
            rule = by_key.get((name, parameter)) or by_key.get((EVERY_CLASS, parameter))
            if rule is None:
                continue
            value = float(getattr(own, parameter))
            low, high = (float(np.clip(v, *LIMITS[parameter])) for v in rule.limits(value))
            if high > low:
                out.append(
                    ParameterRange(
                        class_name=name,
                        parameter=parameter,
                        value=value,
                        low=low,
                        high=high,
                        source=rule.source,
                        verified=rule.verified,
                        sites=rule.sites,
                        rocks=rule.rocks,
                        together=rule.together,
                    )
                )
    return tuple(out)


def acting(engine: EngineSettings) -> tuple[str, ...]:
    """Return parameters that the readings of the engine use."""
    given = engine.resolved()
    rebound = ["restitution", "restitution_speed_mps", "mu_v"]
    idle = [] if given.eta_max_rule == "restitution" else rebound
    if given.rolling_threshold is not None:
        idle.append("rolling_threshold")
    return tuple(p for p in RANGED if p not in idle)


def with_values(table: GroundTable, values: Mapping[tuple[str, str], float]) -> GroundTable:
    """Return the classes with other values of some parameters, by class and parameter."""
    changed: dict[str, dict[str, float]] = {}
    for (name, parameter), value in values.items():
        own = table.classes[table.index(name)]
        changed.setdefault(name, {})[parameter] = value
        if parameter == "dp_max":
            share = value / own.dp_max if own.dp_max > 0.0 else 0.0
            changed[name]["dp_min"] = own.dp_min * share
    return GroundTable(
        tuple(replace(c, **changed.get(c.name, {})) for c in table.classes)  # type: ignore[arg-type]
    )
