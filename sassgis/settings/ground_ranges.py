"""How far the parameters of ground classes lie apart between sites, and classes with other values.

A range is what the middle 90 % of the sites have that are known by the description of the class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sassgis.errors import InputError
from sassgis.settings.ground import LIMITS, PARAMETERS, GroundTable
from sassgis.settings.settings import EngineSettings

#: What stands for every class without a separate range.
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
                        name, parameter, value, low, high, rule.source, rule.verified, rule.sites,
                        rule.rocks, rule.together,
                    )
                )  # fmt: skip
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
